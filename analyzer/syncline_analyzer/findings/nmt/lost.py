"""Nodes that fell silent: each by itself, or with the whole bus, equal losses told as one."""

from collections.abc import Iterator
from itertools import groupby

from syncline_analyzer.context import Context
from syncline_analyzer.findings.bus.bus_off import bus_off_silences
from syncline_analyzer.findings.bus.lss_back import Back, gone_back
from syncline_analyzer.findings.device.exchange import Exchange, exchanged_in
from syncline_analyzer.findings.device.identity import Absence, absences
from syncline_analyzer.findings.emcy.messages import EMPTY
from syncline_analyzer.findings.nmt.guarding_story import STORY_NS, told_by_guarding
from syncline_analyzer.findings.nmt.lateness import late_silences
from syncline_analyzer.findings.nmt.power import APART_NS, power_breaks, told_at_once
from syncline_analyzer.findings.nmt.switching import bus_silence, faded, fading, others_went_on
from syncline_analyzer.findings.nmt.twins import Shared, twins
from syncline_analyzer.findings.nmt.waited import only_waited
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds, several
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.folds.nmt.events import IN_FLIGHT_NS, Command, Lost
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.folds.nmt.timeout import LOST_FACTOR
from syncline_analyzer.results import Finding, Severity
from syncline_schemas.canopen.nmt import RESETS
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

BOOT_UP_NS = 1_000_000_000
"""A boot-up this soon after a silence belongs to it [ns]."""
TOGETHER_NS = 1_500_000_000
"""Nodes whose last signs of life are no further apart fell silent at the same moment [ns]."""
AT_ONCE_NS = 500_000_000
"""Nodes that are switched off together fall silent within this time [ns]."""
EVIDENCE = 40
"""Frames named at most."""
_BY_EXCHANGE = (
    "The device was taken off, or set to another node id, and another one took its place.",
    (
        "Was it exchanged on purpose? Then compare the new one's settings with those of the old one:"
        " scale, zero point and preset are not carried over by themselves."
    ),
)


class FailedReset(NamedTuple):
    """A reset after which a node was silent for too long; `back` when it was heard again."""

    command: Command
    end_ns: int
    end_seq: int | None
    back: bool


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
    silent: tuple[int, int]
    """While nobody at all was heard, where the whole bus was silent [ns]."""
    exchanged: str = ""
    """Sentences on devices that were exchanged meanwhile."""

    @property
    def kind(self) -> tuple[int, tuple[int, ...], bool, bool, bool]:
        """What equal losses have in common."""
        return self.bus, self.nodes, self.whole_bus, self.booted, self.over


def _lost_nodes(facts: Facts) -> Iterator[Finding]:
    """Silences of single nodes, but for those that another story tells already."""
    entries = facts.once(_entries)
    off = {entry[:2] for group in fading(facts, entries) for entry in group}
    single = [entry for entry in entries if not entry[2].whole_bus and entry[:2] not in off]
    losses = [_loss(facts, [entry]) for entry in single]
    losses.sort(key=lambda loss: (loss.kind, loss.start_ns))
    for _, equal in groupby(losses, key=lambda loss: loss.kind):
        found = list(equal)
        first = found[0]
        text, cause, check_next = _alone(facts, found, _together(losses, first))
        yield _finding(
            "nmt.node_lost", "error", facts, found, first.nodes[0], text, cause, check_next
        )


def _silent_buses(facts: Facts) -> Iterator[Finding]:
    """Silences of a whole bus: they accuse no node, unless the only one on it started anew."""
    entries = facts.once(_entries)
    groups = fading(facts, entries)
    yield from (faded(facts, group) for group in groups)
    yield from (told_at_once(facts, each) for each in power_breaks(facts))
    off = {entry[:2] for group in groups for entry in group}
    whole = [entry for entry in entries if entry[2].whole_bus and entry[:2] not in off]
    losses = [_loss(facts, group) for group in _at_once(whole)]
    losses.sort(key=lambda loss: (loss.kind, loss.start_ns))
    for _, equal in groupby(losses, key=lambda loss: loss.kind):
        found = list(equal)
        first = found[0]
        only = facts.control.nmt.timelines[first.bus, first.nodes[0]].history.alone
        node = first.nodes[0] if first.booted and only else None
        cut_off = others_went_on(facts, first.bus, first.silent[0])
        severity: Severity = "warning" if first.booted or cut_off else "info"
        yield _finding("nmt.bus_silent", severity, facts, found, node, *_whole_bus(facts, found))


