"""From the samples of an unbroken piece to the columns of its trace: angle, speed, flags, jumps."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.angle.link import Floats, Link, line_through, wraps
from syncline_analyzer.folds.angle.samples import Samples
from syncline_analyzer.folds.angle.speeds import Speeds, circle_speeds, encoder_speeds
from syncline_schemas.measurement import (
    AxisScale,
    EncoderScale,
    TiltScale,
    encoder_angles,
    sent_in,
    tilt_deg,
)
from syncline_schemas.records import dataclass

WRAP, JUMP, AMBIGUOUS, FROZEN, OUT_OF_RANGE, SCALE_ASSUMED, SILENCE, SINGULAR = (
    1 << k for k in range(8)
)
_CIRCLE = 360.0

Flags = NDArray[np.uint16]


@dataclass(frozen=True, slots=True, eq=False)
class Derived:
    """Columns of one unbroken piece of a trace; all (n,)."""

    value: Floats
    columns: dict[str, Floats]
    flags: Flags
    counted: NDArray[np.bool_]
    """Rows of the source that tells the motion: those of the others carry values of another age."""
    speeds: Speeds | None = None


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


@dataclass(frozen=True, slots=True)
class Encoder:
    """Counts of an encoder (CiA 406, 6004h)."""

    scale: EncoderScale
    bits: int = 32
    """Bits of the widest source."""
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
    def reach_counts(self) -> int | None:
        """What the widest source repeats after: the range, or less where lower bits are sent."""
        total = self.scale.range_counts
        return None if total is None else min(total, 1 << self.bits)

    @property
    def range_deg(self) -> float:
        """After so many degrees the values repeat."""
        return self.step_deg * self.reach_counts if self.reach_counts else np.nan

    @property
    def shows(self) -> str:
        """Counts per turn, range and direction."""
        per_turn, total = self.scale.counts_per_turn, self.reach_counts
        bits = self.bits if total != self.scale.range_counts else None
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
        """Position, turn, angle, unwrapped angle and speed.

        Where only lower bits are sent, the upper ones are those of the line, once a source that
        sends them all has told which they are.
        """
        whole = float(self.scale.range_counts or np.inf)
        width = _widths(piece, whole)
        sent = piece.raw.astype(np.float64)
        if np.isfinite(whole) and not bool(((sent >= 0.0) & (sent < width)).all()):
            sent = np.mod(piece.raw, width)
        line = line_through(state, piece, sent, width, whole, _around_zero)
        position = sent
        if state.offset is not None and (width < whole).any():
            told = np.isfinite(line.unwrapped) & (width < whole)
            position = np.where(told, np.mod(line.unwrapped + state.offset, whole), sent)
        flags = np.where(wraps(state, line, position, whole), WRAP, 0)
        flags |= np.where(self._possible(piece, whole), 0, OUT_OF_RANGE)
        speeds = Speeds(np.full(len(sent), np.nan), np.zeros(len(sent), np.int64))
        if timed:
            speeds = encoder_speeds(state, self.scale, piece, sent, width)
        flags |= speeds.flags
        for jump in speeds.jumps:
            flags[jump.row] |= JUMP
        value = np.where(piece.valid, position, np.nan)
        turn, angle = self._angles(position, (width < whole) & (state.offset is None))
        columns = {
            "position": value,
            "turn": turn,
            "angle_deg": angle,
            "unwrapped_deg": line.unwrapped * self.step_deg,
            "speed_rpm": speeds.rpm,
        }
        return Derived(value, columns, flags.astype(np.uint16), line.counted, speeds)

    def _possible(self, piece: Samples, whole: float) -> NDArray[np.bool_]:
        """Whether the raw values (n,) are within the range."""
        below = np.abs(piece.raw) < whole
        return below if self.scale.signed else below & (piece.raw >= 0)

    def _angles(self, position: Floats, cut: NDArray[np.bool_]) -> tuple[Floats, Floats]:
        """Turn and angle (n,) of positions, and of those of which upper bits are not known."""
        counts = position.astype(np.int64)
        known = encoder_angles(counts, self.scale)
        if not cut.any():
            return known.turn, known.angle_deg
        part = encoder_angles(counts, sent_in(self.scale, self.bits))
        return np.where(cut, np.nan, known.turn), np.where(cut, part.angle_deg, known.angle_deg)


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
    def may_be_zeroed(self) -> bool:
        """Whether a zero point that nobody told of may have moved it beyond half a circle."""
        narrow = self.axis.high_deg - self.axis.low_deg < 360.0
        return narrow and self.reference == "reference unknown"

    @property
    def vague(self) -> bool:
        """Whether 16 bits are too few to tell the angle."""
        return self.bits == 16 and self.axis.ambiguous_16

    @property
    def repeats_deg(self) -> float:
        """After so many degrees the values repeat: 65536 counts where 16 bits are too few."""
        return 65536 * self.scale.deg_per_count if self.vague else _CIRCLE

    @property
    def shows(self) -> str:
        """Axis, angle definition, range and reference."""
        span = f"{self.axis.low_deg:g} .. {self.axis.high_deg:g} deg"
        if self.vague:
            span += f" modulo {self.repeats_deg:g} deg (16 bits)"
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
        width = np.full(len(angle), self.repeats_deg)
        step = _around_both if self.vague else _on_circle
        line = line_through(state, piece, angle, width, self.repeats_deg, step)
        flags = np.where(wraps(state, line, angle, _CIRCLE), WRAP, 0)
        # Of the angles that look alike in too few bits one is always possible.
        flags |= AMBIGUOUS if self.vague else np.where(self.axis.outside(angle), OUT_OF_RANGE, 0)
        speeds = Speeds(np.full(len(angle), np.nan), np.zeros(len(angle), np.int64))
        if timed:
            speeds = circle_speeds(state, piece, angle, width, step)
        value = np.where(piece.valid, angle, np.nan)
        columns = {
            "angle_deg": value,
            "unwrapped_deg": line.unwrapped,
            "speed_rpm": speeds.rpm,
        }
        return Derived(value, columns, flags.astype(np.uint16), line.counted, speeds)


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
        counted = np.zeros(len(value), np.bool_)
        return Derived(value, {}, np.zeros(len(value), np.uint16), counted)


def _widths(piece: Samples, whole: float) -> Floats:
    """(n,) what the samples repeat after: the whole range, or the bits that are sent."""
    if piece.bits is None:
        return np.full(len(piece.seq), min(whole, 2.0**piece.entry.bits))
    return np.minimum(whole, np.exp2(piece.bits))


def _around_zero(away: Floats, width: Floats) -> Floats:
    """The shortest way: in (-width / 2, width / 2]; all the way where nothing repeats."""
    if bool((np.abs(away) < width).all()) and bool(np.isfinite(width).all()):
        # Division takes much longer.
        rest = np.where(away < 0.0, away + width, away + 0.0)
        return np.where(rest > width / 2, rest - width, rest)
    finite = np.where(np.isfinite(width), width, 1.0)
    rest = np.mod(away, finite)
    short = np.where(rest > finite / 2, rest - finite, rest)
    return np.where(np.isfinite(width), short, away)


def _on_circle(away: Floats, width: Floats) -> Floats:
    """The shortest way on a circle, in [-width / 2, width / 2)."""
    short: Floats = np.mod(away + width / 2, width) - width / 2
    return short


def _around_both(away: Floats, width: Floats) -> Floats:
    """The shortest way of an angle whose upper bits are cut off: the circle is seen modulo those."""
    ways = np.stack([_on_circle(away + turn, width) for turn in (0.0, _CIRCLE, -_CIRCLE)])
    chosen = np.argmin(np.abs(ways), axis=0)
    short: Floats = np.take_along_axis(ways, chosen[None, :], axis=0)[0]
    return short
