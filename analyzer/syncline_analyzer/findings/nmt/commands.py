"""NMT commands: those that a node did not follow, that none can follow, or that nobody hears."""

from collections import Counter
from collections.abc import Iterator

from syncline_analyzer.findings.nmt.outside import during, identifiers
from syncline_analyzer.findings.nmt.states import EVIDENCE, merged
from syncline_analyzer.findings.nmt.twins import twins
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import LISTED, seconds
from syncline_analyzer.folds.nmt.commands import MAX_NODE
from syncline_analyzer.folds.nmt.events import IN_FLIGHT_NS, Command, Ignored
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.results import Finding
from syncline_schemas.canopen.nmt import (
    COMMANDS,
    RESETS,
    STATE_AFTER_COMMAND,
    NmtState,
    command_name,
)
from syncline_schemas.wording import counted

FAIR_NS = 1_000_000_000
"""A node may take so long to follow a command, to start above all [ns]."""
WAITED_NS = 10_000_000_000
"""A node that was started too soon is told of when nobody starts it again for so long [ns]."""
SEARCHED = 10
"""Commands to more absent nodes than these are a search of the whole bus."""


def _ignored(facts: Facts) -> Iterator[Finding]:
    """Commands that the node's own messages contradict a period later, equal ones together."""
    doubled = twins(facts)
    for key, timeline in facts.control.nmt.timelines.items():
        bus = facts.context.bus_name(key[0])
        by_command: dict[int, list[Finding]] = {}
        for ignored in timeline.ignored:
            if doubled.at(bus, key[1], ignored.t_ns):
                continue
            if not _waits(timeline) if ignored.starting else _in_time(timeline, ignored):
                continue
            if ignored.command.node or timeline.followed or _is_slave(facts, key, ignored):
                found = by_command.setdefault(ignored.command.specifier, [])
                found.append(_one_ignored(facts, key, timeline, ignored))
        for found in by_command.values():
            yield from merged(facts, found)


def _one_ignored(facts: Facts, key: NodeKey, timeline: Timeline, ignored: Ignored) -> Finding:
    bus, node = facts.context.bus_name(key[0]), key[1]
    name = command_name(ignored.command.specifier)
    pdos = [v for v in timeline.violations if not v.guess and during(v, ignored)]
    after = _afterwards(facts, timeline, ignored)
    passed = seconds(ignored.t_ns - ignored.command.t_ns)
    still = f"{passed} later it still says {ignored.state}"
    still += f" and goes on sending PDOs ({identifiers(pdos)})." if pdos else "."
    if ignored.can_id is not None:
        still = f"{passed} later it still sends PDOs ({ignored.can_id:03X}h), which only an"
        still += " OPERATIONAL node does; it told no state meanwhile."
    elif ignored.command.specifier in RESETS:
        still += " No boot-up came."
    cause = "The node did not get the command, refuses it in its present condition, or another node"
    cause += " answers under the same number."
    if ignored.starting:
        still = f"it had been reset and booted only {passed} later; since then it says"
        still += f" {ignored.state}, and nobody started it again."
        cause = (
            "The node was still starting, and follows no command before its boot-up: the fault is"
        )
        cause += " in the master's sequence, not in the node."
    return Finding(
        "nmt.command_ignored",
        "warning" if "It followed" in after else "error",
        bus,
        node,
        ignored.command.t_ns,
        ignored.t_ns,
        f'{facts.who(bus, node)} did not follow the command "{name}"{facts.at(ignored.command.t_ns)}:'
        f" {still}{after}",
        cause,
        "Let the master wait for the boot-up before it starts the node."
        if ignored.starting
        else ("" if after else "Does it follow when the command is repeated? ")
        + "Look for an EMCY of the node and for 1F80h, 1029h.",
        [ignored.command.seq, *(v.seq for v in pdos[:10]), ignored.seq],
    )


