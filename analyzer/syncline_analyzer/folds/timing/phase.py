"""Which of n SYNCs a PDO answers that is sent with every n-th."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(slots=True)
class Phase:
    """Counts the answers by the number of their SYNC, modulo n; another n begins anew.

    `basis` tells what numbers the SYNCs: their counter, or the first one of the capture.
    """

    every: int = 0
    basis: str = ""
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def add(self, number: NDArray[np.int64], every: int, basis: str) -> None:
        """Take in the numbers of the SYNCs that were answered."""
        if (every, basis) != (self.every, self.basis):
            self.every, self.basis, self.counts = every, basis, np.zeros(every, np.int64)
        self.counts += np.bincount(number % every, minlength=every)

    def usual(self) -> tuple[int, float] | None:
        """(remainder, share of the answers that have it); None without answers."""
        total = int(self.counts.sum())
        if not total:
            return None
        best = int(self.counts.argmax())
        return best, int(self.counts[best]) / total
