"""Reads of 1003h and 1001h, joined with the EMCYs that the bus told of the same errors."""

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import field
from typing import Literal

from syncline_analyzer.context import Context
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.folds.nmt.table import BootUp
from syncline_analyzer.results import EmcyRow, ErrorHistoryRow, GapRow, NmtStateRow, SdoRow
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.devices import Device, emcy_meaning, quirks, register_bits
from syncline_schemas.records import dataclass
from syncline_schemas.wording import counted

ERROR_REGISTER = 0x1001
ERROR_FIELD = 0x1003
MAX_ROWS = 100_000
MAX_LIST_READ_NS = 60_000_000_000
"""Entries read further apart than this are of two readings of the list [ns]."""
_MUTE = (NmtState.STOPPED, NmtState.LOST, NmtState.INITIALISING)

MAX_LOOK_BACK = 1000
"""EMCYs before a reading among which its entries are looked for."""

Seen = Literal[
    "seen", "older", "missed", "unknown", "empty", "count", "register", "cleared by read"
]


_REGISTER: Seen = "register"
_TAKEN: Seen = "cleared by read"


def _seq_of(row: EmcyRow | SdoRow) -> int:
    return row.seq


def _time_of(row: EmcyRow | SdoRow) -> int:
    return row.t_ns if isinstance(row, EmcyRow) else row.end_ns


@dataclass(slots=True)
class _Node:
    """What a history needs of one node, each in order of `seq`."""

    device: Device | None
    switched_off: bool = False
    """Whether 1014h was ever seen to switch its EMCYs off."""
    reads: list[SdoRow] = field(default_factory=list)
    clears: list[SdoRow] = field(default_factory=list)
    """Writes of 0 to 1003h:0, and reads that say it is empty."""
    emcy: list[EmcyRow] = field(default_factory=list)
    """EMCYs of eight bytes."""
    boot_ups: list[BootUp] = field(default_factory=list)
    states: list[NmtStateRow] = field(default_factory=list)

    def emcy_before(self, seq: int) -> Sequence[EmcyRow]:
        """The last EMCYs before a `seq`, at most `MAX_LOOK_BACK`."""
        stop = bisect_left(self.emcy, seq, key=_seq_of)
        return self.emcy[max(0, stop - MAX_LOOK_BACK) : stop]

    def emcy_between(self, first: int, last: int) -> int:
        """Number of EMCYs between two frames."""
        return bisect_left(self.emcy, last, key=_seq_of) - bisect_left(
            self.emcy, first, key=_seq_of
        )

    def raised_between(self, first: int, last: int) -> int:
        """Number of EMCYs that make an entry between two frames: 00xxh makes none."""
        start, stop = (bisect_left(self.emcy, seq, key=_seq_of) for seq in (first, last))
        return sum(bool((row.code or 0) >> 8) for row in self.emcy[start:stop])

    def started_between(self, first: int, last: int) -> bool:
        return any(first < boot.seq <= last for boot in self.boot_ups)


def error_history(
    control: ControlTables, context: Context, gaps: Sequence[GapRow]
) -> list[ErrorHistoryRow]:
    """One row per successful read of 1003h or 1001h, in order of `seq`; at most `MAX_ROWS`.

    The code of an entry is its low 16 bits (CiA 301 7.5.2.3), also where only 16 bits were sent.
    """
    rows: list[ErrorHistoryRow] = []
    for (bus, _), node in _nodes(control, context).items():
        own = [gap for gap in gaps if gap.bus in (None, bus)]
        rows.extend(_history(node, own))
    return sorted(rows, key=lambda row: row.seq)[:MAX_ROWS]


def _nodes(control: ControlTables, context: Context) -> dict[tuple[str, int], _Node]:
    """Nodes of which 1003h or 1001h was read."""
    nodes: dict[tuple[str, int], _Node] = {}
    numbers = {context.bus_name(bus): bus for bus in range(len(context.buses))}
    wanted = (ERROR_REGISTER, ERROR_FIELD)
    for row in control.sdo.rows.ok.of_objects(lambda of: of.index in wanted):
        key = (row.bus, row.node)
        if row.direction == "upload" and not row.data:
            continue
        if key not in nodes:
            bus = numbers.get(row.bus, 0)
            nodes[key] = _Node(context.shadow.device(bus, row.node), _off(context, bus, row.node))
        if row.direction == "upload":
            nodes[key].reads.append(row)
            if (row.index, row.sub or 0) == (ERROR_FIELD, 0) and not _raw(row) & 0xFF:
                nodes[key].clears.append(row)
        elif row.index == ERROR_FIELD and row.sub == 0:
            nodes[key].clears.append(row)
    for emcy in control.emcy.rows if nodes else ():
        node = nodes.get((emcy.bus, emcy.node))
        if node is not None and emcy.transition not in ("malformed", "reset"):
            node.emcy.append(emcy)
    for boot in control.nmt.boot_ups if nodes else ():
        if (boot.bus, boot.node) in nodes:
            nodes[boot.bus, boot.node].boot_ups.append(boot)
    for state in control.nmt.states if nodes else ():
        if (state.bus, state.node) in nodes:
            nodes[state.bus, state.node].states.append(state)
    return nodes


