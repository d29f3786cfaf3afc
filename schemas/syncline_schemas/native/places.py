"""Values at the rows, or between two places, of a column: `places.c`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, INT, Loop, check, column_of

_AFTER = Loop("after", INT, *[AT] * 3, INT, *[AT] * 3, INT, INT, *[AT] * 4)
_BEFORE = Loop("before", INT, INT, AT, AT)
_RUNNING = Loop("running", INT, INT, AT, AT)
_DIFFERENCES = Loop("differences", INT, *[AT] * 5)
_RUNS = Loop("runs", INT, AT, AT, INT, INT, AT, AT)


def before(rows: NDArray[np.intp], count: int) -> NDArray[np.int64]:
    """(count,) how many of some rows, ascending, are at or before each row."""
    found = np.empty(count, np.int64)
    told = _BEFORE(count, len(rows), column_of(rows, np.int64, len(rows)), found)
    check(told == 0)
    return found


def after(
    places: NDArray[np.intp],
    rows: NDArray[np.intp],
    t_ns: NDArray[np.int64],
    marks: NDArray[np.intp],
    marks_ns: NDArray[np.int64],
    last: NDArray[np.int64],
    first_kind: int,
    kinds: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """How many marks are at or before each row of the places, and the time since the last of them.

    places: as for `differences`. rows, t_ns: (k,). marks: (m,) rows, ascending. marks_ns: (m + 1,)
    the one before the block first. last: (p,) what stands before the first row of each place.

    Returns: (k,) both, set within the places; (p, 4) limits of the times and of the steps from
    each row of a place to the next; (p, kinds) how many of the numbers of marks, if they count
    from `first_kind` on, are of each kind modulo `kinds`.
    """
    count, of = len(places), len(rows)
    check(0 <= first_kind < kinds)
    position, passed = np.empty((2, of), np.int64)
    limits, counts = np.empty((count, 4), np.int64), np.zeros((count, kinds), np.int64)
    _AFTER(
        count,
        _places(places, of),
        column_of(rows, np.int64, of),
        column_of(t_ns, np.int64, of),
        len(marks),
        column_of(marks, np.int64, len(marks)),
        column_of(marks_ns, np.int64, len(marks) + 1),
        column_of(last, np.int64, count),
        first_kind,
        kinds,
        position,
        passed,
        limits,
        counts,
    )
    return position, passed, limits, counts


def running(values: NDArray[np.int64], first: int) -> NDArray[np.int64]:
    """(n,) `first` and the values up to each one, added up."""
    found = np.empty(len(values), np.int64)
    _RUNNING(len(values), first, column_of(values, np.int64, len(values)), found)
    return found


def differences(
    places: NDArray[np.intp], values: NDArray[np.int64], first: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """What lies between each value of a place and the one before, and the limits of that.

    places: (p, 2) where each begins and stops, none of them empty. first: (p,) what stands before the first value of each.
    Returns: (k,), set within the places; (p, 2).
    """
    count = len(places)
    found, limits = np.empty(len(values), np.int64), np.empty((count, 2), np.int64)
    _DIFFERENCES(
        count,
        _places(places, len(values)),
        column_of(values, np.int64, len(values)),
        column_of(first, np.int64, count),
        found,
        limits,
    )
    return found, limits


def runs(
    places: NDArray[np.intp], rows: NDArray[np.intp], data: NDArray[np.uint8]
) -> NDArray[np.int64]:
    """(p, 6) of each place: how often the first eight bytes of its rows are those of the row before.

    First and last of them as a number each, how many are those of the row before, and how many
    rows are alike at the beginning, in the longest stretch between two changes, and at the end (0
    where nothing changes).

    places: as for `differences`. rows: (k,) of data: (n, 8) or wider.
    """
    count, width = len(places), data.shape[1]
    check(width >= 8)
    found = np.empty((count, 6), np.int64)
    told = _RUNS(
        count,
        _places(places, len(rows)),
        column_of(rows, np.int64, len(rows)),
        len(data),
        width,
        column_of(data, np.uint8, data.size),
        found,
    )
    check(told == 0)
    return found


def _places(places: NDArray[np.intp], count: int) -> NDArray[Any]:
    """Places that lie within columns of a length, none of them empty."""
    column = column_of(places, np.int64, 2 * len(places)).reshape(-1, 2)
    begin, stop = column[:, 0], column[:, 1]
    check(bool(((begin >= 0) & (begin < stop) & (stop <= count)).all()))
    return column
