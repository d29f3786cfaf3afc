"""Compiled twins of the dearest loops, behind numpy columns; where there is none, numpy does it.

Who calls a function asks `available()` first. Results are those of numpy bit for bit.
"""

from syncline_schemas.native.busy import fullest_window, stretches
from syncline_schemas.native.chunks import MOST_OTHERS, ChunkFrames, ChunkWalk
from syncline_schemas.native.keys import MOST_KEYS, Grouped, grouping, soon
from syncline_schemas.native.library import SWITCH, available
from syncline_schemas.native.places import after, before, differences, running, runs
from syncline_schemas.native.sdo_pairs import sdo_pairs
from syncline_schemas.native.series import extremes, histogram, tally, thinned
from syncline_schemas.native.spacings import close_runs
from syncline_schemas.native.stamps import later, sooner
from syncline_schemas.native.text import MOST_LENGTH, KnownLines, lines
from syncline_schemas.native.waiting import BusRows, bounds, close, marked
from syncline_schemas.native.waiting_senders import seen_ids, sent_by, short_keys
from syncline_schemas.native.waiting_sums import delays
from syncline_schemas.native.wire import WIRE_TABLES, wire_bits

__all__ = [
    "MOST_KEYS",
    "MOST_LENGTH",
    "MOST_OTHERS",
    "SWITCH",
    "WIRE_TABLES",
    "BusRows",
    "ChunkFrames",
    "ChunkWalk",
    "Grouped",
    "KnownLines",
    "after",
    "available",
    "before",
    "bounds",
    "close",
    "close_runs",
    "delays",
    "differences",
    "extremes",
    "fullest_window",
    "grouping",
    "histogram",
    "later",
    "lines",
    "marked",
    "running",
    "runs",
    "sdo_pairs",
    "seen_ids",
    "sent_by",
    "short_keys",
    "soon",
    "sooner",
    "stretches",
    "tally",
    "thinned",
    "wire_bits",
]
