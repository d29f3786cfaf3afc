"""Traces of position-like objects."""

from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass

EventKind = Literal[
    "jump",
    "out of range",
    "frozen",
    "alarm",
    "ambiguous",
    "gray code",
    "cut",
    "step",
    "spike",
    "preset",
    "parted",
    "too fast",
    "unsure step",
    "disagrees",
]
"""What happens to a trace."""


@dataclass(frozen=True, slots=True)
class TraceRow:
    """Summary of one trace of a position-like object."""

    bus: str
    node: int
    object: int
    """index << 8 | sub"""
    name: str
    unit: str
    samples: int
    min: float | None
    max: float | None
    cuts: int
    flags: dict[str, int]
    shows: str = ""
    """What the value is by the settings at the end: axis, definition, range, reference."""
    assumed: list[str] = field(default_factory=list)
    """Settings of the scale that were only assumed: "cpr", "range", "res", "quad" ..."""
    unwrapped_min_deg: float | None = None
    """Least, greatest and mean angle with the way over the wrap joined; None without a scale."""
    unwrapped_max_deg: float | None = None
    unwrapped_mean_deg: float | None = None
    mean_deg: float | None = None
    """Mean on the circle, 359 and 1 deg give 0: 0..360, or -180..180 where the range is so."""
    std_deg: float | None = None
    """Standard deviation on the circle, sqrt(-2 ln R) with the mean resultant length R; None
    where the angles point everywhere alike."""
    direction_changes: int | None = None
    """Turns back by more than 1 deg, or 3 counts if that is more; None without a scale."""
    rest_samples: int = 0
    """Samples in stretches of 64 in which it stood still; of these are noise_deg (standard
    deviation) and noise_peak_deg (the widest stretch, peak to peak), both None without any."""
    noise_deg: float | None = None
    noise_peak_deg: float | None = None
    sources: dict[str, int] = field(default_factory=dict)
    """Samples by what carried them: "18Ah" (the COB-ID of a PDO), "SDO"."""
    speed_max_rpm: float | None = None
    """Fastest speed that the samples tell, either way."""
    told_below_rpm: float | None = None
    """Speed below which the samples tell speed and direction, where the device may turn faster."""
    untold_speeds: int = 0
    """Samples so far from the one before that the shaft may as well have turned the other way."""
    clockwise: bool | None = None
    """Whether an encoder's angle rises clockwise, looking at the shaft; None where there is none."""


@dataclass(frozen=True, slots=True)
class ShaftRow:
    """Two encoders that the bus description places on one shaft (`same_shaft_as`).

    `node` turns `ratio` times as far as `other` (negative: the other way round). They are compared
    where neither is sampled too seldom; angles are those of `node`.
    """

    bus: str
    node: int
    other_bus: str
    other: int
    ratio: float
    compared: int
    """Samples of the one that comes less often, laid against the line of the other."""
    left_out: int
    """Samples that could not be compared: no sample of the other near, or sampled too seldom."""
    difference_deg: float | None
    """Offset of `node` against `other` in the first stretch."""
    spread_deg: float | None
    """Largest distance from the offset in force, whatever was allowed."""
    allowed_deg: float
    """Allowed distance at an even speed; more where the speed is another one than that at which the
    offset was learned, and 5 ms of the speed for the stamps."""
    parted: int
    """How often they parted for good: the offset was another one afterwards."""
    parted_ns: int | None
    """When for the first time."""
    parted_seq: int | None
    parted_deg: float | None
    """By how much for the first time, when it was sure."""
    shifted_deg: float | None = None
    """How far they were off in the end, at the speed at which they had been together."""


@dataclass(frozen=True, slots=True, eq=False)
class ShaftTrace:
    """How far two encoders on one shaft are apart, for plots; thinned like a trace.

    All (n,): t_ns int64; seq int64 of the sample that was compared; difference_deg float64, the
    angle of `node` less `ratio` times that of `other`, near the offset of the first stretch;
    segment int32, one number per stretch in which neither line breaks.
    """

    bus: str
    node: int
    other_bus: str
    other: int
    t_ns: NDArray[np.int64]
    seq: NDArray[np.int64]
    difference_deg: NDArray[np.float64]
    segment: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class FollowerRow:
    """Two encoders that follow one another although nobody says that they sit on one shaft.

    `node` turns `ratio` times as far as `other`, on the same bus.
    """

    bus: str
    node: int
    other: int
    ratio: float
    start_ns: int
    end_ns: int
    compared: int
    """Moments at which both were compared."""
    moved_deg: float
    """How far `node` turned to and fro."""
    spread_deg: float
    """99 of 100 moments are no further off than this."""


@dataclass(frozen=True, slots=True)
class TraceEventRow:
    """A moment of a trace that a reader must know of; at most 1000 per trace and kind.

    `kind` is "jump" (faster than the device can turn), "out of range" (the first
    one of a stretch), "frozen" (the first of a stretch in which a sibling moves), "alarm" (bits of
    6503h or 6505h came up), "ambiguous" (the first sample whose value or direction cannot be told),
    "gray code" (at the end: counts in the wrong code), "step" (away within one sample, at the same
    speed before and after), "spike" (away for one sample and back), "preset" (a step onto the
    preset value), "parted" (from another encoder on its shaft), "too fast" (turns on and on faster than it may),
    "unsure step" (away within one sample, and a cut or the end so near that a motion may begin), "disagrees" (16 bits of
    an angle are not the lower half of its 32 bits) or "cut"; `text` says why. `before`
    and `after` are values in the trace's unit.
    """

    bus: str
    node: int
    object: int
    kind: EventKind
    seq: int
    t_ns: int
    before: float | None
    after: float | None
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Samples of one trace, for plots and for `Session.traces()`.

    Columns, all (n,): t_ns int64; seq int64; raw int64; value float64 in `unit` (NaN where
    invalid); extra columns by name, for encoders `position` [counts], `turn`, `angle_deg`,
    `unwrapped_deg`, `speed_rpm` (float64, NaN where unknown); flags uint16 of `TraceFlag`; segment int32, one number
    per stretch between cuts. `assumed` names the scales that were only assumed.
    """

    bus: str
    node: int
    object: int
    name: str
    unit: str
    t_ns: NDArray[np.int64]
    seq: NDArray[np.int64]
    raw: NDArray[np.int64]
    value: NDArray[np.float64]
    flags: NDArray[np.uint16]
    segment: NDArray[np.int32]
    columns: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    assumed: list[str] = field(default_factory=list)


TRACE_FLAGS = (
    "wrap",
    "jump",
    "ambiguous",
    "frozen",
    "out_of_range",
    "scale_assumed",
    "silence",
    "singular",
)
"""Names of the bits of `Trace.flags`, bit 0 first; `silence` marks the first sample after a stretch
without any in which the value is not known, `singular` an angle that means nothing in that pose."""
