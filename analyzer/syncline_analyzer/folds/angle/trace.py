"""From the samples of an unbroken piece to the columns of its trace: angle, speed, flags, jumps."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.angle.samples import Samples
from syncline_schemas.measurement import (
    AxisScale,
    EncoderScale,
    TiltScale,
    ambiguous_rpm,
    count_steps,
    encoder_angles,
    tilt_deg,
    tilt_steps,
)

MAX_EVENTS = 1000
_SLACK_NS = 1_000_000
"""How much later than usual after its sampling a value may be sent."""
_MINUTE_NS = 60e9
_ENOUGH = 16
"""Spans from which the usual one is taken anew."""
_NO_SPEED = 2.0
"""A speed of so many times what the device can do is one of the stamps, not of the shaft."""
_TOLD_APART = 0.25
"""Of a range: beyond, the other way round is not even three times as far, so no speed is told."""
_SEVERAL = 5
"""So many steps that are too big may be those of a device that measures less often than it sends."""
_MEASURED_NS = 500_000_000
"""It measures more often than this."""
_SELDOM = 1.5
"""A source that is heard so much less often than another one takes its speed where it is unsure."""
WRAP, JUMP, AMBIGUOUS, FROZEN, OUT_OF_RANGE, SCALE_ASSUMED, SILENCE = (1 << k for k in range(7))

Floats = NDArray[np.float64]
Flags = NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Jump:
    """A step that the device cannot make: `speed_rpm` over `span_ns` beats the limit."""

    row: int
    before: float
    after: float
    span_ns: int
    speed_rpm: float


@dataclass(frozen=True, slots=True, eq=False)
class Derived:
    """Columns of one unbroken piece of a trace; all (n,)."""

    value: Floats
    columns: dict[str, Floats]
    flags: Flags
    jumps: list[Jump] = field(default_factory=list)
    fast: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    """Rows, ascending, at which it turns on and on faster than it may."""


class Converter(Protocol):
    """Turns the raw values of one unbroken piece into columns."""

    @property
    def unit(self) -> str:
        """Unit of the value."""
        ...

    @property
    def assumed(self) -> tuple[str, ...]:
        """Settings that rest on a default."""
        ...

    @property
    def shows(self) -> str:
        """What the value is, by the settings in force."""
        ...

    @property
    def step_deg(self) -> float:
        """One count in degrees; NaN where there are none."""
        ...

    @property
    def range_deg(self) -> float:
        """After so many degrees the values repeat; NaN where that is not known."""
        ...

    def derive(self, state: "Link", piece: Samples, *, timed: bool) -> Derived:
        """Columns of a piece that goes on where `state` ends, which is moved to its end."""
        ...

    def same_scale(self, other: "Converter | None") -> bool:
        """Whether values of both may stand in one piece."""
        ...


@dataclass(slots=True)
class Link:
    """Where a piece ends: what the next samples are compared with."""

    last: float | None = None
    unwrapped: float = 0.0
    sources: dict[int, tuple[int, float]] = field(default_factory=dict)
    """(t_ns, value) of the last sample by source."""
    spacing_ns: dict[int, float] = field(default_factory=dict)
    jump_ns: int | None = None
    steps: dict[int, int] = field(default_factory=dict)
    """The last step [counts] by source."""
    measured_ns: dict[int, float] = field(default_factory=dict)
    """By source: after what time the value is usually another one, where it stands in between."""

    def cut(self) -> None:
        """Forget everything but the usual spacing."""
        self.last = None
        self.sources.clear()
        self.steps.clear()


@dataclass(frozen=True, slots=True)
class Encoder:
    """Counts of an encoder (CiA 406, 6004h)."""

    scale: EncoderScale
    unit: str = "counts"

    @property
    def assumed(self) -> tuple[str, ...]:
        """Settings that rest on a default."""
        return self.scale.assumed

    @property
    def step_deg(self) -> float:
        """One count in degrees."""
        return 360.0 / self.scale.counts_per_turn if self.scale.counts_per_turn else np.nan

    @property
    def range_deg(self) -> float:
        """The measuring range in degrees."""
        return self.step_deg * self.scale.range_counts if self.scale.range_counts else np.nan

    @property
    def shows(self) -> str:
        """Counts per turn, range and direction."""
        per_turn, total = self.scale.counts_per_turn, self.scale.range_counts
        bits = self.scale.cut_bits
        return ", ".join(
            (
                *((f"only {bits} bits are sent",) if bits is not None else ()),
                f"{per_turn} counts per turn" if per_turn else "counts per turn unknown",
                f"range {total} counts" if total else "range unknown",
                f"rising {'clockwise' if self.scale.clockwise else 'counter-clockwise'}",
            )
        )

    def same_scale(self, other: Converter | None) -> bool:
        """Whether counts, range and direction are the same."""
        if not isinstance(other, Encoder):
            return False
        mine, theirs = self.scale, other.scale
        return (mine.counts_per_turn, mine.range_counts, mine.clockwise) == (
            theirs.counts_per_turn,
            theirs.range_counts,
            theirs.clockwise,
        )

    def derive(self, state: Link, piece: Samples, *, timed: bool) -> Derived:
        """Position, turn, angle, unwrapped angle and speed."""
        angles = encoder_angles(piece.raw, self.scale)
        position = np.where(piece.valid, angles.position.astype(np.float64), np.nan)
        plain, step = _steps(state, angles.position.astype(np.float64), self._step)
        unwrapped = state.unwrapped + np.cumsum(step)
        flags = np.where(plain != step, WRAP, 0)
        flags |= np.where(angles.in_range, 0, OUT_OF_RANGE)
        speed, jumps, unsure, fast = _speeds(state, self.scale, piece, angles.position, timed=timed)
        flags |= unsure
        for jump in jumps:
            flags[jump.row] |= JUMP
        _advance(state, angles.position.astype(np.float64), unwrapped)
        columns = {
            "position": position,
            "turn": angles.turn,
            "angle_deg": angles.angle_deg,
            "unwrapped_deg": unwrapped * self.step_deg,
            "speed_rpm": speed,
        }
        return Derived(position, columns, flags.astype(np.uint16), jumps, fast)

    def _step(self, line: Floats) -> Floats:
        if self.scale.range_counts is None:
            return np.diff(line)
        return count_steps(line.astype(np.int64), self.scale.range_counts).astype(np.float64)


@dataclass(frozen=True, slots=True)
class Tilt:
    """An angle of an inclinometer (CiA 410)."""

    scale: TiltScale
    axis: AxisScale
    bits: int
    unit: str = "deg"
    reference: str = ""
    """ "absolute", "relative" or "reference unknown"; "" where the device knows no other."""
    zeroed: bool = False
    """Whether a zero point is subtracted from the angle."""

    @property
    def assumed(self) -> tuple[str, ...]:
        """Settings that rest on a default."""
        return self.scale.assumed

    @property
    def step_deg(self) -> float:
        """One count in degrees."""
        return self.scale.deg_per_count

    @property
    def range_deg(self) -> float:
        """The circle."""
        return 360.0

    @property
    def vague(self) -> bool:
        """Whether 16 bits are too few to tell the angle."""
        return self.bits == 16 and self.axis.ambiguous_16

    @property
    def shows(self) -> str:
        """Axis, angle definition, range and reference."""
        span = f"{self.axis.low_deg:g} .. {self.axis.high_deg:g} deg"
        step = f"{self.scale.deg_per_count:g} deg per count"
        named = (self.axis.name, self.scale.definition, span, step, self.reference)
        return ", ".join(part for part in named if part)

    def same_scale(self, other: Converter | None) -> bool:
        """Whether resolution and axis are the same."""
        if not isinstance(other, Tilt):
            return False
        return (self.scale.deg_per_count, self.axis) == (other.scale.deg_per_count, other.axis)

    def derive(self, state: Link, piece: Samples, *, timed: bool) -> Derived:
        """Angle, unwrapped angle and speed."""
        angle = tilt_deg(piece.raw, self.bits, self.scale.deg_per_count, self.axis)
        plain, step = _steps(state, angle, tilt_steps)
        unwrapped = state.unwrapped + np.cumsum(step)
        flags = np.where(np.abs(plain - step) > 180.0, WRAP, 0)
        outside = (angle < self.axis.low_deg) | (angle > self.axis.high_deg)
        flags |= np.where(outside, OUT_OF_RANGE, 0)
        if self.vague:
            flags |= AMBIGUOUS
        speed = _tilt_speed(state, piece, angle, timed=timed)
        _advance(state, angle, unwrapped)
        value = np.where(piece.valid, angle, np.nan)
        columns = {
            "angle_deg": value,
            "unwrapped_deg": np.where(piece.valid, unwrapped, np.nan),
            "speed_rpm": speed,
        }
        return Derived(value, columns, flags.astype(np.uint16))


@dataclass(frozen=True, slots=True)
class Plain:
    """A quantity without a circle, for example a vibration."""

    factor: float
    unit: str
    assumed: tuple[str, ...] = ()
    shows: str = ""

    @property
    def step_deg(self) -> float:
        """No degrees."""
        return np.nan

    @property
    def range_deg(self) -> float:
        """No degrees."""
        return np.nan

    def same_scale(self, other: Converter | None) -> bool:
        """Whether the factor is the same."""
        return isinstance(other, Plain) and other.factor == self.factor

    def derive(self, state: Link, piece: Samples, *, timed: bool) -> Derived:
        """The value alone."""
        value = np.where(piece.valid, piece.raw * self.factor, np.nan)
        return Derived(value, {}, np.zeros(len(value), np.uint16))


def _steps(state: Link, value: Floats, step_of: Any) -> tuple[Floats, Floats]:
    """(plain differences, steps the shortest way), both (n,); the first of a trace makes none."""
    if state.last is None:
        state.last = state.unwrapped = float(value[0])
    line = np.concatenate(([state.last], value))
    return np.diff(line), step_of(line)


def _advance(state: Link, value: Floats, unwrapped: Floats) -> None:
    state.last, state.unwrapped = float(value[-1]), float(unwrapped[-1])


def _of_source(
    state: Link, piece: Samples, value: Floats
) -> Iterable[tuple[int, NDArray[np.intp], Floats, NDArray[np.int64]]]:
    """(source, rows, values, stamps) by source, with the sample before the piece in front."""
    # Sources are COB-IDs or -1, so counting them beats sorting them.
    for source in (np.flatnonzero(np.bincount(piece.source + 1)) - 1).tolist():
        rows = np.flatnonzero(piece.source == source)
        values, t_ns = value[rows], piece.t_ns[rows]
        if source in state.sources:
            before_ns, before = state.sources[source]
            values = np.concatenate(([before], values))
            t_ns = np.concatenate(([before_ns], t_ns))
        state.sources[source] = (int(t_ns[-1]), float(values[-1]))
        yield source, rows, values, t_ns


def _speeds(
    state: Link, scale: EncoderScale, piece: Samples, position: NDArray[np.int64], *, timed: bool
) -> tuple[Floats, list[Jump], NDArray[np.int64], NDArray[np.intp]]:
    """Speed, jumps, flags of the samples that come too seldom to tell which way it turned, and
    the rows at which it turns on and on faster than it may.

    Samples of one source are compared with one another: two PDOs carry values of different age.
    """
    speed = np.full(len(piece.seq), np.nan)
    flags = np.zeros(len(piece.seq), np.int64)
    jumps: list[Jump] = []
    heard: list[tuple[float, NDArray[np.intp], NDArray[np.intp]]] = []
    per_turn, total = scale.counts_per_turn, scale.range_counts
    fast: list[NDArray[np.intp]] = [np.zeros(0, np.intp)]
    if not timed or per_turn is None or total is None:
        return speed, jumps, flags, fast[0]
    for source, rows, values, t_ns in _of_source(state, piece, position.astype(np.float64)):
        span = np.diff(t_ns)
        if not len(span):
            continue
        target = rows[-len(span) :]
        step = count_steps(values.astype(np.int64), total)
        forward = span > 0
        speed[target] = _rpm(step, np.where(forward, span, np.nan), per_turn)
        if scale.max_rpm is None:
            continue
        unsure = forward & (ambiguous_rpm(total, per_turn, 1e-9) < scale.max_rpm * span)
        flags[target[unsure]] = AMBIGUOUS
        speed[target[unsure & (np.abs(step) > _TOLD_APART * total)]] = np.nan
        usual_ns = _usual_ns(state, source, span)
        heard.append((usual_ns, target, target[unsure]))
        allowed_ns = np.maximum(span, usual_ns) + _SLACK_NS
        fastest = np.abs(_rpm(np.maximum(np.abs(step) - 2, 0), allowed_ns, per_turn))
        beyond = fastest > scale.max_rpm
        if np.count_nonzero(beyond) >= _SEVERAL:
            _learn_measuring(state, source, step, t_ns)
        measured_ns = state.measured_ns.get(source, 0.0)
        if measured_ns > _SELDOM * usual_ns:
            beyond &= fastest * allowed_ns > scale.max_rpm * (measured_ns + _SLACK_NS)
        turning = beyond & _goes_on(step, state.steps.get(source, 0))
        state.steps[source] = int(step[-1])
        fast.append(target[turning])
        too_fast = np.flatnonzero(beyond & ~turning)
        # A jump is no turning, and frames handed over in a bundle are too near for a speed.
        speed[target[too_fast]] = np.nan
        no_speed = np.abs(speed[target]) > _NO_SPEED * scale.max_rpm
        speed[target[no_speed & ~(turning & (2 * span >= usual_ns))]] = np.nan
        jumps += [
            Jump(int(target[k]), values[k], values[k + 1], int(span[k]), float(fastest[k]))
            for k in too_fast[:MAX_EVENTS].tolist()
        ]
        flags[target[too_fast[MAX_EVENTS:]]] |= JUMP
    heard.sort(key=lambda each: each[0])
    for usual_ns, _, guessed in heard[1:]:
        often_ns, often, _ = heard[0]
        if usual_ns > _SELDOM * often_ns:
            speed[guessed] = _last_before(speed, often, guessed)
    return speed, _first_of_each(jumps, piece, state), flags, np.sort(np.concatenate(fast))


def _learn_measuring(
    state: Link, source: int, step: NDArray[np.int64], t_ns: NDArray[np.int64]
) -> None:
    """Learn after what time the value of a source usually changes."""
    apart = np.diff(t_ns[1:][step != 0])
    apart = apart[(apart > 0) & (apart < _MEASURED_NS)]
    if len(apart) >= _SEVERAL:
        state.measured_ns[source] = float(np.median(apart))


def _goes_on(step: NDArray[np.int64], before: int) -> NDArray[np.bool_]:
    """Whether a step is one of several alike: turning; a jump stands alone."""
    size = np.abs(step)
    last = np.concatenate(([before], step[:-1]))
    following = np.concatenate((step[1:], step[-1:]))
    alike = np.ones(len(step), np.bool_)
    for other in (last, following):
        alike &= np.sign(other) == np.sign(step)
        alike &= (2 * np.abs(other) >= size) & (np.abs(other) <= 2 * size)
    return alike


def _last_before(values: Floats, known: NDArray[np.intp], wanted: NDArray[np.intp]) -> Floats:
    """For each wanted row the value of the last known row before it, NaN without one."""
    at = np.searchsorted(known, wanted) - 1
    return np.where(at >= 0, values[known[np.maximum(at, 0)]], np.nan)


def _rpm(step: NDArray[np.int64], span_ns: Floats | NDArray[np.int64], per_turn: int) -> Floats:
    rpm: Floats = step * (_MINUTE_NS / per_turn) / span_ns
    return rpm


def _usual_ns(state: Link, source: int, span: NDArray[np.int64]) -> float:
    """Mean time between samples of a source, pauses left out.

    Adapters may hand frames over in bundles, so that single spans say little.
    """
    forward = span[span > 0]
    if len(forward) >= _ENOUGH or source not in state.spacing_ns:
        regular = forward[forward <= 10 * np.quantile(forward, 0.9)] if len(forward) else forward
        state.spacing_ns[source] = float(regular.mean()) if len(regular) else 0.0
    return state.spacing_ns[source]


def _first_of_each(jumps: list[Jump], piece: Samples, state: Link) -> list[Jump]:
    """One jump is seen by every source that was heard before it: keep the first that shows it."""
    kept: list[Jump] = []
    for jump in sorted(jumps, key=lambda jump: jump.row):
        t_ns = int(piece.t_ns[jump.row])
        if state.jump_ns is None or not t_ns - jump.span_ns < state.jump_ns <= t_ns:
            state.jump_ns = t_ns
            kept.append(jump)
    return kept


def _tilt_speed(state: Link, piece: Samples, angle: Floats, *, timed: bool) -> Floats:
    speed = np.full(len(angle), np.nan)
    for _, rows, values, t_ns in _of_source(state, piece, angle):
        span = np.diff(t_ns)
        forward = span > 0
        if timed and len(span):
            rate = np.full(len(span), np.nan)
            rate[forward] = tilt_steps(values)[forward] / 360.0 * _MINUTE_NS / span[forward]
            speed[rows[-len(span) :]] = rate
    return speed
