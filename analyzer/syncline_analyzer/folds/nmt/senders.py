"""Which frames of a batch each node sends."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.emcy.ids import SYNC_BYTES
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.pdo_binding import Pdo, PdoBindings
from syncline_analyzer.shadow import Shadow
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service

_OWN = (Service.EMCY, Service.SDO_ANSWER, Service.ERROR_CONTROL)
"""Services whose identifiers say which node sends."""
_SERVICES: list[int] = SERVICE_OF_ID.tolist()
_NO_ROWS = np.zeros(0, np.intp)


@dataclass(slots=True)
class Sent:
    """What one node sends in a batch, and who asks for its error control."""

    groups: list[NDArray[np.intp]] = field(default_factory=list)
    """Rows of each identifier."""
    control: list[int] = field(default_factory=list)
    """Identifiers of error control."""
    pdos: list[int] = field(default_factory=list)
    """Identifiers of PDOs."""
    asked: NDArray[np.intp] = field(default_factory=lambda: _NO_ROWS)
    """Remote frames of its error control."""

    @property
    def rows(self) -> NDArray[np.intp]:
        """All of them, in order."""
        return np.sort(np.concatenate((*self.groups, self.asked)))

    def after(self, row: int) -> NDArray[np.intp]:
        """What the node sends from a row on, in order."""
        later = [group[group.searchsorted(row) :] for group in self.groups if group[-1] >= row]
        return np.sort(np.concatenate(later)) if later else _NO_ROWS


class Senders:
    """Tells the sender of every identifier, by its service and by the PDO that it carries."""

    def __init__(self, shadow: Shadow) -> None:
        self._shadow = shadow
        self._bindings = PdoBindings(shadow)
        self._tpdos: dict[tuple[int, int], Pdo | None] = {}
        self._version = -1

    def of(self, batch: IndexedBatch) -> dict[NodeKey, Sent]:
        """What each node sends, in order of bus and node."""
        found: dict[NodeKey, Sent] = {}
        for bus, can_id in batch.ids():
            service, rows = _SERVICES[can_id], batch.rows(bus, can_id)
            pdo = self._now(bus, can_id, batch.seq0)
            if pdo is None and service == Service.EMCY:
                rows = rows[batch.frames.dlc[rows] > SYNC_BYTES]
            if (pdo is None and service not in _OWN) or not len(rows):
                continue
            node = can_id & 0x7F if pdo is None else pdo.node
            sent = found.setdefault((bus, node), Sent())
            sent.groups.append(rows)
            if service == Service.ERROR_CONTROL:
                sent.control.append(can_id)
            elif pdo is not None and service not in _OWN:
                sent.pdos.append(can_id)
        self._add_asked(batch, found)
        return dict(sorted(found.items()))

    def tpdo(self, bus: int, can_id: int, seq: int) -> Pdo | None:
        """The TPDO on an identifier: as bound at `seq`, as bound later, or by a guess."""
        self._bindings.refresh(bus)
        pdo = self._bindings.owner(bus, can_id, seq)
        if pdo is None or pdo.guess:
            pdo = self._bindings.owner(bus, can_id) or pdo
        return pdo if pdo is not None and pdo.kind == "tpdo" else None

    def _now(self, bus: int, can_id: int, seq: int) -> Pdo | None:
        """The same for the next frames: it stays as it is until the shadow learns something."""
        if self._version != self._shadow.version:
            self._version = self._shadow.version
            self._tpdos.clear()
        if (bus, can_id) not in self._tpdos:
            self._tpdos[bus, can_id] = self.tpdo(bus, can_id, seq)
        return self._tpdos[bus, can_id]

    @staticmethod
    def _add_asked(batch: IndexedBatch, found: dict[NodeKey, Sent]) -> None:
        """Remote frames of error control count to their node."""
        asked = batch.rows_of(Service.ERROR_CONTROL, remote=True)
        buses, nodes = batch.frames.bus[asked], batch.node[asked]
        for bus, node in sorted(set(zip(buses.tolist(), nodes.tolist(), strict=True))):
            found.setdefault((bus, node), Sent()).asked = asked[(buses == bus) & (nodes == node)]
