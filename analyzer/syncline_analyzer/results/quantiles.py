"""Spread of a quantity."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Quantiles:
    """Minimum, median, 99th percentile and maximum; `std` where the interface asks for it."""

    min: float
    median: float
    p99: float
    max: float
    std: float | None = None
