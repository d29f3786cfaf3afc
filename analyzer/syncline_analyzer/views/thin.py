"""Fewer points for plots, without losing what matters: the extremes and the holes."""

import numpy as np
from numpy.typing import NDArray


def extremes(
    value: NDArray[np.float64], points: int, wraps: NDArray[np.intp] | None = None
) -> NDArray[np.intp]:
    """Rows to keep so that a plot of about `points` points still shows every peak and every break.

    The rows are cut into `points // 2` runs of equal length; of each, the smallest and the largest
    value stay. A NaN stays wherever else a line would be drawn over it. Those at `wraps`, where an
    angle only starts over, stay with the values beside them unless there are so many that the line
    fills the plot anyway: it must not break up into points.

    Returns: (k,) ascending row numbers; all of them when there are few.

    >>> extremes(np.array([0.0, 9.0, 1.0, 2.0, -5.0, 3.0]), 4).tolist()
    [0, 1, 4, 5]
    """
    count = len(value)
    if count <= points:
        return np.arange(count)
    starts = np.linspace(0, count, points // 2 + 1).astype(np.intp)[:-1]
    hole = np.isnan(value)
    low = _first_of_run(np.where(hole, np.inf, value), starts, np.minimum)
    high = _first_of_run(np.where(hole, -np.inf, value), starts, np.maximum)
    holes = np.flatnonzero(hole)
    rows = np.union1d(low, high)
    if len(holes) <= points // 4:
        beside = np.concatenate([holes - 1, holes, holes + 1])
        return np.union1d(rows, beside[(beside >= 0) & (beside < count)])
    if wraps is not None:
        holes = np.setdiff1d(holes, wraps)
    return np.union1d(rows, _between(rows, holes))


def _between(rows: NDArray[np.intp], holes: NDArray[np.intp]) -> NDArray[np.intp]:
    """The first hole before, between and after rows, where there is any."""
    passed = np.searchsorted(holes, np.append(-1, rows), side="right")
    until = np.searchsorted(holes, np.append(rows, np.iinfo(np.intp).max), side="left")
    return holes[passed[passed < until]]


def envelope(
    t_ns: NDArray[np.int64], value: NDArray[np.float64], points: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Outline of about `points` points around a line, from its smallest values to its largest.

    A NaN interrupts it: then a new outline begins, after a NaN.

    Returns: stamps and values (k,), each outline there along the largest and back along the least.
    """
    run = max(-(-2 * len(value) // points), 1)
    holes = np.flatnonzero(np.isnan(value))
    stretches = zip(np.append(0, holes + 1), np.append(holes, len(value)), strict=True)
    times: list[NDArray[np.int64]] = []
    values: list[NDArray[np.float64]] = []
    for first, end in stretches:
        if first == end:
            continue
        starts = np.arange(first, end, run)
        part = slice(first, end)
        high = np.maximum.reduceat(value[part], starts - first)
        low = np.minimum.reduceat(value[part], starts - first)
        at = np.append(t_ns[starts], t_ns[end - 1])
        high, low = np.append(high, high[-1]), np.append(low, low[-1])
        times += [at, at[::-1], at[:1]]
        values += [high, low[::-1], np.full(1, np.nan)]
    if not times:
        return t_ns[:0], value[:0]
    return np.concatenate(times)[:-1], np.concatenate(values)[:-1]


def _first_of_run(
    value: NDArray[np.float64], starts: NDArray[np.intp], pick: np.ufunc
) -> NDArray[np.intp]:
    best = pick.reduceat(value, starts)
    run = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(value))))
    hits = np.flatnonzero(value == best[run])
    return hits[np.diff(run[hits], prepend=-1) > 0]
