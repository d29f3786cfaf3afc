"""Findings on who keeps synchronous PDOs waiting: identifiers and nodes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import milliseconds
from syncline_analyzer.findings.timing.ahead import (
    EXACT_STAMPS,
    assumed,
    assumed_ahead,
    evidence_of,
    is_late,
    joined,
    late_waits,
    listed,
    named_pdo,
    of_others,
    sync_period_us,
    total_us,
)
from syncline_analyzer.findings.timing.blame import Behind, behind, is_guess, waits_of
from syncline_analyzer.results import Ahead, DelayRow, Finding, LatenessRow, PdoRow, WaitRow

_LONG = 0.2
"""Share of the SYNC period that is a long wait."""
_MOST = 0.5
_FEW = 3
_ENOUGH = 20
_SEVERAL = 1.5
"""Frames of a node ahead of each late answer that are more than one PDO per SYNC."""
_MOSTLY = 0.9
_LAST_SYNCHRONOUS = 0xF0
_IN_STEP = 0.05
"""Distances of a PDO off a whole number of SYNC periods by less may come from SYNC [periods]."""


def _outranked(facts: Facts) -> Iterator[Finding]:
    """Synchronous PDOs that waited for PDOs of other types with lower identifiers."""
    for row in facts.analysis.lateness:
        told, inferred = _outranking(facts, row)
        late = behind(facts, row, _among(told))
        if late:
            yield _outranked_late(facts, row, late)
            continue
        late = behind(facts, row, _among(told | inferred))
        if late:
            yield replace(_outranked_late(facts, row, late), severity="info")
            continue
        period_us = sync_period_us(facts, row.bus)
        long = [
            (wait, ahead)
            for wait in waits_of(facts, row)
            if (ahead := [e for e in of_others(row, wait.ahead) if e.cob_id in told | inferred])
            and period_us
            and total_us(ahead) >= _LONG * period_us
        ]
        if len(long) >= _FEW:
            yield _outranked_long(facts, row, long)


def _outranking(facts: Facts, row: LatenessRow) -> tuple[set[int], set[int]]:
    """PDOs of lower identifiers that are not bound to SYNC: as told, and by their frames alone."""
    lower = [p for p in facts.analysis.pdos if p.bus == row.bus and p.cob_id < row.cob_id]
    told = {p.cob_id for p in lower if (p.transmission_type or 0) > _LAST_SYNCHRONOUS}
    period_us = sync_period_us(facts, row.bus)
    inferred = {
        p.cob_id
        for p in lower
        if p.transmission_type is None
        and p.type_source.startswith("inferred")
        and not _in_step(p, period_us)
    }
    return told, inferred


def _in_step(pdo: PdoRow, sync_us: float | None) -> bool:
    """Whether the distances of a PDO are whole SYNC periods: it may answer some SYNCs (type 0)."""
    if not sync_us or pdo.period_us is None:
        return False
    periods = pdo.period_us.median / sync_us
    return round(periods) > 0 and abs(periods - round(periods)) <= _IN_STEP


def _outranked_late(facts: Facts, row: LatenessRow, late: Behind) -> Finding:
    waits = late_waits(facts, row)
    return Finding(
        "pdo.outranked",
        "warning",
        row.bus,
        row.node,
        row.late_first_ns or 0,
        (row.late_last_ns or 0) + 1,
        f"{named_pdo(facts, row)} was late {late} behind frames that are not bound to"
        f" SYNC and go first by their lower identifiers: {listed(facts, row.bus, late.ahead)}.",
        "Identifiers decide who goes first, and by default they follow the node-ID (CiA 301 7.3.5),"
        " not what is urgent: each of these frames that is sent about the time of a SYNC goes ahead.",
        f"Give {row.cob_id:03X}h a lower identifier (180xh:1) than these, or let them be sent less"
        " often (inhibit time 180xh:3, event timer 180xh:5) or as answers to SYNC, too.",
        evidence_of(waits),
        assumed=[*assumed(facts, row), *assumed_ahead(facts, row, late.ahead)],
    )


def _outranked_long(
    facts: Facts, row: LatenessRow, long: Sequence[tuple[WaitRow, list[Ahead]]]
) -> Finding:
    worst = max(total_us(ahead) for _, ahead in long)
    ahead = joined(each for _, found in long for each in found)
    waits = [wait for wait, _ in long]
    return Finding(
        "pdo.outranked",
        "info",
        row.bus,
        row.node,
        min(wait.t_ns for wait in waits),
        max(wait.t_ns for wait in waits) + 1,
        f"{named_pdo(facts, row)} answers SYNC, but can have waited up to {milliseconds(worst)} for"
        " frames that are not bound to SYNC and go first by their lower identifiers:"
        f" {listed(facts, row.bus, ahead)}.",
        "Identifiers decide who goes first, and by default they follow the node-ID (CiA 301 7.3.5),"
        " not what is urgent.",
        f"Where {row.cob_id:03X}h is the more urgent one, give it a lower identifier (180xh:1) than"
        " these.",
        evidence_of([wait for wait in waits if not is_late(wait, row)]),
        assumed=[*assumed(facts, row), *assumed_ahead(facts, row, ahead)],
    )


def _delaying_node(facts: Facts) -> Iterator[Finding]:
    """Nodes whose frames make the synchronous PDOs of others late, or keep them waiting most."""
    for bus in dict.fromkeys(row.bus for row in facts.analysis.delays):
        senders = [r for r in facts.analysis.delays if r.bus == bus and r.cob_id is None]
        total_us = sum(row.us for row in senders)
        nodes = [row for row in senders if row.node is not None]
        late = [(row, _late_behind(facts, row)) for row in nodes]
        accused = [(row, blamed) for row, blamed in late if blamed]
        for row, blamed in accused:
            yield _delaying_late(facts, row, blamed)
        if accused or not nodes:
            continue
        most = max(nodes, key=lambda row: row.us)
        if (
            len(senders) > 1
            and most.us >= _MOST * total_us
            and most.delayed >= _ENOUGH
            and most.worst_us >= _LONG * (sync_period_us(facts, bus) or float("inf"))
        ):
            yield _delaying(facts, most)


def _late_behind(facts: Facts, delay: DelayRow) -> list[tuple[LatenessRow, Behind]]:
    """PDOs that are late mostly because of several frames of one node each time."""
    found = []
    for row in facts.analysis.lateness:
        if row.bus != delay.bus or row.node == delay.node:
            continue
        late = behind(facts, row, _of_node(delay.node), _MOST)
        if late is None or sum(each.frames for each in late.ahead) < _SEVERAL * late.found:
            continue
        own = [each for each in row.blockers if each.node == delay.node]
        if total_us(own) >= _MOST * total_us(of_others(row, row.blockers)):
            found.append((row, late))
    return found


def _delaying_late(
    facts: Facts, delay: DelayRow, late: Sequence[tuple[LatenessRow, Behind]]
) -> Finding:
    assert delay.node is not None
    ahead = joined(each for _, found in late for each in found.ahead)
    made = ", ".join(f"{row.cob_id:03X}h late {found}" for row, found in late[:_FEW])
    more = f" and {len(late) - _FEW} other PDOs" if len(late) > _FEW else ""
    frames, answers = (
        sum(each.frames for each in ahead),
        sum(found.found for _, found in late),
    )
    first = [(each.us, each.cob_id < row.cob_id) for row, found in late for each in found.ahead]
    times = [t for row, _ in late for t in (row.late_first_ns, row.late_last_ns) if t is not None]
    waits = [wait for row, _ in late for wait in late_waits(facts, row)]
    return Finding(
        "pdo.delaying_node",
        "warning",
        delay.bus,
        delay.node,
        min(times),
        max(times) + 1,
        f"{facts.who(delay.bus, delay.node)} made {made}{more}: they would have been in time without"
        f" its frames ahead of them ({listed(facts, delay.bus, ahead)}).",
        *_why_first(frames / answers, first),
        sorted({*evidence_of(waits), *(seq for row, _ in late for seq in row.late_seq)}),
        assumed=[
            *dict.fromkeys(
                text
                for row, found in late
                for text in (*assumed(facts, row), *assumed_ahead(facts, row, found.ahead))
            )
        ],
    )


def _delaying(facts: Facts, delay: DelayRow) -> Finding:
    assert delay.node is not None
    own = [r for r in facts.analysis.delays if (r.bus, r.node) == (delay.bus, delay.node)]
    frames = [row for row in own if row.cob_id is not None]
    told = ", ".join(
        f"{row.service.split(' (')[0]} ({row.cob_id:03X}h) {milliseconds(row.us)}"
        for row in frames[:_FEW]
    )
    guessed = [
        f"{row.cob_id:03X}h comes from node {row.node} (by its identifier alone)"
        for row in frames[:_FEW]
        if is_guess(row.service)
    ]
    first = [(row.us, (row.cob_id or 0) < row.worst_cob_id) for row in frames]
    capture = facts.analysis.capture
    return Finding(
        "pdo.delaying_node",
        "info",
        delay.bus,
        delay.node,
        capture.begin_ns,
        capture.end_ns,
        f"{facts.who(delay.bus, delay.node)} delays the synchronous PDOs of others most: they waited"
        f" up to {milliseconds(delay.us)} in all for its frames ({told}), one of them up to"
        f" {milliseconds(delay.worst_us)}.",
        *_why_first(delay.frames / delay.delayed, first),
        [delay.worst_seq],
        assumed=[*facts.context.assumed_wire(delay.bus), *guessed],
    )


def _why_first(each: float, first: Sequence[tuple[float, bool]]) -> tuple[str, str]:
    """Why frames go ahead of those of others, and what to check next.

    Args:
        each: how many of them go ahead of an answer on average.
        first: time on the wire, and whether they win by a lower identifier, of each identifier.
    """
    lower_us, all_us = sum(us for us, lower in first if lower), sum(us for us, _ in first)
    often = f"On average {each:.1f} of its frames go ahead of an answer that waits for it"
    sends = "Look at when it sends them and how many (180xh:2, 180xh:3, 180xh:5)"
    if lower_us >= _MOSTLY * all_us:
        return (
            f"{often}; they have lower identifiers.",
            f"{sends}; give it higher identifiers where the others are more urgent.",
        )
    if lower_us > (1 - _MOSTLY) * all_us:
        return (
            f"{often}; part of them have lower identifiers, the others were on the wire first.",
            f"{sends}; higher identifiers help against the first ones only.",
        )
    return (
        f"{often}; they were on the wire first, though their identifiers are higher.",
        f"{sends}; other identifiers would change little.",
    )


def _among(ids: set[int]) -> Callable[[Ahead], bool]:
    """Picks the frames of some identifiers."""
    return lambda each: each.cob_id in ids


def _of_node(node: int | None) -> Callable[[Ahead], bool]:
    """Picks the frames of a node."""
    return lambda each: each.node == node


RULES = (
    Rule(
        "pdo.outranked",
        "A synchronous PDO waits for PDOs that are not bound to SYNC and have lower identifiers.",
        "The answers that waited longest, or were late, and the frames ahead of them.",
        (
            EXACT_STAMPS,
            (
                "A warning only where answers were late (1007h) that would have been in time without these"
                " frames, and the device itself was never late; else at least three waits of a fifth of"
                " the SYNC period."
            ),
            (
                "A PDO whose transmission type nobody tells makes a note at most, and none where its"
                " distances are whole SYNC periods: it may answer some SYNCs."
            ),
            "Frames of the node itself are its own queue and do not count.",
        ),
        _outranked,
    ),
    Rule(
        "pdo.delaying_node",
        "The frames of one node make synchronous PDOs of others late, or delay them most.",
        "The late answers and the frames ahead of them, or the answer that waited longest.",
        (
            EXACT_STAMPS,
            (
                "A warning only where others were late (1007h) and would have been in time without its"
                " frames, several of them ahead of each: one PDO for each SYNC accuses nobody; else a"
                " wait of a fifth of the SYNC period behind its frames alone."
            ),
        ),
        _delaying_node,
    ),
)
