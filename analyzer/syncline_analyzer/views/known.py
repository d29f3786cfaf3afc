"""What is known of each node's settings, and from where, in one short line per matter."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.change_words import shortened
from syncline_analyzer.results import Analysis, NodeRow, ObjectRow
from syncline_analyzer.views.words import hex_code, printable
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.wording import counted

MAX_LINES = 12
"""Lines per node."""
MAX_NODES = 20
_TEXTS = (0x1008, 0x1009, 0x100A)
_IDENTITY = 0x1018
_NUMBERS = {1: "vendor", 2: "product", 4: "serial number"}
_PDOS = range(0x1400, 0x1C00)
_NOT_STORED = {0x1003, *range(0x1F50, 0x1F60)}
"""The error list and programs: no parameters, 1010h stores neither."""
_CONTROL = (0x1005, 0x1006, 0x100C, 0x100D, 0x1014, 0x1015, 0x1016, 0x1017, 0x1019, 0x1029)


class KnownLine(NamedTuple):
    """One line: which node, which matter ("TPDO1", "1017h"), and what is known of it."""

    bus: str
    node: int
    what: str
    text: str


def known_lines(analysis: Analysis) -> list[KnownLine]:
    """The settings that a reader looks for first; the rest is counted and in `s.objects(node)`."""
    lines: list[KnownLine] = []
    groups: dict[tuple[str, int], list[ObjectRow]] = {
        (row.bus, row.node): [] for row in analysis.nodes
    }
    for row in analysis.objects:
        groups.setdefault((row.bus, row.node), []).append(row)
    why = {(row.bus, row.node): line for row in analysis.nodes if (line := device_line(row))}
    told = [(key, rows, _of_node(analysis, rows, why.get(key))) for key, rows in groups.items()]
    told = [entry for entry in told if entry[2]]
    for (bus, node), rows, found in told[:MAX_NODES]:
        lines += [KnownLine(bus, node, what, text) for what, text in found[:MAX_LINES]]
        objects = sum(row.since_seq is not None for row in rows)
        if len(found) > MAX_LINES:
            more = f"{len(found) - MAX_LINES} more, {objects} objects seen: s.objects({node})"
            lines.append(KnownLine(bus, node, "", f"and {more}"))
    if len(told) > MAX_NODES:
        lines.append(KnownLine("", 0, "", f"and {len(told) - MAX_NODES} more nodes"))
    return lines


def device_words(row: NodeRow) -> str:
    """The device of a node; with a question mark what it only looks like, "-" where nothing is known."""
    if row.device:
        return printable(row.device)
    return f"{' or '.join(map(printable, row.device_guess))}?" if row.device_guess else "-"


def device_line(row: NodeRow) -> str:
    """Which device the node is and who says so; of one that is not known, what it looks like."""
    reason = printable(row.device_reason)
    if row.device:
        return f"{printable(row.device)}: {reason}" if reason else ""
    looks = f"looks like {device_words(row).removesuffix('?')}" if row.device_guess else ""
    return ": ".join(part for part in (looks, reason) if part)


def source_words(row: ObjectRow) -> str:
    """Where a value comes from: "sdo-write, seq 123", "eds-default, assumed"."""
    if row.seq is None:
        return f"{row.source}, assumed" if row.source == "eds-default" else row.source
    if row.cause == "reset":
        return f"{row.source}, seq {row.seq}, back since the reset, seq {row.since_seq}"
    cause = "side effect of a write" if row.cause == "side effect" else row.source
    return f"{cause}, seq {row.seq}"


def _of_node(
    analysis: Analysis, rows: Sequence[ObjectRow], why: str | None
) -> list[tuple[str, str]]:
    device = [("device", why)] if why else []
    return [*device, *_lines(analysis, rows)] if rows else device


def _lines(analysis: Analysis, rows: Sequence[ObjectRow]) -> Iterator[tuple[str, str]]:
    identity = ", ".join(_identity(rows))
    if identity:
        yield "identity", f"{identity} (sdo-read)"
    for row in rows:
        if row.index in _CONTROL and not _goes_without_saying(row):
            yield _setting(row)
    yield from _pdo_lines(analysis, rows)
    for row in rows:
        plain = row.index not in _CONTROL and row.index not in _PDOS
        if plain and row.source in ("sdo-write", "bus-description") and row.index != 0x1010:
            yield _setting(row)
    unsaved = sum(row.saved is False and row.index not in _NOT_STORED for row in rows)
    if unsaved:
        yield "not saved", f"{counted(unsaved, 'written value')} not saved (1010h) in this capture"


def _identity(rows: Sequence[ObjectRow]) -> Iterator[str]:
    for row in rows:
        if row.index in _TEXTS and isinstance(row.value, str) and row.source == "sdo-read":
            yield f"{hex_code(row.index)} {printable(row.value).strip()}"
        known = row.index == _IDENTITY and row.sub in _NUMBERS
        if known and isinstance(row.value, int) and row.value:
            yield f"{_NUMBERS[row.sub]} {row.value:X}h"


def _goes_without_saying(row: ObjectRow) -> bool:
    """Assumed values that mean nothing in particular, and counts of entries."""
    if row.seq is not None or row.source == "bus-description":
        return row.sub == 0 and row.index in (0x1016, 0x1029)
    return row.index != 0x1017 and (row.index not in (0x100C, 0x100D) or row.value == 0)


def _setting(row: ObjectRow) -> tuple[str, str]:
    number = f"{hex_code(row.index)}:{row.sub}" if row.sub else hex_code(row.index)
    name = f"{printable(row.name)} = " if row.name else ""
    return number, f"{name}{_value(row)} ({source_words(row)})"


def _value(row: ObjectRow) -> str:
    if isinstance(row.value, str):
        return printable(shortened(row.value))
    if row.meaning:
        short = isinstance(row.value, int) and 0 <= row.value < 1 << 16
        return f"{row.value} ({printable(row.meaning)})" if short else printable(row.meaning)
    return f"{row.value} {row.unit}" if row.unit and row.unit != "us" else str(row.value)


def _pdo_lines(analysis: Analysis, rows: Sequence[ObjectRow]) -> Iterator[tuple[str, str]]:
    """One line per PDO that was seen or of which the bus told something."""
    node = rows[0]
    sent = {
        (row.pdo or "").split(" ")[0]
        for row in analysis.pdos
        if (row.bus, row.node) == (node.bus, node.node)
    }
    by_pdo: dict[str, dict[tuple[bool, int], ObjectRow]] = {}
    for row in rows:
        if row.index in _PDOS:
            mapping = bool(row.index & 0x200)
            kind = "RPDO" if row.index < 0x1800 else "TPDO"
            number = (row.index & 0x1FF) + 1
            by_pdo.setdefault(f"{kind}{number}", {})[mapping, row.sub] = row
    for pdo, parts in by_pdo.items():
        if pdo in sent or any(part.seq is not None for part in parts.values()):
            by_source: dict[str, list[Part]] = {}
            for part in _pdo_parts(parts):
                by_source.setdefault(part[1].source, []).append(part)
            groups = sorted(by_source.values(), key=lambda group: group[0][1].seq is None)
            yield pdo, "; ".join(map(_with_source, groups))


Part = tuple[str, ObjectRow]
"""Something of a PDO in words, and the object that says it."""


def _with_source(parts: Sequence[Part]) -> str:
    """What one source tells, the source once behind it."""
    words = ", ".join(text for text, _ in parts)
    seqs = [row.seq for _, row in parts if row.seq is not None]
    first = parts[0][1]
    if not seqs or min(seqs) == max(seqs):
        return f"{words} ({source_words(first)})"
    return f"{words} ({first.source}, seq {min(seqs)} to {max(seqs)})"


def _pdo_parts(parts: dict[tuple[bool, int], ObjectRow]) -> Iterator[Part]:
    kind = parts.get((False, 2))
    cyclic = kind is None or not isinstance(kind.value, int) or kind.value > 0xF0
    for sub, word in ((1, ""), (2, "type "), (3, "inhibit time "), (5, "event timer ")):
        row = parts.get((False, sub))
        if row is None or (sub > 2 and not row.value) or (sub == 5 and not cyclic):
            continue
        value = row.meaning if sub == 1 else f"{row.value}{_unit(sub, row)}"
        yield f"{word}{printable(value)}", row
    count = parts.get((True, 0))
    if count is None or not isinstance(count.value, int):
        return
    mapped = [parts.get((True, sub)) for sub in range(1, min(count.value, 64) + 1)]
    known = [_mapped(row) for row in mapped if row is not None]
    words = [*known, f"{len(mapped) - len(known)} not known"] if None in mapped else known
    # The weakest source counts: a mapping is as sure as its least sure entry.
    told = [count, *(row for row in mapped if row is not None)]
    weakest = max(told, key=lambda row: (row.seq is None, row.seq or 0))
    yield ", ".join(words) or "nothing mapped", weakest


def _unit(sub: int, row: ObjectRow) -> str:
    if sub == 2:
        return f" {row.meaning}" if row.meaning else ""
    return " x 100 us" if sub == 3 else " ms"


def _mapped(row: ObjectRow) -> str:
    value = row.value if isinstance(row.value, int) else 0
    return f"{value >> 16:04X}h:{value >> 8 & 0xFF:02X}/{value & 0xFF}"
