"""What happens to a running recording, note by note, for who wants to know at once: its own log."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from syncline_schemas.batch import Gap
from syncline_schemas.wording import counted


@dataclass(frozen=True, slots=True)
class Note:
    """Something happened.

    Attributes:
        log_ns: when it became known [ns, log time].
        text: what; with its own times where those are others.
        bus: name of the bus, empty where it is none's.
        serious: data may be missing by it.
    """

    log_ns: int
    text: str
    bus: str = ""
    serious: bool = False

    def __str__(self) -> str:
        """Words for a line."""
        return f"{self.bus}: {self.text}" if self.bus else self.text


OnNote = Callable[[Note], None]


def utc_text(t_ns: int) -> str:
    """A moment as the log and the notes write it.

    >>> utc_text(1_500_000_000)
    '1970-01-01T00:00:01.500Z'
    """
    return f"{np.datetime_as_string(np.datetime64(t_ns, 'ns'), unit='ms')}Z"


def gap_text(gap: Gap) -> str:
    """Words for a gap; times are UTC.

    >>> gap_text(Gap(1_000_000_000, 3_500_000_000, "bus-off", 2))
    'not heard from 1970-01-01T00:00:01.000Z to 00:00:03.500Z (2.500 s): bus-off; 2 frames lost'
    """
    lost = "" if gap.lost_frames is None else f"; {counted(gap.lost_frames, 'frame')} lost"
    begin, end = utc_text(gap.start_ns), utc_text(gap.end_ns)
    same_day = begin[:11] == end[:11]
    span_s = (gap.end_ns - gap.start_ns) / 1e9
    return (
        f"not heard from {begin} to {end[11:] if same_day else end} ({span_s:.3f} s):"
        f" {gap.reason or 'reason not known'}{lost}"
    )
