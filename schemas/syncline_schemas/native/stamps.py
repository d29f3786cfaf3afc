"""Times from one frame to the next: `stamps.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, INT, Loop, column_of

_LATER = Loop("later", INT, AT, INT, AT)
_SOONER = Loop("sooner", INT, AT, INT)


def later(t_ns: NDArray[np.int64], limit_ns: int) -> NDArray[np.intp]:
    """Rows that come later than `limit_ns` after the one before, ascending; t_ns: (n,)."""
    count = len(t_ns)
    rows = np.empty(count, np.int64)
    found = _LATER(count, column_of(t_ns, np.int64, count), limit_ns, rows)
    return rows[:found]


def sooner(t_ns: NDArray[np.int64], limit_ns: int) -> int:
    """How many of (n,) rows come sooner than `limit_ns` after the one before, and not earlier."""
    return _SOONER(len(t_ns), column_of(t_ns, np.int64, len(t_ns)), limit_ns)