def _off(context: Context, bus: int, node: int) -> bool:
    """Whether bit 31 of 1014h was seen set (CiA 301 7.5.2.17: the EMCY does not exist)."""
    shadow = context.shadow
    values = [shadow.number(bus, node, 0x1014, 0, s) for s in shadow.changes(bus, node, 0x1014)]
    return any((value or 0) >> 31 for value in values)


def _history(node: _Node, gaps: Sequence[GapRow]) -> Iterable[ErrorHistoryRow]:
    listed = [row for row in node.reads if row.index == ERROR_FIELD and row.sub]
    for entries in _readings(node, listed):
        yield from _entries(node, entries, gaps)
    yield from _counts([r for r in node.reads if r.index == ERROR_FIELD and not r.sub], node, gaps)
    yield from _registers([r for r in node.reads if r.index == ERROR_REGISTER], node)


def _raw(row: SdoRow) -> int:
    return int.from_bytes(row.data[:4], "little")


def _readings(node: _Node, rows: Sequence[SdoRow]) -> list[list[SdoRow]]:
    """Entries read one after another while the list stayed as it was."""
    readings: list[list[SdoRow]] = []
    for row in rows:
        last = readings[-1][-1] if readings else None
        if last is None or not _goes_on(node, last, row):
            readings.append([])
        readings[-1].append(row)
    return readings


def _goes_on(node: _Node, last: SdoRow, row: SdoRow) -> bool:
    changed = (
        node.emcy_between(last.seq, row.seq) > 0
        or any(last.seq < clear.seq < row.seq for clear in node.clears)
        or node.started_between(last.seq, row.seq)
    )
    apart = not 0 <= row.start_ns - last.start_ns <= MAX_LIST_READ_NS
    return (row.sub or 0) > (last.sub or 0) and not changed and not apart


def _entries(
    node: _Node, rows: Sequence[SdoRow], gaps: Sequence[GapRow]
) -> Iterable[ErrorHistoryRow]:
    """Entries of one reading, newest first (CiA 301 7.5.2.3), each with the EMCY that told it."""
    first = rows[0].seq
    cleared = max((row for row in node.clears if row.seq < first), key=_seq_of, default=None)
    raised = [row for row in node.emcy_before(first) if (row.code or 0) >> 8]
    if cleared is not None:
        raised = [row for row in raised if row.seq > cleared.seq]
    found, ordered = _matches([_raw(row) & 0xFFFF for row in rows], raised)
    told = [place for place, emcy in enumerate(found) if emcy is not None]
    mute = _mute(node, gaps, rows[0].start_ns)
    for place, row in enumerate(rows):
        emcy = found[place]
        older = next((found[n] for n in told if ordered and n > place), cleared)
        seen: Seen = "seen"
        if emcy is None and older is not None:
            newer = next((found[n] for n in reversed(told) if ordered and n < place), row)
            hidden = _blind(gaps, _time_of(older), _time_of(newer or row))
            seen = "unknown" if hidden else "missed"
        elif emcy is None:
            seen = "unknown" if mute or not ordered else "older"
        yield _entry(node, row, seen, emcy, mute)


def _blind(gaps: Sequence[GapRow], since_ns: int, until_ns: int) -> bool:
    """Whether the recorder did not hear all that came between two moments."""
    return any(gap.start_ns < until_ns and gap.end_ns > since_ns for gap in gaps)


def _matches(codes: Sequence[int], raised: Sequence[EmcyRow]) -> tuple[list[EmcyRow | None], bool]:
    """The EMCY of each entry, and whether they lie in the list from the newest to the oldest."""
    found: list[EmcyRow | None] = []
    used: set[int] = set()
    at, ordered = len(raised), True
    for code in codes:
        older = [n for n in range(at - 1, -1, -1) if raised[n].code == code]
        newer = [n for n in range(at, len(raised)) if raised[n].code == code and n not in used]
        if code >> 8 and older:
            at = older[0]
        elif code >> 8 and newer:
            ordered = False
        else:
            found.append(None)
            continue
        number = older[0] if older else newer[0]
        used.add(number)
        found.append(raised[number])
    return found, ordered


