"""Frames that cannot be, of damaged binary logs, taken out and counted."""

import numpy as np

from syncline_analyzer.capture import MAX_UNREAD, CaptureFacts, Unread
from syncline_schemas.batch import FrameBatch, FrameFlag

_STANDARD, _EXTENDED = 0x7FF, 0x1FFFFFFF
_CLASSIC = 8
"""Bytes that a remote frame asks for at most: CAN FD has none."""


def possible(frames: FrameBatch, facts: CaptureFacts) -> FrameBatch:
    """The frames without those of an identifier or a length that there is not; they are counted."""
    if not len(frames):
        return frames
    if int(frames.can_id.max()) <= _STANDARD and int(frames.dlc.max()) <= _CLASSIC:
        return frames
    wide = (frames.flags & (FrameFlag.EXTENDED | FrameFlag.ERROR)) != 0
    wrong = frames.can_id > np.where(wide, np.uint32(_EXTENDED), np.uint32(_STANDARD))
    # Columns are wider where frames beside it have more data: that must not change what it is.
    remote = (frames.flags & FrameFlag.REMOTE) != 0
    wrong |= frames.dlc > np.where(remote, _CLASSIC, frames.data.shape[1])
    if not wrong.any():
        return frames
    facts.unparsed_count += int(np.count_nonzero(wrong))
    for row in np.flatnonzero(wrong)[:MAX_UNREAD].tolist():
        around = frames.t_ns[max(row - 1, 0) : row + 2]
        facts.add_unread(Unread(int(around.min()), int(around.max()), 1))
    return frames[~wrong]
