"""Other nodes of a bus whose heartbeats kept their time while one node was silent."""

from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import field
from operator import itemgetter

from syncline_analyzer.folds.nmt.pace import Late
from syncline_schemas.records import dataclass

SHOWN = 0.25
"""A step of the clock by this part of a heartbeat's period shows in it."""
ON_GRID = 0.03
"""Part of its period by which a heartbeat after a silence may be off the grid of those before."""


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """A node's heartbeat: its period, and when it was heard.

    `late` are its longer intervals, `silent` those (start_ns, end_ns) of the node, both in order.
    """

    period_ns: int
    first_ns: int
    last_ns: int
    late: Sequence[Late] = ()
    silent: Sequence[tuple[int, int]] = ()

    def longer(self, start_ns: int, end_ns: int) -> bool:
        """Whether an interval was longer than usual that overlaps a stretch."""
        late = bisect_left(self.late, start_ns, key=lambda late: late.end_ns)
        silent = bisect_left(self.silent, start_ns, key=itemgetter(1))
        return (late < len(self.late) and self.late[late].start_ns < end_ns) or (
            silent < len(self.silent) and self.silent[silent][0] < end_ns
        )

    def late_by(self, excess_ns: int, start_ns: int, end_ns: int, period_ns: int) -> bool:
        """Whether an interval that overlaps a stretch was too long by a time [ns].

        It may be off by a small part of the shorter period, of its own or another one.
        """
        at = bisect_left(self.late, start_ns, key=lambda late: late.end_ns)
        silent = bisect_left(self.silent, start_ns, key=itemgetter(1))
        found = [(each.start_ns, each.end_ns) for each in self.late[at : at + 1]]
        found += self.silent[silent : silent + 1]
        slack = ON_GRID * min(self.period_ns, period_ns)
        return any(
            begin < end_ns and abs(stop - begin - self.period_ns - excess_ns) <= slack
            for begin, stop in found
        )

    def across(self, start_ns: int, end_ns: int) -> Late | None:
        """The longer interval that covers a stretch."""
        at = bisect_right(self.late, start_ns, key=lambda late: late.start_ns) - 1
        found = self.late[at] if at >= 0 else None
        return found if found is not None and found.end_ns >= end_ns else None


@dataclass(frozen=True, slots=True)
class Witnesses:
    """The heartbeats of one bus by node; none where others send SYNC or PDOs, which tell more."""

    heartbeats: Mapping[int, Heartbeat] = field(default_factory=dict)

    def agree(self, node: int, start_ns: int, end_ns: int) -> bool:
        """Whether all other heartbeats are late by as much as that of a node in a silence.

        So they are where the clock was set forward; of two nodes that fell silent by themselves
        each would be late by whole periods of its own.
        """
        own = self.heartbeats.get(node)
        others = [
            each
            for other, each in self.heartbeats.items()
            if other != node and each.first_ns <= start_ns and each.last_ns >= end_ns
        ]
        if own is None or not others:
            return False
        excess = end_ns - start_ns - own.period_ns
        return all(each.late_by(excess, start_ns, end_ns, own.period_ns) for each in others)

    def prove(self, node: int, start_ns: int, end_ns: int) -> bool:
        """Whether a silence is that of one node, though nobody else was heard for most of it.

        Nobody else was due: no heartbeat of another node that was there became late. A step of the
        clock by so much would have shown in one of them, and would seldom leave the node's own
        heartbeats on their grid.
        """
        own = self.heartbeats.get(node)
        interval = own.across(start_ns, end_ns) if own is not None else None
        if own is None or interval is None:
            return False
        passed = interval.end_ns - interval.start_ns
        off = abs(passed - round(passed / own.period_ns) * own.period_ns)
        if off > ON_GRID * own.period_ns:
            return False
        others = [
            each
            for other, each in self.heartbeats.items()
            if other != node and each.first_ns <= start_ns and each.last_ns >= end_ns
        ]
        shown = any(passed - own.period_ns >= SHOWN * each.period_ns for each in others)
        return shown and not any(each.longer(start_ns, end_ns) for each in others)
