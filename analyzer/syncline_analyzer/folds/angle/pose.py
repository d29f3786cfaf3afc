"""Both axes of an inclinometer taken together: the direction of gravity over time."""

from collections.abc import Iterator
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.angle.samples import Key, Samples
from syncline_analyzer.folds.angle.trace import OUT_OF_RANGE, Derived, Tilt
from syncline_analyzer.results import TiltRow, TiltSetting, TiltTrace
from syncline_analyzer.series import Columns, Thinner
from syncline_schemas.records import dataclass
from syncline_schemas.tilt import Angles, TiltFlag, gravity_of, signed_deg, slope_deg

MAX_POSES = 100_000
"""Poses of an inclinometer that are kept; beyond, the most and the least tilted of runs of them."""
APART_NS = 100_000_000
"""Two axes that come in different frames, no further apart than this, are one pose."""
_LATERAL = 0x10 << 8
"""From the longitudinal to the lateral object (CiA 410: 6010h and 6020h, 6110h and 6120h)."""

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Acting:
    """What makes a pose of two angles for a while."""

    shown: TiltSetting
    angles: Angles | None
    full_circle: bool
    assumed: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Axis:
    """Samples of one axis in a block, all (n,); `acting` is the place of their `_Acting`."""

    seq: Integers
    t_ns: Integers
    angle: Floats
    acting: Integers

    def of(self, rows: NDArray[np.intp]) -> "_Axis":
        """Some of the samples."""
        return _Axis(self.seq[rows], self.t_ns[rows], self.angle[rows], self.acting[rows])


