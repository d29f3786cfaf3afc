"""Heartbeats that tell nothing new: found for all nodes of a bus at once, and gathered.

Looking at a node's error control costs by the batch, hardly by the frame. Where it goes on as
before, its heartbeats wait until there are many of them.
"""

from collections.abc import Collection, Mapping

import numpy as np

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.nmt.cadence import CANDIDATE_RATIO, MIN_PERIODS, Int64s
from syncline_analyzer.folds.nmt.senders import Sent
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_schemas.named_tuples import NamedTuple

QUEUED_NS = 3_000_000
"""Messages closer together stood in line behind other frames: no node sends them so often [ns]."""
FIRST_ID = 0x700
ENOUGH = 4096
"""So many heartbeats of each node are looked at together."""
STATES = (0x04, 0x05, 0x7F)
"""Bytes of a heartbeat that is no boot-up and no guard answer."""
_NODES = 128
_AWAKE = -1


class Steady(NamedTuple):
    """A node that sends plain heartbeats: the byte, the shortest of its last periods, the last one."""

    byte: int
    floor_ns: int
    last_ns: int


class Waited(NamedTuple):
    """Heartbeats of a node that went on as before: (n,) `seq` and stamps, and the last silences.

    `life` are (seq, t_ns) of the last of them and of every frame of the node after it.
    """

    seq: Int64s
    t_ns: Int64s
    life: tuple[Int64s, Int64s]


class _Section(NamedTuple):
    """The error control of a bus in one batch: columns, and where in them each node is."""

    seq: Int64s
    t_ns: Int64s
    places: dict[int, slice]


class CalmNodes:
    """The nodes of one bus whose heartbeats only go on, and what waits of them."""

    def __init__(self, bus: int) -> None:
        self._bus = bus
        self._byte = np.full(_NODES, _AWAKE, np.int16)
        self._floor_ns = np.zeros(_NODES, np.int64)
        self._last_ns = np.zeros(_NODES, np.int64)
        self._since: dict[int, int] = {}
        """By calm node, the first section that waits of it."""
        self._sections: list[_Section] = []
        self._number = 0
        self._tail: tuple[IndexedBatch, Mapping[NodeKey, Sent]] | None = None
        self._heard_ns = 0
        """Time of the last frame of the bus."""

    def settle(self, node: int, steady: Steady | None) -> None:
        """Let the next heartbeats of a node wait, if they may."""
        if steady is not None:
            self._since[node] = len(self._sections)
            self._byte[node], self._floor_ns[node], self._last_ns[node] = steady

    def going_on(self, batch: IndexedBatch, disturbed: Collection[int]) -> set[int]:
        """Nodes whose heartbeats go on in a batch as they did before it, but for some.

        All others are to be woken before `add` takes these in.
        """
        t_ns, heard_ns = batch.frames.t_ns, self._heard_ns
        self._heard_ns = int(t_ns[-1])
        places = self._places(batch)
        if not self._since or not places or not batch.ascending or t_ns[0] < heard_ns:
            return set()
        return self._calm(batch, places) - set(disturbed)

    def add(self, batch: IndexedBatch) -> None:
        """Let the heartbeats of all calm nodes in a batch wait."""
        if not self._since:
            return
        places = self._places(batch)
        whole = _whole(places)
        # Copies, so that a few heartbeats do not keep the columns of a whole batch alive.
        seq, t_ns = batch.seqs_by_id[whole].copy(), batch.t_ns_by_id[whole].copy()
        begin = whole.start
        within = {n: slice(p.start - begin, p.stop - begin) for n, p in places.items()}
        self._sections.append(_Section(seq, t_ns, within))
        self._number += len(seq)

    def _places(self, batch: IndexedBatch) -> dict[int, slice]:
        """Where in the columns by identifier the messages of each node are."""
        return {
            can_id & 0x7F: batch.place(bus, can_id)
            for bus, can_id in batch.ids()
            if bus == self._bus and FIRST_ID < can_id < FIRST_ID + _NODES
        }

    def _calm(self, batch: IndexedBatch, places: dict[int, slice]) -> set[int]:
        """Nodes whose messages are as before, and that were never silent for longer than usual."""
        nodes, whole = np.array(list(places)), _whole(places)
        starts = np.array([place.start - whole.start for place in places.values()])
        rows, t_ns = batch.rows_by_id[whole], batch.t_ns_by_id[whole]
        told = np.where(batch.frames.dlc[rows] == 1, batch.frames.data[rows, 0], np.uint8(0))
        low, high = np.minimum.reduceat(told, starts), np.maximum.reduceat(told, starts)
        passed = np.empty(len(t_ns), np.int64)
        np.subtract(t_ns[1:], t_ns[:-1], out=passed[1:])
        passed[starts] = t_ns[starts] - self._last_ns[nodes]
        shortest, longest = np.minimum.reduceat(passed, starts), np.maximum.reduceat(passed, starts)
        floor_ns = np.minimum(shortest, self._floor_ns[nodes])
        limit_ns = CANDIDATE_RATIO * floor_ns
        last_ns = t_ns[np.append(starts[1:], len(t_ns)) - 1]
        calm = (low == high) & (low == self._byte[nodes]) & (floor_ns >= QUEUED_NS)
        calm &= (longest <= limit_ns) & (self._heard_ns - last_ns <= limit_ns)
        going = nodes[calm]
        # The next messages are held against the last three periods.
        enough = np.diff(starts, append=len(t_ns)) >= MIN_PERIODS
        self._floor_ns[going] = np.where(enough, shortest, floor_ns)[calm]
        self._last_ns[going] = last_ns[calm]
        return set(going.tolist())

    def keep_tail(self, batch: IndexedBatch, sent: Mapping[NodeKey, Sent]) -> None:
        """Keep what the nodes send behind their last heartbeats of a batch."""
        self._tail = (batch, sent) if self._since else None

    def awake(self, calm: Collection[int]) -> list[int]:
        """Nodes that waited and are not among those that still do."""
        return [node for node in self._since if node not in calm]

    def wake(self, node: int) -> Waited | None:
        """Let a node wait no longer; what waited of it."""
        first = self._since.pop(node, len(self._sections))
        self._byte[node] = _AWAKE
        parts = [(each, each.places[node]) for each in self._sections[first:]]
        if not self._since:
            self._sections, self._number = [], 0
        if not parts:
            return None
        seq = np.concatenate([each.seq[place] for each, place in parts])
        t_ns = np.concatenate([each.t_ns[place] for each, place in parts])
        return Waited(seq, t_ns, self._life(node))

    def full(self) -> list[int]:
        """Nodes to be woken because enough waits of them."""
        return list(self._since) if self._number >= ENOUGH * len(self._since) else []

    def _life(self, node: int) -> tuple[Int64s, Int64s]:
        """What a node sent from its last heartbeat of the last batch on."""
        assert self._tail is not None
        batch, sent = self._tail
        place = batch.place(self._bus, FIRST_ID + node)
        after = sent[self._bus, node].after(int(batch.rows_by_id[place.stop - 1]))
        return batch.seqs_at(after), batch.frames.t_ns[after]


def _whole(places: dict[int, slice]) -> slice:
    """The columns of all nodes, which are in order."""
    nodes = list(places)
    return slice(places[nodes[0]].start, places[nodes[-1]].stop)
