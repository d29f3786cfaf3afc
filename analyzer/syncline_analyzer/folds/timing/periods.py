"""Periods of a rhythm, of SYNC, PDOs and error control alike."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distribution import Distribution
from syncline_analyzer.folds.timing.extremes import Extremes

LEARN = 8
"""Periods from which those of a block tell what is usual in it."""
SINGLE = 1.5
"""A period of so many usual ones is not a single one: something is missing in it, or paused."""

Ints = NDArray[np.int64]


@dataclass(slots=True)
class Periods:
    """All of them, the single ones alone, and the extreme ones with the frame that ended each."""

    spread: Distribution = field(default_factory=Distribution)
    single: Distribution = field(default_factory=Distribution)
    extremes: Extremes = field(default_factory=Extremes)

    def add(
        self, periods: Ints, seq: Ints, t_ns: Ints, usual_ns: NDArray[np.float64] | None = None
    ) -> None:
        """Take in periods, none of them negative; all (n,).

        Args:
            periods: in order.
            seq, t_ns: of the frame that ends each.
            usual_ns: the usual period around each, where it is known better than by their median.
        """
        self.spread.add(periods)
        self.extremes.add(periods, seq, t_ns)
        usual = self.usual_ns(periods) if usual_ns is None else usual_ns
        self.single.add(periods[periods < SINGLE * usual])

    def usual_ns(self, periods: Ints) -> float:
        """Median of a block's own periods where there are enough of them, so that it may change."""
        return float(np.median(periods)) if len(periods) >= LEARN else self.spread.quantile(0.5)
