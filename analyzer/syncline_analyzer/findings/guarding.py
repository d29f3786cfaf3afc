"""EMCY 8130h as one story: who fell silent, who missed it, and what it did then (analysis.md 8)."""

from collections.abc import Iterator
from itertools import groupby

from syncline_analyzer.context import Context
from syncline_analyzer.findings.stretch import Stretch, moment, seconds
from syncline_analyzer.folds.control import ControlTables
from syncline_analyzer.folds.nmt import NodeKey
from syncline_analyzer.results import Analysis, EmcyRow, Finding

STORY_NS = 10_000_000_000
"""Events this close to an EMCY belong to its story [ns]."""
LIFE_GUARD = 0x8130


def guarding_stories(
    analysis: Analysis, control: ControlTables, context: Context
) -> Iterator[Finding]:
    """EMCY 8130h: a node missed its master, not the other way round."""
    rows = [
        row for row in analysis.emcy if row.code == LIFE_GUARD and row.transition != "malformed"
    ]
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
            pieces.append(f"{who} silent from {moment(analysis, last_ns)} on")
            evidence.insert(0, last_seq)
            start = last_ns
        pieces.append(
            f"node {node} misses it after {seconds(first.t_ns - start)}"
            if silent
            else f"node {node} misses its master"
        )
        pieces.append(f"EMCY 8130h at {moment(analysis, first.t_ns)}")
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
                f"{silent[0][:1].upper() + silent[0][1:]} stopped: the root is there, not at node {node}."
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
        for lost in (*timeline.lost, *timeline.restarts)
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
