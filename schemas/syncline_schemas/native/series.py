"""Values of one series: `histogram.c`, `extremes.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, FLOAT, INT, Loop, check, column_of

_HISTOGRAM = Loop("histogram", INT, AT, AT, FLOAT, FLOAT, INT, AT, AT)
_EXTREMES = Loop("extremes", INT, AT, INT, AT)


def histogram(
    values: NDArray[np.int64] | NDArray[np.float64],
    low: float,
    width: float,
    counts: NDArray[np.int64],
) -> NDArray[np.intp]:
    """Add values to the counts of bins of equal width; rows of those in none of the bins."""
    count = len(values)
    outside = np.empty(count, np.int64)
    whole = values.dtype == np.int64
    column = column_of(values, np.int64 if whole else np.float64, count)
    given = (column, 0) if whole else (0, column)
    bins = len(counts)
    check(counts.dtype == np.int64 and counts.flags.carray)
    left = _HISTOGRAM(count, *given, low, width, bins, counts, outside)
    return outside[:left]


def extremes(values: NDArray[np.float64], run: int) -> NDArray[np.intp]:
    """Rows of the smallest and the largest value of each run, ascending."""
    count = len(values)
    rows = np.empty(2 * -(-count // run), np.int64)
    found = _EXTREMES(count, column_of(values, np.float64, count), run, rows)
    return rows[:found]
