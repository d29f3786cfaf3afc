"""NMT commands and states: what a node did not follow, or did without being told."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from syncline_analyzer.findings.bus.bus_off import tells_bus_off
from syncline_analyzer.findings.nmt.guarding_story import STORY_NS, guarding_stories
from syncline_analyzer.findings.nmt.twins import twins
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import LISTED, error_name, seconds, several
from syncline_analyzer.folds.nmt.events import IN_FLIGHT_NS, Command, Ignored, Violation
from syncline_analyzer.folds.nmt.fold import MAX_NODE, NodeKey
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.results import EmcyRow, Finding
from syncline_schemas.canopen.nmt import COMMANDS, STATE_AFTER_COMMAND, NmtState, command_name
from syncline_schemas.wording import counted

EVIDENCE = 40
STORY_PDOS_NS = 1_000_000_000
"""PDOs this soon after a node fell out of OPERATIONAL belong to the story of its fall [ns]."""
FAIR_NS = 1_000_000_000
"""A node may take so long to follow a command, to start above all [ns]."""
FIRST_TPDO = 0x180
LONG_OUTSIDE_NS, MANY_OUTSIDE = 5_000_000_000, 20
"""So long, and so often, PDOs go on whose identifier alone says whose they are."""
GROUPED = 5
"""More equal findings of one node than these are one finding."""
SEARCHED = 10
"""Commands to more absent nodes than these are a search of the whole bus."""
WAITED_NS = 30_000_000_000
"""A node that nobody started in so long is not going to be started [ns]."""


def _ignored(facts: Facts) -> Iterator[Finding]:
    """Commands that the node's own messages contradict a period later, equal ones together."""
    doubled = twins(facts)
    for key, timeline in facts.control.nmt.timelines.items():
        bus = facts.context.bus_name(key[0])
        by_command: dict[int, list[Finding]] = {}
        for ignored in timeline.ignored:
            if doubled.at(bus, key[1], ignored.t_ns):
                continue
            if _in_time(timeline, ignored):
                continue
            if ignored.command.node or timeline.followed or _is_slave(facts, key, ignored):
                found = by_command.setdefault(ignored.command.specifier, [])
                found.append(_one_ignored(facts, key, timeline, ignored))
        for found in by_command.values():
            yield from _merged(facts, found)


def _one_ignored(facts: Facts, key: NodeKey, timeline: Timeline, ignored: Ignored) -> Finding:
    bus, node = facts.context.bus_name(key[0]), key[1]
    name = command_name(ignored.command.specifier)
    pdos = [v for v in timeline.violations if not v.guess and _during(v, ignored)]
    after = _afterwards(facts, timeline, ignored)
    return Finding(
        "nmt.command_ignored",
        "warning" if "It followed" in after else "error",
        bus,
        node,
        ignored.command.t_ns,
        ignored.t_ns,
        f'{facts.who(bus, node)} did not follow the command "{name}"{facts.at(ignored.command.t_ns)}:'
        f" {seconds(ignored.t_ns - ignored.command.t_ns)} later it still says {ignored.state}"
        + (f" and goes on sending PDOs ({_identifiers(pdos)})." if pdos else ".")
        + after,
        "The node did not get the command, refuses it in its present condition, or another node"
        " answers under the same number.",
        ("" if after else "Does it follow when the command is repeated? ")
        + "Look for an EMCY of the node and for 1F80h, 1029h.",
        [ignored.command.seq, *(v.seq for v in pdos[:10]), ignored.seq],
    )


def _obeyed(timeline: Timeline, ignored: Ignored) -> int | None:
    """When the node came into the state that it was commanded to, None if it never did [ns]."""
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
    serves = any(
        (row.bus, row.node) == (bus, key[1]) and row.result in ("ok", "abort")
        for row in facts.analysis.sdo
    )
    wanted = STATE_AFTER_COMMAND.get(ignored.command.specifier)
    others = any(
        interval.evidence == ignored.command.seq and interval.certainty == "observed"
        for other, timeline in timelines.items()
        if other[0] == key[0] and other != key
        for interval in timeline.intervals
        if interval.state is wanted
    )
    return booted and serves and others


def _merged(facts: Facts, found: list[Finding]) -> list[Finding]:
    """Equal findings of one node in order of time; many of them become one."""
    if len(found) <= GROUPED:
        return found
    first, last = found[0], found[-1]
    more = f" The same happened {len(found) - 1} times more, the last time at"
    return [
        replace(
            first,
            end_ns=max(first.end_ns, last.end_ns),
            text=f"{first.text}{more} {facts.moment(last.end_ns)}.",
            evidence=[seq for finding in found for seq in finding.evidence][:EVIDENCE],
        )
    ]


def _during(violation: Violation, ignored: Ignored) -> bool:
    """Whether PDOs show that the node did not follow a command."""
    return violation.start_ns <= ignored.t_ns and violation.end_ns >= ignored.command.t_ns


