"""Nodes of which something is not heard any more, though nobody can say that they are lost."""

from collections.abc import Iterator

from syncline_analyzer.findings.nmt.twins import NEVER, twins
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.folds.nmt.table import NodeKey, NodeNmt
from syncline_analyzer.folds.nmt.timeout import PRODUCER_TIME
from syncline_analyzer.results import Finding, GapRow
from syncline_schemas.canopen.nmt import RESETS

ENOUGH = 20
"""Heartbeats that make a rhythm."""
LATER_NS = 10_000_000_000
LATER_PERIODS = 20
"""A heartbeat has ended when its node is heard so long, and so many of its periods, after it."""
AFTER_GAP_NS = 5_000_000_000
AFTER_GAP_PERIODS = 5
"""A node is missed when others are heard so long, and so many of its periods, after a gap."""
LONG_GAP_NS = 600_000_000_000
"""In a longer gap a machine may well be rebuilt: then a missing node is only worth a word [ns]."""
_EVIDENCE = 40


def _ended(facts: Facts) -> Iterator[Finding]:
    """Heartbeats that end for good while their node goes on to send PDOs or answers."""
    doubled = twins(facts)
    for key, nmt in facts.control.nmt.nodes.items():
        period, bus, node = nmt.heartbeat_period_ns, facts.context.bus_name(key[0]), key[1]
        last_ns, heard_ns = nmt.told_ns, nmt.heard_ns
        if period is None or last_ns is None or heard_ns is None:
            continue
        lasted = heard_ns - last_ns
        if lasted < max(LATER_NS, LATER_PERIODS * period) or doubled.begin(bus, node) != NEVER:
            continue
        if not _steady(nmt) or _explained(facts, key, last_ns, period):
            continue
        guess = nmt.pdos == "guess" and not _answers(facts, bus, node, last_ns)
        yield Finding(
            "nmt.heartbeat_ended",
            "warning",
            bus,
            node,
            last_ns,
            heard_ns,
            f"The heartbeat of {facts.inside(bus, node)}, every {seconds(period)} until then, ended"
            f" at {facts.moment(last_ns)}, but its other frames went on for {seconds(lasted)}: the"
            " node lives.",
            "Its heartbeat was switched off in a way that was not recorded (1017h), or its program"
            " hangs in part; whoever watches the heartbeat takes the node for lost.",
            "Read 1017h and 1001h of the node; does the heartbeat come again after a reset?",
            [pace.last_seq for pace in nmt.paces.paces[-1:]],
            assumed=[f"PDOs on the predefined identifiers of node {node} are its own"]
            if guess
            else [],
        )


def _steady(nmt: NodeNmt) -> bool:
    """Whether a node sent heartbeats enough, unasked, and any way to tell a state."""
    return nmt.counts.heartbeats >= ENOUGH and not nmt.counts.guard_requests


def _explained(facts: Facts, key: NodeKey, last_ns: int, period: int) -> bool:
    """Whether a restart, a write of 1017h, or what a gap hides may have ended a heartbeat."""
    timeline, shadow = facts.control.nmt.timelines[key], facts.context.shadow
    since_ns = last_ns - 2 * period
    known = (shadow.get(*key, PRODUCER_TIME, 0, seq) for seq in shadow.changes(*key, PRODUCER_TIME))
    return (
        any(boot.t_ns >= since_ns for boot in timeline.boot_ups)
        or any(c.specifier in RESETS and c.t_ns >= since_ns for c in timeline.history.commands)
        or any(gap.end_ns > last_ns for _, gap in timeline.history.gaps)
        or any(k is not None and k.t_ns is not None and k.t_ns >= since_ns for k in known)
    )


def _answers(facts: Facts, bus: str, node: int, since_ns: int) -> bool:
    answered = facts.analysis.sdo.ok.of_node(bus, node)
    return bool((answered.records["start_ns"] > since_ns).any())


def _after_gap(facts: Facts) -> Iterator[Finding]:
    """Nodes that were heard up to a gap and never after it, though others were."""
    for key, nmt in facts.control.nmt.nodes.items():
        bus, node = facts.context.bus_name(key[0]), key[1]
        gap = _last_gap(facts, bus)
        if gap is None or nmt.heard_ns is None or nmt.heartbeat_period_ns is None:
            continue
        enough_ns = max(AFTER_GAP_NS, AFTER_GAP_PERIODS * nmt.heartbeat_period_ns)
        until_gap = 0 <= gap.start_ns - nmt.heard_ns <= 2 * nmt.heartbeat_period_ns
        others = {
            other: each.heard_ns - gap.end_ns
            for (on, other), each in facts.control.nmt.nodes.items()
            if on == key[0] and each.heard_ns is not None and each.heard_ns > gap.end_ns
        }
        lasted = max(others.values(), default=0)
        if not until_gap or lasted < enough_ns:
            continue
        names = ", ".join(map(str, sorted(others)))
        new = [n for n in sorted(others) if _first_ns(facts, (key[0], n)) >= gap.start_ns]
        renumbered = f" {_numbers(new)} heard for the first time after it." if new else ""
        yield Finding(
            "nmt.missing_after_gap",
            "warning" if gap.end_ns - gap.start_ns <= LONG_GAP_NS else "info",
            bus,
            node,
            nmt.heard_ns,
            gap.end_ns + lasted,
            f"{facts.who(bus, node)} was heard until the gap in the capture at"
            f" {facts.moment(gap.start_ns)} and not in the {seconds(lasted)} after it, in which"
            f" {'node' if len(others) == 1 else 'nodes'} {names} came back. When it fell silent"
            f" lies in the gap.{renumbered}",
            (
                f"It carries another number since then ({' or '.join(map(str, new))}), or it was"
                " switched off, unplugged or failed while nothing was recorded; the capture cannot"
                " tell which."
            )
            if new
            else (
                "It was switched off, unplugged or failed while nothing was recorded; the capture"
                " cannot tell when, nor whether somebody meant it."
            ),
            "Is the node still there? If it should be: its supply, its plug, its error memory"
            " (1003h).",
            [],
        )


def _first_ns(facts: Facts, key: NodeKey) -> int:
    """When a node was heard first [ns]."""
    history = facts.control.nmt.timelines[key].history
    first = [beat.t_ns for beat in history.beats[:1]] + [s.first_ns for s in history.spans[:1]]
    return min(first, default=0)


def _numbers(nodes: list[int]) -> str:
    if len(nodes) == 1:
        return f"Node {nodes[0]} was"
    return f"Nodes {', '.join(map(str, nodes))} were"


def _last_gap(facts: Facts, bus: str) -> GapRow | None:
    gaps = [gap for gap in facts.analysis.capture.gaps if gap.bus in (None, bus)]
    return max(gaps, key=lambda gap: gap.end_ns, default=None)


RULES = (
    Rule(
        "nmt.heartbeat_ended",
        "A node's heartbeat ended for good while its PDOs or SDO answers went on.",
        "The last heartbeat.",
        (
            "At least 20 heartbeats before, and other frames for 10 s and 20 of its periods after.",
            "Not after a boot-up, a reset, a write of 1017h or a gap, nor on a guarded node.",
        ),
        _ended,
    ),
    Rule(
        "nmt.missing_after_gap",
        "A node was heard until a gap in the capture and never after it, though others were.",
        "The gap; no frame proves it.",
        (
            "Only where others are heard for 5 s, and 5 of its periods, after the last gap.",
            "It says that the capture cannot tell when the node fell silent.",
        ),
        _after_gap,
    ),
)
