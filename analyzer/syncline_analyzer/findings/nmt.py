"""Findings on NMT: nodes lost, resets nobody asked for, commands ignored, guarding (analysis.md 4)."""

from collections import Counter
from collections.abc import Iterable, Iterator
from collections.abc import Set as AbstractSet

from syncline_analyzer.context import Context
from syncline_analyzer.findings.bus import tells_bus_off
from syncline_analyzer.findings.guarding import STORY_NS, guarding_stories
from syncline_analyzer.findings.lost import BOOT_UP_NS, EVIDENCE, lost_nodes, was_bus_off
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import LISTED, error_name, moment, seconds
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.folds.nmt import BootUp, NodeKey
from syncline_analyzer.folds.nmt_events import Ignored, Lost, Violation
from syncline_analyzer.folds.nmt_timeline import Timeline
from syncline_analyzer.results import Analysis, EmcyRow, Finding
from syncline_schemas.canopen.nmt import command_name
from syncline_schemas.devices import quirks
from syncline_schemas.wording import counted

COMMAND_WINDOW_NS = 10_000_000_000
"""A reset this long before a boot-up explains it (analysis.md 4)."""
FLIPS = 3
"""Returns to OPERATIONAL without a command that no single node makes."""
Place = tuple[str | None, int | None]
"""Bus and node of a finding."""
DOUBLED = 10
"""Alternating heartbeat intervals from which on two producers are believed."""


def _guarding(facts: Facts) -> list[Finding]:
    return list(guarding_stories(facts.analysis, facts.control, facts.context))


def _told_by_guarding(facts: Facts) -> set[int]:
    """Frames that the stories of lost guarding rest on."""
    return {seq for finding in _guarding(facts) for seq in finding.evidence}


def _twins(facts: Facts) -> set[Place]:
    """Where two devices share one number: what follows from that is no fault of its own."""
    return {(finding.bus, finding.node) for finding in _doubled(facts)}


def _lost(facts: Facts) -> Iterator[Finding]:
    told = _told_by_guarding(facts)
    yield from lost_nodes(facts.analysis, facts.control, facts.context, told)


def _resets(facts: Facts) -> Iterator[Finding]:
    twins = _twins(facts)
    found = _unexpected_resets(
        facts.analysis, facts.control, facts.context, _told_by_guarding(facts)
    )
    yield from (finding for finding in found if (finding.bus, finding.node) not in twins)


def _unexpected_resets(
    analysis: Analysis, control: ControlTables, context: Context, told: AbstractSet[int]
) -> Iterator[Finding]:
    """Boot-ups without a reset command before them; those after a lost stretch belong to it.

    Left out are those that another story tells, by the frame before the silence (`told`) or
    because the node says that it was bus-off.
    """
    for boot in control.nmt.boot_ups:
        key = (context.buses.index(boot.bus) if boot.bus in context.buses else 0, boot.node)
        timeline = control.nmt.timelines[key]
        if boot.command_seq is not None or boot.repeated or _first_sign(timeline, boot):
            continue
        if any(0 <= boot.t_ns - lost.end_ns <= BOOT_UP_NS for lost in timeline.lost):
            continue
        if _recent_command(control, boot) or _reset_by_sdo(analysis, context, key, boot):
            continue
        silence = next((r for r in timeline.restarts if r.end_seq == boot.seq), None)
        if silence is not None and (
            silence.last_seq in told or was_bus_off(analysis, context, key, silence)
        ):
            continue
        yield _unexpected_reset(analysis, control, boot, silence)