def _identifiers(violations: Iterable[Violation]) -> str:
    return ", ".join(sorted({f"{v.can_id:03X}h" for v in violations}))


def _pdo_outside(facts: Facts) -> Iterator[Finding]:
    """PDOs of nodes that are known to be in another state than OPERATIONAL."""
    stories, doubled = guarding_stories(facts), twins(facts)
    for (number, node), timeline in facts.control.nmt.timelines.items():
        bus = facts.context.bus_name(number)
        owned = _owned(timeline, node)
        found = [
            violation
            for violation in timeline.violations
            if owned(violation)
            and not any(_during(violation, ignored) for ignored in timeline.ignored)
            and not doubled.at(bus, node, violation.end_ns)
            and not _after_story(stories, bus, node, violation)
        ]
        if not found:
            continue
        first = found[0]
        known = "by command" if first.certainty == "commanded" else "by its own word"
        yield Finding(
            "nmt.pdo_outside_operational",
            "warning",
            bus,
            node,
            first.start_ns,
            max(v.end_ns for v in found),
            f"{facts.who(bus, node)} sent {counted(sum(v.number for v in found), 'PDO')}"
            f" ({_identifiers(found)}) while it was {first.state} {known}.",
            "A second device under the same number, a device that does not keep to CiA 301, or a"
            " command that it did not follow.",
            "Switch the node off: do the PDOs stop? Compare with its heartbeat.",
            [v.seq for v in found[:20]],
            assumed=sorted(
                {f"{v.can_id:03X}h is its TPDO1, as predefined" for v in found if v.guess}
            ),
        )


def _owned(timeline: Timeline, node: int) -> Callable[[Violation], bool]:
    """Tells PDOs that are known to be a node's, or likely are, from those that may be another's."""
    likely = _sends_first_tpdo(timeline, node)
    return lambda v: not v.guess or (likely and v.can_id == FIRST_TPDO + node)


def _sends_first_tpdo(timeline: Timeline, node: int) -> bool:
    """Whether PDOs on its predefined identifier are a node's: they began while it was OPERATIONAL.

    They go on for long against its own word; those of another device would have been there before
    the node was started.
    """
    can_id = FIRST_TPDO + node
    same = [v for v in timeline.violations if v.can_id == can_id and v.guess]
    if not same:
        return False
    began = min(s.first_ns for s in timeline.history.spans if s.can_id == can_id and s.count)
    state = next((i for i in timeline.intervals if i.start_ns <= began < i.end_ns), None)
    return (
        state is not None
        and state.state is NmtState.OPERATIONAL
        and state.certainty == "observed"
        and any(v.certainty == "observed" for v in same)
        and sum(v.end_ns - v.start_ns for v in same) >= LONG_OUTSIDE_NS
        and sum(v.number for v in same) >= MANY_OUTSIDE
    )


def _after_story(stories: list[Finding], bus: str, node: int, violation: Violation) -> bool:
    """Whether PDOs still came in a story of lost guarding of their node."""
    return any(
        (story.bus, story.node) == (bus, node)
        and story.start_ns <= violation.start_ns <= story.end_ns + STORY_PDOS_NS
        for story in stories
    )


def _left_operational(facts: Facts) -> Iterator[Finding]:
    """Nodes that left OPERATIONAL by themselves, as 1029h:1 lets them do after an error."""
    stories, doubled = guarding_stories(facts), twins(facts)
    for (number, node), timeline in facts.control.nmt.timelines.items():
        bus = facts.context.bus_name(number)
        by_state: dict[str, list[Finding]] = {}
        for seq, t_ns, before, after in timeline.changes:
            if doubled.at(bus, node, t_ns):
                continue
            emcy = _error_before(facts, bus, node, t_ns) if before == "OPERATIONAL" else None
            if before != "OPERATIONAL" or (emcy and tells_bus_off(emcy.code or 0, emcy.meaning)):
                continue
            finding = _fall(facts, (number, node), seq, t_ns, after, emcy)
            if not _within(finding, stories):
                by_state.setdefault(after, []).append(finding)
        for found in by_state.values():
            yield from _merged(facts, found)


def _fall(
    facts: Facts, key: NodeKey, seq: int, t_ns: int, after: str, emcy: EmcyRow | None
) -> Finding:
    bus, node = facts.context.bus_name(key[0]), key[1]
    told = f" after it reported {error_name(emcy.code or 0, emcy.meaning)}" if emcy else ""
    return Finding(
        "nmt.left_operational",
        "error",
        bus,
        node,
        emcy.t_ns if emcy else t_ns,
        t_ns,
        f"{facts.who(bus, node)} went from OPERATIONAL to {after} at {facts.moment(t_ns)} without a"
        f" command{told}.",
        "Its own reaction to an error (1029h:1)."
        if emcy
        else "Its own reaction to an error that it did not report, or a command that was not"
        " recorded.",
        "Read 1001h, 1003h and 1029h:1 of the node; it stays so until it is commanded.",
        [*([emcy.seq] if emcy else []), seq],
    )


