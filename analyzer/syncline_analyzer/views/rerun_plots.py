"""Plots in a Rerun recording: thinned lines, every sample where they are thinned, and markers."""

from dataclasses import replace

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis
from syncline_analyzer.views.events import Marks, marks
from syncline_analyzer.views.plots import Line, Panel, panels, shown_at_once
from syncline_analyzer.views.rerun_layout import Device, PlotContent
from syncline_analyzer.views.rerun_names import part, slug
from syncline_analyzer.views.rerun_sink import Axis, Sink
from syncline_analyzer.views.thin import extremes
from syncline_analyzer.views.troubled import NodeKey, troubled

OVERVIEW_POINTS = 10_000
"""Points of a line in the plots over the whole capture; the rest is in the plot at the cursor."""

MAX_MARKERS = 20_000

STRIP = PlotContent(
    "Events, from top to bottom: node lost, node starting, EMCY, finding or blind recorder",
    "/events",
    (0.3, 4.7),
    legend=False,
)
"""The strip of markers, which has no room for a legend: its title says what its rows are."""

LOAD = ("Bus load", "Frame rate")
_PALE = ", each second; pale: each 100 ms"
_COLOUR_NAMES = ("blue", "orange", "green", "violet")
"""Of the first lines of a plot, see `palette.LINE_COLOURS`."""
_LOUDER = (
    "node starting",
    "recorder blind",
    "finding: warning",
    "EMCY",
    "finding: error",
    "node lost",
)
"""Markers that lie over all others, each over those before it."""
_ON_PLOTS = ("EMCY", "finding: error", "finding: warning")
_WIDTHS = {False: 1.5, True: 0.8}
"""Width of a line, and of one that lies behind."""


def panels_of(analysis: Analysis, axis: Axis) -> list[Panel]:
    """Plots of an analysis, each device apart.

    Without times only what belongs to frames can be drawn, by their place in the capture.
    """
    plotted = panels(analysis, nodes_apart=len(analysis.trace_data))
    if axis.clock.timed:
        return plotted
    kept = [replace(p, lines=[line for line in p.lines if len(line.seq)]) for p in plotted]
    return [panel for panel in kept if panel.lines]


def load_plots(plotted: list[Panel]) -> list[PlotContent]:
    """Plots of the bus as a whole."""
    return [_plot(panel) for panel in plotted if panel.title in LOAD]


def timing_plots(plotted: list[Panel], analysis: Analysis) -> list[PlotContent]:
    """Plots of SYNC periods and PDO responses."""
    return [_plot(panel) for panel in _timing(plotted, analysis)]


def timing_details(plotted: list[Panel], analysis: Analysis) -> list[PlotContent]:
    """The same with every sample, of those that were thinned."""
    return [_detail(panel) for panel in _timing(plotted, analysis) if _is_thinned(panel)]


def devices_of(analysis: Analysis, plotted: list[Panel]) -> list[Device]:
    """What each device measured, those that something is to be seen of first."""
    groups: dict[str, list[Panel]] = {}
    for panel in plotted:
        if not panel.is_timing:
            groups.setdefault(panel.subject or panel.title, []).append(panel)
    ranks = troubled(analysis)
    order = sorted(groups.values(), key=lambda group: _rank(group[0], ranks))
    return [
        Device(
            group[0].subject.replace("node ", "", 1) or group[0].title,
            [_plot(panel) for panel in group],
            [_detail(panel) for panel in group if _is_thinned(panel)],
        )
        for group in order
    ]


def write_panel(sink: Sink, panel: Panel, analysis: Analysis) -> None:
    """Write the lines and markers of a plot."""
    root = _entity("plots", panel)
    thinned = _is_thinned(panel)
    for i, line in enumerate(panel.lines):
        _write_line(sink, f"{root}/{i}", line, extremes(line.value, OVERVIEW_POINTS, line.wraps))
        if thinned:
            _write_line(sink, f"{_entity('detail', panel)}/{i}", line, None)
    told = [] if panel.title in LOAD else marks(panel.told(analysis))
    shown = [mark for mark in told if mark.name in _ON_PLOTS]
    height = panel.markers_height() if shown else 0.0
    for mark in shown:
        _write_marks(sink, f"{root}/{_part(mark)}", mark, height)


def write_strip(sink: Sink, analysis: Analysis) -> None:
    """Write the markers of the strip."""
    for mark in marks(analysis):
        _write_marks(sink, f"{STRIP.entity}/{_part(mark)}", mark, mark.row)


def _part(mark: Marks) -> str:
    """Entity of markers; the viewer draws them in the order of their names, the loudest on top."""
    quiet = mark.name not in _LOUDER
    rank = 0 if quiet else 1 + _LOUDER.index(mark.name)
    return f"{rank}_{slug(mark.name)}"


def _timing(plotted: list[Panel], analysis: Analysis) -> list[Panel]:
    shown = shown_at_once(plotted, analysis)
    return [panel for panel in shown if panel.is_timing and panel.title not in LOAD]


def _rank(panel: Panel, ranks: dict[NodeKey, int]) -> tuple[int, str, int]:
    line = panel.lines[0]
    key = line.bus, line.node or 0
    return ranks.get(key, len(ranks) + len(_ON_PLOTS)), *key


def _plot(panel: Panel) -> PlotContent:
    lines = [line for line in panel.lines if not line.band]
    legend, title = len(panel.lines) > 1, panel.label
    if not panel.subject and panel.is_timing and len(lines) <= len(_COLOUR_NAMES):
        legend = False
        if len(lines) > 1:
            title += f": {', '.join(map(_coloured, lines, _COLOUR_NAMES))}"
        title += _PALE if len(lines) < len(panel.lines) else ""
    return PlotContent(title, _entity("plots", panel), panel.limits(), legend)


def _coloured(line: Line, colour: str) -> str:
    """The bus of a line and its colour, for a plot that is too low for a legend."""
    return f"{line.bus} {colour}"


def _detail(panel: Panel) -> PlotContent:
    return PlotContent(panel.label, _entity("detail", panel), legend=len(panel.lines) > 1)


def _entity(root: str, panel: Panel) -> str:
    name = slug(f"{panel.title} {panel.unit}")
    return f"/{root}/{name}/{part(panel.subject)}" if panel.subject else f"/{root}/{name}/all"


def _is_thinned(panel: Panel) -> bool:
    return any(len(line.t_ns) > OVERVIEW_POINTS for line in panel.lines)


def _write_line(sink: Sink, entity: str, line: Line, rows: NDArray[np.intp] | None) -> None:
    """Write some rows of a line, or all."""
    t_ns, value, seq = line.t_ns, line.value, line.seq
    if rows is not None:
        t_ns, value = t_ns[rows], value[rows]
        seq = seq[rows] if len(seq) else seq
    look = rr.SeriesLines(
        names=line.name,
        colors=[line.colour],
        widths=[_WIDTHS[line.band]],
        aggregation_policy="MinMax",
    )
    sink.static(entity, look)
    sink.rows(entity, t_ns, seq, lambda part: rr.Scalars.columns(scalars=value[part]))


def _write_marks(sink: Sink, entity: str, mark: Marks, height: float) -> None:
    moments = mark.moments[:: len(mark.moments) // MAX_MARKERS + 1]
    look = rr.SeriesPoints(
        names=mark.name, colors=[mark.colour], markers=mark.shape, marker_sizes=[6.0]
    )
    sink.static(entity, look)
    sink.rows(
        entity,
        [t_ns for t_ns, _ in moments],
        [seq for _, seq in moments],
        lambda part: rr.Scalars.columns(scalars=np.full(len(moments[part]), float(height))),
    )
