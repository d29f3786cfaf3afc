"""When frames can have been ready, and how long devices took: `waiting.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.native.library import AT, FLOAT, INT, Loop, check, column_of

_ARBITRATION = Loop("arbitration", INT, *[AT] * 4, FLOAT, AT, AT)
_CLOSE = Loop("close", INT, AT, AT, FLOAT, AT)
_MARKED = Loop("marked", INT, AT, AT, INT, *[AT] * 3)
_LAST_WITHOUT = Loop("last_without", INT, *[AT] * 4, INT, *[AT] * 4, INT, AT)
_READY = Loop(
    "ready",
    *(INT, *[AT] * 7, FLOAT, FLOAT, FLOAT),
    *(INT, *[AT] * 6, INT, *[AT] * 4),
    *[AT] * 6,
)
_BOUNDS = Loop("bounds", INT, AT, AT, FLOAT, FLOAT, INT, INT, *[AT] * 5, INT, *[AT] * 4)
_BACK = 4
"""Mark of a row before which the stamps stepped back."""

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class ReadyColumns(NamedTuple):
    """(r,) what `waiting.Ready` holds, and (p, 7) the figures of each PDO."""

    least_ns: Floats
    waiting_ns: Floats
    first: Ints
    free: Bools
    known: Bools
    figures: Floats


class BusRows:
    """The frames of one bus, looked at once for all questions about their arbitration.

    Args:
        t_ns, wire_ns, rank, sender: (n,) as for `waiting.Arbitration`.
        idle_ns: frames apart for longer than this, or closer by more, are not back to back.
    """

    def __init__(
        self,
        t_ns: Ints,
        wire_ns: Floats,
        rank: NDArray[np.uint32],
        sender: NDArray[np.int16],
        idle_ns: float,
    ) -> None:
        count = self._count = len(t_ns)
        check(count < 1 << 31)
        self._times = column_of(t_ns, np.int64, count), column_of(wire_ns, np.float64, count)
        self._ranks = column_of(rank, np.uint32, count), column_of(sender, np.int16, count)
        marks, before = np.empty(count, np.uint8), np.empty(count, np.int32)
        back = _ARBITRATION(count, *self._times, *self._ranks, idle_ns, marks, before)
        self._marks = marks, before
        self._steps: Ints | int = np.cumsum(marks & _BACK != 0) if back else 0

    def last_without(
        self,
        rows: Ints,
        ranks: NDArray[np.uint32],
        senders: NDArray[np.int16],
        stops: Ints | None,
        *,
        itself: bool,
    ) -> Ints:
        """See `waiting.Arbitration`; all (r,)."""
        count = len(rows)
        found = np.empty(count, np.int64)
        told = _LAST_WITHOUT(
            self._count,
            *self._ranks,
            *self._marks,
            count,
            column_of(rows, np.int64, count),
            column_of(ranks, np.uint32, count),
            column_of(senders, np.int16, count),
            0 if stops is None else column_of(stops, np.int64, count),
            itself,
            found,
        )
        check(told == 0)
        return found

    def ready(
        self,
        starts: Ints,
        ranks: NDArray[np.uint32],
        senders: NDArray[np.int16],
        rows: Ints,
        position: Ints,
        sync_rows: Ints,
        sync_ns: Ints,
        low_ns: Floats,
        most_ns: Floats,
        margins_ns: tuple[float, float, float],
    ) -> ReadyColumns:
        """See `waiting.Arbitration`, and `waiting.Asked` for the columns.

        margins_ns: slack of the stamps, how late a frame may join, length of the intermission.
        """
        pdos, count, syncs = len(starts), len(rows), len(sync_rows)
        least, waiting = np.empty((2, count))
        free, known = np.empty((2, count), np.bool_)
        first, figures = np.empty(count, np.int64), np.empty((pdos, 7))
        told = _READY(
            self._count,
            *(*self._times, *self._ranks, *self._marks, self._steps),
            *margins_ns,
            pdos,
            *begins_and_edges(starts, count),
            column_of(ranks, np.uint32, pdos),
            column_of(senders, np.int16, pdos),
            column_of(rows, np.int64, count),
            column_of(position, np.int64, count),
            syncs,
            column_of(sync_rows, np.int64, syncs),
            column_of(sync_ns, np.int64, syncs),
            column_of(low_ns, np.float64, count),
            column_of(most_ns, np.float64, count),
            *(least, waiting, first, free, known, figures),
        )
        check(told == 0)
        return ReadyColumns(least, waiting, first, free, known, figures)


def marked(rows: Ints, since_ns: Ints, mark_rows: NDArray[np.intp], mark_ns: Ints) -> Bools:
    """(r,) whether the last of some marks before each row has a stamp from `since_ns` on.

    rows, since_ns: (r,). mark_rows, mark_ns: (m,), in order as the rows are.
    """
    count, marks = len(rows), len(mark_rows)
    found = np.empty(count, np.bool_)
    _MARKED(
        count,
        column_of(rows, np.int64, count),
        column_of(since_ns, np.int64, count),
        marks,
        column_of(mark_rows, np.int64, marks),
        column_of(mark_ns, np.int64, marks),
        found,
    )
    return found


def close(t_ns: Ints, wire_ns: Floats, most_ns: float) -> Floats:
    """(c,) distances of frames closer than `most_ns` behind others, see `waiting.close_ns`."""
    count = len(t_ns)
    found = np.empty(count)
    times = column_of(t_ns, np.int64, count), column_of(wire_ns, np.float64, count)
    return found[: _CLOSE(count, *times, most_ns, found)]


def bounds(
    sent: Ints,
    wire_bits: Ints,
    starts: Ints,
    rows: NDArray[np.intp],
    position: Ints,
    response: Ints,
    sync_bits: Ints,
    numbers: tuple[float, float, int],
) -> tuple[Floats, Floats, Floats]:
    """(r,) bounds of the times of devices, low and high, and (p, 4) the limits of both.

    sent, wire_bits: (n,). starts: (p,). rows, position, response: (r,). sync_bits: (m,).
    numbers: length of a bit and slack of the stamps [ns], bits of the intermission.
    """
    frames, pdos, count = len(sent), len(starts), len(rows)
    low, high = np.empty((2, count))
    limits = np.empty((pdos, 4))
    told = _BOUNDS(
        frames,
        column_of(sent, np.int64, frames),
        column_of(wire_bits, np.int64, frames),
        *numbers,
        pdos,
        *begins_and_edges(starts, count),
        column_of(rows, np.int64, count),
        column_of(position, np.int64, count),
        column_of(response, np.int64, count),
        len(sync_bits),
        column_of(sync_bits, np.int64, len(sync_bits)),
        *(low, high, limits),
    )
    check(told == 0)
    return low, high, limits


def begins_and_edges(starts: Ints, count: int) -> tuple[Ints, Ints]:
    """(p,) where the parts of a column begin, to be written over; (p + 1,) where they meet."""
    edges = np.append(starts, count).astype(np.int64, copy=False)
    check(int(edges[0]) == 0 and bool((edges[1:] >= edges[:-1]).all()))
    return edges[:-1].copy(), edges
