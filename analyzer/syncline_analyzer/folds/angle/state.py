"""One angle trace from block to block: its segments, its events and what its row is made of."""

from bisect import bisect_left, insort
from collections.abc import Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.angle.gray import GrayTest
from syncline_analyzer.folds.angle.leaps import Leap, Leaps
from syncline_analyzer.folds.angle.link import Floats, Link
from syncline_analyzer.folds.angle.samples import SDO_SOURCE, Samples
from syncline_analyzer.folds.angle.silence import Pauses
from syncline_analyzer.folds.angle.speeds import MAX_EVENTS
from syncline_analyzer.folds.angle.statistics import Statistics
from syncline_analyzer.folds.angle.trace import (
    AMBIGUOUS,
    FROZEN,
    OUT_OF_RANGE,
    SCALE_ASSUMED,
    SILENCE,
    SINGULAR,
    Converter,
    Derived,
    Encoder,
    Tilt,
)
from syncline_analyzer.folds.angle.untold import Untold
from syncline_analyzer.results import TRACE_FLAGS, EventKind, Trace, TraceEventRow, TraceRow
from syncline_analyzer.series import Columns, Thinner
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

MOVES = ("jump", "step", "spike", "preset", "unsure step")
"""Events in which a position moves as no shaft does."""
MAX_SAMPLES = 250_000
"""Samples of a trace that are kept; beyond, the extremes of runs of samples."""


