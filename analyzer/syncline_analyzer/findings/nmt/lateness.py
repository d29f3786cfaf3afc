"""Heartbeats that came late again and again: no single one is missing, so the node was not lost."""

from bisect import bisect_left

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.folds.nmt.events import Lost
from syncline_analyzer.folds.nmt.pace import Late
from syncline_analyzer.folds.nmt.table import NodeKey, NodeNmt
from syncline_analyzer.folds.nmt.timeout import LOST_FACTOR

MISSING = 1.9
"""After so many periods a heartbeat is missing; before, the one that comes is only late."""
OFTEN = 3
"""A heartbeat that is late so often has a spread, however short a time it is allowed."""


def late_silences(facts: Facts, key: NodeKey) -> list[Lost]:
    """Silences of a node, longer than it is allowed, in which no heartbeat is missing.

    They are its spread where there are several, or where only 1016h of another node calls them
    too long.
    """
    nmt, timeline = facts.control.nmt.nodes[key], facts.control.nmt.timelines[key]
    boots = {boot.seq for boot in timeline.boot_ups}
    found = [
        (lost, period)
        for lost in timeline.lost
        if lost.end_seq is not None and lost.end_seq not in boots and not lost.whole_bus
        if lost.state_before != "INITIALISING" and (period := _period_ns(nmt, lost))
        if lost.end_ns - lost.last_ns < MISSING * period
    ]
    often = len(found) >= OFTEN
    return [lost for lost, period in found if often or lost.timeout_ns < LOST_FACTOR * period]


def late_heartbeats(facts: Facts, key: NodeKey) -> list[Late]:
    """Late heartbeats of a node that nothing explains, in order of time."""
    spread = (
        Late(lost.end_seq or 0, lost.last_ns, lost.end_ns) for lost in late_silences(facts, key)
    )
    return sorted({*facts.control.nmt.nodes[key].late, *spread})


def _period_ns(nmt: NodeNmt, lost: Lost) -> int:
    """The heartbeat's period around a silence, 0 where none is known [ns]."""
    at = bisect_left([pace.last_seq for pace in nmt.paces.paces], lost.last_seq)
    near = nmt.paces.paces[at : at + 1]
    return near[0].median_ns if near else nmt.heartbeat_period_ns or 0
