"""What is usual for each of many periods: it may change on the way."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from syncline_analyzer.distribution import median_of
from syncline_analyzer.folds.timing.unsteady import OFF

MISSING = 1.5
"""A period longer than this many usual ones has something missing in it."""
_AROUND = 33
"""So many periods, or pairs of them, tell what is usual for the one in their middle."""
_STEADY = 0.02
_MOSTLY = 0.75
"""Where more than this share of the periods are as close to the median as that, it is the cycle."""


def cycles_of(periods: NDArray[np.int64], median: float | None = None) -> NDArray[np.float64]:
    """(n,) the producer's cycle around each of its periods; it may change within a block.

    The mean of a late period and the early one beside it is the cycle; a median may be either.
    `median` is theirs, where it is known.
    """
    usual = median_of(periods) if median is None else median
    apart = np.abs(periods - usual)
    mean = usual
    if np.count_nonzero(apart <= _STEADY * usual) <= _MOSTLY * len(periods):
        mean = float(periods.mean())
        apart = np.abs(periods - mean)
    if float(apart.max()) <= OFF * mean:
        return np.full(len(periods), mean)
    pairs = (periods[1:] + periods[:-1]) / 2
    if len(pairs) < _AROUND:
        return np.full(len(periods), mean)
    cycles = _around(pairs, 1)
    same = bool((np.abs(cycles - mean) <= OFF * mean).all())
    return np.full(len(periods), mean) if same else cycles


def even(limits: tuple[int, int], median: float) -> bool:
    """Whether periods within limits are all so close to their median that it is their cycle."""
    return max(median - limits[0], limits[1] - median) <= _STEADY * median


def usual_of(periods: NDArray[np.int64], median: float) -> NDArray[np.float64]:
    """(n,) the median of the periods around each one; `median` where there are too few of them."""
    if len(periods) < _AROUND or float(periods.max()) <= MISSING * _low(periods):
        return np.full(len(periods), median)
    return _around(periods.astype(np.float64), 0)


def _low(periods: NDArray[np.int64]) -> float:
    """A period that a tenth of them are shorter than."""
    place = len(periods) // 10
    return float(np.partition(periods, place)[place])


def _around(values: NDArray[np.float64], more: int) -> NDArray[np.float64]:
    """(n + more,) median of the values around each one."""
    padded = np.pad(values, (_AROUND // 2, _AROUND // 2 + more), mode="symmetric")
    medians: NDArray[np.float64] = np.median(sliding_window_view(padded, _AROUND), axis=1)
    return medians
