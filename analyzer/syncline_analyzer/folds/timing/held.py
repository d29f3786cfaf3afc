"""Stretches in which the master holds all nodes: it may switch SYNC off meanwhile."""

from collections.abc import Sequence

from syncline_analyzer.folds.timing.sync_state import SyncHole
from syncline_analyzer.results import NmtCommandRow

AROUND_NS = 100_000_000
"""SYNC may end so long before the command that holds all nodes [ns]."""
SETTLED_NS = 1_000_000_000
"""And begin so long after the one that starts them [ns]."""
_HOLDS = frozenset({"stop", "enter pre-operational", "reset node", "reset communication"})


def held(hole: SyncHole, commands: Sequence[NmtCommandRow], period_ns: float) -> bool:
    """Whether SYNC was away while the master had stopped, or reset, every node of the bus.

    Args:
        hole: SYNCs that are missing.
        commands: NMT commands of the bus in order of `seq`.
        period_ns: usual time between two SYNCs.
    """
    before = [each for each in commands if each.t_ns <= hole.end_ns]
    holds = [each for each in before if each.node == 0 and each.command in _HOLDS]
    early = [each for each in holds if each.t_ns <= hole.start_ns + AROUND_NS + 2 * period_ns]
    if not early:
        return False
    starts = [each.t_ns for each in before if each.command == "start" and each.seq > early[-1].seq]
    if any(t_ns <= hole.start_ns for t_ns in starts):
        return False
    return not starts or hole.end_ns - max(starts) <= SETTLED_NS + 2 * period_ns
