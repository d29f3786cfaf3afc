"""Spread of a quantity."""

from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class Quantiles:
    """Minimum, median, 99th percentile and maximum; `std` where the interface asks for it.

    Minimum and maximum are exact, the others exact up to 8192 values and beyond that within the
    `quantile_error` of the row. `std` is None too where it is smaller than a step of the stamps.
    """

    min: float
    median: float
    p99: float
    max: float
    std: float | None = None


@dataclass(frozen=True, slots=True)
class Jitter:
    """How far a quantity spreads, by three measures (analysis.md section 5).

    A figure is None where it is smaller than a step of the stamps, which cannot show it.
    """

    std: float | None
    """Standard deviation."""
    p99_p1: float | None
    """99th percentile less the 1st."""
    max_min: float | None
    """Maximum less minimum."""