def _at_once(
    entries: list[tuple[int, NodeKey, Lost]],
) -> Iterator[list[tuple[int, NodeKey, Lost]]]:
    """Silences of one bus that overlap, as those of all its nodes do when it is off."""
    group: list[tuple[int, NodeKey, Lost]] = []
    for entry in entries:
        last = group[-1] if group else None
        if last and (last[1][0] != entry[1][0] or entry[0] >= min(e[2].end_ns for e in group)):
            yield group
            group = []
        group.append(entry)
    if group:
        yield group


def elsewhere(facts: Facts) -> list[Absence | Back]:
    """When numbers fell silent because their device had another one since, or again."""
    return [*absences(facts), *gone_back(facts)]


def _entries(facts: Facts) -> list[tuple[int, NodeKey, Lost]]:
    """(last sign of life, node, silence) of what is no story of guarding, bus-off or a reset."""
    told, others, doubled = told_by_guarding(facts), elsewhere(facts), twins(facts)
    entries = [
        (lost.last_ns, key, lost)
        for key, timeline in facts.control.nmt.timelines.items()
        for lost in sorted({*timeline.lost} - {*late_silences(facts, key)})
        if lost.last_seq not in told
        and not _after_reset(timeline, lost)
        and not was_bus_off(facts, key, lost)
        and not only_waited(facts, key, lost)
        and not _not_due(facts, key, lost)
        and not _of_one_of_two(doubled, facts, key, lost)
        and not any(
            each.explains(facts.context.bus_name(key[0]), key[1], lost.last_ns, lost.end_ns)
            for each in others
        )
        and not any(each.covers(*key, lost.end_ns) for each in power_breaks(facts))
    ]
    return sorted(entries, key=lambda entry: (entry[1][0], entry[0], entry[1]))


def _not_due(facts: Facts, key: NodeKey, lost: Lost) -> bool:
    """Whether a silence is none but for a time that is not the node's.

    The recorder's clock was set in it, or nobody was heard for a while shortly before the end.
    """
    bus = facts.context.bus_name(key[0])
    others = [
        (row.start_ns, row.end_ns, row.step_ns)
        for row in facts.analysis.clock_steps
        if row.bus == bus
    ]
    if lost.end_seq is None:
        others += [
            (row.start_ns, row.end_ns, row.end_ns - row.start_ns)
            for row in facts.analysis.bus_silences
            if row.bus == bus and row.end_ns < lost.end_ns
        ]
        quiet = facts.control.clock.silence_within(key[0], lost.last_ns, lost.end_ns)
        if quiet is not None and quiet.end_ns < lost.end_ns:
            others.append((quiet.start_ns, quiet.end_ns, quiet.end_ns - quiet.start_ns))
    longest = max(
        (by_ns for start, end, by_ns in others if lost.last_ns < end and start < lost.end_ns),
        default=0,
    )
    return longest > 0 and lost.end_ns - lost.last_ns - longest <= lost.timeout_ns


def _of_one_of_two(doubled: Shared, facts: Facts, key: NodeKey, lost: Lost) -> bool:
    """Whether a silence is only that of one of two devices, held against the cadence of both."""
    period = facts.control.nmt.nodes[key].doubles.pair_ns
    within = lost.end_ns - lost.last_ns <= LOST_FACTOR * period
    return within and doubled.at(facts.context.bus_name(key[0]), key[1], lost.end_ns)


def failed_resets(facts: Facts) -> Iterator[tuple[NodeKey, FailedReset]]:
    """Resets that silenced a node for longer than a start may take."""
    for key, timeline in facts.control.nmt.timelines.items():
        found = False
        for lost in timeline.lost:
            command = _after_reset(timeline, lost)
            if command is not None:
                found = True
                back = lost.end_seq is not None
                yield key, FailedReset(command, lost.end_ns, lost.end_seq, back)
        if not found and (command := _last_reset(facts, key, timeline)):
            yield key, FailedReset(command, timeline.history.end_ns, None, False)


