"""Columns out of the messages of a chunk: `chunk.c`."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, INT, Loop, column_of

MOST_OTHERS = 4096
"""Messages that are no frames, in a chunk that is read at once."""
_PLAIN, _TOO_WIDE = 0, 2
"""Of `chunk.c`."""
_CHUNK_FRAMES = Loop("chunk_frames", AT, INT, AT, AT, INT, INT, INT, *[AT] * 7, INT, AT, AT)


class ChunkWalk(NamedTuple):
    """What is in a plain chunk besides its frames.

    Attributes:
        others: (m, 4) int64 offset, end, channel and log time of messages of bus states, clocks
            and marks.
        first_ns: log time of the first message.
        last_ns: of the last.
    """

    others: NDArray[np.int64]
    first_ns: int
    last_ns: int


class ChunkFrames:
    """Columns that take the frames of chunks, one chunk behind the other.

    Attributes:
        count: frames so far.
        too_narrow: whether the last chunk was refused because of a frame wider than `width`.
        t_ns, log_time_ns, bus, can_id, flags, dlc: (capacity,), data: (capacity, width).

    Args:
        capacity: frames of all chunks at most.
        width: 8, or 64.
    """

    def __init__(self, capacity: int, width: int) -> None:
        self.count = 0
        self.too_narrow = False
        self.t_ns = np.empty(capacity, np.int64)
        self.log_time_ns = np.empty(capacity, np.int64)
        self.bus = np.empty(capacity, np.uint8)
        self.can_id = np.empty(capacity, np.uint32)
        self.flags = np.empty(capacity, np.uint16)
        self.dlc = np.empty(capacity, np.uint8)
        self.data = np.empty((capacity, width), np.uint8)
        self._others = np.empty((MOST_OTHERS, 4), np.int64)
        self._told = np.empty(4, np.int64)

    def add(
        self, chunk: bytes, kind: NDArray[np.uint8], bus_of_channel: NDArray[np.int16]
    ) -> ChunkWalk | None:
        """Take in the frames of a chunk; None where not all of it is plain, or it is too wide.

        kind, bus_of_channel: (65536,) by channel id.
        """
        capacity, width = self.data.shape
        found = _CHUNK_FRAMES(
            chunk,
            len(chunk),
            column_of(kind, np.uint8, 1 << 16),
            column_of(bus_of_channel, np.int16, 1 << 16),
            width,
            capacity,
            self.count,
            self.t_ns,
            self.log_time_ns,
            self.bus,
            self.can_id,
            self.flags,
            self.dlc,
            self.data,
            MOST_OTHERS,
            self._others,
            self._told,
        )
        self.too_narrow = found == _TOO_WIDE
        if found != _PLAIN:
            return None
        frames, others, first_ns, last_ns = self._told.tolist()
        self.count += frames
        return ChunkWalk(self._others[:others].copy(), first_ns, last_ns)
