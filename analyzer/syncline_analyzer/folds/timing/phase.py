"""Which of n SYNCs a PDO answers that is sent with every n-th."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

UNTOLD = 240
"""Most n that are inferred from the frames divide it, so n need not be known beforehand."""


class UsualPhase(NamedTuple):
    """Remainder modulo n of the SYNCs that are answered, its share, and what numbers them."""

    remainder: int
    share: float
    basis: str


def _none() -> NDArray[np.int64]:
    return np.zeros(0, np.int64)


@dataclass(slots=True)
class Phase:
    """Counts the answers by the number of their SYNC, modulo `every`; another one begins anew.

    SYNCs have two numbers: that of their counter, and that from the first SYNC of the capture on,
    which says nothing over a gap.
    """

    every: int = 0
    by_counter: NDArray[np.int64] = field(default_factory=_none)
    by_place: NDArray[np.int64] = field(default_factory=_none)

    def add_counts(self, every: int, counts: NDArray[np.int64]) -> None:
        """Take in how many SYNCs of each number modulo `every` were answered; none has a counter."""
        self._begin(every)
        self.by_place += counts

    def add(self, every: int, at: NDArray[np.int64], sync: SyncIndex) -> None:
        """Take in the positions of the SYNCs that were answered; (n,)."""
        self._begin(every)
        if sync.counted:
            counter = sync.counter[at]
            self.by_counter += np.bincount(counter[counter > 0] % every, minlength=every)
        times = np.bincount(at)
        shift = sync.first_ordinal % every
        times = np.concatenate((np.zeros(shift, np.int64), times))
        times = np.concatenate((times, np.zeros(-len(times) % every, np.int64)))
        self.by_place += times.reshape(-1, every).sum(axis=0)

    def _begin(self, every: int) -> None:
        if every != self.every:
            self.every = every
            self.by_counter, self.by_place = np.zeros(every, np.int64), np.zeros(every, np.int64)

    def usual(self, every: int, counter_end: int) -> UsualPhase | None:
        """The usual one of n; by the counter where it numbers all and tells n apart.

        Args:
            every: n; None comes back where it was not counted.
            counter_end: highest value of the SYNC counter, 0 without one.
        """
        total = int(self.by_place.sum())
        if not total or self.every % every:
            return None
        counted = int(self.by_counter.sum()) == total
        numbered = counted and counter_end > 0 and counter_end % every == 0
        counts = self.by_counter if numbered else self.by_place
        counts = counts.reshape(-1, every).sum(axis=0)
        best = int(counts.argmax())
        return UsualPhase(
            best, int(counts[best]) / total, "SYNC counter" if numbered else "first SYNC"
        )
