"""What is worth plotting in an analysis: lines grouped by quantity, the same in HTML and Rerun."""

from collections.abc import Iterator
from dataclasses import field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import TRACE_FLAGS, Analysis, Responses, Series, ShaftTrace, Trace
from syncline_analyzer.views.basis import estimated_buses
from syncline_analyzer.views.palette import Rgb, line_colour, paler
from syncline_analyzer.views.words import hex_code, names_of, node_label, printable, trace_object
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

QUANTITIES = {
    "deg": "Angle",
    "rpm": "Speed",
    "counts": "Position",
    "mm/s": "Vibration velocity",
    "g": "Vibration acceleration",
    "degC": "Temperature",
}
"""Title of a plot by the unit of its traces."""

NODES_APART = 12
"""Up to so many nodes with traces have a plot each; of more, one plot per quantity shows all."""

_WITH_OUTLIERS = ("us", "rpm")
_REACH = 4.0
"""Spreads (1st to 99th percentile) that an axis reaches beyond them."""

RESPONSES_APART = 12
"""So many nodes have a plot of their answers that is shown at once: those that spread most."""

_SHORT_WINDOWS = " in 100 ms"
_ESTIMATED = ", bit rate estimated"

_SILENCE_NS = 1_000_000_000
_SILENT_STEPS = 20

