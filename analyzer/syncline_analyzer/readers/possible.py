"""Frames that cannot be, of damaged binary logs, taken out and counted."""

import numpy as np

from syncline_analyzer.capture import MAX_UNREAD, CaptureFacts, Unread
from syncline_schemas.batch import FrameBatch, FrameFlag

_STANDARD, _EXTENDED = 0x7FF, 0x1FFFFFFF


def possible(frames: FrameBatch, facts: CaptureFacts) -> FrameBatch:
    """The frames without those of an identifier or a length that there is not; they are counted."""
    if not len(frames):
        return frames
    width = frames.data.shape[1]
    if int(frames.can_id.max()) <= _STANDARD and int(frames.dlc.max()) <= width:
        return frames
    wide = (frames.flags & (FrameFlag.EXTENDED | FrameFlag.ERROR)) != 0
    wrong = frames.can_id > np.where(wide, np.uint32(_EXTENDED), np.uint32(_STANDARD))
    wrong |= frames.dlc > width
    if not wrong.any():
        return frames
    facts.unparsed_count += int(np.count_nonzero(wrong))
    for row in np.flatnonzero(wrong)[:MAX_UNREAD].tolist():
        around = frames.t_ns[max(row - 1, 0) : row + 2]
        facts.add_unread(Unread(int(around.min()), int(around.max()), 1))
    return frames[~wrong]
