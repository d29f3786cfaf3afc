"""A source in the recorder's own process that gives numbered frames at a rate and tells of each."""

import time
from collections.abc import Callable

import numpy as np

from syncline_logger.batcher import FrameBuffer
from syncline_logger.source import SourceFacts
from syncline_schemas.batch import FrameBatch

COB_ID = 0x185
LONGEST_READ_S = 0.02


class NumberedSource:
    """Frames 0, 1, 2 ... `rate` of them a second, given as time passes.

    Args:
        rate: [frames/s].
        told: called after frames were given, with the time [ns, UTC] before that and their number.
    """

    def __init__(self, rate: float, told: Callable[[int, int], None]) -> None:
        self.facts = SourceFacts("a", "numbered", str(rate), bitrate=1_000_000)
        self._rate = rate
        self._told = told
        self._start = time.monotonic()
        self.given = 0

    def open(self) -> None:
        """Begin to count."""
        self._start = time.monotonic()

    def fileno(self) -> int | None:
        """It is read by a thread of its own."""
        return None

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        """Give what is due; waits a little where nothing is."""
        due = int((time.monotonic() - self._start) * self._rate) - self.given
        if due <= 0:
            time.sleep(min(timeout_s, LONGEST_READ_S, 1 / self._rate))
            return 0
        due = min(due, 10_000)
        now_ns = time.time_ns()
        buffer.extend(numbered(self.given, due, now_ns, bus))
        self.given += due
        self._told(now_ns, self.given)
        time.sleep(min(timeout_s, LONGEST_READ_S))
        return due

    def close(self) -> None:
        """Nothing to close."""


def numbered(first: int, count: int, t_ns: int, bus: int = 0) -> FrameBatch:
    """Frames with these numbers in their data, all of one time."""
    number = np.arange(first, first + count, dtype="<u8")
    return FrameBatch(
        np.full(count, t_ns, np.int64),
        np.full(count, bus, np.uint8),
        np.full(count, COB_ID, np.uint32),
        np.zeros(count, np.uint16),
        np.full(count, 8, np.uint8),
        number.view(np.uint8).reshape(-1, 8).copy(),
    )