_HALF_TURN_DEG = 180.0
_CIRCLE_DEG = 360.0
_FILLED = 4
"""Where one sample of so many starts over, the line fills the plot and is not broken at all."""
_SILENCE_FLAG = 1 << TRACE_FLAGS.index("silence")


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A line of a plot: t_ns and seq (n,) int64, value (n,) float64, NaN where it is interrupted.

    `seq` is empty where the quantity belongs to no single frame. A `band` is what lies behind the
    other lines: short windows, of which the smallest and the largest matter.
    """

    bus: str
    node: int | None
    name: str
    t_ns: NDArray[np.int64]
    seq: NDArray[np.int64]
    value: NDArray[np.float64]
    colour: Rgb
    band: bool = False
    wraps: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    """Rows of the NaNs at which an angle only starts over."""
    partner: tuple[str, int] | None = None
    """(bus, node) of the other one where two are compared."""


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """A plot: lines of one quantity over one axis; `subject` is the node that it is about."""

    title: str
    unit: str
    subject: str = ""
    lines: list[Line] = field(default_factory=list)

    @property
    def is_timing(self) -> bool:
        """Whether it shows the bus at work rather than what devices measured."""
        return self.title in TIMING

    def told(self, analysis: Analysis) -> Analysis:
        """What belongs to this plot: with a subject, only what that node did."""
        if not self.subject:
            return analysis
        own: set[tuple[str, int | None] | None] = {(line.bus, line.node) for line in self.lines}
        own |= {line.partner for line in self.lines}
        return replace(
            analysis,
            nmt_states=[row for row in analysis.nmt_states if (row.bus, row.node) in own],
            emcy=[row for row in analysis.emcy if (row.bus, row.node) in own],
            findings=[
                row for row in analysis.findings if row.node is None or (row.bus, row.node) in own
            ],
        )

    @property
    def label(self) -> str:
        """Title with unit and subject."""
        return f"{self.title} [{self.unit}]" + (f" of {self.subject}" if self.subject else "")

    def limits(self) -> tuple[float, float]:
        """Limits of the axis to open with, with room on top for markers.

        Times and speeds leave single outliers outside, as lines that run off the plot: one power
        cycle must not flatten the jitter of the rest.
        """
        values = [line.value[np.isfinite(line.value)] for line in self.lines]
        known = np.concatenate(values) if values else _NO_VALUES
        if not len(known):
            return 0.0, 1.0
        low, high = float(known.min()), float(known.max())
        if self.title in _FROM_ZERO:
            low = min(low, 0.0)
        if self.unit in _WITH_OUTLIERS:
            first, last = (float(q) for q in np.percentile(known, (1, 99)))
            reach = _REACH * max(last - first, abs(last) * 0.001)
            low, high = max(low, first - reach), min(high, last + reach)
        room = (high - low) or max(abs(high), 1.0)
        return low - 0.05 * room, high + 0.15 * room

    def markers_height(self) -> float:
        """Where on the axis markers stand."""
        low, high = self.limits()
        return high - 0.05 * (high - low)


def panels(analysis: Analysis, *, nodes_apart: int = NODES_APART) -> list[Panel]:
    """Plots of an analysis: angles and other traces first, then load, SYNC and PDO answers.

    With more nodes than `nodes_apart` that have traces, one plot of a quantity shows all of them.
    """
    found: dict[tuple[str, str, str], Panel] = {}
    for title, unit, subject, line in _lines(analysis, nodes_apart):
        panel = found.setdefault((title, unit, subject), Panel(title, unit, subject))
        panel.lines.append(line)
    plots = [replace(panel, lines=_coloured(panel.lines)) for panel in found.values()]
    return sorted(plots, key=lambda panel: _RANK.get(panel.title, len(_RANK) - len(TIMING) - 0.5))


def shown_at_once(plotted: list[Panel], analysis: Analysis) -> list[Panel]:
    """The plots without those of nodes that answer more evenly than twelve others.

    Nodes with a warning or an error are among the twelve.
    """
    found = {
        (each.bus, each.node)
        for each in analysis.findings
        if each.node is not None and each.severity != "info"
    }

    def interest(panel: Panel) -> tuple[bool, float]:
        return any((line.bus, line.node) in found for line in panel.lines), _spread(panel)

    answers = [panel for panel in plotted if panel.title == _RESPONSE]
    steady = sorted(answers, key=interest)[: max(len(answers) - RESPONSES_APART, 0)]
    return [panel for panel in plotted if panel not in steady]


def _spread(panel: Panel) -> float:
    """How far the answers of a node lie apart, the widest PDO [us]."""
    values = (line.value[np.isfinite(line.value)] for line in panel.lines if not line.band)
    return max((float(np.ptp(np.percentile(v, (1, 99)))) for v in values if len(v)), default=0.0)


def _lines(analysis: Analysis, nodes_apart: int) -> Iterator[tuple[str, str, str, Line]]:
    several = len(analysis.capture.buses) > 1
    gaps = np.array(sorted(gap.end_ns for gap in analysis.capture.gaps), np.int64)
    labels = names_of(analysis.nodes)
    apart = len({(trace.bus, trace.node) for trace in analysis.trace_data}) <= nodes_apart
    for trace in analysis.trace_data:
        label = labels.get((trace.bus, trace.node), node_label(trace.node))
        subject = f"{trace.bus} node {label}" if several else f"node {label}"
        for title, unit, line in _of_trace(trace, gaps):
            yield (
                (title, unit, subject, line) if apart else (title, unit, "", _named(line, subject))
            )
    for pair in analysis.shaft_data:
        both = (pair.bus, pair.node), (pair.other_bus, pair.other)
        names = [f"node {labels.get(key, node_label(key[1]))}" for key in both]
        yield _APART, "deg", " against ".join(names), _of_shafts(pair, names, gaps)
    estimated = estimated_buses(analysis)
    for responses in sorted(analysis.responses, key=_sender):
        label = labels.get((responses.bus, responses.node or 0), node_label(responses.node))
        subject = f"{responses.bus} node {label}" if several else f"node {label}"
        for line in _of_responses(responses, gaps, responses.bus in estimated):
            yield _RESPONSE, "us", subject, line
    for series in analysis.series:
        title, unit, line = _of_series(series, several, gaps, series.bus in estimated)
        yield title, unit, "", line


def _sender(responses: Responses) -> tuple[str, int, int]:
    return responses.bus, responses.node or 0, responses.cob_id


def _of_trace(trace: Trace, gaps: NDArray[np.int64]) -> Iterator[tuple[str, str, Line]]:
    name = f"{printable(trace.name)} ({trace_object(trace.object)})"
    cuts = _cuts(trace.t_ns, gaps) | _changes(trace.segment)
    cuts |= (trace.flags & _SILENCE_FLAG).astype(np.bool_)
    angle = trace.columns.get("angle_deg")
    if angle is None or not np.isfinite(angle).any():
        angle = trace.value if trace.unit == "deg" else None
    if angle is not None:
        shown = _shown_angle(trace, angle)
        yield (
            QUANTITIES["deg"],
            "deg",
            _line(trace, name + shown.note, shown.deg, cuts, shown.wraps),
        )
    elif len(trace.value):
        title = QUANTITIES.get(trace.unit, printable(trace.unit) or "Value")
        yield title, printable(trace.unit), _line(trace, name, trace.value, cuts)
    speed = trace.columns.get("speed_rpm")
    if speed is not None and np.isfinite(speed).any():
        yield QUANTITIES["rpm"], "rpm", _line(trace, name, speed, cuts)


class _ShownAngle(NamedTuple):
    """An angle as it is drawn, the rows at which it starts over, and what to say of it."""

    deg: NDArray[np.float64]
    wraps: NDArray[np.bool_]
    note: str


def _shown_angle(trace: Trace, angle: NDArray[np.float64]) -> _ShownAngle:
    """An inclinometer that swings about 0 is drawn from -180 to 180, not in two parts of 0 to 360."""
    way = trace.columns.get("unwrapped_deg")
    wraps = _wraps(angle, way)
    if "position" not in trace.columns and wraps.any():
        signed = (angle + _HALF_TURN_DEG) % _CIRCLE_DEG - _HALF_TURN_DEG
        fewer = _wraps(signed, way)
        if fewer.sum() < wraps.sum():
            return _ShownAngle(signed, _few(fewer), ", -180 to 180")
    return _ShownAngle(angle, _few(wraps), "")


def _wraps(angle: NDArray[np.float64], way: NDArray[np.float64] | None) -> NDArray[np.bool_]:
    """Rows at which an angle starts over: it does not go the way that the joined angle goes."""
    step = np.diff(angle, prepend=angle[:1])
    wrapped: NDArray[np.bool_] = np.abs(step) > _HALF_TURN_DEG
    if way is None:
        return wrapped
    joined = np.diff(way, prepend=way[:1])
    return np.where(np.isfinite(joined), np.abs(step - joined) > _HALF_TURN_DEG, wrapped)


def _few(wraps: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return wraps if _FILLED * wraps.sum() <= len(wraps) else np.zeros_like(wraps)


def _of_shafts(pair: ShaftTrace, names: list[str], gaps: NDArray[np.int64]) -> Line:
    """How far two encoders have moved apart since the start; whole turns of a preset are left out."""
    edges = np.flatnonzero(_changes(pair.segment))
    starts = np.append(0, edges)
    turns = np.round((pair.difference_deg[starts] - pair.difference_deg[0]) / _CIRCLE_DEG)
    lengths = np.diff(np.append(starts, len(pair.t_ns)))
    base = pair.difference_deg[0] + np.repeat(turns, lengths) * _CIRCLE_DEG
    cuts = _cuts(pair.t_ns, gaps) | _changes(pair.segment) | silences(pair.t_ns)
    t_ns, value, seq, _ = _interrupted(pair.t_ns, pair.difference_deg - base, pair.seq, cuts)
    name = f"{names[0]} ahead of {names[1]} since the start, presets included"
    other = pair.other_bus, pair.other
    return Line(pair.bus, pair.node, name, t_ns, seq, value, (0, 0, 0), partner=other)


def _of_responses(responses: Responses, gaps: NDArray[np.int64], estimated: bool) -> Iterator[Line]:
    """Response of one PDO, and behind it the part of it that it can have waited."""
    name = f"{responses.pdo or 'PDO'} ({hex_code(responses.cob_id, 3)})"
    cuts = _cuts(responses.t_ns, gaps) | silences(responses.t_ns)
    known = np.isfinite(responses.waiting_us)
    if known.any():
        waited = f"{name} waited at most{_ESTIMATED if estimated else ''}"
        t_ns = responses.t_ns[known]
        part = replace(responses, t_ns=t_ns, seq=responses.seq[known])
        apart = _cuts(t_ns, gaps) | silences(t_ns)
        yield replace(_line(part, waited, responses.waiting_us[known], apart), band=True)
    yield _line(responses, name, responses.response_us, cuts)


def _of_series(
    series: Series, several: bool, gaps: NDArray[np.int64], estimated: bool
) -> tuple[str, str, Line]:
    name = printable(series.name)
    whole = name.removesuffix(_SHORT_WINDOWS)
    title = "SYNC period" if name.startswith("SYNC") else whole[:1].upper() + whole[1:]
    label = f"{series.bus} {name}" if several else name
    label += " in 1 s" if title in _IN_WINDOWS and name == whole else ""
    label += _ESTIMATED if estimated and series.unit == "%" else ""
    cuts = _cuts(series.t_ns, gaps) | silences(series.t_ns)
    t_ns, value, _, _ = _interrupted(series.t_ns, series.value, _NO_SEQ, cuts)
    band = name != whole
    return title, series.unit, Line(series.bus, None, label, t_ns, _NO_SEQ, value, (0, 0, 0), band)


def _line(
    source: Trace | Responses,
    name: str,
    value: NDArray[np.float64],
    cuts: NDArray[np.bool_],
    wraps: NDArray[np.bool_] | None = None,
) -> Line:
    t_ns, value, seq, only_wraps = _interrupted(source.t_ns, value, source.seq, cuts, wraps)
    return Line(source.bus, source.node, name, t_ns, seq, value, (0, 0, 0), wraps=only_wraps)


def _coloured(lines: list[Line]) -> list[Line]:
    """Bands first, which lie behind, each in the paler colour of the line that it belongs to."""
    told = [line for line in lines if not line.band]
    bands = [line for line in lines if line.band]
    front = [replace(line, colour=line_colour(i)) for i, line in enumerate(told)]
    back = [replace(line, colour=paler(line_colour(i))) for i, line in enumerate(bands)]
    return [*back, *front]


def _named(line: Line, subject: str) -> Line:
    return replace(line, name=f"{subject} {line.name}")


def _changes(column: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
    changed: NDArray[np.bool_] = np.diff(column, prepend=column[:1]) != 0
    return changed


def _cuts(t_ns: NDArray[np.int64], gaps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Rows that are the first after a capture gap."""
    passed = np.searchsorted(gaps, t_ns, side="right")
    return _changes(passed)


