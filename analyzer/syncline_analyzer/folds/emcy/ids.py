"""Which frames are EMCYs, and of which node: by 081h..0FFh, and by where 1014h moves them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.pdo_binding import PdoBindings
from syncline_analyzer.service_ids import EMCY, SYNC, changes_of, moved_emcy_id, sync_id

SYNC_BYTES = 1
"""A SYNC is empty or carries its counter (CiA 301 7.2.5); an EMCY has eight bytes."""
RHYTHM = 8
"""Empty frames from which on a steady rhythm is believed."""
STEADY_SHARE = 0.9
"""Part of their intervals that lie within half of the median."""


class EmcyIds:
    """Tells EMCYs from a SYNC that 1005h put on their identifiers, and from PDOs bound to them.

    An identifier is followed from the frame on that moves it.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._bindings = PdoBindings(context.shadow)
        self._settled: dict[tuple[int, int], tuple[int, bool]] = {}
        """Node of each identifier, and whether SYNCs come on it, while the shadow learns nothing."""
        self._moved: dict[int, set[int]] = {}
        """By bus, the same for identifiers to which EMCYs were moved."""
        self._version = -1

    def frames(self, batch: IndexedBatch) -> tuple[NDArray[np.intp], NDArray[np.uint8]]:
        """(n,) rows of the batch that are EMCYs, in order, and (n,) the nodes that they are of."""
        if self._version != self._context.shadow.version:
            self._version = self._context.shadow.version
            self._settled.clear()
            self._moved = {}
        found, senders = [np.zeros(0, np.intp)], [np.zeros(0, np.uint8)]
        for bus, can_id in batch.ids():
            if bus not in self._moved:
                self._moved[bus] = self._moved_ids(bus)
                self._bindings.refresh(bus)
            if 0x80 < can_id <= 0xFF or can_id in self._moved[bus]:
                rows = batch.rows(bus, can_id)
                found.append(rows)
                senders.append(self._senders(batch, bus, can_id, rows))
        rows, nodes = np.concatenate(found), np.concatenate(senders)
        order = np.argsort(rows)
        order = order[nodes[order] > 0]
        return rows[order], nodes[order]

    def _moved_ids(self, bus: int) -> set[int]:
        """Every identifier to which 1014h ever moved the EMCYs of a node of the bus."""
        shadow = self._context.shadow
        found = set()
        for node in shadow.nodes_of(bus):
            for seq in [0, *shadow.changes(bus, node, EMCY)]:
                found.add(moved_emcy_id(shadow, bus, node, seq))
        return {can_id for can_id in found if can_id is not None}

    def _senders(
        self, batch: IndexedBatch, bus: int, can_id: int, rows: NDArray[np.intp]
    ) -> NDArray[np.uint8]:
        """(n,) node of each row of an identifier, 0 where the frame is a SYNC or a PDO."""
        settled = self._settled.get((bus, can_id))
        if settled is not None:
            nodes = np.full(len(rows), settled[0], np.uint8)
            return np.where(batch.frames.dlc[rows] <= SYNC_BYTES, 0, nodes) if settled[1] else nodes
        moments = self._moments(bus, can_id, batch.seq0, batch.last_seq)
        sender = np.array([self._sender(bus, can_id, seq) for seq in moments], np.uint8)
        sync = np.array([self._is_sync(bus, can_id, seq) for seq in moments])
        self._settled[bus, can_id] = int(sender[-1]), bool(sync[-1])
        at = np.searchsorted(moments, batch.seqs_at(rows), side="right") - 1
        empty = batch.frames.dlc[rows] <= SYNC_BYTES
        return np.where(sync[at] & empty, 0, sender[at]).astype(np.uint8)

    def _moments(self, bus: int, can_id: int, first: int, last: int) -> list[int]:
        """`seq` from which on an identifier may mean something else, the first one included."""
        nodes = self._context.shadow.nodes_of(bus)
        cuts = set(self._bindings.cuts(bus, can_id, first, last))
        for index in (SYNC, EMCY):
            cuts |= changes_of(self._context.shadow, bus, nodes, index, first, last)
        return [first, *sorted(cuts)]

    def _sender(self, bus: int, can_id: int, seq: int) -> int:
        shadow = self._context.shadow
        for node in shadow.nodes_of(bus):
            if moved_emcy_id(shadow, bus, node, seq) == can_id:
                return node
        pdo = self._bindings.owner(bus, can_id, seq)
        taken = pdo is not None and not pdo.guess
        return 0 if taken or not 0x80 < can_id <= 0xFF else can_id & 0x7F

    def _is_sync(self, bus: int, can_id: int, seq: int) -> bool:
        shadow = self._context.shadow
        return any(sync_id(shadow, bus, node, seq) == can_id for node in shadow.nodes_of(bus))


def beats_like_sync(times_ns: Sequence[int], lengths: Sequence[int]) -> bool:
    """Whether frames without content come in a steady rhythm, which no error does.

    Times [ns] are all equal in a capture without times: there the number of frames decides.

    >>> beats_like_sync([10 * n for n in range(20)], [0] * 20)
    True
    >>> beats_like_sync([10, 20, 900, 910, 2000, 2010, 2020, 9000], [0] * 8)
    False
    """
    if len(times_ns) < RHYTHM or any(length > SYNC_BYTES for length in lengths):
        return False
    periods = np.diff(np.asarray(times_ns, np.float64))
    median = float(np.median(periods))
    steady = np.abs(periods - median) <= median / 2
    return float(np.mean(steady)) >= STEADY_SHARE
