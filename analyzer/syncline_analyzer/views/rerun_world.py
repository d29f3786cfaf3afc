"""The machine in 3D at the cursor: one encoder's shaft, one inclinometer's box."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis, Trace
from syncline_analyzer.views.palette import line_colour
from syncline_analyzer.views.rerun_sink import Sink

_MAX_POSES = 6_000
_SHAFT, _BOX = "/world/shaft", "/world/tilt"


def shaft_of(analysis: Analysis) -> Trace | None:
    """The first trace that knows an angle of rotation."""
    return next((t for t in analysis.trace_data if "angle_deg" in t.columns and len(t.t_ns)), None)


def tilt_of(analysis: Analysis) -> tuple[Trace, Trace] | None:
    """Longitudinal and lateral slope of the first inclinometer (CiA 410 objects 6010h and 6020h)."""
    slopes = {
        (t.bus, t.node, t.object >> 8): t
        for t in analysis.trace_data
        if t.unit == "deg" and len(t.t_ns)
    }
    for (bus, node, index), trace in slopes.items():
        other = slopes.get((bus, node, index + 0x10))
        if index in (0x6010, 0x6110) and other is not None:
            return trace, other
    return None


def has_world(analysis: Analysis) -> bool:
    """Whether there is anything to show in 3D."""
    return shaft_of(analysis) is not None or tilt_of(analysis) is not None


def write_world(sink: Sink, analysis: Analysis) -> None:
    """Write shapes and poses of what there is."""
    sink.static("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    shaft, tilt = shaft_of(analysis), tilt_of(analysis)
    if shaft is not None:
        _write_shaft(sink, shaft)
    if tilt is not None:
        _write_box(sink, *tilt)


def _write_shaft(sink: Sink, trace: Trace) -> None:
    body = rr.Cylinders3D(lengths=[1.6], radii=[0.15], colors=[190, 190, 190], fill_mode="solid")
    pointer = rr.Arrows3D(
        origins=[[0, 0, 0.85]], vectors=[[0.9, 0, 0]], colors=[line_colour(0)], radii=0.05
    )
    sink.static(_SHAFT, rr.Transform3D(translation=[-1.2, 0, 0]), body)
    sink.static(f"{_SHAFT}/rotor/pointer", pointer)
    angle = trace.columns["angle_deg"]
    rows = _some(np.flatnonzero(np.isfinite(angle)))
    half = np.radians(angle[rows]) / 2
    zero = np.zeros(len(rows))
    _send_poses(sink, f"{_SHAFT}/rotor", trace, rows, [zero, zero, np.sin(half), np.cos(half)])


def _write_box(sink: Sink, long: Trace, lateral: Trace) -> None:
    """Turn a box about x by the longitudinal and about y by the lateral slope."""
    box = rr.Boxes3D(
        half_sizes=[[0.6, 0.4, 0.15]], colors=[line_colour(1)], fill_mode="solid", labels=["tilt"]
    )
    sink.static(_BOX, rr.Transform3D(translation=[1.0, 0, 0.3]))
    sink.static(f"{_BOX}/box/shape", box)
    rows = _some(np.flatnonzero(np.isfinite(long.value)))
    at = np.clip(np.searchsorted(lateral.t_ns, long.t_ns[rows]), 0, len(lateral.t_ns) - 1)
    x = np.radians(long.value[rows]) / 2
    y = np.radians(np.nan_to_num(lateral.value[at])) / 2
    quaternion = [
        np.sin(x) * np.cos(y),
        np.cos(x) * np.sin(y),
        np.sin(x) * np.sin(y),
        np.cos(x) * np.cos(y),
    ]
    _send_poses(sink, f"{_BOX}/box", long, rows, quaternion)


def _some(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    return rows[:: len(rows) // _MAX_POSES + 1]


def _send_poses(
    sink: Sink,
    entity: str,
    trace: Trace,
    rows: NDArray[np.intp],
    quaternion: list[NDArray[np.float64]],
) -> None:
    turned = np.stack(quaternion, axis=1)
    sink.rows(
        entity,
        trace.t_ns[rows],
        trace.seq[rows],
        lambda part: rr.Transform3D.columns(quaternion=turned[part]),
    )
