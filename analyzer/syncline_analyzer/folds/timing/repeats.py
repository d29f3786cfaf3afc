"""Frames of a PDO that bring the data of the one before."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(slots=True)
class Repeats:
    """Counts them, and the most in a row."""

    count: int = 0
    longest: int = 0
    """Frames in a row with the same data, the first of them included."""
    _last: bytes = b""
    _run: int = 0

    def add(self, data: NDArray[np.uint8]) -> None:
        """Take in the data of frames in order; (n, 8)."""
        line = np.ascontiguousarray(data).view(np.uint64)[:, 0]
        same = np.concatenate(([self._last == data[0].tobytes()], line[1:] == line[:-1]))
        self._last = data[-1].tobytes()
        self.count += int(np.count_nonzero(same))
        starts = np.flatnonzero(~same)
        if not len(starts):
            self._run += len(same)
        else:
            lengths = np.diff(starts, append=len(same))
            self.longest = max(self.longest, self._run + int(starts[0]), int(lengths.max()))
            self._run = int(lengths[-1])
        self.longest = max(self.longest, self._run)
