"""`session.rrd`: the analysis as a Rerun recording that opens with its own layout.

Timelines: `capture` (since the first frame) and, where the capture has a date, `utc`; a capture
without times has `frame` (position in the capture) instead.
"""

import hashlib
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import rerun as rr

from syncline_analyzer.results import Analysis, NmtStateRow, Responses
from syncline_analyzer.views import events, rerun_world
from syncline_analyzer.views.events import Event, Marks
from syncline_analyzer.views.histogram import Bars, histograms
from syncline_analyzer.views.markdown import findings_markdown
from syncline_analyzer.views.palette import (
    STATE_COLOURS,
    Rgb,
    line_colour,
    rgba,
)
from syncline_analyzer.views.plots import Line, Panel, panels, shown_at_once
from syncline_analyzer.views.rerun_layout import Content, PlotContent, blueprint
from syncline_analyzer.views.rerun_sink import Axis, Sink
from syncline_analyzer.views.thin import extremes
from syncline_analyzer.views.words import Clock, names_of, node_label, printable
from syncline_schemas.canopen.nmt import NmtState

OVERVIEW_POINTS = 10_000
"""Points of a line in the plots over the whole capture; the rest is in the plot at the cursor."""

MAX_MARKERS = 5_000

_LEVELS = {"error": "ERROR", "warning": "WARN", "info": "INFO"}

_STRIP = "Events: 3 node lost or starting, 2 EMCY, 1 findings and blind recorder"
"""Title of the strip of markers, which has no room for a legend: what its rows are."""

_ON_PLOTS = ("EMCY", "finding: error", "finding: warning")

_LOGS: list[tuple[str, str, Callable[[Analysis], Iterable[Event]]]] = [
    ("EMCY log", "/log/emcy", events.emcy_events),
    ("NMT log", "/log/nmt", events.nmt_events),
    ("Finding log", "/log/findings", events.finding_events),
    ("SDO failures", "/log/sdo", events.sdo_events),
    ("Change log", "/log/changes", events.change_events),
]


def write_rrd(analysis: Analysis, path: Path) -> Path:
    """Write the recording of an analysis, and return the file."""
    axis = Axis(Clock.of(analysis.capture))
    plotted = _drawable(panels(analysis), axis)
    recording = _open(analysis, _content(analysis, axis, plotted), path)
    try:
        sink = Sink(recording, axis)
        _write_lanes(sink, analysis)
        for mark in events.marks(analysis):
            _write_marks(sink, f"/events/{_slug(mark.name)}", mark, mark.row)
        for panel in plotted:
            _write_panel(sink, panel, analysis)
        for responses, bars in histograms(analysis):
            _write_histogram(sink, responses, bars)
        for _, entity, told in _LOGS:
            _write_log(sink, entity, list(told(analysis)))
        rerun_world.write_world(sink, analysis)
        text = findings_markdown(analysis)
        sink.static("/findings", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        recording.flush()
    finally:
        recording.disconnect()
    return path


def _open(analysis: Analysis, content: Content, path: Path) -> rr.RecordingStream:
    capture = analysis.capture
    identity = f"{capture.files}{capture.first_ns}{capture.frames}"
    recording = rr.RecordingStream(
        f"syncline-{_digest(content.signature())[:8]}",
        recording_id=_digest(identity)[:16],
        send_properties=False,
    )
    recording.set_log_time_enabled(False)
    recording.save(path, default_blueprint=blueprint(content))
    names = ", ".join(Path(file).name for file in capture.files)
    recording.send_recording_name(printable(names))
    if capture.start_utc_ns is not None:
        recording.send_recording_start_time_nanos(capture.start_utc_ns)
    return recording


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode(errors="replace")).hexdigest()


def _slug(text: str) -> str:
    return re.sub(r"\W+", "_", text.lower()).strip("_")


def _part(text: str) -> str:
    """A name as one part of an entity path; the viewer titles lanes with it."""
    return re.sub(r"[^\w.-]+", "_", text)


def _drawable(plotted: list[Panel], axis: Axis) -> list[Panel]:
    """Without times only what belongs to frames can be drawn, by their place in the capture."""
    if axis.clock.timed:
        return plotted
    kept = [replace(p, lines=[line for line in p.lines if len(line.seq)]) for p in plotted]
    return [panel for panel in kept if panel.lines]