def _after_reset(timeline: Timeline, lost: Lost) -> Command | None:
    """The reset command that began a silence; None where it is a loss of another kind."""
    if lost.whole_bus or lost.state_before != "INITIALISING":
        return None
    resets = [
        command
        for command in timeline.history.commands
        if command.specifier in RESETS and lost.last_ns - STORY_NS <= command.t_ns <= lost.start_ns
    ]
    return resets[-1] if resets else None


def _last_reset(facts: Facts, key: NodeKey, timeline: Timeline) -> Command | None:
    """A reset after which nothing at all came of a node whose silence nobody times."""
    last = timeline.intervals[-1] if timeline.intervals else None
    if last is None or last.state.value != "INITIALISING" or last.certainty != "commanded":
        return None
    command = next((c for c in timeline.history.commands if c.seq == last.evidence), None)
    heard = facts.control.nmt.nodes[key].heard_ns
    if command is None or heard is None or not 0 <= command.t_ns + IN_FLIGHT_NS - heard <= STORY_NS:
        return None
    others = [
        nmt.heard_ns or 0
        for other, nmt in facts.control.nmt.nodes.items()
        if other[0] == key[0] and other != key
    ]
    until = command.t_ns + timeline.reset_quiet_ns
    heard_ns = min(max(others, default=0), timeline.history.end_ns)
    return command if heard_ns > until else None


def _loss(facts: Facts, group: list[tuple[int, NodeKey, Lost]]) -> _Loss:
    _, (bus, _), first = group[0]
    start_ns = min(lost.last_ns for _, _, lost in group)
    end_ns = max(lost.end_ns for _, _, lost in group)
    frames = [seq for _, _, lost in group for seq in (lost.last_seq, lost.end_seq)]
    booted = any(_booted(facts.control, facts.context, key, lost) for _, key, lost in group)
    exchanges = _exchanges(facts, group)
    frames += [seq for each in exchanges for seq in each.evidence]
    nodes = {key[1] for _, key, _ in group}
    if first.whole_bus and booted:
        nodes |= _started_too(facts, bus, min(lost.end_ns for _, _, lost in group))
    return _Loss(
        bus,
        tuple(sorted(nodes)),
        first.whole_bus,
        booted,
        any(lost.end_seq is not None for _, _, lost in group),
        start_ns,
        end_ns,
        tuple(sorted(seq for seq in frames if seq is not None)),
        f" It counts as lost after {seconds(first.timeout_ns)}: {first.reason}.",
        bus_silence(facts, bus, start_ns, end_ns) if first.whole_bus else (start_ns, end_ns),
        "".join(each.text(facts) for each in exchanges),
    )


def _exchanges(facts: Facts, group: list[tuple[int, NodeKey, Lost]]) -> list[Exchange]:
    """The devices that were exchanged in these silences."""
    found = (
        exchanged_in(facts, facts.context.bus_name(bus), node, lost)
        for _, (bus, node), lost in group
    )
    return [each for each in found if each is not None]


def _finding(
    rule: str,
    severity: Severity,
    facts: Facts,
    losses: list[_Loss],
    node: int | None,
    text: str,
    cause: str,
    check_next: str,
) -> Finding:
    return Finding(
        rule,
        severity,
        facts.context.bus_name(losses[0].bus),
        node,
        losses[0].start_ns,
        losses[-1].end_ns,
        text,
        cause,
        check_next,
        [seq for loss in losses for seq in loss.evidence][:EVIDENCE],
        assumed=[
            *sorted({loss.limit.strip() for loss in losses if "eds-default" in loss.limit}),
            *(facts.assumed_remote() if any("request" in loss.limit for loss in losses) else []),
        ],
    )


def _together(losses: list[_Loss], loss: _Loss) -> tuple[int, ...]:
    """Other nodes that fell silent at about the same moment, and not only briefly after it."""
    at_once = [
        other.nodes[0]
        for other in losses
        if other.bus == loss.bus
        and other.nodes != loss.nodes
        and abs(other.start_ns - loss.start_ns) <= TOGETHER_NS
    ]
    return tuple(sorted(set(at_once)))


