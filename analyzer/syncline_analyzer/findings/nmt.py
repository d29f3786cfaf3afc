"""Findings on NMT: nodes lost, resets nobody asked for, commands ignored, guarding (analysis.md 4)."""

from collections.abc import Iterator
from itertools import groupby

from syncline_analyzer.context import Context
from syncline_analyzer.findings.stretch import Stretch, seconds
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.folds.nmt import BootUp, NodeKey
from syncline_analyzer.folds.nmt_timeline import Lost, Timeline
from syncline_analyzer.results import Analysis, EmcyRow, Finding
from syncline_schemas.canopen.nmt import command_name
from syncline_schemas.devices import quirks

COMMAND_WINDOW_NS = 10_000_000_000
"""A reset this long before a boot-up explains it (analysis.md 4)."""
STORY_NS = 10_000_000_000
"""Events this close to an EMCY 8130h belong to its story [ns]."""
LIFE_GUARD = 0x8130
FLIPS = 3
"""Returns to OPERATIONAL without a command that no single node makes."""
DOUBLED = 10
"""Alternating heartbeat intervals from which on two producers are believed."""


def find(analysis: Analysis, control: ControlTables, context: Context) -> list[Finding]:
    """All findings of this family; causes come before what follows from them."""
    if not context.timed:
        return [*_both(control, context), *_toggles(analysis, control, context)]
    stories = list(_guarding(analysis, control, context))
    doubled = list(_doubled(control, context))
    told = {(f.bus, f.node) for f in [*stories, *doubled]}
    twins = {(f.bus, f.node) for f in doubled}
    masters = {seq for finding in stories for seq in finding.evidence}
    single = [
        *_unexpected_resets(analysis, control, context),
        *_ignored(control, context),
    ]
    return [
        *stories,
        *_lost(control, context, masters),
        *doubled,
        *(f for f in single if (f.bus, f.node) not in twins),
        *(f for f in _pdo_outside(control, context) if (f.bus, f.node) not in told),
        *_both(control, context),
        *_toggles(analysis, control, context),
        *_slow(control, context),
    ]


