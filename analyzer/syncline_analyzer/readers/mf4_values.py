"""Values of any length of an ASAM MDF 4 file, each after its length, at the places that records name.

Source: ASAM MDF 4.1, "SDBLOCK", "VLSD".
"""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.named_tuples import NamedTuple

_LENGTH_BYTES = 4


class Values(NamedTuple):
    """Bytes of each record.

    Attributes:
        bytes: (n, width) uint8, 0 behind what a record has.
        fits: (n,) bool; whether all bytes that a record has are there.
    """

    bytes: NDArray[np.uint8]
    fits: NDArray[np.bool_]


def values_at(raw: bytes, places: NDArray[np.uint64], width: int) -> Values:
    r"""The values at places of `raw`, of each the first `width` bytes.

    >>> values_at(b"..\2\0\0\0ab", np.array([2, 3], np.uint64), 3)
    Values(bytes=array([[97, 98,  0],
           [ 0,  0,  0]], dtype=uint8), fits=array([ True, False]))
    """
    data = np.frombuffer(raw, np.uint8)
    out = np.zeros((len(places), width), np.uint8)
    fits = places <= np.uint64(max(len(data) - _LENGTH_BYTES, 0))
    if len(data) < _LENGTH_BYTES:
        return Values(out, np.zeros(len(places), np.bool_))
    start = np.where(fits, places, 0).astype(np.int64)
    length = sum(data[start + byte].astype(np.int64) << 8 * byte for byte in range(_LENGTH_BYTES))
    start += _LENGTH_BYTES
    fits &= start + length <= len(data)
    for column in range(width):
        has = np.flatnonzero(fits & (length > column))
        out[has, column] = data[start[has] + column]
    return Values(out, fits)
