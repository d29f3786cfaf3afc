"""Frames of a PDO that bring the data of the one before."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass


class Runs(NamedTuple):
    """Frames of a block, at least one, in runs of equal data.

    Attributes:
        first, last: their data.
        repeated: how many bring the data of the one before.
        head, longest, tail: frames in the first run, in the longest between two changes, and in the
            last, 0 where that is the first.
    """

    first: int
    last: int
    repeated: int
    head: int
    longest: int
    tail: int

    @classmethod
    def of(cls, words: NDArray[np.uint64]) -> "Runs":
        """Of frames by their eight data bytes as one word each; (n,)."""
        starts = np.flatnonzero(words[1:] != words[:-1]) + 1
        first, last = words[[0, -1]].view(np.int64).tolist()
        if not len(starts):
            return cls(first, last, len(words) - 1, len(words), 0, 0)
        longest = int((starts[1:] - starts[:-1]).max(initial=0))
        head, tail = int(starts[0]), len(words) - int(starts[-1])
        return cls(first, last, len(words) - 1 - len(starts), head, longest, tail)


@dataclass(slots=True)
class Repeats:
    """Counts them, and the most in a row."""

    count: int = 0
    longest: int = 0
    """Frames in a row with the same data, the first of them included."""
    _last: int | None = None
    _run: int = 0

    def add(self, runs: Runs) -> None:
        """Take in the frames of a block."""
        first, self._last = self._last == runs.first, runs.last
        self.count += runs.repeated + first
        run = self._run * first
        self._run = runs.tail or run + runs.head
        self.longest = max(self.longest, run + runs.head, runs.longest, self._run)