def _waits(timeline: Timeline) -> bool:
    """Whether a node that was started too soon is still PRE-OPERATIONAL, long after its boot-up."""
    last = timeline.intervals[-1]
    waited = last.end_ns - last.start_ns >= WAITED_NS
    return last.state is NmtState.PRE_OPERATIONAL and last.certainty == "observed" and waited


def _obeyed(timeline: Timeline, ignored: Ignored) -> int | None:
    """When the node came into the state that it was commanded to, None if it never did [ns].

    Of a reset its boot-up tells.
    """
    if ignored.command.specifier in RESETS:
        boots = (b for b in timeline.boot_ups if b.seq > ignored.seq and b.command_seq is not None)
        return next((boot.t_ns for boot in boots), None)
    wanted = STATE_AFTER_COMMAND.get(ignored.command.specifier)
    return next(
        (
            interval.start_ns
            for interval in timeline.intervals
            if interval.start_ns >= ignored.t_ns
            and interval.state is wanted
            and interval.certainty in ("observed", "implied")
        ),
        None,
    )


def _later_commands(timeline: Timeline, ignored: Ignored, until_ns: int) -> list[Command]:
    """Commands to the node after the one that it did not follow."""
    return [
        command
        for command in timeline.history.commands
        if command.seq > ignored.command.seq and command.t_ns <= until_ns
    ]


def _in_time(timeline: Timeline, ignored: Ignored) -> bool:
    """Whether the node followed soon after all, or nothing shows that it did not.

    It may take its time, and what it does then is told up to a period later.
    """
    command = ignored.command
    until = command.t_ns + FAIR_NS + (timeline.history.period_ns or 0)
    obeyed = _obeyed(timeline, ignored)
    if obeyed is not None and obeyed <= until:
        return not _later_commands(timeline, ignored, obeyed)
    return timeline.history.end_ns - command.t_ns < FAIR_NS


def _afterwards(facts: Facts, timeline: Timeline, ignored: Ignored) -> str:
    """What became of a command that was not followed, as far as the log tells it."""
    obeyed = _obeyed(timeline, ignored)
    later = _later_commands(timeline, ignored, timeline.history.end_ns)
    again = [c for c in later if c.specifier == ignored.command.specifier]
    if obeyed is None:
        if ignored.command.specifier in RESETS:
            known = {each.command.seq for each in timeline.ignored}
            again = [command for command in again if command.seq in known]
        times = counted(len(again), "more time")
        return f" It was commanded {times} and did not follow then either." if again else ""
    before = [c for c in later if c.t_ns <= obeyed + IN_FLIGHT_NS]
    if not before:
        passed = seconds(obeyed - ignored.command.t_ns)
        return f" It followed {passed} after the command, with no other one between."
    if before[-1].specifier == ignored.command.specifier:
        return f" It followed when the command was repeated{facts.at(before[-1].t_ns)}."
    return ""


def _is_slave(facts: Facts, key: NodeKey, ignored: Ignored) -> bool:
    """Whether a node is none that commands the others: it serves SDO, and another one follows.

    The NMT master does not follow its own commands to all.
    """
    bus = facts.context.bus_name(key[0])
    timelines = facts.control.nmt.timelines
    booted = any(boot.seq < ignored.command.seq for boot in timelines[key].boot_ups)
    own = facts.analysis.sdo.of_node(bus, key[1])
    serves = bool(own.ok or own.aborted)
    wanted = STATE_AFTER_COMMAND.get(ignored.command.specifier)
    others = any(
        interval.evidence == ignored.command.seq and interval.certainty == "observed"
        for other, timeline in timelines.items()
        if other[0] == key[0] and other != key
        for interval in timeline.intervals
        if interval.state is wanted
    )
    return booted and serves and others


