"""Frames in order of bus and identifier: `grouping.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, INT, U32, Loop, column_of

MOST_KEYS = 16 << 12
"""Keys that are counted rather than sorted: 16 buses."""
_GROUPING = Loop("grouping", INT, AT, AT, AT, U32, INT, AT, AT, AT, AT)


def grouping(
    can_id: NDArray[np.uint32],
    bus: NDArray[np.uint8],
    flags: NDArray[np.uint16],
    unwanted: int,
    keys: int,
) -> tuple[NDArray[np.intp], NDArray[np.uint32], NDArray[np.intp]] | None:
    """Rows of the frames without some flags by key, the key of each, and where groups begin.

    keys: number of keys; where one is higher, None.
    """
    count = len(can_id)
    rows, key = np.empty(count, np.int64), np.empty(count, np.uint32)
    edges = np.empty(min(count, keys) + 1, np.int64)
    groups = _GROUPING(
        count,
        column_of(can_id, np.uint32, count),
        column_of(bus, np.uint8, count),
        column_of(flags, np.uint16, count),
        unwanted,
        keys,
        np.zeros(keys, np.uint32),
        rows,
        key,
        edges,
    )
    if groups < 0:
        return None
    edges = edges[: groups + 1]
    return rows[: edges[-1]], key[: edges[-1]], edges
