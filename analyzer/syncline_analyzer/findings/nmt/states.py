"""NMT states: what a node did without being told, or was never told to do."""

from collections.abc import Iterator
from dataclasses import replace

from syncline_analyzer.findings.bus.bus_off import tells_bus_off
from syncline_analyzer.findings.nmt.guarding_story import STORY_NS, guarding_stories
from syncline_analyzer.findings.nmt.twins import twins
from syncline_analyzer.findings.reaction import told_until_ns
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import error_name, several
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.folds.nmt.timeline import Timeline
from syncline_analyzer.results import EmcyRow, Finding
from syncline_schemas.canopen.nmt import STATE_AFTER_COMMAND, NmtState

EVIDENCE = 40
GROUPED = 5
"""More equal findings of one node than these are one finding."""
WAITED_NS = 30_000_000_000
"""A node that nobody started in so long is not going to be started [ns]."""


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
            if before != "OPERATIONAL" or (emcy and _by_bus_off(timeline, emcy, t_ns)):
                continue
            finding = _fall(facts, (number, node), seq, t_ns, after, emcy)
            if not _within(finding, stories):
                by_state.setdefault(after, []).append(finding)
        for found in by_state.values():
            yield from merged(facts, found)


def _by_bus_off(timeline: Timeline, emcy: EmcyRow, t_ns: int) -> bool:
    """Whether a fall is the reaction to a bus-off, which tells it already."""
    bus_off = tells_bus_off(emcy.code or 0, emcy.meaning)
    return bus_off and t_ns <= told_until_ns(timeline, emcy.t_ns)


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


def merged(facts: Facts, found: list[Finding]) -> list[Finding]:
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


RULES = (
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
)
