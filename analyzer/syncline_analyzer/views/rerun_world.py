"""The machine in 3D at the cursor: one encoder's shaft, and inclinometers as boxes."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis, Trace
from syncline_analyzer.views.palette import line_colour
from syncline_analyzer.views.rerun_sink import Sink
from syncline_analyzer.views.rerun_tilt import MAX_POSES, shown_tilts, write_tilts

_SHAFT = "/world/shaft"


def shaft_of(analysis: Analysis) -> Trace | None:
    """The first trace of an encoder."""
    return next((t for t in analysis.trace_data if "position" in t.columns and len(t.t_ns)), None)


def has_world(analysis: Analysis) -> bool:
    """Whether there is anything to show in 3D."""
    return shaft_of(analysis) is not None or bool(shown_tilts(analysis))


def write_world(sink: Sink, analysis: Analysis) -> None:
    """Write shapes and poses of what there is."""
    sink.static("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    shaft = shaft_of(analysis)
    if shaft is not None:
        _write_shaft(sink, shaft)
    write_tilts(sink, analysis, x=0.0 if shaft is None else 1.0)


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


def _some(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    return rows[:: len(rows) // MAX_POSES + 1]


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
