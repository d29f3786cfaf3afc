"""Nodes that fade just before a recording ends: the machine may have been switched off."""

from collections.abc import Sequence
from itertools import groupby

from syncline_analyzer.findings.rule import Facts
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.folds.nmt.events import Lost
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.results import Finding

FADE_NS = 2_500_000_000
"""Nodes that fall silent so shortly before the end may be switched off one after another [ns]."""
COMMANDED_FADE_NS = 10_000_000_000
"""The same after somebody stopped or reset all nodes [ns]."""
_DOWN = (0x02, 0x80, 0x81, 0x82)
"""NMT commands after which nodes need not work any more."""
BRIEF_NS = 1_000_000_000
"""A silence this short at the very end says nothing of a single node [ns]."""
BRIEF_TIMEOUTS = 2
"""The same where its error control is slow, in times of its timeout."""
OTHER_BUS_NS = 10_000_000_000
"""A bus that was silent for so long while another was recorded is worth a warning [ns]."""
_EVIDENCE = 40

Entry = tuple[int, NodeKey, Lost]
"""(last sign of life, node, silence)."""


def fading(facts: Facts, entries: Sequence[Entry]) -> list[list[Entry]]:
    """Losses up to the end that the machine's switching off explains, those of a bus together."""
    groups = []
    for bus, group in groupby(entries, key=lambda entry: entry[1][0]):
        end_ns = facts.control.clock.ended_ns.get(bus)
        if end_ns is None or facts.control.nmt.end_ns - end_ns > FADE_NS:
            continue
        found = [entry for entry in group if _lasts(facts, entry, end_ns)]
        most = len(found) > 1 and 2 * len(found) >= _alive(facts, bus, end_ns)
        kept = found if most else [entry for entry in found if _brief(entry, end_ns)]
        if kept:
            groups.append(kept)
    return groups


def _lasts(facts: Facts, entry: Entry, end_ns: int) -> bool:
    """Whether a loss begins shortly before the last frame of its bus and has no end."""
    last_ns, key, lost = entry
    fade_ns = COMMANDED_FADE_NS if _sent_down(facts, key, last_ns) else FADE_NS
    return lost.end_seq is None and lost.end_ns >= end_ns and 0 <= end_ns - last_ns <= fade_ns


def _sent_down(facts: Facts, key: NodeKey, last_ns: int) -> bool:
    """Whether all nodes were stopped or reset shortly before, and not started again."""
    commands = [c for c in facts.control.nmt.timelines[key].history.commands if c.node == 0]
    last = commands[-1] if commands else None
    return (
        last is not None
        and last.specifier in _DOWN
        and abs(last_ns - last.t_ns) <= COMMANDED_FADE_NS
    )


def _brief(entry: Entry, end_ns: int) -> bool:
    last_ns, _, lost = entry
    return end_ns - last_ns <= max(BRIEF_NS, BRIEF_TIMEOUTS * lost.timeout_ns)


def _alive(facts: Facts, bus: int, end_ns: int) -> int:
    """How many nodes were heard until the bus fell silent, or shortly before."""
    return sum(
        on == bus and nmt.heard_ns is not None and end_ns - nmt.heard_ns <= COMMANDED_FADE_NS
        for (on, _), nmt in facts.control.nmt.nodes.items()
    )


def faded(facts: Facts, group: Sequence[Entry]) -> Finding:
    """What is said of nodes that faded at the end of a recording: it accuses none."""
    bus = facts.context.bus_name(group[0][1][0])
    end_ns = facts.control.clock.ended_ns[group[0][1][0]]
    ordered = sorted(group, key=lambda entry: entry[0])
    names = ", ".join(f"node {key[1]} at {facts.moment(last_ns)}" for last_ns, key, _ in ordered)
    start_ns = ordered[0][0]
    return Finding(
        "nmt.bus_silent",
        "info",
        bus,
        group[0][1][1] if len(group) == 1 else None,
        start_ns,
        max(lost.end_ns for _, _, lost in group),
        f"In the last {seconds(end_ns - start_ns)} before the recording of {bus} ended at"
        f" {facts.moment(end_ns)} there fell silent: {names}.",
        "The machine was switched off at the end; so short a time cannot tell that from a fault.",
        "Was it switched off on purpose? If not, record on: are these nodes heard again?",
        [lost.last_seq for _, _, lost in ordered][:_EVIDENCE],
    )


def others_went_on(facts: Facts, bus: int, start_ns: int) -> bool:
    """Whether another bus was recorded long after this one fell silent."""
    return any(
        other != bus and last_ns - start_ns >= OTHER_BUS_NS
        for other, last_ns in facts.control.clock.ended_ns.items()
    )


def bus_silence(facts: Facts, bus: int, start_ns: int, end_ns: int) -> tuple[int, int]:
    """Begin and end of the longest silence of everybody in a stretch; the stretch without one."""
    silence = facts.control.clock.silence_within(bus, start_ns, end_ns)
    return (silence.start_ns, silence.end_ns) if silence else (start_ns, end_ns)
