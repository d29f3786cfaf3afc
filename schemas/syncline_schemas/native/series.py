"""Values of one series: `histogram.c`, `extremes.c`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, FLOAT, INT, Loop, check, column_of

_HISTOGRAM = Loop("histogram", INT, AT, AT, FLOAT, FLOAT, INT, AT, INT, INT, INT, AT)
_TALLY = Loop("tally", INT, AT, AT, INT, AT, AT)
_EXTREMES = Loop("extremes", INT, AT, INT, AT)


def histogram(
    values: NDArray[np.int64] | NDArray[np.float64],
    low: float,
    width: float,
    fine: NDArray[np.int64],
    shift: int,
    first_key: int,
    coarse: NDArray[np.int64],
) -> int:
    """Add values to the counts of bins of equal width, and those in none of them to coarse ones.

    A value's coarse bin are the bits of value + 1, shifted to the right, less the first key.

    Returns: how many are in coarse bins.
    """
    for counts in (fine, coarse):
        check(counts.dtype == np.int64 and counts.flags.carray and len(counts) > 0)
    check(0 <= shift < 64)
    bins = shift, first_key, len(coarse)
    count, whole = len(values), values.dtype == np.int64
    column = column_of(values, np.int64 if whole else np.float64, count)
    given = (column, 0) if whole else (0, column)
    return _HISTOGRAM(count, *given, low, width, len(fine), fine, *bins, coarse)


def tally(
    keys: NDArray[np.integer[Any]],
    weights: NDArray[np.float64],
    counts: NDArray[np.int64],
    sums: NDArray[np.float64],
) -> None:
    """Add to counts and sums by key how often each key comes, and all that it weighs."""
    count = len(keys)
    check(counts.dtype == np.int64 and counts.flags.carray)
    check(sums.dtype == np.float64 and sums.flags.carray and len(sums) == len(counts))
    columns = column_of(keys, np.uint32, count), column_of(weights, np.float64, count)
    check(_TALLY(count, *columns, len(counts), counts, sums) == 0)


def extremes(values: NDArray[np.float64], run: int) -> NDArray[np.intp]:
    """Rows of the smallest and the largest value of each run, ascending."""
    count = len(values)
    rows = np.empty(2 * -(-count // run), np.int64)
    found = _EXTREMES(count, column_of(values, np.float64, count), run, rows)
    return rows[:found]
