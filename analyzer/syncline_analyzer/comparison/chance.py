"""What is no chance: rates of rare events, medians and spreads of two captures."""

from math import erfc, exp, lgamma, log, sqrt

from syncline_analyzer.results import Jitter, Quantiles
from syncline_schemas.records import dataclass

SURE = 1e-4
"""A difference is told where chance makes it less often than this."""
_EXACT = 1000
"""Events up to which the binomial distribution is summed; beyond, the normal one is close."""


def more_often(count: int, extent: float, other: int, other_extent: float) -> bool:
    """Whether events come at least twice as often in `extent` than in `other_extent`, surely.

    >>> more_often(30, 60.0, 5, 60.0), more_often(6, 60.0, 5, 60.0)
    (True, False)
    """
    if extent <= 0 or other_extent <= 0 or not count:
        return False
    if count / extent < 2 * other / other_extent:
        return False
    return at_least(count, count + other, extent / (extent + other_extent)) < SURE


def at_least(successes: int, trials: int, share: float) -> float:
    """Probability of so many successes or more in independent trials of one probability.

    >>> round(at_least(3, 3, 0.5), 3)
    0.125
    """
    if successes <= 0 or share >= 1:
        return 1.0
    if trials > _EXACT:
        spread = sqrt(trials * share * (1 - share))
        return erfc((successes - 0.5 - trials * share) / (spread * sqrt(2))) / 2
    return sum(_binomial(k, trials, share) for k in range(successes, trials + 1))


def _binomial(k: int, n: int, p: float) -> float:
    ways = lgamma(n + 1) - lgamma(k + 1) - lgamma(n - k + 1)
    return exp(ways + k * log(p) + (n - k) * log(1 - p))


@dataclass(frozen=True, slots=True)
class Sample:
    """A quantity in one capture: `count` values, stamps of a step of `resolution_us`."""

    quantiles: Quantiles
    jitter: Jitter | None
    count: int
    resolution_us: float
    quantile_error: float = 0.0

    @property
    def spread_us(self) -> float:
        """99th percentile less the 1st, or what is closest to it."""
        if self.jitter is not None and self.jitter.p99_p1 is not None:
            return self.jitter.p99_p1
        return 0.0 if self.jitter is not None else self.quantiles.p99 - self.quantiles.min

    @property
    def range_us(self) -> float:
        """Maximum less minimum."""
        if self.jitter is not None:
            return self.jitter.max_min or 0.0
        return self.quantiles.max - self.quantiles.min

    @property
    def blur_us(self) -> float:
        """How far off the median may be: step of the stamps, histogram, few values."""
        few = 1.25 * self.spread_us / 4 / sqrt(max(self.count, 1))
        return self.resolution_us + self.quantile_error * self.quantiles.median + 5 * few


def shifted(golden: Sample, capture: Sample, least_us: float) -> float | None:
    """How far the median lies off [us]; None within `least_us` and what stamps and spread hide."""
    off = capture.quantiles.median - golden.quantiles.median
    return off if abs(off) > max(least_us, golden.blur_us + capture.blur_us) else None


def wider(golden: Sample, capture: Sample, least_us: float, *, values: int = 100) -> bool:
    """Whether 98 % of the values scatter more than all of the golden ones did."""
    if min(golden.count, capture.count) < values:
        return False
    bound = max(golden.range_us, 2 * golden.spread_us) + golden.resolution_us
    return capture.spread_us > bound + capture.resolution_us + least_us
