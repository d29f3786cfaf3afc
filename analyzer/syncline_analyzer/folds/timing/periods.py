"""Periods of a rhythm, of SYNC, PDOs and error control alike."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distribution import Distribution
from syncline_analyzer.folds.timing.extremes import Extremes, limits_of
from syncline_analyzer.results import Jitter
from syncline_schemas.records import dataclass

SINGLE = 1.5
"""A period of so many usual ones is not a single one: something is missing in it, or paused."""

Ints = NDArray[np.int64]


@dataclass(slots=True)
class Periods:
    """Their spread, and the extreme ones with the frame that ended each."""

    spread: Distribution = field(default_factory=Distribution)
    extremes: Extremes = field(default_factory=Extremes)

    def add(
        self, periods: Ints, seq: Ints, t_ns: Ints, limits: tuple[int, int] | None = None
    ) -> None:
        """Take in periods, none of them negative, with `seq` and stamp of their ends; all (n,).

        `limits` are the least and the longest of them, where they are known.
        """
        if len(periods):
            limits = limits or limits_of(periods)
            self.spread.add(periods, limits)
            self.extremes.add(periods, seq, t_ns, limits)

    def jitter_us(self, resolution_ns: int) -> Jitter | None:
        """Jitter of the single periods; None without any."""
        return self.spread.jitter(1000, resolution_ns, SINGLE * self.spread.quantile(0.5))
