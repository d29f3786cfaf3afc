"""Findings on SDO answers that should not be: too late, twice, or of another object."""

from collections.abc import Iterator
from itertools import groupby

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.sdo.groups import MAX_EVIDENCE
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.folds.sdo.channel import PATIENCE_NS
from syncline_analyzer.folds.sdo.transfer import Oddity
from syncline_analyzer.results import BusSilenceRow, ClockStepRow, Finding
from syncline_schemas.wording import counted

SAME_FRAME_NS = 1_000_000
"""Equal answers closer than this are one frame that CAN sent twice [ns]."""
ALIKE = 3
"""Equal answers that make a second device likely."""
OUT_OF_STEP = 3
"""Answers of other objects than asked for that are more than a chance."""


def _kept(facts: Facts, kind: str) -> Iterator[tuple[str, int, list[Oddity]]]:
    """(bus, node, answers of a kind) of nodes on buses with CANopen."""
    for (number, node), found in sorted(facts.control.sdo.oddities.items()):
        if number not in facts.control.nmt.canopen:
            continue
        chosen = [odd for odd in found if odd.kind == kind]
        if chosen:
            yield facts.context.bus_name(number), node, chosen


def _late(facts: Facts) -> Iterator[Finding]:
    """Answers after the client's time-out."""
    for bus, node, late in _kept(facts, "late"):
        found = [
            odd for odd in late if _waited_ns(odd) - _unheard_ns(facts, bus, odd) > PATIENCE_NS
        ]
        if not found:
            continue
        waits = [_waited_ns(odd) for odd in found]
        worst = max(odd.t_ns - odd.since_ns for odd in found)
        yield Finding(
            "sdo.late_answer",
            "warning",
            bus,
            node,
            found[0].asked.start_ns,
            found[-1].t_ns,
            f"{facts.who(bus, node)} answered {counted(len(found), 'SDO request')} only after the"
            f" client had given up: it took {'up to ' if len(found) > 1 else ''}{seconds(worst)},"
            f" and the client waits {seconds(min(waits))}.",
            "The node needs longer than the client's SDO time-out, for example to store to flash.",
            "Raise the client's SDO time-out; see what else keeps the node busy at that time.",
            _evidence(found),
        )


def _waited_ns(odd: Oddity) -> int:
    asked = odd.asked
    return (asked.given_up_ns or asked.start_ns) - asked.start_ns


def _unheard_ns(facts: Facts, bus: str, odd: Oddity) -> int:
    """How much of a client's waiting was a silence of everybody, or a step of the clock [ns]."""
    silences: list[BusSilenceRow | ClockStepRow] = [*facts.analysis.bus_silences]
    silences += facts.analysis.clock_steps
    start_ns, end_ns = odd.asked.start_ns, odd.asked.start_ns + _waited_ns(odd)
    shared = (
        min(row.end_ns, end_ns) - max(row.start_ns, start_ns) for row in silences if row.bus == bus
    )
    return max(0, max(shared, default=0))


def _doubled(facts: Facts) -> Iterator[Finding]:
    """Two answers to one request."""
    for bus, node, found in _kept(facts, "doubled"):
        second = [odd for odd in found if odd.differs or odd.t_ns - odd.since_ns > SAME_FRAME_NS]
        differing = sum(odd.differs for odd in second)
        if differing < 2 and len(second) < ALIKE:
            continue
        what = f", {differing} of them with something else" if differing else ""
        yield Finding(
            "sdo.doubled_answer",
            "error" if differing else "warning",
            bus,
            node,
            second[0].asked.start_ns,
            second[-1].t_ns,
            f"{facts.who(bus, node)}: {counted(len(second), 'SDO request')} got two answers{what}.",
            f"Two devices carry the number {node} and both answer.",
            f"Unplug the device that is meant to be node {node}: does a node {node} still answer?",
            _evidence(second),
        )


def _wrong(facts: Facts) -> Iterator[Finding]:
    """Answers of another object than the one that is asked for."""
    for bus, node, found in _kept(facts, "wrong"):
        if len(found) < OUT_OF_STEP:
            continue
        odd = found[0]
        named = f"{odd.named[0]:04X}h:{odd.named[1]:02X}"
        asked = f"{odd.asked.index:04X}h:{odd.asked.sub:02X}"
        yield Finding(
            "sdo.wrong_answer",
            "warning",
            bus,
            node,
            odd.asked.start_ns,
            found[-1].t_ns,
            f"{facts.who(bus, node)}: {counted(len(found), 'SDO answer')} named another object "
            f"than the one asked for, first {named} instead of {asked}.",
            "Answers lag one request behind, or a second client shares the SDO server.",
            "The client's SDO time-out against the node's answer times; a second master or tool.",
            _evidence(found),
        )


def _evidence(odd: list[Oddity]) -> list[int]:
    pairs = [seq for each in odd for seq in (each.asked.seq, each.seq)]
    return [seq for seq, _ in groupby(sorted(pairs))][:MAX_EVIDENCE]


RULES: tuple[Rule, ...] = (
    Rule(
        "sdo.late_answer",
        "A node answered SDO requests only after the client had given up waiting.",
        "The requests and the late answers.",
        (
            "A request that follows another within 50 ms comes from a second client, no time-out.",
            "Time in which nobody was heard, or which a step of the clock made, is no waiting.",
        ),
        _late,
    ),
    Rule(
        "sdo.doubled_answer",
        "Single SDO requests got two answers: two devices share a node number.",
        "The requests and the second answers.",
        (
            "Equal answers within 1 ms are one frame that CAN sent twice.",
            "At least two answers that differ, or three that are alike.",
            "As many answers as requests are late or repeated, not doubled.",
        ),
        _doubled,
    ),
    Rule(
        "sdo.wrong_answer",
        "A node's SDO answers name other objects than the client asks for.",
        "The requests and the answers.",
        ("At least three; overlapping requests of two clients are told apart by their objects.",),
        _wrong,
        untimed=True,
    ),
)