def _content(analysis: Analysis, axis: Axis, plotted: list[Panel]) -> Content:
    strip = (
        PlotContent(_STRIP, "/events", (0.3, 3.7), legend=False) if events.marks(analysis) else None
    )
    logs = [PlotContent(title, entity) for title, entity, told in _LOGS if any(told(analysis))]
    shown = shown_at_once(plotted)
    plots = [
        (p, PlotContent(p.label, _entity("plots", p), p.limits(), legend=len(p.lines) > 1))
        for p in shown
    ]
    return Content(
        timelines=axis.timelines,
        lanes=len({(row.bus, row.node) for row in analysis.nmt_states}),
        strip=strip,
        traces=[plot for panel, plot in plots if not panel.is_timing],
        timing=[plot for panel, plot in plots if panel.is_timing],
        details=[PlotContent(p.label, _entity("detail", p)) for p in shown if _is_thinned(p)],
        histograms=[
            PlotContent(f"{bars.label} [answers per us]", _histogram_entity(responses))
            for responses, bars in histograms(analysis)
        ],
        logs=logs,
        world=rerun_world.world_of(analysis),
    )


def _entity(root: str, panel: Panel) -> str:
    name = _slug(f"{panel.title} {panel.unit}")
    return f"/{root}/{name}/{_part(panel.subject)}" if panel.subject else f"/{root}/{name}/all"


def _is_thinned(panel: Panel) -> bool:
    return any(len(line.t_ns) > OVERVIEW_POINTS for line in panel.lines)


def _write_lanes(sink: Sink, analysis: Analysis) -> None:
    lanes: dict[tuple[str, int], list[NmtStateRow]] = {}
    for row in analysis.nmt_states:
        lanes.setdefault((row.bus, row.node), []).append(row)
    labels = names_of(analysis.nodes)
    states = [str(state) for state in NmtState]
    colours = [rgba(STATE_COLOURS[state]) for state in states]
    look = rr.StateConfiguration(values=states, labels=states, colors=colours)
    for (bus, node), rows in lanes.items():
        label = labels.get((bus, node), node_label(node))
        entity = f"/nmt/{_part(bus)}/{_part(f'{node:03}{label.removeprefix(str(node))}')}"
        sink.static(entity, look)
        _write_lane(sink, entity, rows)


def _write_lane(sink: Sink, entity: str, rows: list[NmtStateRow]) -> None:
    last = rows[-1]
    shown = [*(row.state for row in rows), ""]
    t_ns = [*(row.start_ns for row in rows), max(last.end_ns, last.start_ns)]
    seq = [*(row.evidence or 0 for row in rows), (last.evidence or 0) + 1]
    if not sink.axis.clock.timed:
        shown, t_ns, seq = shown[:-1], t_ns[:-1], seq[:-1]
    sink.rows(entity, t_ns, seq, lambda part: rr.StateChange.columns(state=shown[part]))


def _write_panel(sink: Sink, panel: Panel, analysis: Analysis) -> None:
    root = _entity("plots", panel)
    for i, line in enumerate(panel.lines):
        _write_line(sink, f"{root}/{i}", line, extremes(line.value, OVERVIEW_POINTS, line.wraps))
        if _is_thinned(panel):
            everything = np.arange(len(line.t_ns))
            _write_line(sink, f"{_entity('detail', panel)}/{i}", line, everything)
    shown = [mark for mark in events.marks(panel.told(analysis)) if mark.name in _ON_PLOTS]
    height = panel.markers_height() if shown else 0.0
    for mark in shown:
        _write_marks(sink, f"{root}/{_slug(mark.name)}", mark, height)


def _write_line(
    sink: Sink, entity: str, line: Line, rows: "np.ndarray[tuple[int], np.dtype[np.intp]]"
) -> None:
    t_ns, value = line.t_ns[rows], line.value[rows]
    seq = line.seq[rows] if len(line.seq) else line.seq
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


def _histogram_entity(responses: Responses) -> str:
    return f"/histogram/{_part(responses.bus)}/{responses.cob_id:03X}h"


def _write_histogram(sink: Sink, responses: Responses, bars: Bars) -> None:
    chart = rr.BarChart(
        bars.per_us,
        abscissa=bars.middle_us,
        widths=bars.width_us.astype(np.float32),
        color=_HISTOGRAM_COLOUR,
    )
    sink.static(_histogram_entity(responses), chart)


_WIDTHS = {False: 1.5, True: 0.8}
"""Width of a line, and of one that lies behind."""

_HISTOGRAM_COLOUR: Rgb = line_colour(2)


def _write_log(sink: Sink, entity: str, told: list[Event]) -> None:
    told.sort(key=lambda event: (event.t_ns, event.seq or 0))
    clock = sink.axis.clock
    sink.rows(
        entity,
        [event.t_ns for event in told],
        [event.seq or 0 for event in told],
        lambda part: rr.TextLog.columns(
            text=[f"{clock.short(event.t_ns)}  {event.text}" for event in told[part]],
            level=[_LEVELS[event.severity] for event in told[part]],
        ),
    )
