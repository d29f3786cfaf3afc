"""NMT states in a Rerun recording: one lane per node, named by its device."""

import rerun as rr

from syncline_analyzer.results import Analysis, NmtStateRow
from syncline_analyzer.views.palette import STATE_COLOURS, rgba
from syncline_analyzer.views.rerun_layout import Lanes
from syncline_analyzer.views.rerun_names import part
from syncline_analyzer.views.rerun_sink import Sink
from syncline_analyzer.views.troubled import NodeKey, troubled
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.wording import counted

FEW = 8
"""So many lanes can be seen at once; of more, those that something is to be seen of come first."""


def lanes_of(analysis: Analysis) -> list[Lanes]:
    """The lanes to show together: all, and where they are many, first those worth a look."""
    entities = _entities(analysis)
    if not entities:
        return []
    title = f"NMT states of {counted(len(entities), 'node')}"
    everything = Lanes(title, list(entities.values()))
    ranks = troubled(analysis)
    worth = [entity for key, entity in entities.items() if key in ranks]
    if len(entities) <= FEW or not worth or len(worth) == len(entities):
        return [everything]
    first = Lanes(
        f"NMT states: {counted(len(worth), 'node')} of {len(entities)} with events", worth
    )
    return [first, everything]


def write_lanes(sink: Sink, analysis: Analysis) -> None:
    """Write every node's states as a lane."""
    rows: dict[NodeKey, list[NmtStateRow]] = {}
    for row in analysis.nmt_states:
        rows.setdefault((row.bus, row.node), []).append(row)
    states = [str(state) for state in NmtState]
    colours = [rgba(STATE_COLOURS[state]) for state in states]
    look = rr.StateConfiguration(values=states, labels=states, colors=colours)
    for key, entity in _entities(analysis).items():
        sink.static(entity, look)
        _write_lane(sink, entity, rows[key])


def _entities(analysis: Analysis) -> dict[NodeKey, str]:
    """Entity of each lane by (bus, node); the viewer sorts them by name."""
    names = {(row.bus, row.node): row.name or "" for row in analysis.nodes}
    found = {}
    for bus, node in sorted({(row.bus, row.node) for row in analysis.nmt_states}):
        label = f"{node:03} {names.get((bus, node), '')}".strip()
        found[bus, node] = f"/nmt/{part(bus)}/{part(label)}"
    return found


def _write_lane(sink: Sink, entity: str, rows: list[NmtStateRow]) -> None:
    last = rows[-1]
    shown = [*(row.state for row in rows), ""]
    t_ns = [*(row.start_ns for row in rows), max(last.end_ns, last.start_ns)]
    seq = [*(row.evidence or 0 for row in rows), (last.evidence or 0) + 1]
    if not sink.axis.clock.timed:
        shown, t_ns, seq = shown[:-1], t_ns[:-1], seq[:-1]
    sink.rows(entity, t_ns, seq, lambda part: rr.StateChange.columns(state=shown[part]))
