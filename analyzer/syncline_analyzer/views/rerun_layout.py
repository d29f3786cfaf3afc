"""How `session.rrd` opens: which views there are, and that they show the whole capture."""

from dataclasses import dataclass
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
from rerun.recording_stream import RecordingStream

_WHOLE = rr.TimeRange(start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite())
_GLOBAL_VIEW = "view/5c0dca6a-e63f-9cf7-f657-2602590474cc"
"""Holds the range of linked time axes in rerun 0.41. Not public: the version is pinned and a test
looks at the pixels."""

_DETAIL_SECONDS = 5.0
_LANES_HEIGHT = 500


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
class World:
    """From where shapes in 3D are looked at."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Content:
    """What a recording holds and therefore wants a view.

    `strip` marks events, `details` are the plots whose lines were thinned for the overview.
    """

    timelines: list[str]
    lanes: int
    strip: PlotContent | None
    traces: list[PlotContent]
    timing: list[PlotContent]
    details: list[PlotContent]
    histograms: list[PlotContent]
    logs: list[PlotContent]
    world: World | None

    def signature(self) -> str:
        """Names all views; recordings of one application id share the layout opened first."""
        views = [*self.traces, *self.timing, *self.details, *self.histograms, *self.logs]
        parts = [
            *self.timelines,
            str(self.lanes),
            str(self.world is not None),
            *(view.entity for view in views),
        ]
        return "|".join(parts)


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
    """Rows with the height in pixels that each would like."""
    link = rrb.TimeAxis(link="LinkToGlobal")
    rows: list[tuple[int, Any]] = []
    if content.lanes:
        lanes = rrb.StateTimelineView(origin="/nmt", name="NMT states", time_view=link)
        rows.append((min(_LANES_HEIGHT, 70 + 46 * content.lanes), lanes))
    if content.strip:
        rows.append((140, _plot(content.strip, link)))
    for height, plots in ((210, content.traces), (180, content.timing)):
        if plots:
            rows.append((height, _tabs([_plot(plot, link) for plot in plots])))
    rows.append((150, _tabs([_log(log, content.timelines) for log in content.logs])))
    return rrb.Vertical(*(row for _, row in rows), row_shares=[share for share, _ in rows])


def _tabs(views: list[Any]) -> Any:
    return rrb.Tabs(*views, active_tab=0) if len(views) > 1 else views[0]


def _plot(plot: PlotContent, link: rrb.TimeAxis) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=plot.entity,
        name=plot.title,
        axis_x=link,
        axis_y=rrb.ScalarAxis(range=plot.limits) if plot.limits else None,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=plot.legend),
        interaction=rrb.PlotInteraction(tooltip_mode="All"),
    )


def _log(log: PlotContent, timelines: list[str]) -> rrb.TextLogView:
    columns = rrb.TextLogColumns(
        timeline_columns=timelines[:1], text_log_columns=["LogLevel", "Body"]
    )
    return rrb.TextLogView(origin=log.entity, name=log.title, columns=columns)


def _beside(content: Content) -> rrb.Vertical:
    rows: list[tuple[float, Any]] = [
        (3.0, rrb.TextDocumentView(origin="/findings", name="Findings"))
    ]
    closer: list[Any] = [_detail(plot) for plot in content.details]
    if content.world:
        closer.insert(0, _world(content.world))
    if closer:
        rows.append((2.4, _tabs(closer)))
    if content.histograms:
        charts = [rrb.BarChartView(origin=h.entity, name=h.title) for h in content.histograms]
        rows.append((2.0, _tabs(charts)))
    return rrb.Vertical(*(row for _, row in rows), row_shares=[share for share, _ in rows])


def _world(world: World) -> rrb.Spatial3DView:
    eye = rrb.EyeControls3D(position=world.eye, look_target=world.target)
    return rrb.Spatial3DView(origin="/world", name="3D at the cursor", eye_controls=eye)


def _detail(plot: PlotContent) -> rrb.TimeSeriesView:
    around = rr.TimeRange(
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-_DETAIL_SECONDS),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=_DETAIL_SECONDS),
    )
    return rrb.TimeSeriesView(
        origin=plot.entity,
        name=f"{plot.title} at the cursor",
        axis_x=rrb.TimeAxis(link="Independent", view_range=around),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
    )
