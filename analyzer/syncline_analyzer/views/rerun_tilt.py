"""Inclinometers in 3D: a box in its pose, or two needles where two angles are no pose."""

from collections.abc import Callable
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis, TiltTrace
from syncline_analyzer.views.palette import line_colour
from syncline_analyzer.views.plots import silences
from syncline_analyzer.views.rerun_sink import Sink
from syncline_schemas.tilt import Angles, gravity_of, pose_of

SHOWN_NS = 1_000_000_000
"""A pose is shown for so long after its sample where a silence or a cut follows."""
_HALF_SIZE = (0.6, 0.4, 0.15)
_RING = [(0.85 * np.cos(a), 0.85 * np.sin(a), 0.0) for a in np.linspace(0, 2 * np.pi, 49)]
_GREY = (130, 130, 130)
_NAME = (255, 200, 140)
_ARROW: tuple[tuple[float, ...], tuple[float, ...]] = ((0.6, 0, 0), (0.45, 0, 0))
"""Origin and vector of the printed x arrow on the box."""
_NEEDLES = (("longitudinal", (0.9, 0.0, 0.0), 1), ("lateral", (0.0, 0.9, 0.0), 0))
"""(name, where it points when level, axis about which it turns) of each angle shown by itself.

A positive angle raises them, as it raises the axes of a pose (`syncline_schemas.tilt`)."""
_ALIKE_DEG = 2.0
"""Where two formulas are possible and their poses lie no further apart, a box in outline is drawn."""


def shown_tilts(analysis: Analysis) -> list[TiltTrace]:
    """One tilt per inclinometer: that with the most poses."""
    best: dict[tuple[str, int], TiltTrace] = {}
    for tilt in analysis.tilt_data:
        other = best.get((tilt.bus, tilt.node))
        if len(tilt.t_ns) and (other is None or _worth(tilt) > _worth(other)):
            best[tilt.bus, tilt.node] = tilt
    return list(best.values())


def _worth(tilt: TiltTrace) -> tuple[int, int]:
    """How good a tilt is to show: by poses, then by the objects with the finer steps."""
    return int(np.isfinite(tilt.gravity[:, 0]).sum()), tilt.object


