"""The object dictionary as the capture shows it: every object's last value, and what it was before."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.context import Context
from syncline_analyzer.object_history import Change, Known, ObjectHistory
from syncline_analyzer.results import NodeRow, ObjectHistoryRow, ObjectRow
from syncline_schemas.canopen.datatypes import decode_value
from syncline_schemas.canopen.objects import (
    DRIVES,
    drive_object,
    standard_meaning,
    standard_object,
)
from syncline_schemas.devices import Device

MAX_ROWS = 2000
"""History rows per object: what is polled for days keeps its last ones."""
_ASSUMED = (0x1005, 0x1006, 0x1007, 0x100C, 0x100D, 0x1014, 0x1015, 0x1016, 0x1017, 0x1019, 0x1029)
"""Variables that the analyses ask the shadow for, besides those of PDOs and measurements."""
_COMMUNICATION, _MAPPING = range(0x1800, 0x1A00), range(0x1A00, 0x1C00)
_PROFILE = range(0x6000, 0x6010)
_MAKERS = 0x2000
"""From here on objects are the maker's or a profile's (CiA 301 7.4.1)."""

Key = tuple[int, int]


def object_rows(context: Context, nodes: Sequence[NodeRow] = ()) -> list[ObjectRow]:
    """One row per object that was seen on the bus, or is assumed of one of `nodes`.

    Returns: rows by bus, node, index and sub-index.
    """
    numbers = {name: number for number, name in enumerate(context.buses)}
    listed = {(numbers[row.bus], row.node) for row in nodes if row.bus in numbers}
    return [
        row
        for bus, node in sorted(listed | set(context.shadow.nodes()))
        for row in _rows_of(context, bus, node, assumed=(bus, node) in listed)
    ]


def history_rows(context: Context) -> list[ObjectHistoryRow]:
    """One row per value that an object had, by bus, node, index, sub-index and `seq`."""
    return [
        row
        for bus, node in sorted(context.shadow.nodes())
        for key, history in context.shadow.history(bus, node)
        for row in _history_of(context, bus, node, key, history)
    ]


def named(
    device: Device | None, index: int, sub: int, profile: int | None = None
) -> tuple[str | None, str | None]:
    """Name and unit of an object by its device, else by CiA 301; None where neither knows.

    `profile` is the low half of 1000h: the names of drives count where it says that it is one.
    """
    facts = device.object(index, sub) if device else None
    if facts is not None:
        return facts.full_name, facts.unit or None
    usual = standard_object(index, sub)
    if usual is not None:
        return usual.name, usual.unit or None
    return (drive_object(index) if profile == DRIVES else None), None


def meaning(device: Device | None, index: int, sub: int, value: object) -> str:
    """Words for a value by its device, else by CiA 301; "" where the number says it all."""
    if not isinstance(value, int):
        return ""
    facts = device.object(index, sub) if device else None
    words = facts.describe(value) if facts is not None else ""
    return words or standard_meaning(index, sub, value)


def _modulo(context: Context, bus: int, node: int, key: Key, value: object) -> str:
    """A negative offset of an encoder as it reads within the measuring range."""
    device = context.shadow.device(bus, node)
    measured = device.measurement if device else {}
    if key != measured.get("offset") or not isinstance(value, int) or value >= 0:
        return ""
    total = context.shadow.number(bus, node, *measured["range"]) if "range" in measured else None
    return f"{value % total} modulo the range of {total}" if total else ""


def _rows_of(context: Context, bus: int, node: int, *, assumed: bool) -> Iterator[ObjectRow]:
    shadow = context.shadow
    found: dict[Key, ObjectRow] = {}
    for key, history in shadow.history(bus, node):
        if history.last is not None:
            change = history.changes[-1]
            written = history.last.source == "sdo-write"
            saved = _saved(shadow.device(bus, node), key, history) if written else None
            found[key] = _row(context, bus, node, key, history.last, change, saved)
    for key in _parameters(context, bus, node) if assumed else ():
        known = shadow.assumed(bus, node, *key)
        if key not in found and known is not None:
            found[key] = _row(context, bus, node, key, known)
    yield from (found[key] for key in sorted(found))


def _saved(device: Device | None, key: Key, history: ObjectHistory) -> bool | None:
    """Whether a written value is saved; None where the maker does not say that 1010h keeps it."""
    if not history.unsaved:
        return True
    facts = device.object(*key) if device else None
    if device is None or facts is None or key[0] < _MAKERS:
        return False
    stated = bool(device.quirks.storage) or device.quirks.saves_all
    return None if stated and facts.persisted not in ("yes", "no") else False


def _parameters(context: Context, bus: int, node: int) -> set[Key]:
    """Objects that an analysis may ask for and that the description or the device tell."""
    entry = context.description.node(context.bus_name(bus), node)
    keys = set(entry.objects) if entry else set()
    device = context.shadow.device(bus, node)
    for index, sub in device.facts if device else ():
        timing = index in _COMMUNICATION and sub in (1, 2, 3, 5)
        if timing or index in _MAPPING or index in _PROFILE or index in _ASSUMED:
            keys.add((index, sub))
    return {key for key in keys if key[1] or key[0] not in (0x1016, 0x1029)}


def _row(
    context: Context,
    bus: int,
    node: int,
    key: Key,
    known: Known,
    change: Change | None = None,
    saved: bool | None = None,
) -> ObjectRow:
    device = context.shadow.device(bus, node)
    name, unit = named(device, *key, _profile(context, bus, node))
    value = shown_value(device, key, known)
    return ObjectRow(
        bus=context.bus_name(bus),
        node=node,
        index=key[0],
        sub=key[1],
        name=name,
        unit=unit,
        value=value,
        source=known.source,
        seq=known.seq,
        t_ns=known.t_ns,
        meaning=meaning(device, *key, value) or _modulo(context, bus, node, key, value),
        since_seq=change.seq if change else None,
        since_ns=change.t_ns if change else None,
        cause=change.cause if change else "",
        saved=saved,
    )


def _profile(context: Context, bus: int, node: int) -> int | None:
    kind = context.shadow.number(bus, node, 0x1000)
    return None if kind is None else kind & 0xFFFF


def _history_of(
    context: Context, bus: int, node: int, key: Key, history: ObjectHistory
) -> Iterator[ObjectHistoryRow]:
    device = context.shadow.device(bus, node)
    name, unit = named(device, *key, _profile(context, bus, node))
    bus_name = context.bus_name(bus)
    words: dict[int, str] = {}
    for change, until_seq, until_ns in list(history.spans())[-MAX_ROWS:]:
        known = change.known or context.shadow.assumed(bus, node, *key)
        value = shown_value(device, key, known) if known else None
        if isinstance(value, int) and value not in words:
            words[value] = meaning(device, *key, value)
        yield ObjectHistoryRow(
            bus=bus_name,
            node=node,
            index=key[0],
            sub=key[1],
            name=name,
            unit=unit,
            value=value,
            meaning=words[value] if isinstance(value, int) else "",
            source=known.source if known else "unknown",
            cause=change.cause,
            seq=known.seq if known else None,
            start_seq=change.seq,
            start_ns=change.t_ns,
            until_seq=until_seq,
            until_ns=until_ns,
        )


def shown_value(device: Device | None, key: Key, known: Known) -> int | float | str:
    """The value by the object's type; bytes of an unknown type as hexadecimal."""
    if isinstance(known.value, int):
        return known.value
    usual = standard_object(*key)
    facts = device.object(*key) if device else None
    code = facts.data_type if facts else usual.data_type if usual else None
    value = decode_value(code, known.value)
    return known.value.hex(" ").upper() if isinstance(value, bytes) else value
