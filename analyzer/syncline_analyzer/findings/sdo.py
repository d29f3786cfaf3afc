"""Findings on SDO transfers that were refused or not answered, and all rules on SDO."""

from collections.abc import Iterator

from syncline_analyzer.findings import sdo_answers, sdo_protocol, sdo_writes
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.sdo_groups import (
    History,
    by_node,
    evidence,
    grouped,
    object_words,
    objects_words,
    stretches,
    timed_out,
    times,
    unanswered,
)
from syncline_analyzer.findings.sdo_protocol import TOLD_BY_PROTOCOL
from syncline_analyzer.findings.sdo_writes import failed_configurations
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.results import Finding, SdoRow
from syncline_schemas.canopen.sdo import abort_meaning
from syncline_schemas.devices import Quirks, quirks
from syncline_schemas.wording import counted

PROBING = (0x06010001, 0x06020000, 0x06090011, 0x08000024)
"""Abort codes with which a node says that it does not have what a master looks for."""
ERROR_LIST, NO_SUBINDEX, READ_ONLY = 0x1003, 0x06090011, 0x06010002
STARTING_NS = 1_000_000_000
"""After its boot-up and the silence that its maker describes a node may take as long [ns]."""


def _aborts(facts: Facts) -> Iterator[Finding]:
    """One finding for all equal refusals of a node."""
    told = {row.seq for rows in failed_configurations(facts) for row in rows}
    rows = [
        row
        for row in facts.analysis.sdo
        if row.result == "abort"
        and not timed_out(row)
        and row.abort_code not in TOLD_BY_PROTOCOL
        and row.seq not in told
    ]
    for group in grouped(rows, _what):
        yield _abort(facts, group)


def _what(row: SdoRow) -> tuple[str, int, int, int, str, int, str]:
    code = row.abort_code if row.abort_code is not None else -1
    by = row.abort_by or ""
    return row.bus, row.node, row.index or 0, row.sub or 0, row.direction, code, by


def _abort(facts: Facts, rows: list[SdoRow]) -> Finding:
    first, last = rows[0], rows[-1]
    who = facts.who(first.bus, first.node)
    reading = first.direction == "upload"
    probing = reading and (first.abort_code in PROBING or _normal(facts, first))
    what = f"the {'read' if reading else 'write'} of {object_words(first)}"
    by_client = first.abort_by == "client"
    said = f"{who}: the client broke off {what}" if by_client else f"{who} refused {what}"
    swapped, described = _swapped(first), _described(facts, first)
    if described:
        cause = described
        check = "Nothing, if the client can do without it."
    elif swapped is not None:
        cause = f"The client sends the index with its bytes exchanged: {swapped:04X}h is meant."
        check = "The byte order of the index in the client's program: low byte first."
    elif probing:
        cause = "The master looks for an object that this device does not have."
        check = "Nothing, if the object is optional; else compare the device with the planned one."
    elif by_client:
        cause = "The client did not accept what the node answered, or was told to stop."
        check = "The client's log at that time; the node's answer against its manual."
    else:
        cause = "The client's configuration does not fit this device or its present state."
        check = "Compare object, length and value with the device's manual; was it needed?"
    return Finding(
        "sdo.abort",
        "info" if probing or described else "warning",
        first.bus,
        first.node,
        first.start_ns,
        last.end_ns,
        f"{said}: {_reason(first)}{times(len(rows))}.",
        cause,
        check,
        evidence(rows),
    )


def _described(facts: Facts, row: SdoRow) -> str:
    """Why a node refuses by its description or by CiA 301; "" where nothing there says so."""
    if row.abort_by == "client":
        return ""
    if row.index == ERROR_LIST and row.abort_code == NO_SUBINDEX:
        if row.direction == "upload":
            return (
                "The error list has no such entry yet: fewer errors are stored (CiA 301 7.5.2.3)."
            )
        return "The node did not clear its error list: only a 0 to 1003h:0 clears it."
    device = facts.context.shadow.device(facts.number(row.bus), row.node)
    if device is None or row.direction == "upload":
        return ""
    known = device.object(row.index or 0, row.sub or 0)
    if known is None and row.abort_code in PROBING:
        return f"A {device.title} has no such object, as its description says."
    if known is not None and known.access in ("ro", "const") and row.abort_code == READ_ONLY:
        return f"The object is read-only on a {device.title}, as its description says."
    return ""


def _swapped(row: SdoRow) -> int | None:
    """The index that is meant where the refused one is none of an object (0000h to 0FFFh)."""
    index = row.index or 0
    meant = (index & 0xFF) << 8 | index >> 8
    return meant if 0 < index < 0x1000 <= meant and row.abort_code == 0x06020000 else None


def _reason(row: SdoRow) -> str:
    if row.abort_code is None:
        return "the abort frame is cut short and gives no code"
    return f"{abort_meaning(row.abort_code)} ({row.abort_code:08X}h)"


def _quirks(facts: Facts, row: SdoRow) -> Quirks:
    return quirks(facts.context.shadow.device(facts.number(row.bus), row.node))


def _normal(facts: Facts, row: SdoRow) -> bool:
    """Refusals that the device's maker describes."""
    device = facts.context.shadow.device(facts.number(row.bus), row.node)
    known = device.object(row.index or 0, row.sub or 0) if device else None
    return row.index in quirks(device).absent or (known is not None and known.access == "wo")


