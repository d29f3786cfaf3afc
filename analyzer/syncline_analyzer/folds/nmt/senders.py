"""Which frames of a batch each node sends."""

from bisect import bisect_right
from dataclasses import field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.emcy.ids import SYNC_BYTES
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.pdo_binding import Pdo, PdoBindings
from syncline_analyzer.shadow import Shadow
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.records import dataclass

_SERVICES: list[Service] = [Service(number) for number in SERVICE_OF_ID.tolist()]
_OWN = (Service.EMCY, Service.SDO_ANSWER, Service.ERROR_CONTROL)
"""Services whose identifiers say which node sends."""
_END = 1 << 63
"""A `seq` behind all others."""
_NO_ROWS = np.zeros(0, np.intp)


@dataclass(slots=True)
class Sent:
    """What one node sends in a batch."""

    groups: list[NDArray[np.intp]] = field(default_factory=list)
    """Rows of each identifier, not none."""
    pdos: list[tuple[int, slice]] = field(default_factory=list)
    """Identifiers of PDOs, and where in the columns by identifier the node's are."""

    @property
    def rows(self) -> NDArray[np.intp]:
        """All of them, in order."""
        return np.sort(np.concatenate(self.groups)) if self.groups else _NO_ROWS

    @property
    def last(self) -> int:
        """The last row, -1 without any."""
        return max((int(group[-1]) for group in self.groups), default=-1)

    def after(self, row: int) -> NDArray[np.intp]:
        """What the node sends from a row on, in order."""
        later = [group[group.searchsorted(row) :] for group in self.groups if group[-1] >= row]
        return np.sort(np.concatenate(later)) if later else _NO_ROWS


class Senders:
    """Tells the sender of every identifier, by its service and by the PDO that it carries.

    A PDO is its node's from the frame on that binds it to its identifier. Comes after the fold that
    fills the shadow.
    """

    def __init__(self, shadow: Shadow) -> None:
        self._shadow = shadow
        self._bindings = PdoBindings(shadow)
        self._tpdos: dict[tuple[int, int], Pdo | None] = {}
        """The TPDO on each identifier as long as the shadow learns nothing."""
        self._version = -1
        self._cuts: dict[tuple[int, int], list[int]] = {}
        """By identifier: where in the capture its PDO may change."""
        self._told: dict[tuple[int, int, int], Pdo | None] = {}
        """Its TPDO between them, by bus number, identifier and how many of them came before."""

    def of(self, batch: IndexedBatch) -> dict[NodeKey, Sent]:
        """What each node sends."""
        found: dict[NodeKey, Sent] = {}
        self._forget_outdated()
        for bus, can_id in batch.ids():
            service = _SERVICES[can_id]
            for place, pdo in self._bound(batch, bus, can_id):
                if pdo is None and service not in _OWN:
                    continue
                rows = batch.rows_by_id[place]
                if service is Service.EMCY and pdo is None:
                    rows = _emcys(batch, bus, can_id, rows)
                if len(rows):
                    own = pdo is None or service is Service.ERROR_CONTROL
                    node = can_id & 0x7F if own or pdo is None else pdo.node
                    sent = found.setdefault((bus, node), Sent())
                    sent.groups.append(rows)
                    if service not in _OWN:
                        sent.pdos.append((can_id, place))
        return found

    def tpdo(self, bus: int, can_id: int, seq: int) -> Pdo | None:
        """The TPDO on an identifier: as bound at `seq`, as bound later, or by a guess."""
        self._forget_outdated()
        if (bus, can_id) not in self._cuts:
            self._bindings.refresh(bus)
            self._cuts[bus, can_id] = self._bindings.cuts(bus, can_id, -1, _END)
        key = bus, can_id, bisect_right(self._cuts[bus, can_id], seq)
        if key not in self._told:
            self._told[key] = self._tpdo(bus, can_id, seq)
        return self._told[key]

    def _tpdo(self, bus: int, can_id: int, seq: int) -> Pdo | None:
        pdo = self._bindings.owner(bus, can_id, seq)
        if pdo is None or pdo.guess:
            pdo = self._bindings.owner(bus, can_id) or pdo
        return _sent(pdo)

    def _forget_outdated(self) -> None:
        """Look again at what the shadow may tell differently by now."""
        if self._version != self._shadow.version:
            self._version = self._shadow.version
            for kept in (self._tpdos, self._cuts, self._told):
                kept.clear()

    def _bound(self, batch: IndexedBatch, bus: int, can_id: int) -> list[tuple[slice, Pdo | None]]:
        """Where in the columns by identifier the frames of one are, by the TPDO that they carry."""
        place = batch.place(bus, can_id)
        if (bus, can_id) in self._tpdos:
            return [(place, self._tpdos[bus, can_id])]
        self._bindings.refresh(bus)
        cuts = self._bindings.cuts(bus, can_id, batch.seq0, batch.last_seq)
        bound = [_sent(self._bindings.owner(bus, can_id, seq)) for seq in (batch.seq0, *cuts)]
        self._tpdos[bus, can_id] = bound[-1]
        if not cuts:
            return [(place, bound[0])]
        edges = (place.start + batch.seqs_by_id[place].searchsorted(cuts)).tolist()
        places = (slice(*edge) for edge in pairwise((place.start, *edges, place.stop)))
        pieces = zip(places, bound, strict=True)
        return [(piece, pdo) for piece, pdo in pieces if piece.start < piece.stop]


def _emcys(batch: IndexedBatch, bus: int, can_id: int, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """The frames on the identifier of a node's EMCYs that are no SYNC."""
    if batch.lengths[bus, can_id][0] > SYNC_BYTES:
        return rows
    return rows[batch.frames.dlc[rows] > SYNC_BYTES]


def _sent(pdo: Pdo | None) -> Pdo | None:
    return pdo if pdo is not None and pdo.kind == "tpdo" else None
