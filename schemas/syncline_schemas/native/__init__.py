"""Compiled twins of the dearest loops, behind numpy columns; where there is none, numpy does it.

Who calls a function asks `available()` first. Results are those of numpy bit for bit.
"""

import ctypes
import os
import sys
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from syncline_schemas.native.build import LIBRARY, fingerprint

SWITCH = "SYNCLINE_NATIVE"
"""Environment variable; with 0 the library is not used."""
WIRE_TABLES = 13 * 256 + 8 * 256 + 4 + 64
"""Numbers that `wire_bits` looks up."""
MOST_KEYS = 16 << 12
"""Keys that are counted rather than sorted: 16 buses."""
MOST_LENGTH = 512
"""Characters of a line that may have a layout."""
MOST_OTHERS = 4096
"""Messages that are no frames, in a chunk that is read at once."""
_PLAIN, _TOO_WIDE = 0, 2
"""Of `chunk.c`."""

_INT, _U32, _AT = ctypes.c_int64, ctypes.c_uint32, ctypes.c_void_p
_FLOAT = ctypes.c_double
_FUNCTIONS: dict[str, tuple[Any, list[Any]]] = {
    "syncline_fingerprint": (_U32, []),
    "syncline_wire_bits": (_INT, [_INT, _AT, _AT, _AT, _AT, _INT, _AT, _INT, _AT]),
    "syncline_chunk_frames": (
        _INT,
        [_AT, _INT, _AT, _AT, _INT, _INT, _INT, *[_AT] * 7, _INT, _AT, _AT],
    ),
    "syncline_grouping": (_INT, [_INT, _AT, _AT, _AT, _U32, _INT, _AT, _AT, _AT, _AT]),
    "syncline_count_lines": (_INT, [_AT, _INT]),
    "syncline_lines": (_INT, [_AT, _INT, *[_AT] * 5, _INT, _INT, *[_AT] * 10]),
    "syncline_histogram": (_INT, [_INT, _AT, _AT, _FLOAT, _FLOAT, _INT, _AT, _AT]),
    "syncline_extremes": (_INT, [_INT, _AT, _INT, _AT]),
    "syncline_since": (_INT, [_INT, _AT, _AT, _INT, _AT, _INT, *[_AT] * 3]),
    "syncline_before": (_INT, [_INT, _INT, _AT, _AT]),
    "syncline_limits": (_INT, [_INT, *[_AT] * 3]),
    "syncline_differences": (_INT, [_INT, *[_AT] * 5]),
    "syncline_repeated": (_INT, [_INT, *[_AT] * 3]),
    "syncline_kinds": (_INT, [_INT, _AT, _AT, _INT, _AT, _INT, _AT]),
}
"""Result and arguments; pointers are those of contiguous columns."""


def available() -> bool:
    """Whether there is a library made of the C files that stand here, and it is wanted."""
    return _library() is not None


@cache
def _library() -> ctypes.CDLL | None:
    little = sys.byteorder == "little" and sys.maxsize > 1 << 32
    if os.environ.get(SWITCH) == "0" or not little or not LIBRARY.is_file():
        return None
    try:
        library = ctypes.CDLL(str(LIBRARY))
        for name, (result, arguments) in _FUNCTIONS.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        return library if library.syncline_fingerprint() == fingerprint() else None
    except (OSError, AttributeError):  # of another machine, or another version
        return None


def _call(name: str, *arguments: float | bytes | NDArray[Any]) -> int:
    """Call a function; arrays are contiguous, of the type and length that it takes."""
    given = [each.ctypes.data if isinstance(each, np.ndarray) else each for each in arguments]
    return int(getattr(_library(), name)(*given))


def _column(values: NDArray[Any], dtype: DTypeLike, size: int) -> NDArray[Any]:
    """So many numbers of a type, one behind the other; a copy only where they are not."""
    column = np.require(values, dtype, ["C", "A"])
    _check(column.size == size)
    return column


def _check(kept: bool) -> None:
    """Raises: ValueError, a caller's mistake, before C reads or writes anywhere else."""
    if not kept:
        raise ValueError("columns of other lengths or types than a compiled loop takes")


