"""Bits of frames on the wire: `wire_length.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, INT, Loop, check, column_of

WIRE_TABLES = 13 * 256 + 8 * 256 + 4 + 64
"""Numbers that `wire_bits` looks up."""
_HEADERS = 1 << 11
"""Headers that it remembers: one of each 11-bit identifier."""
_WIRE_BITS = Loop("wire_bits", INT, AT, AT, AT, AT, INT, AT, AT, INT, AT)


def wire_bits(
    can_id: NDArray[np.uint32],
    flags: NDArray[np.uint16],
    dlc: NDArray[np.uint8],
    data: NDArray[np.uint8],
    tables: NDArray[np.uint16],
    intermission: int,
) -> tuple[NDArray[np.uint16], int]:
    """Bits of classic frames, 0 for all others, and how many of those are CAN FD frames.

    data: (n, 8) or wider. tables: as `wire_length.c` tells. Returns: (n,) uint16.
    """
    count, width = data.shape
    check(width >= 8)
    bits = np.empty(count, np.uint16)
    fd = _WIRE_BITS(
        count,
        column_of(can_id, np.uint32, count),
        column_of(flags, np.uint16, count),
        column_of(dlc, np.uint8, count),
        column_of(data, np.uint8, count * width),
        width,
        column_of(tables, np.uint16, WIRE_TABLES),
        np.zeros(_HEADERS, np.uint64),
        intermission,
        bits,
    )
    return bits, fd
