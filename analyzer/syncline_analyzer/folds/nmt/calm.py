"""Heartbeats that tell nothing new: found for all nodes of a batch at once, and gathered.

Looking at a node's error control costs by the batch, hardly by the frame. Where it goes on as
before, its heartbeats wait until there are many of them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.nmt.cadence import CANDIDATE_RATIO, Int64s
from syncline_analyzer.folds.nmt.columns import Columns

QUEUED_NS = 3_000_000
"""Messages closer together stood in line behind other frames: no node sends them so often [ns]."""
FIRST_ID = 0x700
ENOUGH = 4096
"""So many heartbeats of a node are looked at together."""
STATES = (0x04, 0x05, 0x7F)
"""Bytes of a heartbeat that is no boot-up and no guard answer."""
_MIXED = -1
_LONG_AGO = -(1 << 62)


class Beats(NamedTuple):
    """The messages on the error-control identifier of one node in a batch, measured.

    `byte` is what all of them tell, -1 where they are not all plain heartbeats of one state;
    `shortest_ns` and `longest_ns` are of the intervals, that since the one before included.
    """

    node: int
    place: slice
    byte: int
    shortest_ns: int
    longest_ns: int


def measured(batch: IndexedBatch, bus: int, before_ns: Callable[[int], int | None]) -> list[Beats]:
    """The data frames on 701h to 77Fh of a bus, by node.

    Args:
        before_ns: tells the stamp of the last message of a node, None where none is known.
    """
    first, last = FIRST_ID + 1, FIRST_ID + 0x7F
    nodes = [can_id & 0x7F for on, can_id in batch.ids() if on == bus and first <= can_id <= last]
    if not nodes:
        return []
    places = [batch.place(bus, FIRST_ID + node) for node in nodes]
    whole = slice(places[0].start, places[-1].stop)
    starts = np.array([place.start - whole.start for place in places])
    rows, t_ns = batch.rows_by_id[whole], batch.t_ns_by_id[whole]
    told = np.where(batch.frames.dlc[rows] == 1, batch.frames.data[rows, 0], np.uint8(0))
    low, high = np.minimum.reduceat(told, starts), np.maximum.reduceat(told, starts)
    passed = np.empty(len(t_ns), np.int64)
    np.subtract(t_ns[1:], t_ns[:-1], out=passed[1:])
    known = [before_ns(node) for node in nodes]
    passed[starts] = t_ns[starts] - [_LONG_AGO if each is None else each for each in known]
    shortest, longest = np.minimum.reduceat(passed, starts), np.maximum.reduceat(passed, starts)
    byte = np.where((low == high) & np.isin(low, STATES), low.astype(np.int16), _MIXED)
    columns = (byte.tolist(), shortest.tolist(), longest.tolist())
    return [Beats(*each) for each in zip(nodes, places, *columns, strict=True)]


@dataclass(slots=True)
class Calm:
    """The heartbeats of a node that go on as before, and wait.

    `floor_ns` is the shortest of the last periods before them; `life` are (seq, t_ns) of the last
    of them and of every frame of the node after it.
    """

    byte: int
    floor_ns: int
    last_ns: int
    life: tuple[Int64s, Int64s]
    number: int = 0
    _seq: list[Int64s] = field(default_factory=list)
    _t_ns: list[Int64s] = field(default_factory=list)

    def limit_ns(self, beats: Beats, shortest_ns: int) -> float | None:
        """What no silence of the node may exceed; None where the messages are not as before.

        Args:
            shortest_ns: of the periods that the silences are held against.
        """
        floor_ns = min(self.floor_ns, beats.shortest_ns, shortest_ns)
        limit_ns = CANDIDATE_RATIO * floor_ns
        calm = beats.byte == self.byte and floor_ns >= QUEUED_NS and beats.longest_ns <= limit_ns
        return limit_ns if calm else None

    def add(self, seq: Int64s, t_ns: Int64s, life: tuple[Int64s, Int64s]) -> None:
        """Take in further heartbeats, and the signs of life from the last of them on."""
        # Copies, so that a few heartbeats do not keep the columns of a whole batch alive.
        self._seq.append(seq.copy())
        self._t_ns.append(t_ns.copy())
        self.number += len(seq)
        self.last_ns = int(t_ns[-1])
        self.life = life

    def rows(self) -> Columns:
        """Everything that waited."""
        seq, t_ns = np.concatenate(self._seq), np.concatenate(self._t_ns)
        one = np.ones(len(seq), np.uint8)
        return Columns(seq, t_ns, np.zeros(len(seq), np.bool_), one, one * np.uint8(self.byte))
