"""How `session.rrd` opens: which views there are, and that they show the whole capture."""

from collections.abc import Sequence
from dataclasses import field
from typing import Any, Literal

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TimelineColumn
from rerun.recording_stream import RecordingStream

from syncline_schemas.records import dataclass

_WHOLE = rr.TimeRange(start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite())
_GLOBAL_VIEW = "view/5c0dca6a-e63f-9cf7-f657-2602590474cc"
"""Holds the range of linked time axes in rerun 0.41. Not public: the version is pinned and a test
looks at the pixels."""

VERSION = 2
"""Of the layout: one that was opened with an older version does not take it over."""

DETAIL_SECONDS = 5.0
_LANE, _LANES_HEAD, _LANES = 40, 66, 306
"""Height of a lane, of what is above the lanes, and at most of them all."""


class CaptureBlueprint(rrb.Blueprint):
    """A blueprint whose linked time axes open on the whole capture instead of on 60 s."""

    def _log_to_stream(self, stream: RecordingStream) -> None:
        super()._log_to_stream(stream)
        stream.log(f"{_GLOBAL_VIEW}/TimeAxis", rrb.TimeAxis(view_range=_WHOLE))


@dataclass(frozen=True, slots=True)
class PlotContent:
    """One plot: its title, the entity that holds its lines, and the limits of its values."""

    title: str
    entity: str
    limits: tuple[float, float] | None = None
    legend: bool = True


@dataclass(frozen=True, slots=True)
class Lanes:
    """Lanes of NMT states that are shown together: a title and their entities.

    `high` is the number of lanes that there is room for; by default that of the entities.
    """

    title: str
    entities: Sequence[str]
    high: int | None = None


@dataclass(frozen=True, slots=True)
class Device:
    """What one device measured: over the whole capture, and where thinned, also at the cursor."""

    title: str
    plots: list[PlotContent]
    details: list[PlotContent] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class World:
    """Shapes in 3D: a title, the entity that holds them, and from where they are looked at."""

    title: str
    entity: str
    eye: tuple[float, float, float]
    target: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Content:
    """What a recording holds and therefore wants a view; rows of views are tabs of one place.

    `strip` marks events, `details` are the timing plots whose lines were thinned for the overview.
    """

    timelines: list[str]
    lanes: list[Lanes]
    strip: PlotContent | None
    load: list[PlotContent]
    devices: list[Device]
    timing: list[PlotContent]
    details: list[PlotContent]
    histograms: list[PlotContent]
    logs: list[PlotContent]
    frames: PlotContent | None
    worlds: list[World]

    def signature(self) -> str:
        """Names all views; recordings of one application id share the layout opened first."""
        return f"{VERSION}|{self!r}"


def blueprint(content: Content) -> CaptureBlueprint:
    """The layout of a recording: lanes and plots on one time axis, words and shapes beside it."""
    return CaptureBlueprint(
        rrb.Horizontal(_over_time(content), _beside(content), column_shares=[5, 3]),
        rrb.TimePanel(timeline=content.timelines[0], state="collapsed", play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _over_time(content: Content) -> rrb.Vertical:
    """Rows with the height in pixels that each would like, on one time axis."""
    link = rrb.TimeAxis(link="LinkToGlobal")
    rows: list[tuple[int, Any]] = [(185, rrb.TextDocumentView(origin="/findings", name="Findings"))]
    if content.lanes:
        high = content.lanes[0].high or len(content.lanes[0].entities)
        height = min(_LANES, _LANES_HEAD + _LANE * high)
        rows.append((height, _tabs([_lanes(some, link) for some in content.lanes])))
    if content.strip:
        rows.append((105, _plot(content.strip, link)))
    if content.load:
        rows.append((115, _tabs([_plot(plot, link) for plot in content.load])))
    if content.devices:
        rows.append((270, _tabs([_device(device, link) for device in content.devices])))
    return _rows(rows)


def _beside(content: Content) -> rrb.Vertical:
    link = rrb.TimeAxis(link="LinkToGlobal")
    rows: list[tuple[int, Any]] = []
    if content.timing:
        rows.append((145, _tabs([_plot(plot, link) for plot in content.timing])))
    if content.histograms:
        rows.append((140, _tabs([_histogram(chart) for chart in content.histograms])))
    rows.append((185, _tabs([_log(log, content.timelines) for log in content.logs])))
    if content.frames:
        rows.append((185, _log(content.frames, content.timelines, frames=True)))
    closer: list[Any] = [_world(world) for world in content.worlds]
    closer += [_detail(device) for device in content.devices if device.details]
    closer += [_around(plot) for plot in content.details]
    if closer:
        rows.append((280, _tabs(closer)))
    return _rows(rows)


def _rows(rows: list[tuple[int, Any]]) -> rrb.Vertical:
    return rrb.Vertical(*(row for _, row in rows), row_shares=[height for height, _ in rows])


def _tabs(views: list[Any]) -> Any:
    return rrb.Tabs(*views, active_tab=0) if len(views) > 1 else views[0]


def _lanes(lanes: Lanes, link: rrb.TimeAxis) -> rrb.StateTimelineView:
    contents = [f"+ {entity}" for entity in lanes.entities]
    return rrb.StateTimelineView(origin="/nmt", contents=contents, name=lanes.title, time_view=link)


def _plot(plot: PlotContent, link: rrb.TimeAxis) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=plot.entity,
        name=plot.title,
        axis_x=link,
        axis_y=rrb.ScalarAxis(range=plot.limits) if plot.limits else None,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=plot.legend),
        interaction=rrb.PlotInteraction(tooltip_mode="All"),
    )


def _device(device: Device, link: rrb.TimeAxis) -> rrb.Vertical:
    return rrb.Vertical(*(_plot(plot, link) for plot in device.plots), name=device.title)


def _log(log: PlotContent, timelines: list[str], *, frames: bool = False) -> rrb.TextLogView:
    """A log whose lines begin with their time: the viewer's own column would be cut short."""
    columns: list[Literal["Body", "LogLevel"]] = ["Body"] if frames else ["LogLevel", "Body"]
    return rrb.TextLogView(
        origin=log.entity,
        name=log.title,
        columns=rrb.TextLogColumns(
            timeline_columns=[TimelineColumn(name, visible=False) for name in timelines],
            text_log_columns=columns,
        ),
        format_options=rrb.TextLogFormat(monospace_body=frames),
    )


def _histogram(chart: PlotContent) -> rrb.BarChartView:
    return rrb.BarChartView(
        origin=chart.entity, name=chart.title, plot_legend=rrb.PlotLegend(visible=False)
    )


def _world(world: World) -> rrb.Spatial3DView:
    eye = rrb.EyeControls3D(position=world.eye, look_target=world.target)
    return rrb.Spatial3DView(origin=world.entity, name=world.title, eye_controls=eye)


def _detail(device: Device) -> rrb.Vertical:
    return rrb.Vertical(
        *(_around(plot) for plot in device.details), name=f"{device.title} at the cursor"
    )


def _around(plot: PlotContent) -> rrb.TimeSeriesView:
    """Every sample within a few seconds of the cursor."""
    around = rr.TimeRange(
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-DETAIL_SECONDS),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=DETAIL_SECONDS),
    )
    return rrb.TimeSeriesView(
        origin=plot.entity,
        name=f"{plot.title} at the cursor",
        axis_x=rrb.TimeAxis(link="Independent", view_range=around),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=plot.legend),
    )
