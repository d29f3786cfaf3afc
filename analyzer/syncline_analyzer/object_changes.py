"""The change log of a capture: which parameter of which device was changed, by whom, and to what."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from dataclasses import field, replace

from syncline_analyzer.change_words import (
    change_words,
    measuring_roles,
    object_facts,
    typed,
    value_words,
)
from syncline_analyzer.context import Context
from syncline_analyzer.folds.bus.lss import LssTable
from syncline_analyzer.object_history import Change, Known, ObjectHistory
from syncline_analyzer.objects import named, shown_value
from syncline_analyzer.results import ObjectChangeRow, SdoRow, SdoTransfers
from syncline_schemas.canopen.objects import standard_object
from syncline_schemas.canopen.sdo import LOAD_SIGNATURE, SAVE_SIGNATURE
from syncline_schemas.devices import Device, quirks
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

MAX_ROWS = 100_000
MAX_OF_ONE = 2000
"""Changes of one object: of what a client writes all day long the last ones are told."""
STORE, RESTORE, ERROR_LIST = 0x1010, 0x1011, 0x1003
_CLIENTS = range(0x1280, 0x1300)
_COMMUNICATION = range(0x1000, 0x2000)
_STATE = (0x1000, 0x1001, 0x1002, 0x1003, 0x1008, 0x1009, 0x100A, STORE, RESTORE, 0x1013, 0x1018)
"""Objects of the communication profile that are no settings."""
_ACTS = ("sdo-write", "order", "lss")
"""Causes that come before what they bring about."""
_BY_ITSELF = "the device itself"
_UNSEEN = "not seen in this capture"

Key = tuple[int, int]
Clients = dict[tuple[int, int], int]
"""Node by bus number and the identifier on which its SDO client asks."""


class _Save(NamedTuple):
    """A save that the node acknowledged: `seq` of its answer, sub-index of 1010h."""

    seq: int
    sub: int


@dataclass(slots=True)
class _Node:
    """What the log needs to know of one node."""

    bus: int
    node: int
    device: Device | None
    profile: int | None
    writes: dict[int, SdoRow] = field(default_factory=dict)
    """Acknowledged writes by the `seq` of their answers."""
    saves: list[_Save] = field(default_factory=list)


@dataclass(slots=True)
class _Value:
    """What is known of an object at a moment; `doubtful` once a reset may have changed it."""

    known: Known | None
    doubtful: bool = False

    @property
    def sure(self) -> bool:
        return self.known is not None and self.known.confirmed and not self.doubtful

    @property
    def source(self) -> str:
        if self.known is None:
            return "unknown"
        return "before a reset" if self.doubtful else self.known.source


def object_change_rows(
    context: Context, transfers: SdoTransfers, lss: LssTable
) -> list[ObjectChangeRow]:
    """Every change of a parameter that the capture shows or gives away, in order of `seq`."""
    rows = list(_by_lss(lss))
    clients = _sdo_clients(context)
    for node in _nodes(context, transfers):
        for key, history in context.shadow.history(node.bus, node.node):
            if _is_logged(node, key, history):
                rows.extend(_Log(context, clients, node, key).rows(history))
        rows.extend(_storage_orders(clients, node))
    return sorted(rows, key=lambda row: (row.seq, row.cause not in _ACTS))[:MAX_ROWS]


def _nodes(context: Context, transfers: SdoTransfers) -> list[_Node]:
    numbers = {context.bus_name(bus): bus for bus in range(len(context.buses))}
    found: dict[tuple[int, int], _Node] = {}
    for bus, node in sorted(context.shadow.nodes()):
        kind = context.shadow.number(bus, node, 0x1000)
        profile = None if kind is None else kind & 0xFFFF
        found[bus, node] = _Node(bus, node, context.shadow.device(bus, node), profile)
    for row in transfers.accepted.of_objects(lambda of: of.bus in numbers):
        key = numbers[row.bus], row.node
        if key not in found:
            found[key] = _Node(*key, context.shadow.device(*key), None)
        seq = row.seq if row.end_seq is None else row.end_seq
        found[key].writes[seq] = row
        if row.index == STORE and _signature(row) == SAVE_SIGNATURE:
            found[key].saves.append(_Save(seq, row.sub or 0))
    for entry in found.values():
        entry.saves.sort()
    return list(found.values())


def _signature(row: SdoRow) -> int:
    return int.from_bytes(row.data[:4], "little")


def _is_logged(node: _Node, key: Key, history: ObjectHistory) -> bool:
    """Whether the changes of an object are a matter of the log: it was written, or is a setting."""
    if key[0] in (STORE, RESTORE) or len(history.changes) == 0:
        return False
    written = any(change.cause != "sdo-read" for change in history.changes)
    return written or (len(history.changes) > 1 and _is_setting(node, key))


def _is_setting(node: _Node, key: Key) -> bool:
    """Whether another value, when it is read, means that somebody changed a setting."""
    if key[0] in _STATE or key in quirks(node.device).clear_on_read or _is_order(node, key):
        return False
    facts = node.device.object(*key) if node.device else None
    if facts is not None:
        return facts.access.startswith("rw") and not facts.mappable
    return key[0] in _COMMUNICATION and standard_object(*key) is not None


def _is_order(node: _Node, key: Key) -> bool:
    """Whether a write is a command that acts each time, and not a value that stays."""
    facts = quirks(node.device)
    once = {(jump.index, jump.sub) for jump in facts.jumps if jump.values is not None}
    orders = {*facts.reset_writes, *facts.factory_reset_writes, *once, (ERROR_LIST, 0)}
    return key in orders or key == measuring_roles(node.device, node.profile).get("preset")


class _Log:
    """Follows one object through its history."""

    def __init__(self, context: Context, clients: Clients, node: _Node, key: Key) -> None:
        self._context = context
        self._clients = clients
        self._node = node
        self._key = key
        self._facts = object_facts(node.device, node.profile, key)
        self._order = _is_order(node, key)
        self._setting = _is_setting(node, key)
        name, self._unit = named(node.device, *key, node.profile)
        self._name = name or (self._facts.name if self._facts else None)
        self._now = _Value(context.shadow.assumed(node.bus, node.node, *key))
        self._found: list[ObjectChangeRow] = []
        self._open = False
        """Whether the last row's value still holds, so that writing it again is a repetition."""

    def rows(self, history: ObjectHistory) -> list[ObjectChangeRow]:
        """Every change of the object."""
        changes = history.changes[-MAX_OF_ONE:]
        if len(changes) < len(history.changes):
            self._now = _Value(history.changes[-MAX_OF_ONE - 1].known)
        following: list[Change | None] = [*changes[1:], None]
        for change, after in zip(changes, following, strict=True):
            match change.cause:
                case "sdo-write" | "side effect":
                    self._written(change)
                case "sdo-read":
                    self._read(change)
                case _:
                    self._reset(change, after)
        return [self._with_save(row, at) for at, row in enumerate(self._found)]

    def _written(self, change: Change) -> None:
        known = change.known
        assert known is not None
        now = self._now
        same = now.known is not None and now.known.value == known.value
        sure = now.known is not None and now.known.confirmed
        if not self._order and same and (sure or change.cause == "side effect"):
            if self._open:
                last = self._found[-1]
                self._found[-1] = replace(last, repeats=last.repeats + 1)
        else:
            by = self._node.writes.get(change.seq)
            self._add(change, known, self._client(by), by)
        self._now = _Value(known)

    def _read(self, change: Change) -> None:
        known, now = change.known, self._now
        if known is None:
            return
        before = now.known
        if self._setting and before is not None and before.confirmed:
            if known.value != before.value:
                who = f"{_BY_ITSELF} (reset)" if now.doubtful else _UNSEEN
                self._add(change, known, who, None, sure=True)
        else:
            self._open = False
        self._now = _Value(known)

    def _reset(self, change: Change, after: Change | None) -> None:
        """A reset: the saved value is back, the default is assumed, or the next read decides."""
        if self._order or self._is_identity():
            return
        known = change.known
        read = after is not None and after.cause == "sdo-read"
        if known is None and not read and (change.cause == "factory reset" or self._forgets()):
            known = self._context.shadow.assumed(self._node.bus, self._node.node, *self._key)
        if known is None or self._now.known is None:
            self._now.doubtful = True
            return
        if known.value != self._now.known.value:
            self._add(change, known, f"{_BY_ITSELF} ({change.cause})", None)
        self._now = _Value(known)

    def _forgets(self) -> bool:
        """Whether the maker says what a reset does to the object."""
        return self._facts is not None and self._facts.persisted in ("yes", "no")

    def _is_identity(self) -> bool:
        facts = quirks(self._node.device)
        return self._key in (facts.node_id_object, facts.bitrate_object)

    def _add(
        self, change: Change, known: Known, who: str, by: SdoRow | None, *, sure: bool = False
    ) -> None:
        now, node = self._now, self._node
        old, new = (
            typed(node.device, node.profile, self._key, shown_value(node.device, self._key, each))
            if each
            else None
            for each in (now.known, known)
        )
        place = (by.index or 0, by.sub or 0) if by is not None else self._key
        certain = self._order or sure or (now.sure and known.confirmed)
        self._found.append(
            ObjectChangeRow(
                bus=self._context.bus_name(node.bus),
                node=node.node,
                seq=change.seq,
                t_ns=change.t_ns,
                index=self._key[0],
                sub=self._key[1],
                name=self._name,
                unit=self._unit,
                old=old,
                new=new,
                words=change_words(node.device, node.profile, self._key, old, new),
                who=who,
                cause="seen by a read" if change.cause == "sdo-read" else change.cause,
                client=by.client_cob_id if by is not None else None,
                written=None if place == self._key else place[0] << 8 | place[1],
                old_source=now.source,
                new_source=known.source,
                changed=True if certain else None,
                old_words=value_words(node.device, node.profile, self._key, old),
            )
        )
        self._open = True

    def _client(self, by: SdoRow | None) -> str:
        return _client_words(self._clients, self._node.bus, by.client_cob_id if by else None)

    def _with_save(self, row: ObjectChangeRow, at: int) -> ObjectChangeRow:
        """The row with whether a save keeps its value, before it was changed once more."""
        if row.cause not in ("sdo-write", "side effect"):
            return row
        facts, key = quirks(self._node.device), self._effect()
        if key is None:
            return row
        if key in facts.stored_at_once:
            return replace(row, saved=True)
        until = self._found[at + 1].seq if at + 1 < len(self._found) else None
        saves = self._node.saves
        first = bisect_right(saves, row.seq, key=lambda save: save.seq)
        last = len(saves) if until is None else bisect_left(saves, until, key=lambda s: s.seq)
        shadow, node = self._context.shadow, self._node
        for save in saves[first:last]:
            if shadow.kept_by(node.bus, node.node, key, save.sub):
                return replace(row, saved=True, saved_seq=save.seq)
        told = self._forgets() or key[0] in _COMMUNICATION
        return replace(row, saved=False if told else None)

    def _effect(self) -> Key | None:
        """The object by which a write is kept: of a preset its offset; None for other orders."""
        facts = quirks(self._node.device)
        if not self._order or self._key in facts.stored_at_once:
            return self._key
        roles = measuring_roles(self._node.device, self._node.profile)
        if self._key != roles.get("preset"):
            return None
        offset: Key = roles.get("offset", self._key)
        return offset


