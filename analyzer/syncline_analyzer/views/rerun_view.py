"""`session.rrd`: the analysis as a Rerun recording that opens with its own layout.

Timelines: `capture` (since the first frame) and, where the capture has a date, `utc`; a capture
without times has `frame` (position in the capture) instead.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import rerun as rr

from syncline_analyzer.results import Analysis
from syncline_analyzer.views import rerun_plots, rerun_world
from syncline_analyzer.views.events import marks
from syncline_analyzer.views.frame_rows import ReadFrames
from syncline_analyzer.views.markdown import findings_markdown
from syncline_analyzer.views.plots import Panel
from syncline_analyzer.views.rerun_histograms import histogram_plots, write_histograms
from syncline_analyzer.views.rerun_lanes import lanes_of, write_lanes
from syncline_analyzer.views.rerun_layout import Content, blueprint
from syncline_analyzer.views.rerun_logs import (
    FRAMES,
    Decode,
    logs_of,
    write_frames,
    write_logs,
)
from syncline_analyzer.views.rerun_sink import Axis, Sink
from syncline_analyzer.views.words import Clock, printable
from syncline_schemas.records import dataclass

PROPERTIES = "syncline"
"""Group of the properties by which a catalog of many recordings tells them apart."""


@dataclass(frozen=True, slots=True)
class Label:
    """What tells a recording from the others of a catalog.

    Attributes:
        recording_id: under which the catalog knows it.
        name: what a viewer calls it.
        properties: by name; a list is written as it is, None is left out.
    """

    recording_id: str
    name: str
    properties: Mapping[str, Any]


def write_rrd(
    analysis: Analysis,
    path: Path,
    read_frames: ReadFrames | None = None,
    label: Label | None = None,
    decode: Decode | None = None,
) -> Path:
    """Write the recording of an analysis, and return the file.

    With `read_frames` (`Session.frames`) it also lists frames: all of a short capture, of a longer
    one those around its events; with `decode` (`Session.decoding`) those of a short one tell their
    values. Without `label` it is called by the files of the capture.
    """

    def open_at(recording: rr.RecordingStream, layout: rr.blueprint.Blueprint) -> None:
        recording.save(path, layout)

    write_recording(analysis, open_at, read_frames, label, decode)
    return path


Open = Callable[[rr.RecordingStream, rr.blueprint.Blueprint], None]
"""Says where a recording goes, and gives it its layout."""


def write_recording(
    analysis: Analysis,
    open_at: Open,
    read_frames: ReadFrames | None = None,
    label: Label | None = None,
    decode: Decode | None = None,
) -> None:
    """Write the recording of an analysis to wherever `open_at` lets it go."""
    analysis = _with_devices_as_names(analysis)
    axis = Axis(Clock.of(analysis.capture))
    plotted = rerun_plots.panels_of(analysis, axis)
    content = _content(analysis, axis, plotted, frames=read_frames is not None)
    recording = _open(analysis, content, open_at, label or _own_label(analysis))
    try:
        sink = Sink(recording, axis)
        text = findings_markdown(analysis)
        sink.static("/findings", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        write_lanes(sink, analysis)
        rerun_plots.write_strip(sink, analysis)
        write_logs(sink, analysis)
        write_histograms(sink, analysis)
        for panel in plotted:
            rerun_plots.write_panel(sink, panel, analysis)
        rerun_world.write_worlds(sink, analysis)
        if read_frames is not None:
            write_frames(sink, analysis, read_frames, decode)
        recording.flush()
    finally:
        recording.disconnect()


def _open(analysis: Analysis, content: Content, open_at: Open, label: Label) -> rr.RecordingStream:
    recording = rr.RecordingStream(
        f"syncline-{_digest(content.signature())[:8]}",
        recording_id=label.recording_id,
        send_properties=False,
    )
    recording.set_log_time_enabled(False)
    open_at(recording, blueprint(content))
    recording.send_recording_name(printable(label.name))
    if analysis.capture.start_utc_ns is not None:
        recording.send_recording_start_time_nanos(analysis.capture.start_utc_ns)
    told = {name: value for name, value in label.properties.items() if value is not None}
    if told:
        recording.send_property(PROPERTIES, rr.AnyValues(**told))
    return recording


def _own_label(analysis: Analysis) -> Label:
    """By what a capture is called and known that stands alone."""
    capture = analysis.capture
    identity = _digest(f"{capture.files}{capture.first_ns}{capture.frames}")[:16]
    return Label(identity, ", ".join(Path(file).name for file in capture.files), {})


def _with_devices_as_names(analysis: Analysis) -> Analysis:
    """Nodes that nobody gave a name are called by their device."""
    nodes = [replace(row, name=row.name or row.device) for row in analysis.nodes]
    return replace(analysis, nodes=nodes)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode(errors="replace")).hexdigest()


def _content(analysis: Analysis, axis: Axis, plotted: list[Panel], *, frames: bool) -> Content:
    return Content(
        timelines=axis.timelines,
        lanes=lanes_of(analysis),
        strip=rerun_plots.STRIP if marks(analysis) else None,
        load=rerun_plots.load_plots(plotted),
        devices=rerun_plots.devices_of(analysis, plotted),
        timing=rerun_plots.timing_plots(plotted, analysis),
        details=rerun_plots.timing_details(plotted, analysis),
        histograms=histogram_plots(analysis),
        logs=logs_of(analysis),
        frames=FRAMES if frames else None,
        worlds=rerun_world.worlds_of(analysis),
    )