def _alone(facts: Facts, losses: list[_Loss], together: tuple[int, ...]) -> tuple[str, str, str]:
    """(text, cause, what to check) where the bus was not silent as a whole."""
    first = losses[0]
    who, lasted = facts.who(facts.context.bus_name(first.bus), first.nodes[0]), _lasted(losses)
    if not first.over:
        until = "the end"
        if any(gap.start_ns == first.end_ns for gap in facts.analysis.capture.gaps):
            until = f"the gap in the capture{facts.at(first.end_ns)}"
        text = f"{who} is silent from {facts.moment(first.start_ns)} on, {lasted} up to {until}."
    else:
        text = f"{who} was lost {_often(facts, losses)}for {lasted}{_came_back(facts, losses)}."
    text += "".join(loss.exchanged for loss in losses)
    if together:
        others = names(together)
        text += f" {others[:1].upper()}{others[1:]} fell silent at the same moment."
    if all(loss.exchanged for loss in losses):
        return text + first.limit, *_BY_EXCHANGE
    if together:
        return (
            text + first.limit,
            (
                "What these nodes have in common and the others have not: a supply, a fuse, a cable or"
                " a connector between them and the rest of the bus."
            ),
            "Check the common supply and the cable behind the last node that was heard.",
        )
    return (
        text + first.limit,
        "The node lost its supply or restarted: it came back with a boot-up."
        if first.booted or _old_boot_ups(facts, losses)
        else "Supply or cable of this node, its CAN interface bus-off, or the node stopped working;"
        f" {_of_the_bus(facts, first)}.",
        "Check plug, cable and supply voltage of the node; look at its error memory (1003h).",
    )


def _of_the_bus(facts: Facts, loss: _Loss) -> str:
    """What the other nodes tell of the bus, where any was heard since then."""
    node, name = loss.nodes[0], facts.context.bus_name(loss.bus)
    nodes = facts.control.nmt.nodes.items()
    heard = [nmt.heard_ns or 0 for key, nmt in nodes if key[0] == loss.bus and key[1] != node]
    if max(heard, default=0) > loss.start_ns:
        return "the other nodes were heard all the time, so the bus itself worked"
    if any(row.bus == name and row.node != node for row in facts.analysis.nodes):
        return "nothing tells for sure whether the bus itself worked"
    return "no other node is known here that would tell whether the bus itself worked"


def _came_back(facts: Facts, losses: list[_Loss]) -> str:
    """How it came back; a boot-up of the old kind is no frame that ends the silence."""
    each = " each time" if len(losses) > 1 else ""
    if losses[0].booted or not (started := _old_boot_ups(facts, losses)):
        return f" and came back {'with' if losses[0].booted else 'without'} a boot-up{each}"
    old = "a boot-up of the old kind (an empty EMCY, as devices made after CiA DS-301 V3 send it)"
    if not each:
        until = facts.moment(losses[0].end_ns)
        return (
            f", up to {until}; meanwhile it started anew, with {old} at {facts.moment(started[0])}"
        )
    among = sum(bool(_old_boot_ups(facts, [loss])) for loss in losses)
    times = "each time" if among == len(losses) else f"in {among} of these times"
    return f"; {times} it started anew meanwhile, with {old}"


def _old_boot_ups(facts: Facts, losses: list[_Loss]) -> list[int]:
    """When empty EMCYs, boot-ups of before CiA 301 V4, came in the silences of a node [ns]."""
    bus, node = facts.context.bus_name(losses[0].bus), losses[0].nodes[0]
    return [
        row.t_ns
        for row in facts.analysis.emcy
        if (row.bus, row.node, row.meaning) == (bus, node, EMPTY)
        and any(loss.start_ns < row.t_ns <= loss.end_ns for loss in losses)
    ]