def _unexpected_reset(
    analysis: Analysis, control: ControlTables, boot: BootUp, silence: Lost | None
) -> Finding:
    """The restart with the silence before it, a second boot-up frame, and the node's own word."""
    own = [b for b in control.nmt.boot_ups if (b.bus, b.node) == (boot.bus, boot.node)]
    pair = [b for b in own if b.repeated and 0 < b.t_ns - boot.t_ns < BOOT_UP_NS][:1]
    again = any(not b.repeated and 0 < boot.t_ns - b.t_ns < BOOT_UP_NS for b in own)
    watchdog = _watchdog_emcy(analysis, boot)
    text = f"Node {boot.node} restarted at {moment(analysis, boot.t_ns)} although no reset was"
    text += " commanded in the 10 s before"
    if silence is not None:
        text += f", after a silence of {seconds(silence.end_ns - silence.last_ns)}"
    text += f" (two boot-up frames, {seconds(pair[0].t_ns - boot.t_ns)} apart)" if pair else ""
    text += f".{_disguise(boot)}"
    alone = silence is not None and silence.whole_bus
    if alone:
        text += " No other node is on the bus and nobody was heard meanwhile: the capture cannot"
        text += " tell whether the node restarted or the whole machine was switched off and on."
    cause = "Short break of its supply, watchdog, or a crash of its firmware."
    if watchdog:
        cause = f"Its watchdog reset it (EMCY {watchdog.code:04X}h)."
    elif again:
        cause = "Its supply is not steady when it is switched on, or two devices carry this number"
        cause += " and each sent its own boot-up."
    return Finding(
        "nmt.unexpected_reset",
        "warning" if alone else "error",
        boot.bus,
        boot.node,
        silence.last_ns if silence else boot.t_ns,
        boot.t_ns,
        text,
        cause,
        "Measure the node's supply under load; look at its error memory (1003h) and for a"
        " watchdog EMCY after the boot-up.",
        [
            *([silence.last_seq] if silence else []),
            boot.seq,
            *(b.seq for b in pair),
            *([watchdog.seq] if watchdog else []),
        ],
    )


def _disguise(boot: BootUp) -> str:
    """How a boot-up was told that looks like a heartbeat (sheet skbis-lir-canopen.md, trap 1)."""
    if boot.byte == 0:
        return ""
    return (
        f" Its boot-up carries {boot.byte:02X}h like a heartbeat, as this device's does when"
        " 1017h is stored."
    )


def _watchdog_emcy(analysis: Analysis, boot: BootUp) -> EmcyRow | None:
    """What the node itself says of its restart, within two seconds after it."""
    for row in analysis.emcy:
        same = (row.bus, row.node) == (boot.bus, boot.node) and "watchdog" in row.meaning
        raised = row.transition in ("raised", "further")
        if same and raised and 0 <= row.t_ns - boot.t_ns <= 2_000_000_000:
            return row
    return None


def _first_sign(timeline: Timeline, boot: BootUp) -> bool:
    """Whether nothing was heard of the node before: switched on, not restarted."""
    before = [i for i in timeline.intervals if i.start_ns < boot.t_ns]
    return all(interval.state.value == "UNKNOWN" for interval in before)


def _recent_command(control: ControlTables, boot: BootUp) -> bool:
    return any(
        row.bus == boot.bus
        and row.node in (0, boot.node)
        and row.command.startswith("reset")
        and row.seq < boot.seq
        and boot.t_ns - row.t_ns <= COMMAND_WINDOW_NS
        for row in control.nmt.commands
    )


def _reset_by_sdo(analysis: Analysis, context: Context, key: NodeKey, boot: BootUp) -> bool:
    """Some devices restart when an object is written (2002h of the JN2100)."""
    writes = quirks(context.shadow.device(*key)).reset_writes
    return any(
        row.direction == "download"
        and (row.bus, row.node) == (boot.bus, boot.node)
        and (row.index or 0, row.sub or 0) in writes
        and row.seq < boot.seq
        and boot.t_ns - row.start_ns <= COMMAND_WINDOW_NS
        for row in analysis.sdo
    )


