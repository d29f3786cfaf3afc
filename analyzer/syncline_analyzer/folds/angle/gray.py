"""Whether counts are Gray code read as binary, or binary read as Gray code."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.measurement import count_steps
from syncline_schemas.records import dataclass

LEAST = 100
"""Moving samples from which on it is judged."""
ROUGHER = 20.0
"""The counts as sent must be so many times as uneven as the converted ones."""


@dataclass(slots=True)
class GrayTest:
    """Unevenness of a motion as sent, and as it would be in the other code.

    At steady turning the differences of binary counts hardly change; those of counts in the wrong
    code jump by powers of two (sheet skbis-lir-canopen.md, trap 23).
    """

    moving: int = 0
    as_sent: float = 0.0
    from_gray: float = 0.0
    to_gray: float = 0.0
    found: str | None = None
    """The mismatch of a stretch before, with other settings."""

    def rescaled(self) -> None:
        """The settings were written: what comes next is judged by itself."""
        self.found = self.mismatch
        self.moving, self.as_sent, self.from_gray, self.to_gray = 0, 0.0, 0.0, 0.0

    def add(self, raw: NDArray[np.int64], range_counts: int | None) -> None:
        """Take in raw values (n,) of an unbroken piece."""
        if range_counts is None or range_counts & (range_counts - 1) or len(raw) < 3:
            return
        counts = raw % range_counts
        self.moving += int(np.count_nonzero(np.diff(counts)))
        self.as_sent += _unevenness(counts, range_counts)
        self.from_gray += _unevenness(from_gray(counts), range_counts)
        self.to_gray += _unevenness(counts ^ counts >> 1, range_counts)

    @property
    def mismatch(self) -> str | None:
        """ "gray" where Gray code is sent as counts, "binary" where binary was converted."""
        if self.found is not None or self.moving < LEAST:
            return self.found
        better = min(self.from_gray, self.to_gray)
        if self.as_sent <= ROUGHER * max(better, 1.0):
            return None
        return "gray" if self.from_gray <= self.to_gray else "binary"


def _unevenness(counts: NDArray[np.int64], range_counts: int) -> float:
    steps = count_steps(counts, range_counts)
    return float(np.abs(np.diff(steps)).sum())


def from_gray(code: NDArray[np.int64]) -> NDArray[np.int64]:
    """Binary numbers of Gray code.

    >>> from_gray(np.array([0, 1, 3, 2, 6])).tolist()
    [0, 1, 2, 3, 4]
    """
    number = code.copy()
    for shift in (1, 2, 4, 8, 16, 32):
        number ^= number >> shift
    return number
