"""Spacings of several frames in a row: `spacings.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, FLOAT, INT, Loop, check, column_of

_CLOSE = Loop("close_runs", INT, AT, AT, INT, FLOAT, FLOAT, AT, AT, INT, AT)

Ints = NDArray[np.int64]


def close_runs(
    apart_ns: Ints, bits: Ints, frames: int, bit_ns: float, within_ns: float
) -> tuple[Ints, Ints, Ints]:
    """Spacings of so many frames in a row that are at most `within_ns` longer than their bits.

    apart_ns, bits: (n,) of single frames; a negative one counts for nothing.

    Returns: (c,) [ns] and (c,) bits of those; how many of all have 0, 1, 2... bits.
    """
    count = len(apart_ns)
    check(1 <= frames <= count and int(bits.min()) >= 0)
    close_ns, close_bits = np.empty(count, np.int64), np.empty(count, np.int64)
    lengths = np.zeros(frames * int(bits.max()) + 1, np.int64)
    found = _CLOSE(
        *(count, column_of(apart_ns, np.int64, count), column_of(bits, np.int64, count)),
        *(frames, bit_ns, within_ns, close_ns, close_bits, len(lengths), lengths),
    )
    check(found >= 0)
    return close_ns[:found], close_bits[:found], lengths