def _ignored(facts: Facts) -> Iterator[Finding]:
    """Commands that the node's own messages contradict a period later."""
    control, context, twins = facts.control, facts.context, _twins(facts)
    for (bus, node), timeline in control.nmt.timelines.items():
        for ignored in timeline.ignored:
            if ignored.command.node == 0 and not timeline.followed:
                continue
            if (context.bus_name(bus), node) in twins:
                continue
            name = command_name(ignored.command.specifier)
            pdos = [v for v in timeline.violations if not v.guess and _during(v, ignored)]
            yield Finding(
                "nmt.command_ignored",
                "error",
                context.bus_name(bus),
                node,
                ignored.command.t_ns,
                ignored.t_ns,
                f'Node {node} did not follow the command "{name}":'
                f" {seconds(ignored.t_ns - ignored.command.t_ns)} later it still says {ignored.state}"
                + (f" and goes on sending PDOs ({_identifiers(pdos)})." if pdos else "."),
                "The node did not get the command, refuses it in its present condition, or another"
                " node answers under the same number.",
                "Does it follow when the command is repeated? Look for an EMCY of the node and for"
                " 1F80h, 1029h.",
                [ignored.command.seq, *(v.seq for v in pdos[:10]), ignored.seq],
            )


def _during(violation: Violation, ignored: Ignored) -> bool:
    """Whether PDOs show that the node did not follow a command."""
    return violation.start_ns <= ignored.t_ns and violation.end_ns >= ignored.command.t_ns


def _identifiers(violations: Iterable[Violation]) -> str:
    return ", ".join(sorted({f"{v.can_id:03X}h" for v in violations}))


def _pdo_outside(facts: Facts) -> Iterator[Finding]:
    """PDOs of nodes that are known to be in another state than OPERATIONAL."""
    control, context = facts.control, facts.context
    told = {(finding.bus, finding.node) for finding in _guarding(facts)} | _twins(facts)
    for (bus, node), timeline in control.nmt.timelines.items():
        found = [
            violation
            for violation in timeline.violations
            if not violation.guess
            and not any(_during(violation, ignored) for ignored in timeline.ignored)
        ]
        if not found or (context.bus_name(bus), node) in told:
            continue
        first = found[0]
        known = "by command" if first.certainty == "commanded" else "by its own word"
        yield Finding(
            "nmt.pdo_outside_operational",
            "warning",
            context.bus_name(bus),
            node,
            first.start_ns,
            max(v.end_ns for v in found),
            f"Node {node} sent {counted(sum(v.number for v in found), 'PDO')}"
            f" ({_identifiers(found)}) while it was {first.state} {known}.",
            "A second device under the same number, a device that does not keep to CiA 301, or a"
            " command that it did not follow.",
            "Switch the node off: do the PDOs stop? Compare with its heartbeat.",
            [v.seq for v in found[:20]],
        )


def _fallen(facts: Facts) -> Iterator[Finding]:
    stories, twins = _guarding(facts), _twins(facts)
    found = _fell(facts.analysis, facts.control, facts.context)
    yield from (finding for finding in found if not _within(finding, stories, twins))


def _fell(analysis: Analysis, control: ControlTables, context: Context) -> Iterator[Finding]:
    """Nodes that left OPERATIONAL by themselves, as 1029h:1 lets them do after an error."""
    for (bus, node), timeline in control.nmt.timelines.items():
        name = context.bus_name(bus)
        for seq, t_ns, before, after in timeline.changes:
            if before != "OPERATIONAL":
                continue
            emcy = [
                row
                for row in analysis.emcy
                if (row.bus, row.node) == (name, node)
                and row.transition != "malformed"
                and row.code is not None
                and row.code >> 8
                and 0 <= t_ns - row.t_ns <= STORY_NS
            ]
            last = emcy[-1] if emcy else None
            if last is not None and tells_bus_off(last.code or 0, last.meaning):
                continue
            named = error_name(last.code or 0, last.meaning) if last else ""
            told = f" after it reported {named}" if last else ""
            yield Finding(
                "nmt.left_operational",
                "error",
                name,
                node,
                emcy[-1].t_ns if emcy else t_ns,
                t_ns,
                f"Node {node} went from OPERATIONAL to {after} at {moment(analysis, t_ns)} without a"
                f" command{told}.",
                "Its own reaction to an error (1029h:1)."
                if emcy
                else "Its own reaction to an error that it did not report, or a command that was"
                " not recorded.",
                "Read 1001h, 1003h and 1029h:1 of the node; it stays so until it is commanded.",
                [*([emcy[-1].seq] if emcy else []), seq],
            )


