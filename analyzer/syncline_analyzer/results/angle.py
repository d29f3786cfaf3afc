"""Traces of position-like objects."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray


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


@dataclass(frozen=True, slots=True)
class TraceEventRow:
    """A moment of a trace that a reader must know of; at most 1000 per trace and kind.

    `kind` is "jump" (faster than the device can turn), "out of range" (the first
    one of a stretch), "frozen" (the first of a stretch in which a sibling moves), "alarm" (bits of
    6503h or 6505h came up), "ambiguous" (the first sample whose value or direction cannot be told),
    "gray code" (at the end: counts in the wrong code) or "cut"; `text` says why. `before` and
    `after` are values in the trace's unit.
    """

    bus: str
    node: int
    object: int
    kind: Literal["jump", "out of range", "frozen", "alarm", "ambiguous", "gray code", "cut"]
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


TRACE_FLAGS = ("wrap", "jump", "ambiguous", "frozen", "out_of_range", "scale_assumed")
"""Names of the bits of `Trace.flags`, bit 0 first."""