def _whole_bus(facts: Facts, losses: list[_Loss]) -> tuple[str, str, str]:
    """The same where nobody at all was heard: that accuses no node."""
    first, who = losses[0], names(losses[0].nodes)
    lasted = _lasted(losses)
    if first.booted:
        each = " each time" if len(losses) > 1 else ""
        text = f"The whole bus was silent {_often(facts, losses)}for {lasted};"
        text += f" {who} came back with a boot-up{each}."
        if len(losses) == 1 and first.silent[0] - first.start_ns > AT_ONCE_NS:
            earlier = seconds(first.silent[0] - first.start_ns)
            text += f" They fell silent one after another, the first {earlier} before the last."
        cause = "The machine was switched off and on (all nodes started anew)."
    else:
        text = f"The whole bus was silent {_often(facts, losses)}for {lasted};"
        text += f" {who} {'was' if len(first.nodes) == 1 else 'were'} not heard again."
        cause = "The machine was switched off, the recorder was unplugged, or the bus was broken"
        cause += " near it."
        if others_went_on(facts, first.bus, first.silent[0]):
            text += " Another bus was heard meanwhile, so the recorder went on."
            cause = "This bus lost its supply, or the recorder its connection to it: with everybody"
            cause += " silent at once no single node is to blame."
    text += "".join(loss.exchanged for loss in losses)
    check_next = "Was it switched off on purpose? If not: supply of the whole machine, cable at"
    return text, cause, check_next + " the recorder."


def _often(facts: Facts, losses: list[_Loss]) -> str:
    """How often and when, for more than one."""
    moments = [facts.moment(loss.silent[0]) for loss in losses]
    return several(moments) or f"at {moments[0]} "


def _lasted(losses: list[_Loss]) -> str:
    """How long, or the shortest and the longest."""
    lengths = sorted(loss.silent[1] - loss.silent[0] for loss in losses)
    short, long = seconds(lengths[0]), seconds(lengths[-1])
    return short if short == long else f"{short} to {long}"


def was_bus_off(facts: Facts, key: NodeKey, lost: Lost) -> bool:
    """Whether the node says afterwards that it was bus-off: that finding tells the silence too."""
    return lost in facts.once(bus_off_silences).get(key, ())


def _booted(control: ControlTables, context: Context, key: NodeKey, lost: Lost) -> bool:
    bus = context.bus_name(key[0])
    return any(
        (boot.bus, boot.node) == (bus, key[1]) and 0 <= boot.t_ns - lost.end_ns <= BOOT_UP_NS
        for boot in control.nmt.boot_ups
    )


def _started_too(facts: Facts, bus: int, end_ns: int) -> set[int]:
    """Nodes that start anew soon after a silence of everybody, whoever saw them silent."""
    name = facts.context.bus_name(bus)
    return {
        boot.node
        for boot in facts.control.nmt.boot_ups
        if boot.bus == name and boot.command_seq is None and 0 <= boot.t_ns - end_ns <= APART_NS
    }


def names(nodes: tuple[int, ...]) -> str:
    """One node or several, as a text names them."""
    return f"node {nodes[0]}" if len(nodes) == 1 else "nodes " + ", ".join(map(str, nodes))


RULES = (
    Rule(
        "nmt.node_lost",
        "A node that was heard periodically fell silent while others were heard.",
        "Its last frame before the silence and its first one after it.",
        (
            (
                "Never across a capture gap; a silence of the whole bus, as a step of the clock looks"
                " like one, accuses no node, unless only heartbeats are there besides and all of them"
                " came in time."
            ),
            "Only nodes whose error control is periodic, and any frame of a node is a sign of life.",
            "A heartbeat that was switched off or slowed down by a write of 1017h is no loss.",
            (
                "A guarded node only while the master asks it; where no requests are seen, see"
                " nmt.guarding_ended."
            ),
            (
                "That the device was exchanged is said where 1018h:4 was read before and after its only"
                " silence, and no gap, write, program download or second device explains it; that LSS gave"
                " a device the number in between is said with it."
            ),
            (
                "A heartbeat that only waited on a full bus is no loss of its node: see"
                " nmt.heartbeat_waited."
            ),
            (
                "A heartbeat that is late now and then, without one missing, is no loss: see"
                " nmt.heartbeat_irregular and nmt.consumer_time."
            ),
        ),
        _lost_nodes,
    ),
    Rule(
        "nmt.bus_silent",
        "Nobody on the bus was heard for a while: the machine was off, or the recorder cut off.",
        "The last frames before the silence and the first ones after it.",
        (
            (
                "Only where a node starts anew after it, or nobody is heard again; a bare pause in the"
                " stamps may be a step of the clock."
            ),
            (
                "Nodes that fade just before the recording ends are an info: the machine may have been"
                " switched off."
            ),
        ),
        _silent_buses,
    ),
)