def _malformed(facts: Facts) -> Iterator[Finding]:
    """Frames on 000h that no node can follow, on buses that show CANopen otherwise."""
    nmt = facts.control.nmt
    for bus in sorted({odd.bus for odd in nmt.odd} & nmt.canopen):
        found = [odd for odd in nmt.odd if odd.bus == bus]
        more = "More than " if nmt.malformed > len(nmt.odd) else ""
        kinds = Counter(odd.what for odd in found)
        what = "; ".join(f"{k} ({n} times)" if n > 1 else k for k, n in kinds.most_common(LISTED))
        yield Finding(
            "nmt.malformed_command",
            "warning",
            facts.context.bus_name(bus),
            None,
            found[0].t_ns,
            found[-1].t_ns,
            f"{more}{counted(len(found), 'frame')} on 000h"
            f" {'is not an NMT command' if len(found) == 1 else 'are no NMT commands'}: {what}.",
            "An error in the program of a master, or a device that sends on the identifier of the"
            " NMT master.",
            "Find the sender; 000h has the highest priority on the bus and commands every node.",
            [odd.seq for odd in found[:EVIDENCE]],
        )


def _absent(facts: Facts) -> Iterator[Finding]:
    """Commands to single nodes that nobody ever heard: optional ones, or dead ones."""
    there = {(row.bus, row.node) for row in facts.analysis.nodes}
    for bus in sorted({row.bus for row in facts.control.nmt.commands}):
        if facts.number(bus) not in facts.control.nmt.canopen:
            continue
        rows = [
            row
            for row in facts.control.nmt.commands
            if row.bus == bus
            and 0 < row.node <= MAX_NODE
            and (bus, row.node) not in there
            and row.command in COMMANDS.values()
        ]
        nodes = sorted({row.node for row in rows})
        if not nodes or len(nodes) > SEARCHED:
            continue
        named = f"node {nodes[0]}" if len(nodes) == 1 else "nodes " + ", ".join(map(str, nodes))
        yield Finding(
            "nmt.command_to_absent_node",
            "info",
            bus,
            nodes[0] if len(nodes) == 1 else None,
            rows[0].t_ns,
            rows[-1].t_ns,
            f"{counted(len(rows), 'NMT command')} {'was' if len(rows) == 1 else 'were'} sent to"
            f" {named}, of which nothing was heard in this capture.",
            "Optional nodes that this machine does not have; or a node that is dead or has another"
            " number.",
            "Should it be there? Then check its supply, its node id and its bit rate.",
            [row.seq for row in rows][:EVIDENCE],
        )


RULES = (
    Rule(
        "nmt.command_ignored",
        "A node did not follow an NMT command.",
        "The command and the message that contradicts it.",
        (
            "Judged only one error-control period after the command, gaps and clock steps left out.",
            "A node that follows within a second, and the period that tells it, only took its time.",
            "PDOs contradict a command only where they go on for two periods and are surely its own.",
            "The NMT master does not follow its own commands to all.",
            (
                "A reset of one node counts where its heartbeats still say OPERATIONAL or STOPPED and"
                " keep step with those before it, one of them sooner than a node that starts anew sends"
                " any, or after PDOs that went on, and no boot-up, empty EMCY, EMCY without an error,"
                " silence, gap or other command comes within 10 s."
            ),
            (
                "It counts too where a node that booted before says OPERATIONAL or STOPPED after longer"
                " than a start may take, and no boot-up came."
            ),
            "A start before the boot-up that a reset asked for counts where none follows for 10 s.",
        ),
        _ignored,
    ),
    Rule(
        "nmt.malformed_command",
        "Frames on 000h that no node can follow.",
        "These frames.",
        ("Only on buses that show CANopen otherwise.",),
        _malformed,
        untimed=True,
    ),
    Rule(
        "nmt.command_to_absent_node",
        "NMT commands were sent to nodes of which nothing was heard.",
        "These commands.",
        (
            "Information only: a master may look for optional nodes.",
            "Commands to more than ten absent nodes are a search of the whole bus.",
        ),
        _absent,
        untimed=True,
    ),
)
