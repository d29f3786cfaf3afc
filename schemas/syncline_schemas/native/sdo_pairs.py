"""Plain SDO transfers among the frames of many channels: `sdo_pairs.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, INT, Loop, check, column_of

_PAIRS = Loop("sdo_pairs", INT, *[AT] * 4, INT, *[AT] * 3)


def sdo_pairs(
    length: NDArray[np.uint8],
    data: NDArray[np.uint8],
    channel: NDArray[np.uint16],
    request: NDArray[np.bool_],
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Places of the requests and of the answers of plain transfers, by the answer's place.

    length, channel, request: (n,), data: (n, 8), of the frames in their order.
    """
    count = len(length)
    channels = int(channel.max(initial=0)) + 1
    asks, answers = np.empty((2, count), np.int64)
    found = _PAIRS(
        count,
        column_of(length, np.uint8, count),
        column_of(data, np.uint8, 8 * count),
        column_of(channel, np.uint16, count),
        column_of(request, np.bool_, count),
        channels,
        np.full(channels, -1),
        asks,
        answers,
    )
    check(found >= 0)
    return asks[:found], answers[:found]
