"""Frames out of lines of text whose layout is known: `lines.c`."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.native.library import AT, INT, Loop, column_of

MOST_LENGTH = 512
"""Characters of a line that may have a layout."""
_COUNT_LINES = Loop("count_lines", AT, INT)
_LINES = Loop("lines", AT, INT, *[AT] * 5, INT, INT, *[AT] * 10)


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
    count = _COUNT_LINES(text, len(text))
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
    found = _LINES(
        text,
        len(text),
        column_of(layouts, np.int64, layouts.size),
        column_of(place, np.int64, len(to.hits)),
        column_of(of_length, np.int64, MOST_LENGTH + 2),
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
