"""Heartbeats that a full bus kept back for so long that their nodes count as lost."""

from collections.abc import Iterator

from syncline_analyzer.findings.nmt.lateness import late_silences
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds, several
from syncline_analyzer.folds.nmt.events import KeptWaiting, Lost
from syncline_analyzer.folds.nmt.kept_waiting import losses_by_waiting
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.results import Finding
from syncline_schemas.named_tuples import NamedTuple

EVIDENCE = 40


class Waited(NamedTuple):
    """A silence of a node in which its heartbeat only had to wait."""

    lost: Lost
    kept: KeptWaiting
    key: NodeKey


def waited(facts: Facts) -> dict[NodeKey, list[Waited]]:
    """Those of every node, but for a spread of its heartbeat that is told as such."""
    found: dict[NodeKey, list[Waited]] = {}
    for key, timeline in facts.control.nmt.timelines.items():
        for lost, kept in losses_by_waiting(facts.context, timeline):
            if lost not in late_silences(facts, key):
                found.setdefault(key, []).append(Waited(lost, kept, key))
    return found


def only_waited(facts: Facts, key: NodeKey, lost: Lost) -> bool:
    """Whether the bus, not the node, explains a silence."""
    return any(each.lost == lost for each in facts.once(waited).get(key, ()))


def kept_back(facts: Facts) -> Iterator[Finding]:
    """One finding for each bus: it is the bus that fails, not the nodes."""
    by_bus: dict[int, list[Waited]] = {}
    for key, found in facts.once(waited).items():
        by_bus.setdefault(key[0], []).extend(found)
    for bus, found in sorted(by_bus.items()):
        yield _kept_back(facts, bus, sorted(found, key=lambda each: each.lost.last_ns))


def _kept_back(facts: Facts, bus: int, found: list[Waited]) -> Finding:
    name = facts.context.bus_name(bus)
    nodes = sorted({each.key[1] for each in found})
    losses = [each.lost for each in found]
    seqs = {seq for lost in losses for seq in (lost.last_seq, lost.end_seq) if seq is not None}
    assumed = [loss.reason for loss in losses if "eds-default" in loss.reason]
    return Finding(
        "nmt.heartbeat_waited",
        "warning",
        name,
        nodes[0] if len(nodes) == 1 else None,
        losses[0].last_ns,
        max(lost.end_ns for lost in losses),
        _text(facts, name, nodes, found),
        f"Frames of higher priority filled {name}, most of all {_ahead(facts, name, found)}. It is"
        " the bus that is too full, not the node that is broken; whoever watches the heartbeat"
        " takes the node for lost.",
        "Do not change the node. See what fills the bus at that time: send it less often, raise"
        " inhibit times, cut long SDO transfers into pieces or use a higher bit rate; give the"
        " watching nodes a longer time (1016h).",
        sorted(seqs)[:EVIDENCE],
        assumed=[*facts.context.assumed_bitrate(name), *sorted(set(assumed))],
    )


def _text(facts: Facts, bus: str, nodes: list[int], found: list[Waited]) -> str:
    worst = max(found, key=lambda each: each.lost.end_ns - each.lost.last_ns)
    passed = worst.lost.end_ns - worst.lost.last_ns
    whose, which = f"heartbeat of {facts.inside(bus, nodes[0])}", ""
    if len(nodes) > 1:
        whose = "heartbeats of nodes " + ", ".join(map(str, nodes))
        which = f" (node {worst.key[1]})"
    busy_ns = worst.lost.end_ns - max(worst.kept.free_ns, worst.lost.last_ns)
    often = several([facts.moment(each.lost.last_ns) for each in found])
    moment = "" if often else f"from {facts.moment(worst.lost.last_ns)} on "
    text = (
        f"The {whose} had to wait {often}{moment}behind frames of higher priority: up to"
        f" {seconds(passed)} without one{which}, and for the last {seconds(busy_ns)} of them the bus"
        f" was never free for it ({worst.kept.busy:.0%} busy). The node counts as lost after"
        f" {seconds(worst.lost.timeout_ns)}: {worst.lost.reason}."
    )
    if not all(each.kept.over for each in found):
        text += " The bus stayed full up to the end, so whether it is still there is not known."
    return text


def _ahead(facts: Facts, bus: str, found: list[Waited]) -> str:
    """The identifiers that took most of the time, with what they are."""
    worst = max(found, key=lambda each: each.kept.waited_ns)
    service = {row.cob_id: row.service for row in facts.analysis.bus_shares if row.bus == bus}
    named = [
        f"{can_id:03X}h" + (f" ({service[can_id]})" if can_id in service else "")
        for can_id in worst.kept.ahead
    ]
    return ", ".join(named)


RULES = (
    Rule(
        "nmt.heartbeat_waited",
        "A heartbeat waited behind frames of higher priority until its node counted as lost.",
        "The node's last frame before that time and its first one after it.",
        (
            "Only where the bit rate is known; an estimated one is named as such.",
            (
                "The bus was never free for the heartbeat from the moment on at which the node counts"
                " as lost: neither idle nor taken by a frame of lower priority of another node."
            ),
            "A node that comes back with a boot-up was lost, however full the bus was.",
        ),
        kept_back,
    ),
)
