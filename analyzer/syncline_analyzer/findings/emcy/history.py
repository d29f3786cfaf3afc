"""Findings on what the error list 1003h and the error register 1001h say when they are read."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import error_name, seconds
from syncline_analyzer.folds.emcy.history import ERROR_REGISTER
from syncline_analyzer.results import EmcyRow, ErrorHistoryRow, Finding
from syncline_schemas.devices import quirks

IN_FLIGHT_NS = 10_000_000
"""A read this soon after an EMCY may have been answered before it [ns]."""
INHIBIT_TIME = 0x1015
_CAUSES = {
    "missed": "The error came and no EMCY of it is in the capture: the node was mute or the recorder"
    " blind at that moment, the inhibit time 1015h held it back, or the node found it while it"
    " started.",
    "older": "The errors came before the capture began.",
    "unknown": "The errors came before the capture began, or at a moment at which no EMCY of them"
    " could be heard.",
}


def _unseen(facts: Facts) -> Iterator[Finding]:
    """Entries of the error list that no EMCY of the capture told."""
    wanted = [row for row in facts.analysis.error_history if row.seen in _CAUSES]
    wanted.sort(key=lambda row: (row.bus, row.node, row.seen, row.seq))
    for (bus, node, seen), group in groupby(wanted, key=lambda row: (row.bus, row.node, row.seen)):
        yield _unseen_finding(facts, bus, node, seen, list(group))


def _unseen_finding(
    facts: Facts, bus: str, node: int, seen: str, rows: Sequence[ErrorHistoryRow]
) -> Finding:
    names = [error_name(row.code or 0, row.meaning) for row in rows]
    listed = list(dict.fromkeys(names))
    what = ", ".join(listed[:5]) + (", ..." if len(listed) > 5 else "")
    when = {
        "missed": "came during this capture without an EMCY in it",
        "older": "came before this capture",
        "unknown": "no EMCY of this capture told",
    }[seen]
    return Finding(
        "emcy.history_unseen",
        "warning" if seen == "missed" else "info",
        bus,
        node,
        rows[0].t_ns,
        rows[-1].t_ns,
        f"The error list 1003h of {_node(facts, bus, node)}, read{facts.at(rows[0].t_ns)}, holds"
        f" {what}, which {when}.",
        _cause(facts, rows[0], seen),
        "Clear the list (0 to 1003h:0) when the machine is handed over, so that what it holds later"
        " is new."
        if seen != "missed"
        else "Look at the NMT states, gaps and bus errors before the read; read 1015h.",
        [row.seq for row in rows[:20]],
    )


def _cause(facts: Facts, row: ErrorHistoryRow, seen: str) -> str:
    """Why no EMCY told an entry; the inhibit time where it is known to be set."""
    known = facts.context.shadow.get(facts.number(row.bus), row.node, INHIBIT_TIME, 0, row.seq)
    value = known.value if known is not None and known.confirmed else 0
    if seen != "missed" or known is None or not value or not isinstance(value, int):
        return _CAUSES[seen]
    held = seconds(value * 100_000)
    return (
        f"Most likely the node's inhibit time held the EMCY back (1015h = {value}: one in"
        f" {held}, {known.source}); else it was mute or the recorder blind at that moment."
    )


def _node(facts: Facts, bus: str, node: int) -> str:
    who = facts.who(bus, node)
    return who[:1].lower() + who[1:]


def _grown(facts: Facts) -> Iterator[Finding]:
    """1003h:0 that grew by more than the EMCYs between two reads."""
    for row in facts.analysis.error_history:
        if row.seen == "count" and row.note:
            yield Finding(
                "emcy.history_unseen",
                "warning",
                row.bus,
                row.node,
                row.t_ns,
                row.t_ns,
                f"The error list 1003h of {_node(facts, row.bus, row.node)} holds at"
                f" {facts.moment(row.t_ns)} {row.note} of them.",
                _cause(facts, row, "missed"),
                "Read all entries of 1003h; read 1015h.",
                [row.seq],
            )


def _history(facts: Facts) -> Iterator[Finding]:
    yield from _unseen(facts)
    yield from _grown(facts)


def _cleared_by_read(facts: Facts) -> Iterator[Finding]:
    rows = [row for row in facts.analysis.error_history if row.seen == "cleared by read"]
    rows.sort(key=lambda row: (row.bus, row.node, row.seq))
    for (bus, node), group in groupby(rows, key=lambda row: (row.bus, row.node)):
        found = list(group)
        times = f" {len(found)} times" if len(found) > 1 else ""
        yield Finding(
            "emcy.cleared_by_read",
            "info",
            bus,
            node,
            found[0].t_ns,
            found[-1].t_ns,
            f"The error register 1001h of {_node(facts, bus, node)} went back to"
            f" {found[0].raw:02X}h{times} because it was read, not because an error was gone.",
            "This device clears 1001h when it is read: its bits mean since the last read.",
            "Do not take 00h as healthy; keep masters and tools from polling 1001h.",
            [row.seq for row in found[:20]],
        )


def register_before(facts: Facts) -> Iterator[Finding]:
    """Nodes whose 1001h shows an error although no EMCY of theirs came before the read."""
    blind = [(gap.bus, gap.start_ns) for gap in facts.analysis.capture.gaps]
    for row in _first_of_nodes(facts):
        unheard = any(bus in (None, row.bus) and start < row.t_ns for bus, start in blind)
        if row.emcy_seq is None and row.raw & 0xFF and not unheard and not _started(facts, row):
            yield Finding(
                "emcy.active_before",
                "warning",
                row.bus,
                row.node,
                row.t_ns,
                row.t_ns,
                f"The error register 1001h of {_node(facts, row.bus, row.node)} reads"
                f" {row.raw & 0xFF:02X}h ({row.meaning}) at {facts.moment(row.t_ns)}, and no EMCY"
                " came before it.",
                "An error from before the capture began, or one of which the node sends no EMCY.",
                "Read 1003h of the node for its code, and 1014h (bit 31 switches EMCYs off).",
                [row.seq],
            )


def _first_of_nodes(facts: Facts) -> Iterable[ErrorHistoryRow]:
    """The first read of 1001h of each node."""
    first: dict[tuple[str, int], ErrorHistoryRow] = {}
    for row in facts.analysis.error_history:
        if row.index == ERROR_REGISTER:
            first.setdefault((row.bus, row.node), row)
    return first.values()


def _started(facts: Facts, row: ErrorHistoryRow, since: int = -1) -> bool:
    return any(
        (boot.bus, boot.node) == (row.bus, row.node) and since < boot.seq < row.seq
        for boot in facts.control.nmt.boot_ups
    )


def _contradicts(facts: Facts) -> Iterator[Finding]:
    """1001h that shows an error after an EMCY that said that all is clear."""
    emcy = {row.seq: row for row in facts.analysis.emcy}
    told: set[tuple[str, int]] = set()
    for row in facts.analysis.error_history:
        last = emcy.get(row.emcy_seq) if row.emcy_seq is not None else None
        key = (row.bus, row.node)
        if last is not None and key not in told and _contradiction(facts, row, last):
            told.add(key)
            yield Finding(
                "emcy.register_unexplained",
                "warning",
                row.bus,
                row.node,
                last.t_ns,
                row.t_ns,
                f"The error register 1001h of {_node(facts, row.bus, row.node)} reads"
                f" {row.raw & 0xFF:02X}h ({row.meaning}) at {facts.moment(row.t_ns)} although its"
                f" last EMCY at {facts.moment(last.t_ns)} said that no error is left.",
                "An error of which the node sends no EMCY, or could not send one.",
                "Read 1003h of the node for its code; read 1014h (bit 31 switches EMCYs off) and"
                " 1015h.",
                [last.seq, row.seq],
            )


def _contradiction(facts: Facts, row: ErrorHistoryRow, last: EmcyRow) -> bool:
    device = facts.context.shadow.device(facts.number(row.bus), row.node)
    latched = (ERROR_REGISTER, 0) in quirks(device).clear_on_read
    blind = any(
        gap.bus in (None, row.bus) and gap.end_ns > last.t_ns and gap.start_ns < row.t_ns
        for gap in facts.analysis.capture.gaps
    )
    return (
        row.index == ERROR_REGISTER
        and bool(row.raw & 0xFF)
        and last.transition == "all cleared"
        and row.t_ns - last.t_ns > IN_FLIGHT_NS
        and not (latched or blind or _started(facts, row, last.seq))
    )


RULES: tuple[Rule, ...] = (
    Rule(
        "emcy.history_unseen",
        "The error list 1003h of a node holds errors that this capture never saw as EMCYs.",
        "The SDO reads of 1003h.",
        (
            "Only the code is compared, the low 16 bits of an entry.",
            "An entry came during the capture only where an older one did, or the list was cleared.",
            "Old entries are information, not a fault.",
        ),
        _history,
    ),
    Rule(
        "emcy.cleared_by_read",
        "The error register 1001h lost its bits because it was read.",
        "Two reads of 1001h with no EMCY and no restart between them.",
        ("Only for devices whose sheet says that reading clears 1001h.",),
        _cleared_by_read,
    ),
    Rule(
        "emcy.register_unexplained",
        "The error register 1001h shows an error after an EMCY that said that none is left.",
        "The EMCY 0000h and the read of 1001h.",
        (
            "Not for devices whose 1001h keeps its bits until it is read.",
            "Not across a capture gap or a restart, nor within 10 ms of the EMCY.",
        ),
        _contradicts,
    ),
)
