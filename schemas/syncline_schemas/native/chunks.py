"""Columns out of the messages of a chunk: `chunk.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.native.library import AT, INT, Loop, column_of

MOST_OTHERS = 4096
"""Messages that are no frames, in a chunk that is read at once."""
MAX_DATA = 64
_NARROW = 8
"""Bytes of data in a row: of classic frames alone, and of any."""
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
        t_ns, log_time_ns, bus, can_id, flags, dlc: (capacity,), data: (capacity, 8), or 64 wide
            from the first frame on that has more bytes.

    Args:
        capacity: frames of all chunks at most.
        kind, bus_of_channel: (65536,) by channel id.
    """

    def __init__(
        self, capacity: int, kind: NDArray[np.uint8], bus_of_channel: NDArray[np.int16]
    ) -> None:
        self.count = 0
        self.t_ns = np.empty(capacity, np.int64)
        self.log_time_ns = np.empty(capacity, np.int64)
        self.bus = np.empty(capacity, np.uint8)
        self.can_id = np.empty(capacity, np.uint32)
        self.flags = np.empty(capacity, np.uint16)
        self.dlc = np.empty(capacity, np.uint8)
        self.data = np.empty((capacity, _NARROW), np.uint8)
        self._kind = column_of(kind, np.uint8, 1 << 16)
        self._bus_of_channel = column_of(bus_of_channel, np.int16, 1 << 16)
        self._others = np.empty((MOST_OTHERS, 4), np.int64)
        self._told = np.empty(4, np.int64)
        self._places = self._found_places()

    def add(self, chunk: bytes) -> ChunkWalk | None:
        """Take in the frames of a chunk; None where not all of it is plain."""
        found = self._walk(chunk)
        if found == _TOO_WIDE and self.data.shape[1] < MAX_DATA:
            self._widen()
            found = self._walk(chunk)
        if found != _PLAIN:
            return None
        frames, others, first_ns, last_ns = self._told.tolist()
        self.count += frames
        return ChunkWalk(self._others[:others].copy(), first_ns, last_ns)

    def _walk(self, chunk: bytes) -> int:
        capacity, width = self.data.shape
        tables, columns, told = self._places
        return _CHUNK_FRAMES(
            chunk, len(chunk), *tables, width, capacity, self.count, *columns, MOST_OTHERS, *told
        )

    def _widen(self) -> None:
        """Make room for frames of more bytes of data."""
        narrow = self.data
        self.data = np.zeros((len(narrow), MAX_DATA), np.uint8)
        self.data[: self.count, :_NARROW] = narrow[: self.count]
        self._places = self._found_places()

    def _found_places(self) -> tuple[list[int], list[int], list[int]]:
        """Where tables, columns and what is told begin: to ask for each chunk costs as much as it."""
        columns = (
            self.t_ns,
            self.log_time_ns,
            self.bus,
            self.can_id,
            self.flags,
            self.dlc,
            self.data,
        )
        tables, told = (self._kind, self._bus_of_channel), (self._others, self._told)
        at = [[column.ctypes.data for column in each] for each in (tables, columns, told)]
        return at[0], at[1], at[2]
