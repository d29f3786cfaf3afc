"""Values at the rows, or between two places, of a column: `places.c`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, INT, Loop, check, column_of

_SINCE = Loop("since", INT, AT, AT, INT, AT, INT, *[AT] * 3)
_BEFORE = Loop("before", INT, INT, AT, AT)
_RUNNING = Loop("running", INT, INT, AT, AT)
_LIMITS = Loop("limits", INT, *[AT] * 3)
_DIFFERENCES = Loop("differences", INT, *[AT] * 5)
_REPEATED = Loop("repeated", INT, *[AT] * 3)
_KINDS = Loop("kinds", INT, AT, AT, INT, AT, INT, AT)


def before(rows: NDArray[np.intp], count: int) -> NDArray[np.int64]:
    """(count,) how many of some rows, ascending, are at or before each row."""
    found = np.empty(count, np.int64)
    told = _BEFORE(count, len(rows), column_of(rows, np.int64, len(rows)), found)
    check(told == 0)
    return found


def since(
    rows: NDArray[np.intp],
    t_ns: NDArray[np.int64],
    position: NDArray[np.int64],
    marks_ns: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Position of each of some rows, and the time since its mark.

    rows, t_ns: (k,). position: (n,) by row. marks_ns: (m,) by position.
    """
    count = len(rows)
    of_rows, passed = np.empty((2, count), np.int64)
    told = _SINCE(
        count,
        column_of(rows, np.int64, count),
        column_of(t_ns, np.int64, count),
        len(position),
        column_of(position, np.int64, len(position)),
        len(marks_ns),
        column_of(marks_ns, np.int64, len(marks_ns)),
        of_rows,
        passed,
    )
    check(told == 0)
    return of_rows, passed


def running(values: NDArray[np.int64], first: int) -> NDArray[np.int64]:
    """(n,) `first` and the values up to each one, added up."""
    found = np.empty(len(values), np.int64)
    _RUNNING(len(values), first, column_of(values, np.int64, len(values)), found)
    return found


def limits(places: NDArray[np.intp], values: NDArray[np.int64]) -> NDArray[np.int64]:
    """(p, 2) least and largest value of each place.

    places: (p, 2) where each begins and stops, ascending, none of them empty.
    """
    found = np.empty((len(places), 2), np.int64)
    _LIMITS(len(places), _places(places, values), _whole(values), found)
    return found


def differences(
    places: NDArray[np.intp], values: NDArray[np.int64], first: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """What lies between each value of a place and the one before, and the limits of that.

    places: as for `limits`. first: (p,) what stands before the first value of each.
    Returns: (k,), set within the places; (p, 2).
    """
    count = len(places)
    found, limits = np.empty(len(values), np.int64), np.empty((count, 2), np.int64)
    _DIFFERENCES(
        count,
        _places(places, values),
        _whole(values),
        column_of(first, np.int64, count),
        found,
        limits,
    )
    return found, limits


def repeated(places: NDArray[np.intp], words: NDArray[np.uint64]) -> NDArray[np.int64]:
    """(p,) how many words of each place, as for `limits`, are that before; its first is none."""
    counts = np.empty(len(places), np.int64)
    column = column_of(words, np.uint64, len(words))
    _REPEATED(len(places), _places(places, words), column, counts)
    return counts


def kinds(
    places: NDArray[np.intp], values: NDArray[np.int64], kind_of: NDArray[np.uint8], kinds: int
) -> NDArray[np.int64]:
    """(p, kinds) how many values of each place, as for `limits`, are of each kind."""
    counts = np.zeros((len(places), kinds), np.int64)
    told = _KINDS(
        len(places),
        _places(places, values),
        _whole(values),
        len(kind_of),
        column_of(kind_of, np.uint8, len(kind_of)),
        kinds,
        counts,
    )
    check(told == 0)
    return counts


def _whole(values: NDArray[np.int64]) -> NDArray[Any]:
    return column_of(values, np.int64, len(values))


def _places(places: NDArray[np.intp], values: NDArray[Any]) -> NDArray[Any]:
    """Places that lie within a column."""
    column = column_of(places, np.int64, 2 * len(places))
    check(bool(((places >= 0) & (places <= len(values))).all()))
    return column