def _lost(control: ControlTables, context: Context, told: set[int]) -> Iterator[Finding]:
    """Nodes that fell silent; one finding where the whole bus did."""
    losses = sorted(
        (lost.start_ns, key, lost)
        for key, timeline in control.nmt.timelines.items()
        for lost in timeline.lost
        if lost.last_seq not in told
    )
    for _, key, lost in losses:
        if not lost.whole_bus:
            yield _lost_alone(control, context, key, lost)
    whole = [(key, lost) for _, key, lost in losses if lost.whole_bus]
    for _, group in groupby(
        whole, key=lambda entry: (entry[0][0], entry[1].last_ns // 1_000_000_000)
    ):
        yield _lost_together(control, context, list(group))


def _lost_alone(control: ControlTables, context: Context, key: NodeKey, lost: Lost) -> Finding:
    bus, node = key
    silent = seconds(lost.end_ns - lost.last_ns)
    boot = _boot_up_at(control, context, key, lost)
    if lost.end_seq is None:
        text = (
            f"Node {node} is silent from {_at(control, lost.last_ns)} on, {silent} up to the end."
        )
    else:
        how = "with a boot-up" if boot else "without a boot-up"
        text = f"Node {node} was lost for {silent} and came back {how}."
    text += f" It counts as lost after {seconds(lost.timeout_ns)}: {lost.reason}."
    cause = (
        "The node lost its supply or restarted: it came back with a boot-up."
        if boot
        else "Supply or cable of this node, its CAN interface bus-off, or the node stopped working;"
        " the other nodes were heard all the time, so the bus itself worked."
    )
    return Finding(
        "nmt.node_lost",
        "error",
        context.bus_name(bus),
        node,
        lost.last_ns,
        lost.end_ns,
        text,
        cause,
        "Check plug, cable and supply voltage of the node; look at its error memory (1003h).",
        [seq for seq in (lost.last_seq, lost.end_seq) if seq is not None],
    )


def _lost_together(
    control: ControlTables, context: Context, group: list[tuple[NodeKey, Lost]]
) -> Finding:
    """All nodes of a bus silent at once, and nobody else to be heard."""
    nodes = sorted({key[1] for key, _ in group})
    boots = [key[1] for key, lost in group if _boot_up_at(control, context, key, lost)]
    start = min(lost.last_ns for _, lost in group)
    end = max(lost.end_ns for _, lost in group)
    back = "came back with a boot-up" if boots else "was not heard again before the end"
    text = f"The whole bus was silent for {seconds(end - start)}; {_names(nodes)} {back}."
    cause = (
        "The machine was switched off and on (all nodes started anew)."
        if boots
        else "The machine was switched off, the recorder was unplugged, or the bus was broken near it."
    )
    return Finding(
        "nmt.node_lost",
        "warning" if boots else "error",
        context.bus_name(group[0][0][0]),
        nodes[0] if len(nodes) == 1 else None,
        start,
        end,
        text,
        cause,
        "Was it switched off on purpose? If not: supply of the whole machine, cable at the recorder.",
        sorted(
            seq for _, lost in group for seq in (lost.last_seq, lost.end_seq) if seq is not None
        ),
    )


def _boot_up_at(
    control: ControlTables, context: Context, key: NodeKey, lost: Lost
) -> BootUp | None:
    bus = context.bus_name(key[0])
    return next(
        (
            boot
            for boot in control.nmt.boot_ups
            if (boot.bus, boot.node) == (bus, key[1])
            and 0 <= boot.t_ns - lost.end_ns <= 1_000_000_000
        ),
        None,
    )


def _unexpected_resets(
    analysis: Analysis, control: ControlTables, context: Context
) -> Iterator[Finding]:
    """Boot-ups without a reset command before them; those after a lost stretch belong to it."""
    for boot in control.nmt.boot_ups:
        key = (context.buses.index(boot.bus) if boot.bus in context.buses else 0, boot.node)
        timeline = control.nmt.timelines[key]
        if boot.command_seq is not None or boot.repeated or _first_sign(timeline, boot):
            continue
        if any(0 <= boot.t_ns - lost.end_ns <= 1_000_000_000 for lost in timeline.lost):
            continue
        if _recent_command(control, boot) or _reset_by_sdo(analysis, context, key, boot):
            continue
        pair = [b for b in control.nmt.boot_ups if b.repeated and 0 < b.t_ns - boot.t_ns < 10**9]
        pair = [b for b in pair if (b.bus, b.node) == (boot.bus, boot.node)]
        twice = f" (two boot-up frames, {seconds(pair[0].t_ns - boot.t_ns)} apart)" if pair else ""
        yield Finding(
            "nmt.unexpected_reset",
            "error",
            boot.bus,
            boot.node,
            boot.t_ns,
            boot.t_ns,
            f"Node {boot.node} restarted at {_at(control, boot.t_ns)} although no reset was"
            f" commanded in the 10 s before{twice}.",
            "Short break of its supply, watchdog, or a crash of its firmware.",
            "Measure the node's supply under load; look at its error memory (1003h) and for a"
            " watchdog EMCY after the boot-up.",
            [boot.seq, *(b.seq for b in pair[:1])],
        )


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


def _ignored(control: ControlTables, context: Context) -> Iterator[Finding]:
    """Commands that the node's own messages contradict a period later."""
    for (bus, node), timeline in control.nmt.timelines.items():
        for ignored in timeline.ignored:
            if ignored.command.node == 0 and not timeline.followed:
                continue
            name = command_name(ignored.command.specifier)
            yield Finding(
                "nmt.command_ignored",
                "error",
                context.bus_name(bus),
                node,
                ignored.command.t_ns,
                ignored.t_ns,
                f'Node {node} did not follow the command "{name}":'
                f" {seconds(ignored.t_ns - ignored.command.t_ns)} later it still says {ignored.state}.",
                "The node did not get the command, refuses it in its present condition, or another"
                " node answers under the same number.",
                "Does it follow when the command is repeated? Look for an EMCY of the node and for"
                " 1F80h, 1029h.",
                [ignored.command.seq, ignored.seq],
            )


def _pdo_outside(control: ControlTables, context: Context) -> Iterator[Finding]:
    """PDOs of nodes that are known to be in another state than OPERATIONAL."""
    for (bus, node), timeline in control.nmt.timelines.items():
        found = [v for v in timeline.violations if not v.guess]
        if not found or (quirks(context.shadow.device(bus, node)).rtr_any_state and not found):
            continue
        first = found[0]
        ids = ", ".join(sorted({f"{v.can_id:03X}h" for v in found}))
        known = "by command" if first.certainty == "commanded" else "by its own word"
        yield Finding(
            "nmt.pdo_outside_operational",
            "warning",
            context.bus_name(bus),
            node,
            first.start_ns,
            max(v.end_ns for v in found),
            f"Node {node} sent {sum(v.count for v in found)} PDOs ({ids}) while it was"
            f" {first.state} {known}.",
            "A second device under the same number, a device that does not keep to CiA 301, or a"
            " command that it did not follow.",
            "Switch the node off: do the PDOs stop? Compare with its heartbeat.",
            [v.seq for v in found[:20]],
        )


def _guarding(analysis: Analysis, control: ControlTables, context: Context) -> Iterator[Finding]:
    """EMCY 8130h: a node missed its master, not the other way round."""
    rows = [row for row in analysis.emcy if row.code == LIFE_GUARD]
    rows.sort(key=lambda row: (row.bus, row.node, row.t_ns))
    for (bus, node), group in groupby(rows, key=lambda row: (row.bus, row.node)):
        yield from _guarding_of(analysis, control, context, bus, node, list(group))


def _guarding_of(
    analysis: Analysis,
    control: ControlTables,
    context: Context,
    bus: str,
    node: int,
    rows: list[EmcyRow],
) -> Iterator[Finding]:
    stretch = Stretch.of([row.t_ns for row in rows], STORY_NS)
    for begin, end in stretch:
        told = [row for row in rows if begin <= row.t_ns <= end]
        first = told[0]
        key = (context.buses.index(bus) if bus in context.buses else 0, node)
        silent = _silent_before(control, key, first.t_ns)
        fall = _fall_after(control, key, first.t_ns)
        pieces, evidence = [], [row.seq for row in told]
        start = first.t_ns
        if silent is not None:
            who, last_ns, last_seq = silent
            pieces.append(f"{who} silent from {_at(control, last_ns)} on")
            evidence.insert(0, last_seq)
            start = last_ns
        pieces.append(
            f"node {node} misses it after {seconds(first.t_ns - start)}"
            if silent
            else f"node {node} misses its master"
        )
        pieces.append(f"EMCY 8130h at {_at(control, first.t_ns)}")
        if fall is not None:
            pieces.append(f"node {node} goes {fall[1]} and its PDOs stop")
            evidence.append(fall[0])
        yield Finding(
            "nmt.guarding_lost",
            "error",
            bus,
            node,
            start,
            max(end, fall[2] if fall else end),
            " -> ".join(pieces)[:1].upper() + " -> ".join(pieces)[1:] + ".",
            (
                f"{silent[0]} stopped: the root is there, not at node {node}."
                if silent
                else f"The master stopped guarding or its heartbeat did not reach node {node}; no silence of"
                " a master stands in the capture."
            ),
            "Look at the master (program stopped, restarted, bus-off?) before changing the sensor;"
            f" compare its period with 100Ch x 100Dh or 1016h of node {node}.",
            evidence,
        )


def _silent_before(control: ControlTables, key: NodeKey, t_ns: int) -> tuple[str, int, int] | None:
    """Who fell silent just before: another node, or the guard requests to this one."""
    losses = [
        (lost.last_ns, other[1], lost)
        for other, timeline in control.nmt.timelines.items()
        if other[0] == key[0] and other != key
        for lost in timeline.lost
        if lost.last_ns <= t_ns <= lost.end_ns and t_ns - lost.last_ns <= STORY_NS
    ]
    if losses:
        last_ns, node, lost = max(losses, key=lambda entry: entry[0])
        return f"master (node {node})", last_ns, lost.last_seq
    node_nmt = control.nmt.nodes.get(key)
    for pause in reversed(node_nmt.pauses if node_nmt else []):
        covers = pause.start_ns <= t_ns and (pause.end_ns is None or t_ns <= pause.end_ns)
        if covers and t_ns - pause.start_ns <= STORY_NS:
            return "guarding master", pause.start_ns, pause.start_seq
    return None


def _fall_after(control: ControlTables, key: NodeKey, t_ns: int) -> tuple[int, str, int] | None:
    timeline = control.nmt.timelines.get(key)
    for seq, change_ns, before, after in timeline.changes if timeline else ():
        if before == "OPERATIONAL" and 0 <= change_ns - t_ns <= STORY_NS:
            return seq, after, change_ns
    return None


def _doubled(control: ControlTables, context: Context) -> Iterator[Finding]:
    """Two devices under one number: two interleaved cadences, or two states told in turn."""
    for (bus, node), nmt in control.nmt.nodes.items():
        if nmt.counts.doubled >= DOUBLED:
            start, end = nmt.doubled_span
            how = f"short and long intervals alternate {nmt.counts.doubled} times"
            evidence = nmt.doubled_at
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


def _both(control: ControlTables, context: Context) -> Iterator[Finding]:
    """Remote frames to a node that sends heartbeats: some devices then send an empty byte."""
    for (bus, node), nmt in control.nmt.nodes.items():
        if nmt.both_at is None:
            continue
        seq, t_ns = nmt.both_at
        empty = nmt.counts.empty
        effect = f" Since then {empty} heartbeats carried no state." if empty else ""
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


def _toggles(analysis: Analysis, control: ControlTables, context: Context) -> Iterator[Finding]:
    for (bus, node), nmt in control.nmt.nodes.items():
        if nmt.counts.toggle_errors < 2:
            continue
        yield Finding(
            "nmt.guard_toggle",
            "warning",
            context.bus_name(bus),
            node,
            analysis.capture.first_ns,
            analysis.capture.first_ns + analysis.capture.duration_ns,
            f"The toggle bit of node {node}'s guard answers did not alternate"
            f" {nmt.counts.toggle_errors} times.",
            "The node does not keep to CiA 301, two devices answer, or frames were not recorded.",
            "Compare with another recorder; look for a second device under this number.",
            nmt.toggle_seqs[:20],
        )


def _slow(control: ControlTables, context: Context) -> Iterator[Finding]:
    for (bus, node), nmt in control.nmt.nodes.items():
        if nmt.late is None:
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


def _names(nodes: list[int]) -> str:
    return f"node {nodes[0]}" if len(nodes) == 1 else "nodes " + ", ".join(map(str, nodes))


def _at(control: ControlTables, t_ns: int) -> str:
    """A moment as seconds into the capture."""
    return f"+{(t_ns - control.nmt.first_ns) / 1e9:.3f} s"