class Poses:
    """Joins the axes of each inclinometer block by block."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._acting: list[_Acting] = []
        self._parts: dict[Key, list[_Axis]] = {}
        self._states: dict[Key, _PoseState] = {}

    def take(self, key: Key, piece: Samples, derived: Derived, converter: Tilt) -> None:
        """Take in one axis of an unbroken piece; angles that cannot be are left out."""
        acting = _acting_of(converter)
        if acting not in self._acting:
            self._acting.append(acting)
        number = np.full(len(piece.seq), self._acting.index(acting), np.int64)
        outside = (derived.flags & OUT_OF_RANGE).astype(np.bool_)
        angle = np.where(outside | converter.vague, np.nan, derived.value)
        part = _Axis(piece.seq, piece.t_ns, angle, number)
        self._parts.setdefault(key, []).append(part)

    def join(self) -> None:
        """Make poses of the axes taken in since the last call."""
        axes = {key: _joined(parts) for key, parts in self._parts.items()}
        self._parts.clear()
        for key, first in axes.items():
            bus, node, number = key
            second = axes.get((bus, node, number + _LATERAL))
            if second is None:
                continue
            if key not in self._states:
                self._states[key] = _PoseState(self._context.bus_name(bus), node, number)
            for one, other, flag in _pairs(first, second, timed=self._context.timed):
                self._states[key].add(one, other, self._acting, flag)

    def rows(self) -> list[TiltRow]:
        """Summaries, in order of bus, node and object."""
        return [state.row(self._acting) for state in self._seen()]

    def traces(self) -> list[TiltTrace]:
        """What was kept of the poses, in the order of `rows`."""
        return [state.trace(self._acting) for state in self._seen()]

    def _seen(self) -> list["_PoseState"]:
        return [state for _, state in sorted(self._states.items()) if state.samples]


@dataclass(slots=True)
class _PoseState:
    """The tilt of one inclinometer so far."""

    bus: str
    node: int
    object: int
    samples: int = 0
    converted: int = 0
    flag_counts: dict[TiltFlag, int] = field(default_factory=lambda: dict.fromkeys(TiltFlag, 0))
    used: list[int] = field(default_factory=list)
    steepest: tuple[float, int, int] | None = None
    """(slope [deg], t_ns, seq)"""
    kept: Thinner = field(default_factory=lambda: Thinner("height", MAX_POSES))

    def add(self, first: _Axis, second: _Axis, actings: list[_Acting], flag: TiltFlag) -> None:
        """Take in pairs of angles; those that two settings made are left out."""
        alike = np.where(first.acting == second.acting, first.acting, -1)
        for number in (np.flatnonzero(np.bincount(alike + 1)[1:])).tolist():
            rows = np.flatnonzero(alike == number)
            if number not in self.used:
                self.used.append(number)
            self._add(first.of(rows), second.of(rows), actings[number], flag)

    def _add(self, first: _Axis, second: _Axis, acting: _Acting, flag: TiltFlag) -> None:
        gravity, flags = _gravity(first.angle, second.angle, acting)
        flags |= np.uint8(flag)
        slope = slope_deg(gravity)
        told = np.isfinite(slope)
        self.samples += len(slope)
        self.converted += int(told.sum())
        for each in TiltFlag:
            self.flag_counts[each] += int((flags & each).astype(np.bool_).sum())
        if told.any():
            row = int(np.nanargmax(slope))
            if self.steepest is None or slope[row] > self.steepest[0]:
                self.steepest = float(slope[row]), int(first.t_ns[row]), int(first.seq[row])
        if not told.all():
            signed = np.hypot(signed_deg(first.angle), signed_deg(second.angle))
            slope = np.where(told, slope, signed)
        self.kept.add(
            {
                "t_ns": first.t_ns,
                "seq": first.seq,
                "longitudinal_deg": first.angle,
                "lateral_deg": second.angle,
                "gravity": gravity,
                "flags": flags,
                "setting": first.acting,
                "height": slope,
            }
        )

    def row(self, actings: list[_Acting]) -> TiltRow:
        """Summary of the tilt."""
        used = [actings[number] for number in self.used]
        slope, t_ns, seq = self.steepest or (None, None, None)
        return TiltRow(
            self.bus,
            self.node,
            self.object,
            used[-1].shown.definition if used else "",
            used[-1].shown.angles if used else "",
            self.samples,
            self.converted,
            self.flag_counts[TiltFlag.SINGULAR],
            self.flag_counts[TiltFlag.IMPOSSIBLE],
            self.flag_counts[TiltFlag.UPRIGHT_ASSUMED],
            slope,
            t_ns,
            seq,
            sorted({each.shown.reason for each in used} - {""}),
            sorted({name for each in used for name in each.assumed}),
        )

    def trace(self, actings: list[_Acting]) -> TiltTrace:
        """The poses that were kept, in order of time."""
        kept = self.kept.columns()
        settings = [each.shown for each in actings]
        columns = {name: kept.get(name, empty) for name, empty in _NO_POSES.items()}
        order = np.argsort(columns["seq"], kind="stable")
        sorted_columns = {name: column[order] for name, column in columns.items()}
        return TiltTrace(self.bus, self.node, self.object, **sorted_columns, settings=settings)


_NO_POSES: Columns = {
    "t_ns": np.zeros(0, np.int64),
    "seq": np.zeros(0, np.int64),
    "longitudinal_deg": np.zeros(0),
    "lateral_deg": np.zeros(0),
    "gravity": np.zeros((0, 3)),
    "flags": np.zeros(0, np.uint8),
    "setting": np.zeros(0, np.int64),
}


def _acting_of(converter: Tilt) -> _Acting:
    scale = converter.scale
    unseen = ("reference",) if converter.reference == "reference unknown" else ()
    reason = _reason(converter)
    angles = None if reason else scale.angles
    shown = TiltSetting(
        scale.definition, angles.value if angles else "", converter.reference, reason
    )
    return _Acting(shown, angles, scale.full_circle, (*scale.assumed, *unseen))


def _reason(converter: Tilt) -> str:
    """Why two angles tell no direction of gravity; "" where they do."""
    if converter.zeroed:
        return "a zero point is subtracted from the angles, so that together they are no pose"
    if converter.scale.angles is not None:
        return ""
    if converter.scale.geometry == "perpendicular":
        return "two formulas are possible for these angles: choose perp_formula = asin or atan"
    return "what the two angles mean together is not known"


def _gravity(first: Floats, second: Floats, acting: _Acting) -> tuple[Floats, NDArray[np.uint8]]:
    if acting.angles is None:
        return np.full((len(first), 3), np.nan), np.zeros(len(first), np.uint8)
    tilt = gravity_of(acting.angles, first, second, full_circle=acting.full_circle)
    return tilt.gravity, tilt.flags


def _pairs(first: _Axis, second: _Axis, *, timed: bool) -> Iterator[tuple[_Axis, _Axis, TiltFlag]]:
    """Axes row by row: those of one frame, and of the rest those that come soon after another."""
    if np.array_equal(first.seq, second.seq):
        yield first, second, TiltFlag(0)
        return
    _, left, right = np.intersect1d(first.seq, second.seq, return_indices=True)
    if len(left):
        yield first.of(left), second.of(right), TiltFlag(0)
    one = np.delete(np.arange(len(first.seq)), left)
    other = np.delete(np.arange(len(second.seq)), right)
    if timed and len(one) and len(other):
        near = _nearest(first.t_ns[one], second.t_ns[other])
        close = np.abs(second.t_ns[other[near]] - first.t_ns[one]) <= APART_NS
        yield first.of(one[close]), second.of(other[near[close]]), TiltFlag.APART


def _nearest(t_ns: Integers, among_ns: Integers) -> NDArray[np.intp]:
    """For each stamp the place of the nearest one among others, which are ascending."""
    after = np.clip(np.searchsorted(among_ns, t_ns), 0, len(among_ns) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(among_ns[before] - t_ns) <= np.abs(among_ns[after] - t_ns)
    return np.where(nearer, before, after)


def _joined(parts: list[_Axis]) -> _Axis:
    if len(parts) == 1:
        return parts[0]
    columns = (
        [getattr(part, name) for part in parts] for name in ("seq", "t_ns", "angle", "acting")
    )
    return _Axis(*(np.concatenate(column) for column in columns))