class Cut(NamedTuple):
    """A moment at which a trace must be cut; `write` when an SDO write is the reason.

    Without a text something became known that may change the scale: the trace is cut only if so.
    """

    seq: int
    t_ns: int
    text: str
    write: bool


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
    narrowest: int = 64
    """Bits of the narrowest source so far."""
    held: Samples | None = None
    """Samples that wait for those after them, which may show that a cut belongs there."""
    held_cuts: list[Cut] = field(default_factory=list)
    ahead: list[Leap] = field(default_factory=list)
    """Leaps that were found and whose samples are not taken in yet."""
    fast: Fast | None = None
    top_rpm: float | None = None
    told_below_rpm: float | None = None
    untold_speeds: int = 0
    untold: Untold = field(default_factory=Untold)
    """Which those are."""
    silent: list[int] = field(default_factory=list)
    """`seq` of the samples that come after a silence and are not taken in yet."""
    wide: int = 0
    """Steps of which the other way round may be as likely."""
    sources: dict[int, int] = field(default_factory=dict)
    """Samples by COB-ID, or `SDO_SOURCE`."""
    moved_from_ns: dict[int, int] = field(default_factory=dict)
    """Stamp of the sample before a move by the `seq` of the one after."""
    _moves_ns: list[int] = field(default_factory=list)
    """Times of the `MOVES` that are kept, ascending ..."""
    _presets_ns: list[int] = field(default_factory=list)
    """... and of the presets among them."""

    def leapt(self, until: int) -> None:
        """Steps and spikes up to `until` that the speed limit lets pass; each source shows them,
        one is told."""
        due = [leap for leap in self.ahead if leap.seq <= until]
        self.ahead = [leap for leap in self.ahead if leap.seq > until]
        for leap in sorted(due, key=lambda leap: leap.seq):
            since_ns = leap.t_ns - leap.span_ns
            if _any_within(self._moves_ns, since_ns - leap.span_ns, leap.t_ns):
                continue
            self.moved(leap.kind, leap.seq, since_ns)
            self.note(leap.kind, leap.seq, leap.t_ns, leap.before, leap.after, _way(leap))

    def preset_within(self, start_ns: int, end_ns: int) -> bool:
        """Whether a preset was told in a span; another source may show it a little later."""
        return _any_within(self._presets_ns, start_ns, end_ns)

    def room(self, kind: EventKind) -> int:
        """How many events of a kind are still kept."""
        return max(0, MAX_EVENTS - self.noted.get(kind, 0))

    @property
    def preset(self) -> bool:
        """Whether any preset was told."""
        return bool(self._presets_ns)

    def moved(self, kind: EventKind, seq: int, since_ns: int) -> None:
        """Remember since when a move that is noted may have happened."""
        if self.room(kind):
            self.moved_from_ns[seq] = since_ns

    def cut(self, seq: int, t_ns: int, text: str) -> None:
        """Begin a new segment; nothing is joined over it."""
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
        if not self.room(kind):
            return
        self.noted[kind] = self.noted.get(kind, 0) + 1
        self.events.append(
            TraceEventRow(self.bus, self.node, self.object, kind, seq, t_ns, before, after, text)
        )
        if kind in MOVES:
            insort(self._moves_ns, t_ns)
        if kind == "preset":
            insort(self._presets_ns, t_ns)

    def add(self, piece: Samples, converter: Converter, *, timed: bool) -> Derived:
        """Take in the samples of an unbroken piece."""
        self.converter, self.unit = converter, converter.unit
        self.name = piece.entry.name or self.name
        derived = converter.derive(self.link, piece, timed=timed)
        flags = derived.flags
        broken = self._broken(piece, derived)
        for mark, flag in ((piece.frozen, FROZEN), (piece.singular, SINGULAR)):
            if mark is not None:
                flags = flags | np.where(mark, flag, 0).astype(np.uint16)
        if self.silent:
            flags = flags | np.where(np.isin(piece.seq, self.silent), SILENCE, 0).astype(np.uint16)
            self.silent = [seq for seq in self.silent if seq > piece.seq[-1]]
        if converter.assumed:
            flags = flags | np.uint16(SCALE_ASSUMED)
            self.assumed.update(converter.assumed)
        self.begun = True
        if self.first_ns is None:
            self.first_seq, self.first_ns = int(piece.seq[0]), int(piece.t_ns[0])
        self.samples += len(piece.seq)
        combined = np.bincount(flags, minlength=1)
        for seen in np.flatnonzero(combined).tolist():
            bits = seen >> np.arange(len(TRACE_FLAGS)) & 1
            self.flag_counts += combined[seen] * bits
        known = derived.value[~np.isnan(derived.value)]
        if len(known):
            self.low, self.high = min(self.low, known.min()), max(self.high, known.max())
            self.last_value = float(known[-1])
        if "unwrapped_deg" in derived.columns:
            self._widen(derived.columns["unwrapped_deg"][derived.counted])
        self._measure(piece, derived, converter, broken)
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

    def _widen(self, unwrapped: Floats) -> None:
        known = unwrapped[~np.isnan(unwrapped)]
        if len(known):
            low, high, total, count = self.span_deg
            self.span_deg = [
                min(low, float(np.min(known))),
                max(high, float(np.max(known))),
                total + float(np.sum(known)),
                count + len(known),
            ]

    def _broken(self, piece: Samples, derived: Derived) -> NDArray[np.intp]:
        """Rows at which the line breaks: jumps, steps, and spikes with the sample after them."""
        rows = [] if derived.speeds is None else derived.speeds.broken.tolist()
        speed = derived.columns.get("speed_rpm", np.zeros(0))
        for leap in self.ahead:
            row = int(np.searchsorted(piece.seq, leap.seq))
            if row == len(piece.seq) or piece.seq[row] != leap.seq:
                continue
            later = np.flatnonzero(piece.source[row:] == piece.source[row])[:2] + row
            rows += later[: 2 if leap.kind == "spike" else 1].tolist()
        broken = np.array(sorted(set(rows)), np.intp)
        if len(speed):
            speed[broken] = np.nan
        return broken

    def _measure(
        self,
        piece: Samples,
        derived: Derived,
        converter: Converter,
        broken: NDArray[np.intp],
    ) -> None:
        """Count sources, and what is measured of angles that the samples tell."""
        counts = np.bincount(piece.source + 1)
        for number in np.flatnonzero(counts).tolist():
            self.sources[number - 1] = self.sources.get(number - 1, 0) + int(counts[number])
        speed = np.abs(derived.columns.get("speed_rpm", np.zeros(0)))
        unsure = (derived.flags[: len(speed)] & AMBIGUOUS) != 0
        untold = unsure & np.isnan(speed)
        self.untold_speeds += int(np.count_nonzero(untold))
        if unsure.any() and derived.speeds is not None and len(derived.speeds.span_ns):
            rows = np.flatnonzero(unsure & (derived.speeds.span_ns > 0))
            spans = derived.speeds.span_ns[rows]
            self.untold.add(piece.seq[rows], piece.t_ns[rows], spans, untold[rows])
        if np.isfinite(speed).any():
            self.top_rpm = max(self.top_rpm or 0.0, float(np.nanmax(speed)))
        angle = derived.columns.get("angle_deg")
        if angle is None:
            return
        sure = piece.told & (derived.flags & OUT_OF_RANGE == 0)
        if not (isinstance(converter, Tilt) and converter.vague):
            self.statistics.circle.add(np.where(sure, angle, np.nan))
        line = derived.columns["unwrapped_deg"]
        rows = np.flatnonzero(derived.counted & sure & np.isfinite(line))
        unsure = (derived.flags & AMBIGUOUS).astype(np.bool_)[rows]
        if unsure.any():
            quarter = 0.25 * converter.range_deg
            self.wide += int(np.count_nonzero(np.abs(np.diff(line[rows]))[unsure[1:]] > quarter))
        breaks = np.searchsorted(rows, np.intersect1d(broken, rows, assume_unique=True))
        self.statistics.add(line[rows], converter.step_deg, breaks)

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


def _any_within(times_ns: Sequence[int], start_ns: int, end_ns: int) -> bool:
    """Whether any of some ascending times lies in a span, its ends included."""
    at = bisect_left(times_ns, start_ns)
    return at < len(times_ns) and times_ns[at] <= end_ns
