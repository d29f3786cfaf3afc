"""Findings on SDO requests that were not answered, and all rules on SDO."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.sdo import aborts as sdo_abort
from syncline_analyzer.findings.sdo import answers as sdo_answers
from syncline_analyzer.findings.sdo import protocol as sdo_protocol
from syncline_analyzer.findings.sdo import writes as sdo_writes
from syncline_analyzer.findings.sdo.groups import (
    History,
    by_node,
    evidence,
    objects_words,
    stretches,
    unanswered_of,
)
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.folds.nmt.events import Interval
from syncline_analyzer.results import Finding, SdoRow
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.devices import Quirks, quirks
from syncline_schemas.wording import counted

STARTING_NS = 1_000_000_000
"""After its boot-up and the silence that its maker describes a node may take as long [ns]."""


def _quirks(facts: Facts, row: SdoRow) -> Quirks:
    return quirks(facts.context.shadow.device(facts.number(row.bus), row.node))


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
        for row in unanswered_of(facts.analysis.sdo).of_objects(
            lambda of: (of.bus, of.node) in there
        )
        if row.seq not in late
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
        f"{facts.who(first.bus, first.node)} did not answer {counted(len(rows), 'SDO request')}"
        f"{facts.at(first.start_ns)} ({objects_words(rows)}){within}{meanwhile}.",
        "The node was busy, its SDO server was moved (1200h), or its answer was lost.",
        "Look at the bus errors at that time; repeat the request; read 1200h and 1001h.",
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
        and not _at_work(timeline.intervals, interval.end_ns, row.start_ns)
        for interval in timeline.intervals
    )


def _at_work(intervals: Sequence[Interval], booted_ns: int, asked_ns: int) -> bool:
    """Whether a node told between its boot-up and a request that it was OPERATIONAL."""
    return any(
        interval.state is NmtState.OPERATIONAL
        and interval.certainty in ("observed", "implied")
        and booted_ns <= interval.start_ns < asked_ns
        for interval in intervals
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
                f"{counted(len(part), 'SDO request')}{facts.at(first.start_ns)} "
                f"({objects_words(part)}).",
                "The client asks a node that may not answer: STOPPED allows NMT commands only.",
                "The client's program; who stopped the node.",
                evidence(part),
            )


RULES: tuple[Rule, ...] = (
    *sdo_abort.RULES,
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
