"""Plots of the report as data for plotly: thinned so that a page stays small, peaks kept."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis
from syncline_analyzer.views.events import marks
from syncline_analyzer.views.palette import SEVERITY_COLOURS, css
from syncline_analyzer.views.plots import Line, Panel, panels, shown_at_once
from syncline_analyzer.views.thin import envelope, extremes
from syncline_analyzer.views.words import Clock

POINTS_OF_A_PAGE = 80_000
MAX_POINTS, MIN_POINTS = 4_000, 100
MAX_LINES = 40
"""Lines of one plot; of more, those that reach farthest up and down."""
MAX_MARKS, MAX_BANDS = 1_000, 200

_OUTLINE = 8
"""Points of a stretch that are worth an outline; with more holes a band is drawn as a line."""

_LONGEST_BAND = 0.2

_ON_PLOTS = ("EMCY", "EMCY cleared", "node lost")
_SYMBOLS = {"down": "triangle-down", "up": "triangle-up", "diamond": "diamond", "square": "square"}


def plots_of(analysis: Analysis) -> list[dict[str, Any]]:
    """Plots in the order of the page: id, group ("traces" or "timing"), titles, traces for plotly.

    `x` are seconds of capture time. A capture without times has no plots.
    """
    clock = Clock.of(analysis.capture)
    drawn = shown_at_once(panels(analysis)) if clock.timed else []
    lines = sum(min(len(panel.lines), MAX_LINES) for panel in drawn)
    points = max(MIN_POINTS, min(MAX_POINTS, POINTS_OF_A_PAGE // max(lines, 1)))
    plots = [_over_time(panel, analysis, clock, points) for panel in drawn]
    return [{"id": f"plot-{i}", **plot} for i, plot in enumerate(plots)]


def bands_of(analysis: Analysis) -> list[tuple[float, float, str]]:
    """Stretches of the findings that are marked in a plot: start and end [s], colour.

    A finding that lasts for most of the capture is only marked where it starts.
    """
    clock = Clock.of(analysis.capture)
    longest = analysis.capture.duration_ns * _LONGEST_BAND
    return [
        (
            _second(row.start_ns, clock),
            _second(row.end_ns if row.end_ns - row.start_ns <= longest else row.start_ns, clock),
            css(SEVERITY_COLOURS[row.severity]),
        )
        for row in analysis.findings[:MAX_BANDS]
        if clock.timed
    ]


def _second(t_ns: int, clock: Clock) -> float:
    return (t_ns - clock.first_ns) / 1e9


def _over_time(panel: Panel, analysis: Analysis, clock: Clock, points: int) -> dict[str, Any]:
    lines = _farthest(panel.lines)
    left_out = len(panel.lines) - len(lines)
    return {
        "group": "timing" if panel.is_timing else "traces",
        "title": panel.label + (f", {left_out} lines left out" if left_out else ""),
        "y_title": panel.unit,
        "y_range": panel.limits(),
        "lines": [line.name for line in lines],
        "bands": bands_of(panel.told(analysis)),
        "traces": [
            *(_trace(line, clock, points) for line in lines),
            *_marks(panel, analysis, clock),
        ],
    }


def _farthest(lines: list[Line]) -> list[Line]:
    """The lines of the widest reach, in their order."""
    if len(lines) <= MAX_LINES:
        return lines
    kept = sorted(range(len(lines)), key=lambda i: -_reach(lines[i].value))[:MAX_LINES]
    return [lines[i] for i in sorted(kept)]


def _reach(value: NDArray[np.float64]) -> float:
    known = value[np.isfinite(value)]
    return float(np.ptp(known)) if len(known) else 0.0


def _trace(line: Line, clock: Clock, points: int) -> dict[str, Any]:
    outlines = np.count_nonzero(np.isnan(line.value)) + 1
    if line.band and len(line.value) > points > _OUTLINE * outlines:
        return _band(line, clock, points)
    rows = extremes(line.value, points, line.wraps)
    return {
        "name": line.name,
        "mode": "lines" if len(rows) > 1 else "markers",
        "x": _seconds(line.t_ns[rows], clock),
        "y": _plain(line.value[rows]),
        "line": {"color": css(line.colour), "width": 0.8 if line.band else 1.3},
    }


def _band(line: Line, clock: Clock, points: int) -> dict[str, Any]:
    """What lies between the smallest and the largest of many values, as an outline."""
    t_ns, value = envelope(line.t_ns, line.value, points)
    return {
        "name": f"{line.name}, smallest to largest",
        "mode": "lines",
        "x": _seconds(t_ns, clock),
        "y": _plain(value),
        "fill": "toself",
        "fillcolor": css(line.colour),
        "opacity": 0.55,
        "hoverinfo": "skip",
        "line": {"color": css(line.colour), "width": 0.5},
    }


def _seconds(t_ns: NDArray[np.int64], clock: Clock) -> list[float]:
    seconds: list[float] = np.round((t_ns - clock.first_ns) / 1e9, 6).tolist()
    return seconds


def _marks(panel: Panel, analysis: Analysis, clock: Clock) -> Iterator[dict[str, Any]]:
    for mark in marks(panel.told(analysis)):
        if mark.name in _ON_PLOTS:
            moments = mark.moments[:: len(mark.moments) // MAX_MARKS + 1]
            yield {
                "name": mark.name,
                "mode": "markers",
                "x": [_second(t_ns, clock) for t_ns, _ in moments],
                "y": [panel.markers_height()] * len(moments),
                "marker": {"color": css(mark.colour), "symbol": _SYMBOLS[mark.shape], "size": 9},
            }


def _plain(values: NDArray[np.float64]) -> list[float | None]:
    """Six significant digits, None for NaN."""
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in values.tolist()]