def _sdo_clients(context: Context) -> Clients:
    """Nodes that say that they are SDO clients (1280h and on), by bus and identifier."""
    shadow = context.shadow
    found: Clients = {}
    for bus, node in shadow.nodes():
        for (index, sub), _ in shadow.history(bus, node):
            can_id = (
                shadow.confirmed(bus, node, index, 1) if index in _CLIENTS and sub == 1 else None
            )
            if can_id is not None:
                found[bus, can_id] = node
    return found


def _client_words(clients: Clients, bus: int, client: int | None) -> str:
    """Who asks on an identifier: the node that says that it is its SDO client, else the channel."""
    if client is None:
        return "SDO client"
    channel = f"SDO client on {client:03X}h"
    node = clients.get((bus, client))
    return channel if node is None else f"node {node} ({channel})"


def _storage_orders(clients: Clients, node: _Node) -> Iterator[ObjectChangeRow]:
    """Saves and restored defaults: they change what outlives a reset."""
    wanted = {STORE: SAVE_SIGNATURE, RESTORE: LOAD_SIGNATURE}
    for seq, row in node.writes.items():
        index, sub = row.index, row.sub or 0
        if index not in wanted or _signature(row) != wanted[index]:
            continue
        name, _ = named(node.device, index, sub)
        value = _signature(row)
        yield ObjectChangeRow(
            bus=row.bus,
            node=row.node,
            seq=seq,
            t_ns=row.end_ns,
            index=index,
            sub=sub,
            name=name,
            unit=None,
            old=None,
            new="save" if index == STORE else "load",
            words=change_words(None, None, (index, sub), None, value),
            who=_client_words(clients, node.bus, row.client_cob_id),
            cause="order",
            client=row.client_cob_id,
        )


def _by_lss(lss: LssTable) -> Iterator[ObjectChangeRow]:
    """Node ids and bit rates that LSS configured and the slave took."""
    for setting in lss.settings:
        if setting.refused:
            continue
        new = setting.request.values.get("node_id")
        old = lss.node_before(setting)
        yield ObjectChangeRow(
            bus=setting.request.bus,
            node=old,
            seq=setting.answer.seq,
            t_ns=setting.answer.t_ns,
            index=None,
            sub=None,
            name="node id" if new is not None else None,
            unit=None,
            old=old if new is not None else None,
            new=new if new is not None else setting.request.text,
            words=setting.request.text,
            who="LSS master",
            cause="lss",
            old_source="unknown",
            new_source="lss",
        )