def write_tilt(
    sink: Sink,
    root: str,
    tilt: TiltTrace,
    label: str,
    at: tuple[float, float, float],
    poses: int,
) -> None:
    """Write an inclinometer, and where it would be if it were level."""
    x, y, z = at
    sink.static(root, rr.Transform3D(translation=[x, y, z + 0.4]))
    sink.static(f"{root}/level", rr.LineStrips3D([_RING], colors=[_GREY], radii=[0.01]))
    level = rr.Boxes3D(half_sizes=[_HALF_SIZE], colors=[_GREY], fill_mode="majorwireframe")
    sink.static(f"{root}/level/box", level)
    rows = np.arange(0, len(tilt.t_ns), len(tilt.t_ns) // poses + 1)
    is_pose = np.isfinite(tilt.gravity[rows, 0])
    angles = np.stack([tilt.longitudinal_deg[rows], tilt.lateral_deg[rows]], axis=1)
    is_alone = ~is_pose & np.isfinite(angles).all(axis=1)
    moments = _Moments(sink, tilt.t_ns[rows], tilt.seq[rows])
    about = _about(tilt, angles) if is_alone.any() else np.full((len(rows), 3), np.nan)
    is_about = is_alone & np.isfinite(about[:, 0])
    note = " (about)" if is_about.any() and not is_pose.any() else ""
    _write_name(sink, root, label + note)
    if is_pose.any():
        _write_box(moments, f"{root}/box", tilt.gravity[rows], is_pose)
    if is_about.any():
        _write_box(moments, f"{root}/about", about, is_about, outline=True)
    if is_alone.any():
        for (name, points, axis), angle in zip(_NEEDLES, angles.T, strict=True):
            needle = f"{root}/{name}"
            moments.turned(needle, _turned_about(axis, angle))
            look = rr.Arrows3D.from_fields(
                colors=[line_colour(1 - axis)], radii=[0.04], labels=[name], show_labels=False
            )
            sink.static(f"{needle}/as_sent", look)
            moments.shown(f"{needle}/as_sent", is_alone, _arrows(points))


def _about(tilt: TiltTrace, angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gravity (n, 3) where both formulas of perpendicular angles nearly agree, else NaN."""
    first, second = (
        gravity_of(formula, *angles.T).gravity
        for formula in (Angles.PERPENDICULAR_ASIN, Angles.PERPENDICULAR_ATAN)
    )
    apart = np.linalg.norm(first - second, axis=1) > np.radians(_ALIKE_DEG)
    if any(each.definition != "perpendicular" for each in tilt.settings):
        apart[:] = True
    first[apart] = np.nan
    return first


def _write_box(
    moments: "_Moments",
    entity: str,
    gravity: NDArray[np.float64],
    is_pose: NDArray[np.bool_],
    *,
    outline: bool = False,
) -> None:
    moments.turned(entity, pose_of(gravity))
    shape = rr.Boxes3D.from_fields(
        colors=[line_colour(1)], fill_mode="majorwireframe" if outline else "solid"
    )
    moments.sink.static(f"{entity}/shape", shape)
    moments.shown(f"{entity}/shape", is_pose, _boxes)
    origin, vector = _ARROW
    arrow = rr.Arrows3D.from_fields(
        origins=[origin], colors=[line_colour(0)], radii=[0.04], labels=["x"]
    )
    moments.sink.static(f"{entity}/arrow", arrow)
    moments.shown(f"{entity}/arrow", is_pose, _arrows(vector))


class _Moments:
    """Rows of a recording at the moments of a tilt."""

    def __init__(self, sink: Sink, t_ns: NDArray[np.int64], seq: NDArray[np.int64]) -> None:
        self.sink = sink
        self._t_ns = t_ns
        self._seq = seq

    def turned(self, entity: str, quaternion: NDArray[np.float64]) -> None:
        """Turn an entity; rows without a pose leave it level."""
        known = np.isfinite(quaternion).all(axis=1, keepdims=True)
        turns = np.where(known, quaternion, [0.0, 0.0, 0.0, 1.0])
        self.sink.rows(
            entity,
            self._t_ns,
            self._seq,
            lambda part: rr.Transform3D.columns(quaternion=turns[part]),
        )

    def shown(
        self,
        entity: str,
        visible: NDArray[np.bool_],
        columns: Callable[[int], rr.ComponentColumnList],
    ) -> None:
        """Show an entity only while it is visible, and not long after the last sample."""
        last = np.flatnonzero(silences(self._t_ns)) - 1
        t_ns = np.append(self._t_ns, self._t_ns[last] + SHOWN_NS)
        order = np.argsort(t_ns, kind="stable")
        seq = np.append(self._seq, self._seq[last] + 1)[order]
        there = np.append(visible.astype(np.int64), np.zeros(len(last), np.int64))[order]
        changes = np.flatnonzero(np.diff(there, prepend=-1))
        self.sink.rows(
            entity,
            t_ns[order][changes],
            seq[changes],
            lambda part: columns(int(there[changes[part]].sum())).partition(there[changes[part]]),
        )


def _write_name(sink: Sink, root: str, label: str) -> None:
    name = rr.Points3D(
        [[0.0, -1.0, -0.4]], colors=[_NAME], radii=[0.01], labels=[label], show_labels=True
    )
    sink.static(f"{root}/name", name)


def _boxes(count: int) -> rr.ComponentColumnList:
    return rr.Boxes3D.columns(half_sizes=np.tile(_HALF_SIZE, (count, 1)))


def _arrows(vector: tuple[float, ...]) -> Callable[[int], Any]:
    return lambda count: rr.Arrows3D.columns(vectors=np.tile(vector, (count, 1)))


def _turned_about(axis: int, angle_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (n, 4), x y z w, of turns about x (0), or about y (1) the left-handed way."""
    half = np.radians(angle_deg) / 2 * (-1.0 if axis == 1 else 1.0)
    turns = np.zeros((len(half), 4))
    turns[:, axis], turns[:, 3] = np.sin(half), np.cos(half)
    return turns