def wire_bits(
    can_id: NDArray[np.uint32],
    flags: NDArray[np.uint16],
    dlc: NDArray[np.uint8],
    data: NDArray[np.uint8],
    tables: NDArray[np.uint16],
    intermission: int,
) -> tuple[NDArray[np.int64], int]:
    """Bits of classic frames, 0 for all others, and how many of those are CAN FD frames.

    data: (n, 8) or wider. tables: as `wire_length.c` tells. Returns: (n,) int64.
    """
    count, width = data.shape
    _check(width >= 8)
    bits = np.empty(count, np.int64)
    fd = _call(
        "syncline_wire_bits",
        count,
        _column(can_id, np.uint32, count),
        _column(flags, np.uint16, count),
        _column(dlc, np.uint8, count),
        _column(data, np.uint8, count * width),
        width,
        _column(tables, np.uint16, WIRE_TABLES),
        intermission,
        bits,
    )
    return bits, fd


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
        found = _call(
            "syncline_chunk_frames",
            chunk,
            len(chunk),
            _column(kind, np.uint8, 1 << 16),
            _column(bus_of_channel, np.int16, 1 << 16),
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
    groups = _call(
        "syncline_grouping",
        count,
        _column(can_id, np.uint32, count),
        _column(bus, np.uint8, count),
        _column(flags, np.uint16, count),
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


class KnownLines(NamedTuple):
    """Lines of a text, and the frames of those whose layout is known.

    Attributes:
        starts, lengths: (n,) of each line in the text.
        hits: (layouts,) lines of each.
        of_length: (513,) lines of each length.
        t_ns, bus, can_id, flags, dlc: (n,), words: (n, 1) or (n, 8) data bytes; 0 where not read.
        read, timed: (n,) whether a line was read, and whether it has a time.
    """

    starts: NDArray[np.intp]
    lengths: NDArray[np.intp]
    hits: NDArray[np.int64]
    of_length: NDArray[np.int64]
    t_ns: NDArray[np.int64]
    bus: NDArray[np.uint8]
    can_id: NDArray[np.uint32]
    flags: NDArray[np.uint16]
    dlc: NDArray[np.uint8]
    words: NDArray[np.uint64]
    read: NDArray[np.bool_]
    timed: NDArray[np.bool_]


def lines(
    text: bytes, layouts: NDArray[np.int64], place: NDArray[np.int64], lengths: NDArray[np.int64]
) -> KnownLines:
    """Lines of a text, those read whose layout is one of these.

    layouts: as `lines.c` tells, one behind the other. place: (layouts,) where each begins.
    lengths: (layouts,) of its lines, ascending; those of one length are tried in order.
    """
    count = _call("syncline_count_lines", text, len(text))
    of_length = np.searchsorted(lengths, np.arange(MOST_LENGTH + 2))
    found = _empty_lines(count, len(place), 1)
    read = partial(_read_lines, text, layouts, place, of_length)
    if not read(found):
        found = _empty_lines(count, len(place), 8)
        read(found)
    return found


def _empty_lines(count: int, layouts: int, width: int) -> KnownLines:
    return KnownLines(
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        np.zeros(layouts, np.int64),
        np.zeros(MOST_LENGTH + 1, np.int64),
        np.zeros(count, np.int64),
        np.zeros(count, np.uint8),
        np.zeros(count, np.uint32),
        np.zeros(count, np.uint16),
        np.zeros(count, np.uint8),
        np.zeros((count, width), np.uint64),
        np.zeros(count, np.bool_),
        np.zeros(count, np.bool_),
    )


def _read_lines(
    text: bytes,
    layouts: NDArray[np.int64],
    place: NDArray[np.int64],
    of_length: NDArray[np.intp],
    to: KnownLines,
) -> bool:
    """Fill in the lines; False where a frame has more data than there is room."""
    count, width = to.words.shape
    found = _call(
        "syncline_lines",
        text,
        len(text),
        _column(layouts, np.int64, layouts.size),
        _column(place, np.int64, len(to.hits)),
        _column(of_length, np.int64, MOST_LENGTH + 2),
        to.hits,
        to.of_length,
        count,
        width,
        to.starts,
        to.lengths,
        to.t_ns,
        to.bus,
        to.can_id,
        to.flags,
        to.dlc,
        to.words,
        to.read,
        to.timed,
    )
    return found >= 0


def histogram(
    values: NDArray[np.int64] | NDArray[np.float64],
    low: float,
    width: float,
    counts: NDArray[np.int64],
) -> NDArray[np.intp]:
    """Add values to the counts of bins of equal width; rows of those in none of the bins."""
    count = len(values)
    outside = np.empty(count, np.int64)
    whole = values.dtype == np.int64
    column = _column(values, np.int64 if whole else np.float64, count)
    given = (column, 0) if whole else (0, column)
    bins = len(counts)
    _check(counts.dtype == np.int64 and counts.flags.carray)
    left = _call("syncline_histogram", count, *given, low, width, bins, counts, outside)
    return outside[:left]


def extremes(values: NDArray[np.float64], run: int) -> NDArray[np.intp]:
    """Rows of the smallest and the largest value of each run, ascending."""
    count = len(values)
    rows = np.empty(2 * -(-count // run), np.int64)
    found = _call("syncline_extremes", count, _column(values, np.float64, count), run, rows)
    return rows[:found]


def before(rows: NDArray[np.intp], count: int) -> NDArray[np.int64]:
    """(count,) how many of some rows, ascending, are at or before each row."""
    found = np.empty(count, np.int64)
    told = _call("syncline_before", count, len(rows), _column(rows, np.int64, len(rows)), found)
    _check(told == 0)
    return found


def since(
    rows: NDArray[np.intp],
    t_ns: NDArray[np.int64],
    position: NDArray[np.int64],
    marks_ns: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Position of each of some rows, and the time since its mark.

    rows, t_ns: (k,). position: (n,) by row. marks_ns: (m,) by position.
    """
    count = len(rows)
    of_rows, passed = np.empty((2, count), np.int64)
    told = _call(
        "syncline_since",
        count,
        _column(rows, np.int64, count),
        _column(t_ns, np.int64, count),
        len(position),
        _column(position, np.int64, len(position)),
        len(marks_ns),
        _column(marks_ns, np.int64, len(marks_ns)),
        of_rows,
        passed,
    )
    _check(told == 0)
    return of_rows, passed


def limits(places: NDArray[np.intp], values: NDArray[np.int64]) -> NDArray[np.int64]:
    """(p, 2) least and largest value of each place.

    places: (p, 2) where each begins and stops, ascending, none of them empty.
    """
    found = np.empty((len(places), 2), np.int64)
    _call("syncline_limits", len(places), _places(places, values), _whole(values), found)
    return found


def differences(
    places: NDArray[np.intp], values: NDArray[np.int64], first: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """What lies between each value of a place and the one before, and the limits of that.

    places: as for `limits`. first: (p,) what stands before the first value of each.
    Returns: (k,), set within the places; (p, 2).
    """
    count = len(places)
    found, limits = np.empty(len(values), np.int64), np.empty((count, 2), np.int64)
    _call(
        "syncline_differences",
        count,
        _places(places, values),
        _whole(values),
        _column(first, np.int64, count),
        found,
        limits,
    )
    return found, limits


def repeated(places: NDArray[np.intp], words: NDArray[np.uint64]) -> NDArray[np.int64]:
    """(p,) how many words of each place, as for `limits`, are that before; its first is none."""
    counts = np.empty(len(places), np.int64)
    column = _column(words, np.uint64, len(words))
    _call("syncline_repeated", len(places), _places(places, words), column, counts)
    return counts


def kinds(
    places: NDArray[np.intp], values: NDArray[np.int64], kind_of: NDArray[np.uint8], kinds: int
) -> NDArray[np.int64]:
    """(p, kinds) how many values of each place, as for `limits`, are of each kind."""
    counts = np.zeros((len(places), kinds), np.int64)
    told = _call(
        "syncline_kinds",
        len(places),
        _places(places, values),
        _whole(values),
        len(kind_of),
        _column(kind_of, np.uint8, len(kind_of)),
        kinds,
        counts,
    )
    _check(told == 0)
    return counts


def _whole(values: NDArray[np.int64]) -> NDArray[Any]:
    return _column(values, np.int64, len(values))


def _places(places: NDArray[np.intp], values: NDArray[Any]) -> NDArray[Any]:
    """Places that lie within a column."""
    column = _column(places, np.int64, 2 * len(places))
    _check(bool(((places >= 0) & (places <= len(values))).all()))
    return column
