"""The machine in 3D at the cursor: the shafts of encoders, and inclinometers as boxes."""

from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis, Trace
from syncline_analyzer.views.palette import line_colour
from syncline_analyzer.views.rerun_layout import World
from syncline_analyzer.views.rerun_sink import Sink
from syncline_analyzer.views.rerun_tilt import MAX_POSES, SHOWN_NS, shown_tilts, write_tilts
from syncline_analyzer.views.words import names_of, node_label

MAX_SHAFTS = 6
_COLUMNS, _COLUMN, _ROW = 3, 2.2, 2.4
"""Shafts in a row, and how far rows and columns are apart."""
_POINTER = (0.8, 0.0, 0.0)


def shafts_of(analysis: Analysis) -> list[Trace]:
    """One trace per encoder, of the first six."""
    found: dict[tuple[str, int], Trace] = {}
    for trace in analysis.trace_data:
        angle = trace.columns.get("angle_deg")
        if "position" in trace.columns and angle is not None and np.isfinite(angle).any():
            found.setdefault((trace.bus, trace.node), trace)
    return list(found.values())[:MAX_SHAFTS]


def world_of(analysis: Analysis) -> World | None:
    """From where everything in 3D is seen; None where there is nothing."""
    shafts, tilts = len(shafts_of(analysis)), len(shown_tilts(analysis))
    if not shafts:
        return World((0.2, -4.5, 2.6), (-0.1, 0.0, 0.5)) if tilts else None
    columns = min(shafts, _COLUMNS) + (1 if tilts else 0)
    behind = _ROW * (max(-(-shafts // _COLUMNS), tilts) - 1) / 2
    middle = (columns - 1) * _COLUMN / 2
    away = max(2.6, 1.05 * columns) + behind / 2
    return World((middle, behind - 0.75 * away, 0.3 + away), (middle, behind, 0.1))


def write_world(sink: Sink, analysis: Analysis) -> None:
    """Write shapes and poses of what there is: shafts in rows on the left, tilts on the right."""
    sink.static("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    shafts, labels = shafts_of(analysis), names_of(analysis.nodes)
    rising = {(row.bus, row.node, row.object): bool(row.clockwise) for row in analysis.traces}
    for place, trace in enumerate(shafts):
        label = labels.get((trace.bus, trace.node), node_label(trace.node))
        row, column = divmod(place, _COLUMNS)
        at = (_COLUMN * column, _ROW * row, 0.0)
        key = trace.bus, trace.node, trace.object
        turns = _Turns(trace, clockwise=rising.get(key, False))
        _write_shaft(sink, f"/world/shaft/{place}", turns, label, at)
    write_tilts(sink, analysis, x=_COLUMN * min(len(shafts), _COLUMNS))


@dataclass(frozen=True, slots=True)
class _Turns:
    """A shaft as it is seen from its end, which is where z points."""

    trace: Trace
    clockwise: bool

    @property
    def rows(self) -> NDArray[np.intp]:
        """Samples with an angle, thinned."""
        rows = np.flatnonzero(np.isfinite(self.trace.columns["angle_deg"]))
        return rows[:: len(rows) // MAX_POSES + 1]

    @property
    def quaternion(self) -> NDArray[np.float64]:
        """Turns about z at `rows`, (n, 4) as x y z w."""
        half = np.radians(self.trace.columns["angle_deg"][self.rows]) / 2
        turns = np.zeros((len(half), 4))
        turns[:, 2] = -np.sin(half) if self.clockwise else np.sin(half)
        turns[:, 3] = np.cos(half)
        return turns


def _write_shaft(
    sink: Sink, root: str, turns: _Turns, label: str, at: tuple[float, float, float]
) -> None:
    body = rr.Cylinders3D(
        lengths=[0.9],
        radii=[0.15],
        colors=[190, 190, 190],
        fill_mode="solid",
        labels=[label],
        show_labels=True,
    )
    ring = [(0.8 * np.cos(a), 0.8 * np.sin(a), 0.5) for a in np.linspace(0, 2 * np.pi, 49)]
    sink.static(root, rr.Transform3D(translation=list(at)), body)
    sink.static(f"{root}/circle", rr.LineStrips3D([ring], colors=[(130, 130, 130)], radii=[0.01]))
    trace, rows = turns.trace, turns.rows
    turned = turns.quaternion
    rotor = f"{root}/rotor"
    sink.rows(
        rotor,
        trace.t_ns[rows],
        trace.seq[rows],
        lambda part: rr.Transform3D.columns(quaternion=turned[part]),
    )
    look = rr.Arrows3D.from_fields(origins=[[0, 0, 0.5]], colors=[line_colour(0)], radii=[0.05])
    sink.static(f"{rotor}/pointer", look)
    _show_while_known(sink, f"{rotor}/pointer", trace)


def _show_while_known(sink: Sink, entity: str, trace: Trace) -> None:
    """Show the pointer from the first sample of each stretch to soon after its last one."""
    starts = np.flatnonzero(np.diff(trace.segment, prepend=trace.segment[0] - 1))
    ends = np.append(starts[1:] - 1, len(trace.t_ns) - 1)
    until = trace.t_ns[ends] + SHOWN_NS
    far = until[:-1] < trace.t_ns[starts[1:]]
    t_ns = np.concatenate([trace.t_ns[starts], until[:-1][far]])
    seq = np.concatenate([trace.seq[starts], trace.seq[ends[:-1]][far] + 1])
    visible = np.append(np.ones(len(starts), np.int64), np.zeros(int(far.sum()), np.int64))
    order = np.argsort(t_ns, kind="stable")
    t_ns, seq, visible = t_ns[order], seq[order], visible[order]
    sink.rows(
        entity,
        t_ns,
        seq,
        lambda part: rr.Arrows3D.columns(
            vectors=np.tile(_POINTER, (int(visible[part].sum()), 1))
        ).partition(visible[part]),
    )