def _error_before(facts: Facts, bus: str, node: int, t_ns: int) -> EmcyRow | None:
    """The last error that the node reported in the 10 s before."""
    rows = [
        row
        for row in facts.analysis.emcy
        if (row.bus, row.node) == (bus, node)
        and row.transition != "malformed"
        and row.code is not None
        and row.code >> 8
        and 0 <= t_ns - row.t_ns <= STORY_NS
    ]
    return rows[-1] if rows else None


def _within(finding: Finding, stories: list[Finding]) -> bool:
    """Whether a story of the same node tells a finding already."""
    return any(
        (finding.bus, finding.node) == (story.bus, story.node)
        and story.start_ns <= finding.end_ns <= story.end_ns
        for story in stories
    )


def _state_changes(facts: Facts) -> Iterator[Finding]:
    """Other changes without a command: into STOPPED, and out of it."""
    doubled = twins(facts)
    for (number, node), timeline in facts.control.nmt.timelines.items():
        bus = facts.context.bus_name(number)
        found = [
            change
            for change in timeline.changes
            if change[2] != "OPERATIONAL"
            and "STOPPED" in change[2:]
            and not doubled.at(bus, node, change[1])
        ]
        if not found:
            continue
        _, _, before, after = found[0]
        often = several([facts.moment(t_ns) for _, t_ns, _, _ in found])
        when = often or f"at {facts.moment(found[0][1])} "
        yield Finding(
            "nmt.state_changed",
            "warning",
            bus,
            node,
            found[0][1],
            found[-1][1],
            f"{facts.who(bus, node)} went from {before} to {after} {when}without a command.",
            "Its own reaction to an error (1029h:1 = 2 stops it), or a command that was not"
            " recorded.",
            "Read 1001h, 1003h and 1029h:1; is there a second master, or a gateway that commands?",
            [change[0] for change in found][:EVIDENCE],
        )


def _never_operational(facts: Facts) -> Iterator[Finding]:
    """Nodes that nobody starts while others are at work."""
    working = {
        number
        for (number, _), timeline in facts.control.nmt.timelines.items()
        if any(i.state is NmtState.OPERATIONAL for i in timeline.intervals)
    }
    for (number, node), timeline in facts.control.nmt.timelines.items():
        if number not in working or not _waits(timeline):
            continue
        bus = facts.context.bus_name(number)
        told = [i for i in timeline.intervals if i.state is NmtState.PRE_OPERATIONAL]
        yield Finding(
            "nmt.never_operational",
            "info",
            bus,
            node,
            told[0].start_ns,
            told[-1].end_ns,
            f"{facts.who(bus, node)} was PRE-OPERATIONAL for the whole capture: nobody started it"
            " while other nodes worked.",
            "The master does not know this node, waits for something of it (identity, boot-up), or"
            " leaves it so on purpose.",
            "Is it in the master's node list with the right vendor, product and revision?",
            [i.evidence for i in told if i.evidence is not None][:EVIDENCE],
        )


def _waits(timeline: Timeline) -> bool:
    """Whether a node only ever was PRE-OPERATIONAL, long enough, and no start was meant for it."""
    states = {i.state for i in timeline.intervals}
    quiet = {NmtState.PRE_OPERATIONAL, NmtState.UNKNOWN, NmtState.INITIALISING}
    told = [
        i
        for i in timeline.intervals
        if i.state is NmtState.PRE_OPERATIONAL and i.certainty == "observed"
    ]
    started = any(
        STATE_AFTER_COMMAND.get(c.specifier) is NmtState.OPERATIONAL
        for c in timeline.history.commands
    )
    long = sum(i.end_ns - i.start_ns for i in told) >= WAITED_NS
    return bool(told) and states <= quiet and long and not started


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
            "The NMT master does not follow its own commands to all.",
        ),
        _ignored,
    ),
    Rule(
        "nmt.pdo_outside_operational",
        "A node sent PDOs in a state in which it must not.",
        "These PDOs.",
        (
            "Frames in flight within 10 ms of the change are none, nor PDOs asked by remote frames.",
            (
                "Only PDOs of which the bus or the description says whose they are; those on its"
                " predefined identifier where they began after it was started and go on for 5 s"
                " against its own word, which is said."
            ),
        ),
        _pdo_outside,
    ),
    Rule(
        "nmt.left_operational",
        "A node left OPERATIONAL without a command.",
        "The message that tells the new state, and the EMCY before it.",
        ("Not where a command, or a gap in which one may lie, stands before it.",),
        _left_operational,
    ),
    Rule(
        "nmt.state_changed",
        "A node went to STOPPED, or came out of it, without a command.",
        "The message that tells the new state.",
        ("Not where a command, or a gap in which one may lie, stands before it.",),
        _state_changes,
    ),
    Rule(
        "nmt.never_operational",
        "A node stayed PRE-OPERATIONAL although others were started.",
        "The message that told its state.",
        ("At least 30 s of it, no start command to it or to all, and no sign of OPERATIONAL.",),
        _never_operational,
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
