"""One angle trace from block to block: its segments, its events and what its row is made of."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.angle.gray import GrayTest
from syncline_analyzer.folds.angle.leaps import Leap, Leaps
from syncline_analyzer.folds.angle.samples import SDO_SOURCE, Samples
from syncline_analyzer.folds.angle.silence import Pauses
from syncline_analyzer.folds.angle.statistics import Statistics
from syncline_analyzer.folds.angle.trace import (
    AMBIGUOUS,
    FROZEN,
    MAX_EVENTS,
    OUT_OF_RANGE,
    SCALE_ASSUMED,
    SILENCE,
    Converter,
    Derived,
    Encoder,
    Floats,
    Link,
    Tilt,
)
from syncline_analyzer.results import TRACE_FLAGS, EventKind, Trace, TraceEventRow, TraceRow
from syncline_analyzer.series import Columns, Thinner

MOVES = ("jump", "step", "spike", "preset", "unsure step")
"""Events in which a position moves as no shaft does."""
MAX_SAMPLES = 250_000
"""Samples of a trace that are kept; beyond, the extremes of runs of samples."""


@dataclass(frozen=True, slots=True)
class Fast:
    """A stretch in which it turns faster than it may, so far."""

    seq: int
    start_ns: int
    end_ns: int
    top_rpm: float
    limit_rpm: float


@dataclass(slots=True)
class TraceState:
    """A trace and what its row is made of."""

    bus: str
    node: int
    object: int
    name: str = ""
    unit: str = ""
    samples: int = 0
    low: float = np.inf
    high: float = -np.inf
    segment: int = 0
    begun: bool = False
    flag_counts: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(len(TRACE_FLAGS), np.int64)
    )
    assumed: set[str] = field(default_factory=set)
    converter: Converter | None = None
    link: Link = field(default_factory=Link)
    kept: Thinner = field(default_factory=lambda: Thinner("value", MAX_SAMPLES))
    events: list[TraceEventRow] = field(default_factory=list)
    noted: dict[EventKind, int] = field(default_factory=dict)
    outside: bool = False
    frozen: bool = False
    span_deg: list[float] = field(default_factory=lambda: [np.inf, -np.inf, 0.0, 0.0])
    """Least, greatest, sum and number of the unwrapped degrees."""
    gray: GrayTest = field(default_factory=GrayTest)
    alarm_bits: int = 0
    first_seq: int = 0
    first_ns: int | None = None
    last_value: float | None = None
    statistics: Statistics = field(default_factory=Statistics)
    pauses: Pauses = field(default_factory=Pauses)
    leaps: Leaps = field(default_factory=Leaps)
    last_raw: int | None = None
    fast: Fast | None = None
    top_rpm: float | None = None
    told_below_rpm: float | None = None
    untold_speeds: int = 0
    silent: list[int] = field(default_factory=list)
    """`seq` of the samples of this block that come after a silence."""
    wide: int = 0
    """Steps of which the other way round may be as likely."""
    sources: dict[int, int] = field(default_factory=dict)
    """Samples by COB-ID, or `SDO_SOURCE`."""
    moved_from_ns: dict[int, int] = field(default_factory=dict)
    """Stamp of the sample before a move by the `seq` of the one after."""

    def end(self) -> None:
        """Judge what waited for the samples after it."""
        self.leapt(self.leaps.end())

    def leapt(self, leaps: Iterable[Leap]) -> None:
        """Steps and spikes that the speed limit lets pass; each source shows them, one is told."""
        for leap in leaps:
            since_ns = leap.t_ns - leap.span_ns
            told = [e.t_ns for e in self.events if e.kind in MOVES]
            if any(since_ns - leap.span_ns <= t_ns <= leap.t_ns for t_ns in told):
                continue
            self.moved(leap.kind, leap.seq, since_ns)
            self.note(leap.kind, leap.seq, leap.t_ns, leap.before, leap.after, _way(leap))

    def moved(self, kind: EventKind, seq: int, since_ns: int) -> None:
        """Remember since when a move that is noted may have happened."""
        if self.noted.get(kind, 0) < MAX_EVENTS:
            self.moved_from_ns[seq] = since_ns

    def cut(self, seq: int, t_ns: int, text: str) -> None:
        """Begin a new segment; nothing is joined over it."""
        self.end()
        self.link.cut()
        self.statistics.cut()
        if not self.begun:
            return
        self.begun = False
        self.segment += 1
        self.note("cut", seq, t_ns, None, None, text)

    def note(
        self,
        kind: EventKind,
        seq: int,
        t_ns: int,
        before: float | None,
        after: float | None,
        text: str,
    ) -> None:
        """Keep an event, up to the limit of its kind."""
        self.noted[kind] = self.noted.get(kind, 0) + 1
        if self.noted[kind] <= MAX_EVENTS:
            self.events.append(
                TraceEventRow(
                    self.bus, self.node, self.object, kind, seq, t_ns, before, after, text
                )
            )

    def add(self, piece: Samples, converter: Converter, *, timed: bool) -> Derived:
        """Take in the samples of an unbroken piece."""
        self.converter, self.unit = converter, converter.unit
        self.name = piece.entry.name or self.name
        derived = converter.derive(self.link, piece, timed=timed)
        flags = derived.flags
        if piece.frozen is not None:
            flags = flags | np.where(piece.frozen, FROZEN, 0).astype(np.uint16)
        if self.silent:
            flags = flags | np.where(np.isin(piece.seq, self.silent), SILENCE, 0).astype(np.uint16)
        if converter.assumed:
            flags = flags | np.uint16(SCALE_ASSUMED)
            self.assumed.update(converter.assumed)
        self.begun = True
        if self.first_ns is None:
            self.first_seq, self.first_ns = int(piece.seq[0]), int(piece.t_ns[0])
        self.samples += len(piece.seq)
        for bit in range(len(TRACE_FLAGS)):
            self.flag_counts[bit] += int((flags >> bit & 1).sum())
        known = derived.value[~np.isnan(derived.value)]
        if len(known):
            self.low, self.high = min(self.low, known.min()), max(self.high, known.max())
            self.last_value = float(known[-1])
        self._widen(derived.columns.get("unwrapped_deg"))
        self._measure(piece, derived, converter)
        columns: Columns = {
            "t_ns": piece.t_ns,
            "seq": piece.seq,
            "raw": piece.raw,
            "value": derived.value,
            "flags": flags,
            "segment": np.full(len(flags), self.segment, np.int32),
        }
        self.kept.add(columns | {f"column {name}": c for name, c in derived.columns.items()})
        return derived

    def _widen(self, unwrapped: Floats | None) -> None:
        known = unwrapped[~np.isnan(unwrapped)] if unwrapped is not None else ()
        if len(known):
            low, high, total, count = self.span_deg
            self.span_deg = [
                min(low, float(np.min(known))),
                max(high, float(np.max(known))),
                total + float(np.sum(known)),
                count + len(known),
            ]

    def _measure(self, piece: Samples, derived: Derived, converter: Converter) -> None:
        """Count sources, and what is measured of angles that the samples tell."""
        counts = np.bincount(piece.source + 1)
        for number in np.flatnonzero(counts).tolist():
            self.sources[number - 1] = self.sources.get(number - 1, 0) + int(counts[number])
        self.last_raw = int(piece.raw[-1])
        speed = np.abs(derived.columns.get("speed_rpm", np.zeros(0)))
        unsure = (derived.flags[: len(speed)] & AMBIGUOUS) != 0
        self.untold_speeds += int(np.count_nonzero(unsure & np.isnan(speed)))
        if np.isfinite(speed).any():
            self.top_rpm = max(self.top_rpm or 0.0, float(np.nanmax(speed)))
        angle = derived.columns.get("angle_deg")
        if angle is None or (isinstance(converter, Tilt) and converter.vague):
            return
        sure = piece.valid & (derived.flags & OUT_OF_RANGE == 0)
        line = np.where(sure, derived.columns["unwrapped_deg"], np.nan)
        unsure = (derived.flags & AMBIGUOUS).astype(np.bool_)
        if unsure.any():
            quarter = 0.25 * converter.range_deg
            self.wide += int(np.count_nonzero(np.abs(np.diff(line))[unsure[1:]] > quarter))
        self.statistics.add(np.where(sure, angle, np.nan), line, converter.step_deg)

    def _mean_deg(self) -> float | None:
        """Mean on the circle, in the range of the angle."""
        mean = self.statistics.circle.mean_deg
        if mean is None:
            return None
        tilt = self.converter if isinstance(self.converter, Tilt) else None
        mean = mean if tilt is not None and tilt.axis.low_deg < 0 else mean % 360.0
        return round(mean, 6)

    def _reversals(self) -> int | None:
        """Changes of direction; None where the samples tell no direction."""
        told = self.statistics.scaled and 100 * self.wide < self.samples
        return self.statistics.reversals.count if told else None

    def row(self) -> TraceRow:
        """Summary of the trace."""
        known = self.low <= self.high
        low, high, total, count = self.span_deg
        counts = dict(zip(TRACE_FLAGS, self.flag_counts.tolist(), strict=True))
        return TraceRow(
            self.bus,
            self.node,
            self.object,
            self.name,
            self.unit,
            self.samples,
            float(self.low) if known else None,
            float(self.high) if known else None,
            self.segment,
            counts,
            self.converter.shows if self.converter else "",
            sorted(self.assumed),
            low if count else None,
            high if count else None,
            total / count if count else None,
            self._mean_deg(),
            _rounded(self.statistics.circle.std_deg),
            self._reversals(),
            self.statistics.rest.samples,
            _rounded(self.statistics.rest.noise_deg),
            _rounded(self.statistics.rest.widest) if self.statistics.rest.samples else None,
            {_source_name(source): count for source, count in sorted(self.sources.items())},
            self.top_rpm,
            self.told_below_rpm,
            self.untold_speeds,
            self.converter.scale.clockwise if isinstance(self.converter, Encoder) else None,
        )

    def trace(self) -> Trace:
        """The samples that were kept."""
        columns = self.kept.columns()
        derived = {
            name.removeprefix("column "): column
            for name, column in columns.items()
            if name.startswith("column ")
        }
        return Trace(
            self.bus,
            self.node,
            self.object,
            self.name,
            self.unit,
            columns["t_ns"],
            columns["seq"],
            columns["raw"],
            columns["value"],
            columns["flags"],
            columns["segment"],
            derived,
            sorted(self.assumed),
        )


def _way(leap: Leap) -> str:
    """What is odd about a leap, in words."""
    apart = f"{leap.span_ns / 1e6:.4g} ms apart"
    if leap.kind == "unsure step":
        return f"{apart}; speeding up so would take {leap.rev_s2:.0f} rev/s^2"
    landed = f"; it landed at the preset value {leap.preset}" if leap.kind == "preset" else ""
    return (
        f"{apart}, the shaft turning as slowly before as after; it would have to speed up and brake"
        f" with {leap.rev_s2:.0f} rev/s^2{landed}"
    )


def _rounded(value: float | None) -> float | None:
    """Beyond this a sum depends on how the frames came in blocks."""
    return None if value is None else round(value, 6)


def _source_name(source: int) -> str:
    return "SDO" if source == SDO_SOURCE else f"{source:03X}h"
