"""The machine in 3D at the cursor: the shafts of encoders, and inclinometers as boxes."""

from collections.abc import Iterator

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis, TiltTrace, Trace
from syncline_analyzer.views.palette import line_colour
from syncline_analyzer.views.rerun_layout import World
from syncline_analyzer.views.rerun_sink import Sink
from syncline_analyzer.views.rerun_tilt import SHOWN_NS, shown_tilts, write_tilt
from syncline_analyzer.views.troubled import troubled
from syncline_analyzer.views.words import names_of, node_label
from syncline_schemas.records import dataclass

MAX_SHAPES = 12
"""Devices of one view; further ones have a view of their own."""
MAX_POSES = 6_000
"""Poses of one device, as long as there are no more devices than in one view."""
_COLUMNS, _ROW = 4, 2.6
"""Devices in a row at most, and how far rows are apart."""
_STEPS = (2.8, 3.2, 4.2)
"""How far columns are apart by the number of rows: what is further away needs room for names."""
_POINTER = (0.8, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """A device to be drawn, with its name."""

    device: Trace | TiltTrace
    label: str


def worlds_of(analysis: Analysis) -> list[World]:
    """Views of all devices that turn or tilt, up to twelve in each."""
    groups = list(_groups(analysis))
    return [world_of(place, len(groups), len(group)) for place, group in enumerate(groups)]


def write_worlds(sink: Sink, analysis: Analysis) -> None:
    """Write shapes and poses of all that turn or tilt."""
    groups = list(_groups(analysis))
    rising = {(row.bus, row.node, row.object): bool(row.clockwise) for row in analysis.traces}
    poses = MAX_POSES // max(len(groups), 1)
    for place, group in enumerate(groups):
        sink.static(_root(place), rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        for number, shape in enumerate(group):
            root, device = f"{_root(place)}/{number}", shape.device
            row, column = divmod(number, _columns(len(group)))
            at = (_step(len(group)) * column, -_ROW * row, 0.0)
            if isinstance(device, TiltTrace):
                write_tilt(sink, root, device, shape.label, at, poses)
                continue
            key = device.bus, device.node, device.object
            turns = _Turns(device, clockwise=rising.get(key, False), poses=poses)
            _write_shaft(sink, root, turns, shape.label, at)


def shafts_of(analysis: Analysis) -> list[Trace]:
    """One trace per encoder."""
    found: dict[tuple[str, int], Trace] = {}
    for trace in analysis.trace_data:
        angle = trace.columns.get("angle_deg")
        if "position" in trace.columns and angle is not None and np.isfinite(angle).any():
            found.setdefault((trace.bus, trace.node), trace)
    return list(found.values())


def _groups(analysis: Analysis) -> Iterator[list[_Shape]]:
    """Devices by view: those that something is to be seen of first, then by bus and node."""
    labels, ranks = names_of(analysis.nodes), troubled(analysis)
    several = len(analysis.capture.buses) > 1
    devices: list[Trace | TiltTrace] = [*shafts_of(analysis), *shown_tilts(analysis)]
    few = len(devices) <= MAX_SHAPES
    calm = max(ranks.values(), default=0) + 1
    devices.sort(
        key=lambda each: (
            0 if few else ranks.get((each.bus, each.node), calm),
            each.bus,
            each.node,
        )
    )
    shapes = [
        _Shape(
            each,
            f"{each.bus} {label}" if several else label,
        )
        for each in devices
        for label in [labels.get((each.bus, each.node), node_label(each.node))]
    ]
    for first in range(0, len(shapes), MAX_SHAPES):
        yield shapes[first : first + MAX_SHAPES]


def _rows(count: int) -> int:
    return -(-count // _COLUMNS)


def _columns(count: int) -> int:
    """Devices in a row, the rows equally long."""
    return -(-count // _rows(count))


def _step(count: int) -> float:
    return _STEPS[_rows(count) - 1]


def _root(place: int) -> str:
    return f"/world/{place}"


def world_of(place: int, groups: int, count: int) -> World:
    """From where everything in a view is seen: from above the front row."""
    columns, rows, step = _columns(count), _rows(count), _step(count)
    middle = step * (columns - 1) / 2, -_ROW * (rows - 1) / 2 - 0.4
    depth = _ROW * (rows - 1) + 2.0
    away = max(1.05 * depth + 0.6, 0.47 * step * columns)
    title = "3D at the cursor" + (f", {place + 1} of {groups}" if groups > 1 else "")
    eye = middle[0], middle[1] - 0.64 * away, 0.77 * away
    return World(title, _root(place), eye, (*middle, 0.0))


@dataclass(frozen=True, slots=True)
class _Turns:
    """A shaft as it is seen from its end, which is where z points."""

    trace: Trace
    clockwise: bool
    poses: int

    @property
    def rows(self) -> NDArray[np.intp]:
        """Samples with an angle, thinned."""
        rows = np.flatnonzero(np.isfinite(self.trace.columns["angle_deg"]))
        return rows[:: len(rows) // self.poses + 1]

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
    body = rr.Cylinders3D(lengths=[0.9], radii=[0.15], colors=[190, 190, 190], fill_mode="solid")
    ring = [(0.8 * np.cos(a), 0.8 * np.sin(a), 0.5) for a in np.linspace(0, 2 * np.pi, 49)]
    sink.static(root, rr.Transform3D(translation=list(at)), body)
    sink.static(f"{root}/circle", rr.LineStrips3D([ring], colors=[(130, 130, 130)], radii=[0.01]))
    _write_name(sink, root, label)
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


def _write_name(sink: Sink, root: str, label: str) -> None:
    """Write the name of a device in front of it."""
    name = rr.Points3D(
        [[0.0, -1.0, 0.0]],
        colors=[(200, 200, 200)],
        radii=[0.01],
        labels=[label],
        show_labels=True,
    )
    sink.static(f"{root}/name", name)


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
