"""The counter in a SYNC (CiA 301 7.2.5.3): from 1 to 1019h and again from 1."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.bundles import lacking
from syncline_schemas.records import dataclass

SURE = 2
"""So often a counter must have begun again from the same number to show where it ends."""

_OFF = 0.1
"""Share by which the time of many SYNCs may differ from their number."""

Ints = NDArray[np.int64]


@dataclass(slots=True)
class SyncCounter:
    """Follows the counter of one SYNC identifier; `jumps` counts the places where it left some out.

    `highest` is 0 for a SYNC without a counter, and counts since 1019h was `told` last.
    """

    jumps: int = 0
    highest: int = 0
    told: int | None = None
    _last: int = 0
    _ends: Ints = field(default_factory=lambda: np.zeros(256, np.int64))
    """How often it began again after each number."""

    @property
    def wraps(self) -> int:
        """How often it began again after the number where it does so most often."""
        return int(self._ends.max())

    def follow(self, counter: Ints, told: int | None) -> Ints:
        """(n,) SYNCs that were left out before each of these.

        Args:
            counter: (n,) counters in order, 0 for SYNCs without one.
            told: 1019h, which counts until the frames themselves show where the counter ends.
        """
        if not counter.any():
            self._last = 0
            return np.zeros(len(counter), np.int64)
        line = np.concatenate(([self._last], counter))
        known = (line[:-1] > 0) & (counter > 0)
        apart = np.diff(line)
        ends = line[:-1][known & (apart < 0) & (counter == 1)]
        self._ends += np.bincount(ends.clip(max=255), minlength=256)
        self.highest = max(self.highest, int(counter.max()))
        # The same number once more is the same SYNC once more.
        known &= apart != 0
        lost: Ints = np.where(known, (apart - 1) % max(self.end(told), 1), 0)
        self._last = int(counter[-1])
        self.jumps += int(np.count_nonzero(lost))
        return lost

    def expect(self, told: int | None) -> None:
        """Take in 1019h as it is told by now; another one begins anew with where it ends."""
        if told is not None and told != self.told:
            self.highest, self._ends = 0, np.zeros(256, np.int64)
            self.told = told

    def cut(self) -> None:
        """Nothing is left out over what comes now, as at a gap or a SYNC without a counter."""
        self._last = 0

    def overflow(self, told: int | None) -> int | None:
        """Where it ends, by the frames or by what was `told`; None where neither says so."""
        return int(self._ends.argmax()) if self.wraps >= SURE else told

    def end(self, told: int | None) -> int:
        """The highest number that there is, as far as known; 0 without a counter."""
        return max(self.overflow(told) or 0, self.highest)


def lost_in_time(
    lost: Ints, unsent: Ints, cycles: NDArray[np.float64], counter: Ints, end: int
) -> Ints:
    """(n,) SYNCs missing in each period by the counter, as far as the time has room for them.

    Where it has not, the counter began anew, and the time alone tells.

    Args:
        lost: (n,) how many the counter left out, or a multiple of `end` more.
        unsent: (n,) how many are missing by the time alone.
        cycles: (n,) the periods in usual ones.
        counter: (n,) the counter at the end of each period.
        end: where the counter begins again.
    """
    room = np.maximum(np.rint(cycles).astype(np.int64) - 1, lacking(cycles))
    nearest = lost + end * np.rint((room - lost) / max(end, 1)).astype(np.int64)
    fits = np.abs(nearest - room) <= np.maximum(1.0, _OFF * room)
    anew = ~fits | ((counter == 1) & (nearest > room))
    return np.where(anew | (lost == 0), unsent, nearest)