def silences(t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Rows that come after a silence of a second and more that is long for this line."""
    step = np.diff(t_ns, prepend=t_ns[:1])
    usual = np.median(step[1:]) if len(step) > 1 else 0
    silent: NDArray[np.bool_] = step > max(_SILENCE_NS, _SILENT_STEPS * usual)
    return silent


class _Interrupted(NamedTuple):
    t_ns: NDArray[np.int64]
    value: NDArray[np.float64]
    seq: NDArray[np.int64]
    wraps: NDArray[np.intp]


def _interrupted(
    t_ns: NDArray[np.int64],
    value: NDArray[np.float64],
    seq: NDArray[np.int64],
    cuts: NDArray[np.bool_],
    wraps: NDArray[np.bool_] | None = None,
) -> _Interrupted:
    """The series with a NaN just before each cut and wrap, so that no line is drawn across."""
    rows = np.flatnonzero(cuts if wraps is None else cuts | wraps)
    if not len(rows):
        return _Interrupted(t_ns, value, seq, rows)
    only_wraps = np.flatnonzero(~cuts[rows])
    return _Interrupted(
        np.insert(t_ns, rows, t_ns[rows] - 1),
        np.insert(value, rows, np.nan),
        np.insert(seq, rows, seq[rows]) if len(seq) else seq,
        rows[only_wraps] + only_wraps,
    )


_RESPONSE = "PDO response"
_APART = "Encoders apart"
TIMING = ("Bus load", "Frame rate", "SYNC period", _RESPONSE)
_IN_WINDOWS = ("Bus load", "Frame rate")
_FROM_ZERO = ("Bus load", "Frame rate", _RESPONSE)
_RANK = {title: i for i, title in enumerate((*QUANTITIES.values(), *TIMING))}
_NO_VALUES = np.zeros(0, np.float64)
_NO_SEQ = np.zeros(0, np.int64)