def _doubled(facts: Facts) -> Iterator[Finding]:
    """Two devices under one number: two interleaved cadences, or two states told in turn."""
    control, context = facts.control, facts.context
    for (bus, node), nmt in control.nmt.nodes.items():
        if nmt.twins.periods_ns is not None:
            start, end = nmt.twins.span
            fast, slow = nmt.twins.periods_ns
            how = f"one every {seconds(fast)}, the other every {seconds(slow)}"
            evidence = nmt.twins.at
        elif nmt.doubles.count >= DOUBLED:
            start, end = nmt.doubles.span
            how = f"short and long intervals alternate {nmt.doubles.count} times"
            evidence = nmt.doubles.at
        elif flips := _flips(control.nmt.timelines[bus, node]):
            start, end = flips[0][1], flips[-1][1]
            states = " and ".join(sorted({flip[3] for flip in flips}))
            how = f"{states} are told in turn, {len(flips)} times without any command"
            evidence = [flip[0] for flip in flips[:20]]
        else:
            continue
        yield Finding(
            "nmt.duplicate_node_id",
            "error",
            context.bus_name(bus),
            node,
            start,
            end,
            f"Two devices send heartbeats as node {node}: {how}.",
            f"Two devices carry the number {node} (or the recorder took every frame twice).",
            "Unplug the device that should be there: if the heartbeat goes on, find the other one.",
            evidence,
        )


def _flips(timeline: Timeline) -> list[tuple[int, int, str, str]]:
    """Changes to and fro that no single node makes: back in OPERATIONAL without a command."""
    back = [change for change in timeline.changes if change[3] == "OPERATIONAL"]
    gone = [change for change in timeline.changes if change[2] == "OPERATIONAL"]
    return timeline.changes if min(len(back), len(gone)) >= FLIPS else []


def _both(facts: Facts) -> Iterator[Finding]:
    """Remote frames to a node that sends heartbeats: some devices then send an empty byte."""
    control, context = facts.control, facts.context
    for (bus, node), nmt in control.nmt.nodes.items():
        if nmt.both_at is None:
            continue
        seq, t_ns = nmt.both_at
        empty = nmt.counts.empty
        effect = f" Since then {counted(empty, 'heartbeat')} carried no state." if empty else ""
        yield Finding(
            "config.rtr_on_heartbeat_node",
            "warning",
            context.bus_name(bus),
            node,
            t_ns,
            t_ns,
            f"Node {node} sends heartbeats and is asked by remote frames as well.{effect}",
            "The master guards a node whose heartbeat (1017h) is on; only one of both is allowed"
            " (CiA 301 7.2.8.3.2.2).",
            "Switch node guarding off in the master for this node, or 1017h to 0; after that reset"
            " the node.",
            [seq],
        )


def _toggles(facts: Facts) -> Iterator[Finding]:
    control, context = facts.control, facts.context
    for (bus, node), nmt in control.nmt.nodes.items():
        if nmt.counts.toggle_errors < 2:
            continue
        yield Finding(
            "nmt.guard_toggle",
            "warning",
            context.bus_name(bus),
            node,
            control.nmt.first_ns,
            control.nmt.end_ns,
            f"The toggle bit of node {node}'s guard answers did not alternate"
            f" {nmt.counts.toggle_errors} times.",
            "The node does not keep to CiA 301, two devices answer, or frames were not recorded.",
            "Compare with another recorder; look for a second device under this number.",
            nmt.toggle_seqs[:20],
        )


