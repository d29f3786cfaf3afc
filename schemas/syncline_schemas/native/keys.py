"""Frames in order of bus and identifier: `grouping.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.native.library import AT, INT, U32, Loop, check, column_of

MOST_KEYS = 16 << 12
"""Keys that are counted rather than sorted: 16 buses."""
_GROUPING = Loop("grouping", INT, *[AT] * 5, U32, INT, *[AT] * 7)
_SOON = Loop("soon", INT, AT, INT, AT, INT, AT)


class Grouped(NamedTuple):
    """Rows by key, in arrival order within each: (m,), with their stamps.

    keys, shortest, longest: (g,) of each group; edges: (g + 1,) where they begin.
    """

    rows: NDArray[np.intp]
    t_ns: NDArray[np.int64]
    keys: NDArray[np.uint32]
    edges: NDArray[np.intp]
    shortest: NDArray[np.uint8]
    longest: NDArray[np.uint8]


def grouping(
    can_id: NDArray[np.uint32],
    bus: NDArray[np.uint8],
    flags: NDArray[np.uint16],
    dlc: NDArray[np.uint8],
    t_ns: NDArray[np.int64],
    unwanted: int,
    keys: int,
) -> Grouped | None:
    """The frames without some flags by key.

    keys: number of keys; where one is higher, None.
    """
    count, most = len(can_id), min(len(can_id), keys)
    rows, ordered_ns = np.empty(count, np.int64), np.empty(count, np.int64)
    key, edges = np.empty(most, np.uint32), np.empty(most + 1, np.int64)
    shortest, longest = np.empty(most, np.uint8), np.empty(most, np.uint8)
    groups = _GROUPING(
        count,
        column_of(can_id, np.uint32, count),
        column_of(bus, np.uint8, count),
        column_of(flags, np.uint16, count),
        column_of(dlc, np.uint8, count),
        column_of(t_ns, np.int64, count),
        unwanted,
        keys,
        np.zeros(keys, np.uint64),
        rows,
        ordered_ns,
        key,
        edges,
        shortest,
        longest,
    )
    if groups < 0:
        return None
    found = int(edges[groups])
    return Grouped(
        rows[:found],
        ordered_ns[:found],
        key[:groups],
        edges[: groups + 1],
        shortest[:groups],
        longest[:groups],
    )


def soon(t_ns: NDArray[np.int64], edges: NDArray[np.intp], limit_ns: int) -> NDArray[np.intp]:
    """Places whose stamp comes at most so much after the one before it in the same group.

    t_ns: (m,). edges: (g + 1,) where groups begin.
    """
    count, groups = len(t_ns), len(edges) - 1
    check(groups >= 0 and limit_ns >= 0)
    places = np.empty(count, np.int64)
    columns = column_of(t_ns, np.int64, count), groups, column_of(edges, np.int64, groups + 1)
    found = _SOON(count, *columns, limit_ns, places)
    check(found >= 0)
    return places[:found]
