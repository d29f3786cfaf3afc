"""Plots of the report as data for plotly: thinned so that a page stays small, peaks kept."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis
from syncline_analyzer.views.events import marks
from syncline_analyzer.views.histogram import Bars, histograms
from syncline_analyzer.views.palette import SEVERITY_COLOURS, css, line_colour
from syncline_analyzer.views.plots import Line, Panel, panels
from syncline_analyzer.views.thin import extremes
from syncline_analyzer.views.words import Clock

POINTS_OF_A_PAGE = 120_000
MAX_POINTS, MIN_POINTS = 4_000, 500
MAX_MARKS, MAX_BANDS = 1_000, 200

_LONGEST_BAND = 0.2

_ON_PLOTS = ("EMCY", "EMCY cleared", "node lost")
_SYMBOLS = {"down": "triangle-down", "up": "triangle-up", "diamond": "diamond", "square": "square"}


def plots_of(analysis: Analysis) -> list[dict[str, Any]]:
    """Plots in the order of the page: id, kind ("time" or "bars"), titles, traces for plotly.

    `x` of a plot over time are seconds of capture time. A capture without times has none.
    """
    clock = Clock.of(analysis.capture)
    drawn = panels(analysis) if clock.timed else []
    lines = sum(len(panel.lines) for panel in drawn)
    points = max(MIN_POINTS, min(MAX_POINTS, POINTS_OF_A_PAGE // max(lines, 1)))
    plots = [_over_time(panel, analysis, clock, points) for panel in drawn]
    shown = [bars for _, bars in histograms(analysis)]
    if shown:
        plots.append(_bars(shown))
    return [{"id": f"plot-{i}", **plot} for i, plot in enumerate(plots)]


def bands_of(analysis: Analysis) -> list[tuple[float, float, str]]:
    """Stretches of the findings that are marked in every plot: start and end [s], colour.

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
    traces = [_trace(line, clock, points) for line in panel.lines]
    return {
        "kind": "time",
        "title": panel.label,
        "y_title": panel.unit,
        "y_range": panel.limits(),
        "lines": [line.name for line in panel.lines],
        "traces": [*traces, *_marks(panel, analysis, clock)],
    }


def _trace(line: Line, clock: Clock, points: int) -> dict[str, Any]:
    rows = extremes(line.value, points)
    return {
        "name": line.name,
        "mode": "lines",
        "x": np.round((line.t_ns[rows] - clock.first_ns) / 1e9, 6).tolist(),
        "y": _plain(line.value[rows]),
        "line": {"color": css(line.colour), "width": 1.3},
    }


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


def _bars(shown: list[Bars]) -> dict[str, Any]:
    return {
        "kind": "bars",
        "title": "PDO response times",
        "y_title": "answers per us",
        "x_title": "us after the SYNC",
        "lines": [bars.label for bars in shown],
        "traces": [_bar(bars, css(line_colour(i))) for i, bars in enumerate(shown)],
    }


def _bar(bars: Bars, colour: str) -> dict[str, Any]:
    return {
        "type": "bar",
        "name": bars.label,
        "x": _plain(bars.middle_us),
        "y": _plain(bars.per_us),
        "width": _plain(bars.width_us),
        "opacity": 0.65,
        "marker": {"color": colour, "line": {"width": 0}},
    }


def _plain(values: NDArray[np.float64]) -> list[float | None]:
    """Six significant digits, None for NaN."""
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in values.tolist()]
