"""Short breaks of the whole machine's supply: all nodes start anew at once, so none by itself."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.folds.nmt.table import BootUp
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.results import Finding
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.records import dataclass

APART_NS = 2_000_000_000
"""Nodes that start together boot no further apart than this [ns]."""
SILENT_NS = 100_000_000
"""So long nobody at all is heard before the first boot-up [ns]."""
BEFORE_NS = 5_000_000_000
"""That silence begins no longer before the first boot-up [ns]."""
COMMAND_NS = 10_000_000_000
"""A reset of all nodes this long before the first boot-up explains it [ns]."""
_OFF = (NmtState.LOST, NmtState.UNKNOWN)
_EVIDENCE = 40


@dataclass(frozen=True, slots=True)
class PowerBreak:
    """Boot-ups of all nodes of a bus, and the silence of everybody before them [ns]."""

    bus: int
    boots: tuple[BootUp, ...]
    start_ns: int
    end_ns: int

    def covers(self, bus: int, node: int, t_ns: int) -> bool:
        """Whether a node's silence or restart that ended at a moment is part of it."""
        last_ns = self.boots[-1].t_ns + APART_NS
        return bus == self.bus and self.start_ns <= t_ns <= last_ns and node in self.nodes

    @property
    def nodes(self) -> list[int]:
        return sorted({boot.node for boot in self.boots})


def power_breaks(facts: Facts) -> list[PowerBreak]:
    """Moments at which all nodes of a bus started anew without a command."""
    return facts.once(_breaks)


def _breaks(facts: Facts) -> list[PowerBreak]:
    found = []
    for bus, name in enumerate(facts.context.buses):
        boots = sorted(
            (b for b in facts.control.nmt.boot_ups if b.bus == name and b.command_seq is None),
            key=lambda boot: boot.t_ns,
        )
        for group in _groups(boots):
            each = _break(facts, bus, group)
            if each is not None:
                found.append(each)
    return found


def _groups(boots: Sequence[BootUp]) -> Iterator[tuple[BootUp, ...]]:
    cuts = [k for k, (a, b) in enumerate(pairwise(boots), 1) if b.t_ns - a.t_ns > APART_NS]
    for first, stop in pairwise([0, *cuts, len(boots)]):
        if len({boot.node for boot in boots[first:stop]}) > 1:
            yield tuple(boots[first:stop])


def _break(facts: Facts, bus: int, boots: tuple[BootUp, ...]) -> PowerBreak | None:
    """What a group of boot-ups tells, None where a node went on, or another rule tells it."""
    first_ns, nodes = boots[0].t_ns, {boot.node for boot in boots}
    silence = facts.control.clock.silence_within(bus, first_ns - BEFORE_NS, first_ns)
    if silence is None or silence.end_ns - silence.start_ns < SILENT_NS:
        return None
    if _commanded(facts, boots[0]):
        return None
    for (on, node), timeline in facts.control.nmt.timelines.items():
        if on != bus:
            continue
        fresh = node in nodes and _state_at(timeline, silence.start_ns) is NmtState.UNKNOWN
        went_on = node not in nodes and _state_at(timeline, boots[-1].t_ns + APART_NS) not in _OFF
        told = any(
            lost.whole_bus and lost.last_ns <= silence.end_ns and lost.end_ns >= silence.start_ns
            for lost in timeline.lost
        )
        if fresh or went_on or told:
            return None
    return PowerBreak(bus, boots, silence.start_ns, silence.end_ns)


def _commanded(facts: Facts, boot: BootUp) -> bool:
    return any(
        row.bus == boot.bus
        and row.node == 0
        and row.command.startswith("reset")
        and 0 <= boot.t_ns - row.t_ns <= COMMAND_NS
        for row in facts.control.nmt.commands
    )


def _state_at(timeline: Timeline, t_ns: int) -> NmtState:
    """What is told of a node at a moment; UNKNOWN before and after everything."""
    return next(
        (each.state for each in timeline.intervals if each.start_ns <= t_ns < each.end_ns),
        NmtState.UNKNOWN,
    )


def told_at_once(facts: Facts, each: PowerBreak) -> Finding:
    """One statement on the machine, which accuses no node."""
    names = ", ".join(map(str, each.nodes))
    return Finding(
        "nmt.bus_silent",
        "warning",
        facts.context.bus_name(each.bus),
        None,
        each.start_ns,
        each.boots[-1].t_ns,
        f"The whole bus was silent at {facts.moment(each.start_ns)} for"
        f" {seconds(each.end_ns - each.start_ns)}; nodes {names} came back with a boot-up, all of"
        f" them within {seconds(each.boots[-1].t_ns - each.boots[0].t_ns)} and without a command.",
        "The supply of the whole machine broke down, or it was switched off and on (all nodes"
        " started anew).",
        "Was it switched off on purpose? If not: supply of the whole machine.",
        [boot.seq for boot in each.boots][:_EVIDENCE],
    )