def _silent_rows(facts: Facts) -> list[SdoRow]:
    """Requests without an answer to nodes that are there; elsewhere a master searches."""
    there = {(row.bus, row.node) for row in facts.analysis.nodes}
    late = {
        odd.asked.seq
        for found in facts.control.sdo.oddities.values()
        for odd in found
        if odd.kind == "late"
    }
    return [
        row
        for row in facts.analysis.sdo
        if unanswered(row) and (row.bus, row.node) in there and row.seq not in late
    ]


def _stopped(facts: Facts, history: History, row: SdoRow) -> bool:
    mute = "sdo" in _quirks(facts, row).mute_in_stopped
    return mute and _state(history, row) == "STOPPED"


def _state(history: History, row: SdoRow) -> str | None:
    """NMT state of the node at the time of a request, None where nothing tells it."""
    return next(history.states((row.bus, row.node), row.start_ns, row.start_ns), None)


def _no_answer(facts: Facts) -> Iterator[Finding]:
    history = History(facts)
    rows = [
        row
        for row in _silent_rows(facts)
        if not _stopped(facts, history, row)
        and not _explained(facts, history, row)
        and not _not_on_yet(history, row)
    ]
    for found in by_node(rows):
        for part in stretches(found):
            yield _unanswered(facts, history, part)


def _unanswered(facts: Facts, history: History, rows: list[SdoRow]) -> Finding:
    first, last = rows[0], rows[-1]
    end_ns = max(row.end_ns for row in rows)
    span = last.start_ns - first.start_ns
    within = f" within {seconds(span)}" if span > 0 else ""
    others = history.answers((first.bus, first.node), first.start_ns, end_ns)
    meanwhile = f"; {counted(others, 'other request')} in that time it answered" if others else ""
    return Finding(
        "sdo.no_answer",
        "warning",
        first.bus,
        first.node,
        first.start_ns,
        end_ns,
        f"{facts.who(first.bus, first.node)} did not answer {counted(len(rows), 'SDO request')} "
        f"({objects_words(rows)}){within}{meanwhile}.",
        "The node was busy or restarting, its SDO server was moved (1200h), or its answer lost.",
        "Look at its state and at the bus errors at that time; repeat the request.",
        evidence(rows),
    )


def _explained(facts: Facts, history: History, row: SdoRow) -> bool:
    """Whether the node was silent altogether, or starting: that is told by another finding."""
    timeline = facts.control.nmt.timelines.get((facts.number(row.bus), row.node))
    if timeline is None:
        return False
    gone = [*timeline.lost, *timeline.restarts]
    if any(lost.last_ns <= row.end_ns and row.start_ns < lost.end_ns for lost in gone):
        return True
    quiet_ns = _quirks(facts, row).reset_quiet_ms * 1_000_000 + STARTING_NS
    node = row.bus, row.node
    return any(
        interval.state.value == "INITIALISING"
        and interval.start_ns <= row.start_ns < interval.end_ns + quiet_ns
        and not history.answers(node, interval.end_ns, row.start_ns)
        for interval in timeline.intervals
    )


def _not_on_yet(history: History, row: SdoRow) -> bool:
    """Whether the node was switched on only later: nothing of it was heard before its boot-up."""
    node = row.bus, row.node
    first_ns = history.first_boot_ns(node)
    if first_ns is None or first_ns <= row.start_ns or history.answers(node, 0, row.start_ns):
        return False
    return _state(history, row) in (None, "UNKNOWN", "INITIALISING")


def _while_stopped(facts: Facts) -> Iterator[Finding]:
    history = History(facts)
    rows = [row for row in _silent_rows(facts) if _stopped(facts, history, row)]
    for found in by_node(rows):
        for part in stretches(found):
            first = part[0]
            yield Finding(
                "sdo.while_stopped",
                "info",
                first.bus,
                first.node,
                first.start_ns,
                part[-1].end_ns,
                f"{facts.who(first.bus, first.node)} was STOPPED and therefore did not answer "
                f"{counted(len(part), 'SDO request')} ({objects_words(part)}).",
                "The client asks a node that may not answer: STOPPED allows NMT commands only.",
                "The client's program; who stopped the node.",
                evidence(part),
            )


RULES: tuple[Rule, ...] = (
    Rule(
        "sdo.abort",
        "An SDO transfer was refused or broken off, with the reason in words.",
        "The requests that were refused.",
        (
            "Reads of objects that a device does not have are a note: a master that searches.",
            "Refusals that the device's maker describes are a note.",
            "Time-outs, CRC and toggle errors and failed configurations have rules of their own.",
        ),
        _aborts,
        untimed=True,
    ),
    Rule(
        "sdo.no_answer",
        "A node that is there did not answer SDO requests.",
        "The requests without an answer.",
        (
            "Numbers where nobody was heard are a master's search.",
            "Not before the node's first boot-up, while it was lost, starting or STOPPED.",
            "Not where the capture ends or has a gap soon after the request.",
        ),
        _no_answer,
        untimed=True,
    ),
    Rule(
        "sdo.while_stopped",
        "A client asked a STOPPED node, which may not answer: the client's mistake, not the node's.",
        "The requests without an answer.",
        ("Only for devices that are silent in STOPPED, while nothing else explains the silence.",),
        _while_stopped,
    ),
    *sdo_answers.RULES,
    *sdo_protocol.RULES,
    *sdo_writes.RULES,
)
