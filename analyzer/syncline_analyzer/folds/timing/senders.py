"""Who sends the frames of a bus, and what they are: by PDO bindings, moved identifiers and CiA 301.

The predefined connection set tells what nothing else does.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.waiting import MASTER, UNKNOWN
from syncline_analyzer.pdo_binding import PdoBindings, settled
from syncline_analyzer.service_ids import (
    FRAME_29_BIT,
    PRODUCES,
    SYNC,
    cob_id,
    moved_emcy_id,
    sync_id,
)
from syncline_schemas import native
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.named_tuples import NamedTuple

_REMOTE = 1 << 11
_NO_SERVICE = np.uint16(FrameFlag.EXTENDED | FrameFlag.ERROR | FrameFlag.FD)
_OF_MASTER = (Service.NMT, Service.TIME, Service.SDO_REQUEST)
_OF_NODE = (Service.EMCY, Service.SDO_ANSWER, Service.ERROR_CONTROL)
_WORDS = {
    Service.NMT: "NMT",
    Service.SYNC: "SYNC",
    Service.EMCY: "EMCY",
    Service.TIME: "TIME",
    Service.PDO: "PDO",
    Service.SDO_ANSWER: "SDO answer",
    Service.SDO_REQUEST: "SDO request",
    Service.ERROR_CONTROL: "error control",
    Service.LSS: "LSS",
}
_SDO_CLIENT, _SDO_SERVER = ((0x1200, 1), "SDO request"), ((0x1200, 2), "SDO answer")


class Sender(NamedTuple):
    """Node that sends an identifier (`MASTER`, `UNKNOWN`) and its service in words."""

    node: int
    service: str


_STRANGER = Sender(UNKNOWN, "other")
_NODES = 128
_SPOKEN = np.isin(SERVICE_OF_ID, (int(Service.SDO_ANSWER), int(Service.ERROR_CONTROL)))
"""(2048,) identifiers of services of which only the node itself sends the data frames."""


class Senders:
    """Answers for a whole block at once.

    That an identifier is the predefined one of a node proves nothing where nobody else heard of
    that node: any other node may send it.
    """

    def __init__(self, context: Context, bindings: PdoBindings) -> None:
        self._context = context
        self._bindings = bindings
        self._moved_ids: dict[int, tuple[int, dict[int, Sender]]] = {}
        self._told: dict[int, tuple[tuple[int | None, int], dict[tuple[int, bool], Sender]]] = {}
        """What was told on each bus, and what it depends on."""
        self._heard: dict[int, set[int]] = {}

    def nodes(self, frames: FrameBatch, bus: int, seq: int) -> NDArray[np.int16]:
        """(n,) sender of each frame of a bus as of `seq`; `UNKNOWN` for 29-bit and FD frames."""
        self._bindings.refresh(bus)
        seen = _seen(frames)
        spoken = np.flatnonzero(seen[:_REMOTE] & _SPOKEN) % _NODES
        self._heard.setdefault(bus, set()).update(spoken.tolist())
        known = self._known(bus, seq)
        node = np.full(2 * _REMOTE, UNKNOWN, np.int16)
        for key in np.flatnonzero(seen).tolist():
            name = key & 0x7FF, key >= _REMOTE
            if name not in known:
                known[name] = self.of(bus, name[0], seq, remote=name[1])
            node[key] = known[name].node
        return _sent_by(frames, node)

    def told(self, bus: int) -> Mapping[tuple[int, bool], Sender]:
        """By identifier, and whether its frames are remote ones: those that `nodes` told last."""
        return self._told[bus][1]

    def _known(self, bus: int, seq: int) -> dict[tuple[int, bool], Sender]:
        """What was told before, and holds at `seq` as well."""
        since = settled(self._context.shadow, bus, seq), len(self._heard[bus])
        if since[0] is None or self._told.get(bus, (None, {}))[0] != since:
            self._told[bus] = since, {}
        return self._told[bus][1]

    def of(self, bus: int, can_id: int, seq: int | None = None, *, remote: bool = False) -> Sender:
        """Sender of one 11-bit identifier as of `seq`, by default in the end."""
        service = Service(int(SERVICE_OF_ID[can_id]))
        if remote:
            asked = "guard request" if service == Service.ERROR_CONTROL else "remote frame"
            return Sender(MASTER, asked)
        moved = self._moved(bus).get(can_id)
        owner = self._bindings.owner(bus, can_id, seq)
        if owner is not None and (moved is None or not owner.guess):
            if owner.guess and not self._exists(bus, owner.node):
                return Sender(UNKNOWN, owner.name)
            return Sender(owner.node if owner.kind == "tpdo" else MASTER, owner.name)
        if moved is not None:
            return moved
        if service in _OF_NODE:
            return Sender(can_id & 0x7F, _WORDS[service])
        if service in _OF_MASTER or can_id == 0x7E5:
            return Sender(MASTER, _WORDS[service])
        return Sender(UNKNOWN, _WORDS[service]) if service in _WORDS else _STRANGER

    def _exists(self, bus: int, node: int) -> bool:
        """Whether anything but a PDO tells of a node."""
        return node in self._heard.get(bus, ()) or node in self._context.shadow.nodes_of(bus)

    def _moved(self, bus: int) -> dict[int, Sender]:
        version, found = self._moved_ids.get(bus, (-1, {}))
        if version != self._context.shadow.version:
            found = self._read_moved(bus)
            self._moved_ids[bus] = (self._context.shadow.version, found)
        return found

    def _read_moved(self, bus: int) -> dict[int, Sender]:
        """Senders of the identifiers that objects give to SYNC, EMCY and SDO (CiA 301 7.5.2)."""
        shadow = self._context.shadow
        found = {0x80: Sender(MASTER, "SYNC")}
        for node in shadow.nodes_of(bus):
            found.setdefault(sync_id(shadow, bus, node), Sender(MASTER, "SYNC"))
            for key, word in (_SDO_CLIENT, _SDO_SERVER):
                value = shadow.number(bus, node, *key)
                can_id = cob_id(value) if value else None
                if can_id:
                    found[can_id] = Sender(node if word == "SDO answer" else MASTER, word)
            emcy = moved_emcy_id(shadow, bus, node)
            if emcy is not None:
                found[emcy] = Sender(node, "EMCY")
        for node in shadow.nodes_of(bus):
            known = shadow.get(bus, node, SYNC, 0)
            told = known.value if known and known.source != "eds-default" else None
            if isinstance(told, int) and told & PRODUCES and not told & FRAME_29_BIT:
                found[told & 0x7FF] = Sender(node, "SYNC")
        return found


def _seen(frames: FrameBatch) -> NDArray[np.bool_]:
    """(4096,) identifiers of frames of services, those of remote ones behind the others."""
    if native.available():
        return native.seen_ids(frames.can_id, frames.flags, int(_NO_SERVICE))
    place = _places(frames)
    return np.bincount(place[(frames.flags & _NO_SERVICE) == 0], minlength=2 * _REMOTE) > 0


def _sent_by(frames: FrameBatch, node: NDArray[np.int16]) -> NDArray[np.int16]:
    """(n,) `node` of each frame by its identifier, see `_seen`."""
    if native.available():
        return native.sent_by(frames.can_id, frames.flags, int(_NO_SERVICE), node, UNKNOWN)
    plain = (frames.flags & _NO_SERVICE) == 0
    return np.where(plain, node.take(_places(frames)), np.int16(UNKNOWN))


def _places(frames: FrameBatch) -> NDArray[np.uint32]:
    remote = (frames.flags & FrameFlag.REMOTE) != 0
    place: NDArray[np.uint32] = frames.can_id & 0x7FF | remote.astype(np.uint32) << 11
    return place
