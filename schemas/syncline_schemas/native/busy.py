"""How long a bus was busy, and its fullest moment: `busy.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, FLOAT, INT, Loop, check, column_of

_STRETCHES = Loop("stretches", INT, AT, AT, INT, INT, FLOAT, FLOAT, AT, AT)
_FULLEST = Loop("fullest_window", INT, INT, AT, AT, INT, FLOAT, FLOAT, FLOAT, INT, *[AT] * 8)


def stretches(
    t_ns: NDArray[np.int64],
    wire_ns: NDArray[np.float64],
    before_ns: int | None,
    least_ns: float,
    most_ns: float,
) -> tuple[NDArray[np.bool_], int, list[int]]:
    """Frames back to back: which come less than `least_ns` after that before, and how many.

    t_ns, wire_ns: (n,) end of each frame, and how long it was on the wire. before_ns: end of the
    frame before, if there is one. More than `most_ns` between two is a pause.

    Returns: (n,); how many; rows where the first and the last stretch begin, n where none does,
    and first and last row of the longest.
    """
    count = len(t_ns)
    soon, rows = np.empty(count, np.bool_), np.empty(4, np.int64)
    early = _STRETCHES(
        count,
        column_of(t_ns, np.int64, count),
        column_of(wire_ns, np.float64, count),
        before_ns is not None,
        before_ns or 0,
        least_ns,
        most_ns,
        soon,
        rows,
    )
    return soon, early, rows.tolist()


def fullest_window(
    t_ns: NDArray[np.int64],
    wire_ns: NDArray[np.float64],
    known: int,
    begun_ns: int,
    width_ns: float,
    least_ns: float,
    after: NDArray[np.float64],
    until: NDArray[np.float64],
) -> tuple[float, float] | None:
    """(what it carries, its end since `begun_ns`) of the fullest window that ends or begins with a frame.

    t_ns, wire_ns: (n,) as for `stretches`, ascending; windows up to row `known` may be left out,
    and those that carry less than `least_ns`. after, until: (s,) ascending; no window counts that
    ends after one of these moments, until the other.
    """
    count = len(t_ns)
    check(count > 0)
    found = np.empty(2)
    any_found = _FULLEST(
        count,
        known,
        column_of(t_ns, np.int64, count),
        column_of(wire_ns, np.float64, count),
        begun_ns,
        width_ns,
        float(wire_ns.max()),
        least_ns,
        len(after),
        column_of(after, np.float64, len(after)),
        column_of(until, np.float64, len(after)),
        np.empty(count),
        np.empty(2 * count, np.int64),
        np.empty(2 * count, np.int64),
        np.empty(2 * count),
        np.zeros(count, np.uint8),
        found,
    )
    return (float(found[0]), float(found[1])) if any_found else None