def _mute(node: _Node, gaps: Sequence[GapRow], end_ns: int) -> str:
    """Why an EMCY of the node may not be in the capture, "" where it would be."""
    if node.switched_off:
        return "1014h switched its EMCYs off"
    if any(gap.start_ns < end_ns for gap in gaps):
        return "the recorder was blind for a while"
    for state in node.states:
        if state.state in _MUTE and state.start_ns < end_ns:
            return f"the node was {state.state} for a while and could not send it"
    return ""


def _entry(
    node: _Node, row: SdoRow, seen: Seen, emcy: EmcyRow | None, mute: str
) -> ErrorHistoryRow:
    raw = _raw(row)
    code, info = raw & 0xFFFF, raw >> 16 if len(row.data) > 2 else None
    if not raw:
        return _row(row, None, None, "no entry", "empty", None, "")
    notes: dict[Seen, str] = {
        "seen": "",
        "older": "from before the capture",
        "missed": f"it came during the capture; {mute or 'no EMCY told it'}",
        "unknown": f"from before the capture, or missed: {mute}" if mute else "order not clear",
    }
    meaning = emcy_meaning(node.device, code)
    return _row(row, code, info, meaning, seen, emcy.seq if emcy else None, notes[seen])


def _counts(
    rows: Sequence[SdoRow], node: _Node, gaps: Sequence[GapRow]
) -> Iterable[ErrorHistoryRow]:
    """Reads of 1003h:0; more new entries than EMCYs between two reads mean some were not sent.

    Not where a capture gap lies between the two: it may hide them.
    """
    before: SdoRow | None = None
    for row in rows:
        number = _raw(row) & 0xFF
        note = ""
        if before is not None and not _emptied(node, before.seq, row.seq):
            grown = number - (_raw(before) & 0xFF)
            told = node.raised_between(before.seq, row.seq)
            if grown > told and not _blind(gaps, before.start_ns, row.end_ns):
                note = f"{counted(grown, 'error')} more than at the read before; EMCYs told {told}"
        entries = "entry" if number == 1 else "entries"
        yield _row(row, None, None, f"{number} {entries}", "count", None, note)
        before = row


def _emptied(node: _Node, first: int, last: int) -> bool:
    return any(first < clear.seq < last for clear in node.clears) or node.started_between(
        first, last
    )


def _registers(rows: Sequence[SdoRow], node: _Node) -> Iterable[ErrorHistoryRow]:
    """Reads of 1001h beside the register that the last EMCY gave."""
    clears = (ERROR_REGISTER, 0) in quirks(node.device).clear_on_read
    before: SdoRow | None = None
    for row in rows:
        register = _raw(row) & 0xFF
        told = node.emcy_before(row.seq)
        last = told[-1] if told else None
        names = ", ".join(register_bits(node.device, register)) or "no error"
        note, seen = "", _REGISTER
        if before is not None and clears and _cleared_by_read(node, before, row):
            seen = _TAKEN
            note = f"cleared by the read at seq {before.seq}, not repaired"
        elif clears and register:
            note = "this read clears it"
        elif last is not None and last.error_register != register and not clears:
            note = f"the last EMCY said {last.error_register or 0:02X}h"
        yield _row(row, None, None, names, seen, last.seq if last else None, note)
        before = row


def _cleared_by_read(node: _Node, before: SdoRow, row: SdoRow) -> bool:
    """Whether bits are gone since the read before although no EMCY or start took them away."""
    gone = _raw(before) & ~_raw(row) & 0xFF
    told = node.emcy_between(before.seq, row.seq) > 0
    return bool(gone) and not told and not node.started_between(before.seq, row.seq)


def _row(
    row: SdoRow,
    code: int | None,
    info: int | None,
    meaning: str,
    seen: Seen,
    emcy_seq: int | None,
    note: str,
) -> ErrorHistoryRow:
    return ErrorHistoryRow(
        row.bus,
        row.node,
        row.seq,
        row.end_ns,
        row.index or 0,
        row.sub or 0,
        _raw(row),
        code,
        info,
        meaning,
        seen,
        emcy_seq,
        note,
    )
