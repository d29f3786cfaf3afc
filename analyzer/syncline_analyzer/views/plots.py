"""What is worth plotting in an analysis: lines grouped by quantity, the same in HTML and Rerun."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import TRACE_FLAGS, Analysis, Responses, Series, Trace
from syncline_analyzer.views.palette import Rgb, line_colour
from syncline_analyzer.views.words import hex_code, names_of, node_label, printable, trace_object

QUANTITIES = {
    "deg": "Angle",
    "rpm": "Speed",
    "counts": "Position",
    "mm/s": "Vibration velocity",
    "g": "Vibration acceleration",
    "degC": "Temperature",
}
"""Title of a plot by the unit of its traces."""

_WRAP = 1 << TRACE_FLAGS.index("wrap")


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A line of a plot: t_ns and seq (n,) int64, value (n,) float64, NaN where it is interrupted.

    `seq` is empty where the quantity belongs to no single frame.
    """

    bus: str
    node: int | None
    name: str
    t_ns: NDArray[np.int64]
    seq: NDArray[np.int64]
    value: NDArray[np.float64]
    colour: Rgb


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """A plot: lines of one quantity over one axis."""

    title: str
    unit: str
    lines: list[Line] = field(default_factory=list)

    @property
    def label(self) -> str:
        """Title with unit."""
        return f"{self.title} [{self.unit}]"

    def limits(self) -> tuple[float, float]:
        """Smallest and largest value of all lines; (0, 1) when there is none."""
        values = [line.value[np.isfinite(line.value)] for line in self.lines]
        known = np.concatenate(values) if values else np.zeros(0)
        return (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)


def panels(analysis: Analysis) -> list[Panel]:
    """Plots of an analysis: angles and other traces first, then SYNC, PDO answers and bus load."""
    found: dict[tuple[str, str], Panel] = {}
    for title, unit, line in _lines(analysis):
        panel = found.setdefault((title, unit), Panel(title, unit))
        panel.lines.append(_coloured(line, len(panel.lines)))
    order = [*QUANTITIES.values(), "SYNC period", "PDO response"]
    rank = {title: i for i, title in enumerate(order)}
    return sorted(found.values(), key=lambda panel: rank.get(panel.title, len(rank)))


def _lines(analysis: Analysis) -> Iterator[tuple[str, str, Line]]:
    several = len(analysis.capture.buses) > 1
    gaps = np.array(sorted(gap.end_ns for gap in analysis.capture.gaps), np.int64)
    labels = names_of(analysis.nodes)
    for trace in analysis.trace_data:
        label = labels.get((trace.bus, trace.node), node_label(trace.node))
        yield from _of_trace(trace, f"{trace.bus} {label}" if several else label, gaps)
    for responses in analysis.responses:
        yield "PDO response", "us", _of_responses(responses, several, gaps)
    for series in analysis.series:
        yield _of_series(series, several, gaps)


def _of_trace(trace: Trace, label: str, gaps: NDArray[np.int64]) -> Iterator[tuple[str, str, Line]]:
    name = f"{label} {printable(trace.name)} ({trace_object(trace.object)})"
    angle = trace.columns.get("angle_deg")
    cuts = _cuts(trace.t_ns, gaps) | _changes(trace.segment)
    if _any_known(angle):
        wraps = cuts | ((trace.flags & _WRAP) != 0)
        yield QUANTITIES["deg"], "deg", _line(trace, name, angle, wraps)
    elif len(trace.value):
        title = QUANTITIES.get(trace.unit, printable(trace.unit) or "Value")
        yield title, printable(trace.unit), _line(trace, name, trace.value, cuts)
    speed = trace.columns.get("speed_rpm")
    if _any_known(speed):
        yield QUANTITIES["rpm"], "rpm", _line(trace, name, speed, cuts)


def _any_known(column: NDArray[np.float64] | None) -> bool:
    return column is not None and bool(np.isfinite(column).any())


def _of_responses(responses: Responses, several: bool, gaps: NDArray[np.int64]) -> Line:
    where = f"{responses.bus} " if several else ""
    pdo = responses.pdo or "PDO"
    name = f"{where}node {node_label(responses.node)} {pdo} ({hex_code(responses.cob_id, 3)})"
    cuts = _cuts(responses.t_ns, gaps)
    return _line(responses, name, responses.response_us, cuts)


def _of_series(series: Series, several: bool, gaps: NDArray[np.int64]) -> tuple[str, str, Line]:
    name = printable(series.name)
    title = "SYNC period" if name.startswith("SYNC") else name[:1].upper() + name[1:]
    label = f"{series.bus} {name}" if several else name
    t_ns, value, _ = _interrupted(series.t_ns, series.value, _NO_SEQ, _cuts(series.t_ns, gaps))
    return title, series.unit, Line(series.bus, None, label, t_ns, _NO_SEQ, value, (0, 0, 0))


def _line(
    source: Trace | Responses,
    name: str,
    value: NDArray[np.float64] | None,
    cuts: NDArray[np.bool_],
) -> Line:
    assert value is not None
    t_ns, value, seq = _interrupted(source.t_ns, value, source.seq, cuts)
    return Line(source.bus, source.node, name, t_ns, seq, value, (0, 0, 0))


def _coloured(line: Line, number: int) -> Line:
    return Line(
        line.bus, line.node, line.name, line.t_ns, line.seq, line.value, line_colour(number)
    )


def _changes(column: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
    changed: NDArray[np.bool_] = np.diff(column, prepend=column[:1]) != 0
    return changed


def _cuts(t_ns: NDArray[np.int64], gaps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Rows that are the first after a capture gap."""
    passed = np.searchsorted(gaps, t_ns, side="right")
    return _changes(passed)


def _interrupted(
    t_ns: NDArray[np.int64],
    value: NDArray[np.float64],
    seq: NDArray[np.int64],
    cuts: NDArray[np.bool_],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """The series with a NaN just before each cut, so that no line is drawn across."""
    rows = np.flatnonzero(cuts)
    if not len(rows):
        return t_ns, value, seq
    return (
        np.insert(t_ns, rows, t_ns[rows] - 1),
        np.insert(value, rows, np.nan),
        np.insert(seq, rows, seq[rows]) if len(seq) else seq,
    )


_NO_SEQ = np.zeros(0, np.int64)