def _malformed(facts: Facts) -> Iterator[Finding]:
    """Frames on 000h that no node can follow, on buses that show CANopen otherwise."""
    control, context = facts.control, facts.context
    for bus in sorted({odd.bus for odd in control.nmt.odd} & control.nmt.canopen):
        found = [odd for odd in control.nmt.odd if odd.bus == bus]
        more = "More than " if control.nmt.malformed > len(control.nmt.odd) else ""
        kinds = Counter(odd.what for odd in found)
        what = "; ".join(f"{k} ({n} times)" if n > 1 else k for k, n in kinds.most_common(LISTED))
        yield Finding(
            "nmt.malformed_command",
            "warning",
            context.bus_name(bus),
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


def _slow(facts: Facts) -> Iterator[Finding]:
    control, context = facts.control, facts.context
    twins = _twins(facts)
    for (bus, node), nmt in control.nmt.nodes.items():
        if nmt.late is None or (context.bus_name(bus), node) in twins:
            continue
        timeline = control.nmt.timelines[bus, node]
        yield Finding(
            "nmt.heartbeat_slow",
            "warning",
            context.bus_name(bus),
            node,
            timeline.intervals[0].start_ns,
            timeline.intervals[-1].end_ns,
            f"Node {node} sends its heartbeat every {nmt.late.median_ms:.0f} ms although 1017h is"
            f" {nmt.late.producer_ms} ms ({nmt.late.source}).",
            "1017h was changed without effect, or the node is overloaded.",
            "Read 1017h back; compare after a reset.",
            [timeline.history.beats[0].seq] if timeline.history.beats else [],
        )


def _within(finding: Finding, stories: list[Finding], twins: set[Place]) -> bool:
    """Whether a story of the same node tells a finding already, or it is none of one node."""
    return (finding.bus, finding.node) in twins or any(
        (finding.bus, finding.node) == (story.bus, story.node)
        and story.start_ns <= finding.end_ns <= story.end_ns
        for story in stories
    )


_SILENCE_GUARDS = (
    "Never across a capture gap, a step of the clock, or the end of the capture.",
    "Only nodes whose error control is periodic.",
    "A silence of the whole bus accuses no node.",
)
RULES = (
    Rule(
        "nmt.guarding_lost",
        "A node missed its master: life guarding or heartbeat consumption failed (EMCY 8130h).",
        "The master's last frame, the EMCY, and the state the node went to.",
        ("Only where the node itself says so.",),
        _guarding,
    ),
    Rule(
        "nmt.node_lost",
        "A node that was heard periodically fell silent.",
        "Its last frame before the silence and its first one after it.",
        _SILENCE_GUARDS,
        _lost,
    ),
    Rule(
        "nmt.duplicate_node_id",
        "Two devices carry one node id.",
        "Heartbeats of two cadences or states that are told in turn.",
        ("Jitter of one producer, a reset or a changed 1017h is none.",),
        _doubled,
    ),
    Rule(
        "nmt.unexpected_reset",
        "A node restarted although nobody commanded it.",
        "The boot-up, and the last frame before it.",
        (
            "No reset command, and no write that resets the device, in the 10 s before.",
            "The first boot-up of a node that was not heard before is its switching on.",
        ),
        _resets,
    ),
    Rule(
        "nmt.command_ignored",
        "A node did not follow an NMT command.",
        "The command and the message that contradicts it.",
        ("Judged only one error-control period after the command.",),
        _ignored,
    ),
    Rule(
        "nmt.pdo_outside_operational",
        "A node sent PDOs in a state in which it must not.",
        "These PDOs.",
        ("Frames in flight within 10 ms of the change are none.", "Guessed PDOs are not used."),
        _pdo_outside,
    ),
    Rule(
        "nmt.left_operational",
        "A node left OPERATIONAL without a command.",
        "The message that tells the new state, and the EMCY before it.",
        ("Not where a command, or a gap in which one may lie, stands before it.",),
        _fallen,
    ),
    Rule(
        "config.rtr_on_heartbeat_node",
        "A node that sends heartbeats is guarded by remote frames as well.",
        "The first guard request.",
        ("Only nodes whose heartbeat is on.",),
        _both,
        untimed=True,
    ),
    Rule(
        "nmt.guard_toggle",
        "The toggle bit of a node's guard answers does not alternate.",
        "The answers that repeat it.",
        ("A single repetition is none; nor is the first answer after a reset or a gap.",),
        _toggles,
        untimed=True,
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
        "nmt.heartbeat_slow",
        "A node sends its heartbeat slower than 1017h says.",
        "A heartbeat of the node.",
        ("Only where 1017h is known by confirmed values or the description.",),
        _slow,
    ),
)
