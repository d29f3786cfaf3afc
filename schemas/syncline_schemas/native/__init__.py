"""Compiled twins of the dearest loops, behind numpy columns; where there is none, numpy does it.

Who calls a function asks `available()` first. Results are those of numpy bit for bit.
"""

from syncline_schemas.native.chunks import MOST_OTHERS, ChunkFrames, ChunkWalk
from syncline_schemas.native.keys import MOST_KEYS, grouping
from syncline_schemas.native.library import SWITCH, available
from syncline_schemas.native.places import before, differences, kinds, limits, repeated, since
from syncline_schemas.native.series import extremes, histogram
from syncline_schemas.native.text import MOST_LENGTH, KnownLines, lines
from syncline_schemas.native.wire import WIRE_TABLES, wire_bits

__all__ = [
    "MOST_KEYS",
    "MOST_LENGTH",
    "MOST_OTHERS",
    "SWITCH",
    "WIRE_TABLES",
    "ChunkFrames",
    "ChunkWalk",
    "KnownLines",
    "available",
    "before",
    "differences",
    "extremes",
    "grouping",
    "histogram",
    "kinds",
    "limits",
    "lines",
    "repeated",
    "since",
    "wire_bits",
]
