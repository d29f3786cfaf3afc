"""Frames of a PDO that bring the data of the one before."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass


@dataclass(slots=True)
class Repeats:
    """Counts them, and the most in a row."""

    count: int = 0
    longest: int = 0
    """Frames in a row with the same data, the first of them included."""
    _last: int | None = None
    _run: int = 0

    def add(self, words: NDArray[np.uint64], repeated: int) -> None:
        """Take in the eight data bytes of frames in order, at least one, each as one word; (n,).

        So many of them are `repeated`, the first one aside.
        """
        first, self._last = self._last == int(words[0]), int(words[-1])
        self.count += repeated + first
        run = self._run * first
        if repeated == len(words) - 1:
            self._run = run + len(words)
        elif not repeated:
            self.longest = max(self.longest, run + 1)
            self._run = 1
        else:
            starts = np.flatnonzero(words[1:] != words[:-1]) + 1
            longest = int((starts[1:] - starts[:-1]).max(initial=0))
            self.longest = max(self.longest, run + int(starts[0]), longest)
            self._run = len(words) - int(starts[-1])
        self.longest = max(self.longest, self._run)
