"""Objects whose value differs: parameters, settings of angles, mappings of PDOs."""

from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from typing import Any

from syncline_analyzer.comparison.node_presence import IDENTITY_OBJECTS, SEEN
from syncline_analyzer.comparison.rows import ComparisonRow
from syncline_analyzer.comparison.side import Pair, Side
from syncline_analyzer.results import ObjectRow, Severity
from syncline_analyzer.views.words import object_name
from syncline_schemas.devices import Device, load_device
from syncline_schemas.errors import DescriptionError

_STATUS = {0x1001, 0x1002, 0x1003, 0x1010, 0x1011, 0x1012, 0x1013}
"""Objects of CiA 301 that tell a state or take a command."""
_COMMUNICATION = range(0x1000, 0x2000)
_PROGRAMS = range(0x1F50, 0x1F60)
_MAPPING = (range(0x1600, 0x1800), range(0x1A00, 0x1C00))
_WRITABLE = ("rw", "rww", "rwr", "wo", "const")
Key = tuple[int, int, int]


def parameter_rows(pair: Pair) -> Iterator[ComparisonRow]:
    """Values that the bus itself told in both captures, and that are not the same."""
    golden, capture = _told(pair.golden), _told(pair.capture)
    moving = _moving(pair.golden) | _moving(pair.capture)
    differing = [
        key for key in sorted(golden.keys() & capture.keys())
        if golden[key].value != capture[key].value and key not in moving
    ]  # fmt: skip
    devices = {node: _device(pair, node) for node, _, _ in differing}
    chosen = [key for key in differing if _is_parameter(devices[key[0]], golden[key], capture[key])]
    for (node, index), keys in groupby(chosen, key=lambda key: key[:2]):
        rows = [(golden[key], capture[key]) for key in keys]
        if any(index in each for each in _MAPPING):
            yield _mapping(pair, node, index, rows, golden, capture)
        else:
            yield from (_row(pair, devices[node], *each) for each in rows)


def _told(side: Side) -> dict[Key, ObjectRow]:
    rows: Iterable[ObjectRow] = side.of_bus("objects")
    return {(row.node, row.index, row.sub): row for row in rows if row.source in SEEN}


def _moving(side: Side) -> set[Key]:
    """Objects that changed by themselves, and those that are measured or counted."""
    found: set[Key] = set()
    values: dict[Key, object] = {}
    for row in side.of_bus("object_history"):
        key = row.node, row.index, row.sub
        if row.cause == "sdo-read" and key in values and values[key] != row.value:
            found.add(key)
        values[key] = row.value
    found |= {(row.node, row.object >> 8, row.object & 0xFF) for row in side.of_bus("traces")}
    found |= {(row.node, row.index, row.sub) for row in side.of_bus("device_health")}
    return found


def _device(pair: Pair, node: int) -> Device | None:
    for side in (pair.golden, pair.capture):
        name = side.nodes[node].device if node in side.nodes else None
        if name:
            try:
                return load_device(name)
            except DescriptionError:
                continue
    return None


def _is_parameter(device: Device | None, golden: ObjectRow, capture: ObjectRow) -> bool:
    """Whether an object is a setting, and not a state, a command or something measured."""
    index, sub = golden.index, golden.sub
    if (index, sub) in IDENTITY_OBJECTS or index in _STATUS or index in _PROGRAMS:
        return False
    if index in _COMMUNICATION:
        return True
    facts = device.object(index, sub) if device else None
    if facts is not None:
        # What an RPDO may carry is an output, not a setting.
        told = facts.access in _WRITABLE or (index, sub) in _scales(device)
        return told and not facts.mappable
    return "sdo-write" in (golden.source, capture.source) and golden.cause != "sdo-read"


def _words(row: ObjectRow) -> str:
    unit = f" {row.unit}" if row.unit else ""
    plain = f"{row.value:X}h" if isinstance(row.value, int) and 0x1000 <= row.index < 0x2000 and not row.unit else f"{row.value}"  # fmt: skip
    return f"{row.meaning} ({plain}{unit})" if row.meaning else f"{plain}{unit}"


def _scales(device: Device | None) -> set[tuple[int, int]]:
    """Objects that decide what the values of a device mean, and the values themselves."""
    found: set[tuple[int, int]] = set()
    for value in device.measurement.values() if device else ():
        inner = value.get("object") if isinstance(value, Mapping) else value
        for each in inner if isinstance(inner, tuple | list) and inner else ():
            if isinstance(each, tuple) and len(each) == 2:
                found.add(each)
        if isinstance(inner, tuple) and len(inner) == 2 and isinstance(inner[0], int):
            found.add(inner)
    return found


def _row(pair: Pair, device: Device | None, golden: ObjectRow, capture: ObjectRow) -> ComparisonRow:
    key = capture.index, capture.sub
    scale = key in _scales(device) or 0x6000 <= capture.index <= 0x6003
    severity: Severity = "error" if scale else "warning"
    name = f"{object_name(*key)} {capture.name or golden.name or ''}".rstrip()
    told = [_words(golden), _words(capture)]
    numbers = [
        row.value if isinstance(row.value, int | float) else None for row in (golden, capture)
    ]
    return pair.row(
        "angle.setting" if scale else "object", severity, capture.node, name,
        f"{pair.who(capture.node)}: {name} is {told[1]}; golden: {told[0]}.", *told,
        golden_value=numbers[0], capture_value=numbers[1], unit=capture.unit or "",
        object=capture.index << 8 | capture.sub, **_evidence(golden, capture),
    )  # fmt: skip


def _evidence(golden: ObjectRow, capture: ObjectRow) -> dict[str, Any]:
    return {
        "golden_seq": [] if golden.seq is None else [golden.seq],
        "capture_seq": [] if capture.seq is None else [capture.seq],
        "golden_ns": golden.t_ns,
        "capture_ns": capture.t_ns,
    }


def _mapping(
    pair: Pair,
    node: int,
    index: int,
    rows: list[tuple[ObjectRow, ObjectRow]],
    golden: dict[Key, ObjectRow],
    capture: dict[Key, ObjectRow],
) -> ComparisonRow:
    """All entries of one PDO's mapping as one difference."""
    receive = index < 0x1800
    pdo = f"{'RPDO' if receive else 'TPDO'}{index - (0x15FF if receive else 0x19FF)}"
    told = [_mapped(golden, node, index), _mapped(capture, node, index)]
    return pair.row(
        "pdo.mapping", "warning", node, f"{pdo} mapping",
        f"{pair.who(node)}: {pdo} maps {told[1]}; golden: {told[0]}.",
        *told, object=index << 8, **_evidence(*rows[0]),
    )  # fmt: skip


def _mapped(known: dict[Key, ObjectRow], node: int, index: int) -> str:
    count = known.get((node, index, 0))
    subs = sorted(sub for n, i, sub in known if (n, i) == (node, index) and sub)
    if count is not None and isinstance(count.value, int):
        subs = [sub for sub in subs if sub <= count.value]
    entries = [known[node, index, sub] for sub in subs]
    return ", ".join(row.meaning or str(row.value) for row in entries) or "nothing"
