"""Nodes that fell silent: each by itself, or with the whole bus, equal losses told as one."""

from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from itertools import groupby

from syncline_analyzer.context import Context
from syncline_analyzer.findings.bus import tells_bus_off
from syncline_analyzer.findings.guarding import STORY_NS
from syncline_analyzer.findings.stretch import moment, seconds, several
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.folds.nmt import NodeKey
from syncline_analyzer.folds.nmt_events import Lost
from syncline_analyzer.results import Analysis, Finding

BOOT_UP_NS = 1_000_000_000
"""A boot-up this soon after a silence belongs to it [ns]."""
EVIDENCE = 40
"""Frames named at most."""


@dataclass(frozen=True, slots=True)
class _Loss:
    """A silence of one node, or of all nodes of a bus at once."""

    bus: int
    nodes: tuple[int, ...]
    whole_bus: bool
    booted: bool
    """It ended with a boot-up."""
    over: bool
    """It ended before the capture, or a gap, did."""
    start_ns: int
    end_ns: int
    evidence: tuple[int, ...]
    limit: str
    """When it counts as lost, and why."""

    @property
    def kind(self) -> tuple[int, tuple[int, ...], bool, bool, bool]:
        """What equal losses have in common."""
        return self.bus, self.nodes, self.whole_bus, self.booted, self.over


def lost_nodes(
    analysis: Analysis, control: ControlTables, context: Context, told: AbstractSet[int]
) -> Iterator[Finding]:
    """Findings on silences, but for those whose last frame another story tells already."""
    entries = [
        (lost.last_ns, key, lost)
        for key, timeline in control.nmt.timelines.items()
        for lost in timeline.lost
        if lost.last_seq not in told and not was_bus_off(analysis, context, key, lost)
    ]
    entries.sort(key=lambda entry: (entry[1][0], entry[0], entry[1]))
    losses = [_loss(control, context, [e]) for e in entries if not e[2].whole_bus]
    whole = [entry for entry in entries if entry[2].whole_bus]
    for _, group in groupby(whole, key=lambda e: (e[1][0], e[0] // 1_000_000_000)):
        losses.append(_loss(control, context, list(group)))
    losses.sort(key=lambda loss: (loss.kind, loss.start_ns))
    for _, equal in groupby(losses, key=lambda loss: loss.kind):
        yield _finding(analysis, context, list(equal))


def _loss(
    control: ControlTables, context: Context, group: list[tuple[int, NodeKey, Lost]]
) -> _Loss:
    _, (bus, _), first = group[0]
    frames = [seq for _, _, lost in group for seq in (lost.last_seq, lost.end_seq)]
    return _Loss(
        bus,
        tuple(sorted({key[1] for _, key, _ in group})),
        first.whole_bus,
        any(_booted(control, context, key, lost) for _, key, lost in group),
        any(lost.end_seq is not None for _, _, lost in group),
        min(lost.last_ns for _, _, lost in group),
        max(lost.end_ns for _, _, lost in group),
        tuple(sorted(seq for seq in frames if seq is not None)),
        f" It counts as lost after {seconds(first.timeout_ns)}: {first.reason}.",
    )


def _finding(analysis: Analysis, context: Context, losses: list[_Loss]) -> Finding:
    first = losses[0]
    words = _whole_bus if first.whole_bus else _alone
    severity, text, cause, check_next = words(analysis, losses)
    return Finding(
        "nmt.node_lost",
        "error" if severity == "error" else "warning",
        context.bus_name(first.bus),
        first.nodes[0] if len(first.nodes) == 1 and not _accuses_nobody(first) else None,
        first.start_ns,
        losses[-1].end_ns,
        text,
        cause,
        check_next,
        [seq for loss in losses for seq in loss.evidence][:EVIDENCE],
    )


def _accuses_nobody(loss: _Loss) -> bool:
    """Whether nothing shows that it was the node: nobody was heard, and it did not start anew."""
    return loss.whole_bus and not loss.booted


def _alone(analysis: Analysis, losses: list[_Loss]) -> tuple[str, str, str, str]:
    """(severity, text, cause, what to check) where the other nodes were heard all the time."""
    first = losses[0]
    node, lasted = f"Node {first.nodes[0]}", _lasted(losses)
    if not first.over:
        since = moment(analysis, first.start_ns)
        text = f"{node} is silent from {since} on, {lasted} up to the end."
    else:
        how = "with a boot-up" if first.booted else "without a boot-up"
        often, each = _often(analysis, losses), " each time" if len(losses) > 1 else ""
        text = f"{node} was lost {often}for {lasted} and came back {how}{each}."
    return (
        "error",
        text + first.limit,
        "The node lost its supply or restarted: it came back with a boot-up."
        if first.booted
        else "Supply or cable of this node, its CAN interface bus-off, or the node stopped working;"
        " the other nodes were heard all the time, so the bus itself worked.",
        "Check plug, cable and supply voltage of the node; look at its error memory (1003h).",
    )


def _whole_bus(analysis: Analysis, losses: list[_Loss]) -> tuple[str, str, str, str]:
    """The same where nobody at all was heard: that accuses no node."""
    first, names = losses[0], _names(losses[0].nodes)
    lasted = _lasted(losses)
    if first.booted:
        each = " each time" if len(losses) > 1 else ""
        text = f"The whole bus was silent {_often(analysis, losses)}for {lasted};"
        text += f" {names} came back with a boot-up{each}."
        cause = "The machine was switched off and on (all nodes started anew)."
    else:
        text = f"The whole bus was silent for {lasted};"
        text += f" {names} {'was' if len(first.nodes) == 1 else 'were'} not heard again."
        cause = "The machine was switched off, the recorder was unplugged, or the bus was broken"
        cause += " near it."
    check_next = "Was it switched off on purpose? If not: supply of the whole machine, cable at"
    return "warning", text, cause, check_next + " the recorder."


def _often(analysis: Analysis, losses: list[_Loss]) -> str:
    """How often and when, for more than one."""
    return several([moment(analysis, loss.start_ns) for loss in losses])


def _lasted(losses: list[_Loss]) -> str:
    """How long, or the shortest and the longest."""
    lengths = sorted(loss.end_ns - loss.start_ns for loss in losses)
    short, long = seconds(lengths[0]), seconds(lengths[-1])
    return short if short == long else f"{short} to {long}"


def was_bus_off(analysis: Analysis, context: Context, key: NodeKey, lost: Lost) -> bool:
    """Whether the node says afterwards that it was bus-off: that finding tells the silence too."""
    bus = context.bus_name(key[0])
    return any(
        (row.bus, row.node) == (bus, key[1])
        and row.transition != "malformed"
        and row.code is not None
        and tells_bus_off(row.code, row.meaning)
        and lost.start_ns <= row.t_ns <= lost.end_ns + STORY_NS
        for row in analysis.emcy
    )


def _booted(control: ControlTables, context: Context, key: NodeKey, lost: Lost) -> bool:
    bus = context.bus_name(key[0])
    return any(
        (boot.bus, boot.node) == (bus, key[1]) and 0 <= boot.t_ns - lost.end_ns <= BOOT_UP_NS
        for boot in control.nmt.boot_ups
    )


def _names(nodes: tuple[int, ...]) -> str:
    return f"node {nodes[0]}" if len(nodes) == 1 else "nodes " + ", ".join(map(str, nodes))
