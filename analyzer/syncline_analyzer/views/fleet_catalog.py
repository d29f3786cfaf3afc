"""How a catalog of many recordings opens: its table, and one layout for each of them.

The layout names no node and no quantity of one machine alone: it is made from the entities of all
recordings, as `rerun_view` names them, and a view of what a recording lacks stays empty.
"""

from collections.abc import Iterable, Sequence

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint import table as rrt

from syncline_analyzer.views.plots import QUANTITIES, TIMING
from syncline_analyzer.views.rerun_layout import (
    CaptureBlueprint,
    Content,
    Device,
    Lanes,
    PlotContent,
    World,
    blueprint,
)
from syncline_analyzer.views.rerun_logs import LOGS
from syncline_analyzer.views.rerun_names import slug
from syncline_analyzer.views.rerun_plots import LOAD, STRIP
from syncline_analyzer.views.rerun_view import PROPERTIES
from syncline_analyzer.views.rerun_world import world_of
from syncline_schemas.records import dataclass

TIMELINES = ("capture", "utc")
MAX_DEVICES = 16
"""Devices that have a tab each; of more, of many unlike machines, there is one for a quantity."""
MAX_CHARTS = 12
_HIGH_LANES = 8
LINK = "recording link"
"""Column of a catalog's table that leads to the recording."""
_PREVIEW_RANGE = rrb.TimeAxis(
    link="Independent",
    view_range=rr.TimeRange(
        start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite()
    ),
)
_COLUMNS = {
    "machine": "Machine",
    "date": "Date",
    "verdict": "Verdict",
    "errors": "Errors",
    "warnings": "Warnings",
    "infos": "Notes",
    "worst": "Worst finding",
    "duration_s": "Seconds",
    "blind_s": "Blind [s]",
    "frames": "Frames",
    "nodes": "Nodes",
    "buses": "Buses",
    "bitrates": "Bit rates",
    "capture_id": "Capture",
}
"""Properties in the order of the table's columns, and what they are called there."""
_TECHNICAL = (
    "rerun_segment_id",
    "rerun_layer_names",
    "rerun_storage_urls",
    "rerun_last_updated_at",
    "rerun_num_chunks",
    "rerun_size_bytes",
    "property:RecordingInfo:name",
    "property:RecordingInfo:start_time",
    "capture:start",
    "capture:end",
    "utc:end",
)
"""Columns that the catalog has by itself and that say nothing new."""


def property_column(name: str) -> str:
    """Column of a property in a catalog's table.

    >>> property_column("machine")
    'property:syncline:machine'
    """
    return f"property:{PROPERTIES}:{name}"


@dataclass(frozen=True, slots=True)
class _Plot:
    """A plot of some recording: its quantity and what it is of, as entities name them."""

    quantity: str
    subject: str

    def content(self, root: str) -> PlotContent:
        """The plot by itself."""
        title = f"{_title(self.quantity)} of {_words(self.subject)}"
        return PlotContent(title, f"/{root}/{self.quantity}/{self.subject}")

    def is_of(self, titles: Sequence[str]) -> bool:
        """Whether its quantity is one of these titles."""
        return self.quantity.startswith(tuple(map(slug, titles)))


def capture_layout(entities: Iterable[str]) -> CaptureBlueprint:
    """One layout for all recordings that have some of these entities."""
    parts = sorted({tuple(entity.strip("/").split("/")) for entity in entities})
    lanes = sum(part[0] == "nmt" for part in parts)
    plots, thinned = _plots(parts, "plots"), _plots(parts, "detail")
    timing = [title for title in TIMING if title not in LOAD]
    return blueprint(
        Content(
            timelines=list(TIMELINES),
            lanes=[Lanes("NMT states", ["/nmt/**"], min(lanes, _HIGH_LANES))] if lanes else [],
            strip=STRIP if any(part[0] == "events" for part in parts) else None,
            load=_by_quantity([each for each in plots if each.is_of(LOAD)], "plots"),
            devices=_devices(
                [each for each in plots if not each.is_of(TIMING)],
                [each for each in thinned if not each.is_of(TIMING)],
            ),
            timing=_by_quantity([each for each in plots if each.is_of(timing)], "plots"),
            details=_by_quantity([each for each in thinned if each.is_of(timing)], "detail"),
            histograms=_histograms(parts),
            logs=[PlotContent(title, entity) for title, entity in LOGS.items()],
            frames=None,
            worlds=_worlds(parts),
        )
    )


def table_blueprint() -> rrt.TableBlueprint:
    """The catalog's table: what is worst first, its states at a glance; and as cards."""
    link = rrt.Column(LINK, name="NMT states", column_type=rrt.PreviewCell(_lanes_preview()))
    told = [rrt.Column(property_column(name), name=title) for name, title in _COLUMNS.items()]
    hidden = [rrt.Column(name, visible=False) for name in _TECHNICAL]
    begun = rrt.Column("utc:start", name="Begun (UTC)")
    return rrt.TableBlueprint(
        table_layout=rrt.TableLayout(
            columns=[rrt.Column(LINK, name="Recording"), *told, begun, *hidden]
        ),
        card_layout=rrt.CardLayout(
            title="property:RecordingInfo:name",
            link=LINK,
            fields=[link, *(each for each in told if each.name in ("Verdict", "Worst finding"))],
        ),
        default_layout="table",
        previews_config=rrt.PreviewsConfig(timeline=TIMELINES[0]),
        sort_by=rrt.SortBy(property_column("errors"), direction="descending"),
    )


def _lanes_preview() -> rrb.StateTimelineView:
    return rrb.StateTimelineView(origin="/nmt", name="NMT states", time_view=_PREVIEW_RANGE)


def _plots(parts: Iterable[Sequence[str]], root: str) -> list[_Plot]:
    """Plots below an entity, those of one quantity together."""
    lines = (part for part in parts if part[0] == root and len(part) > 3)
    return sorted({_Plot(part[1], part[2]) for part in lines}, key=_rank)


def _devices(plots: Sequence[_Plot], thinned: Sequence[_Plot]) -> list[Device]:
    """Tabs of what devices measured: one for each device, or for each quantity."""
    subjects = sorted({plot.subject for plot in plots}, key=_numbered)
    if len(subjects) > MAX_DEVICES:
        return [Device(each.title, [each]) for each in _by_quantity(plots, "plots")]
    return [
        Device(
            _words(subject).removeprefix("node "),
            [each.content("plots") for each in plots if each.subject == subject],
            [each.content("detail") for each in thinned if each.subject == subject],
        )
        for subject in subjects
    ]


def _by_quantity(plots: Sequence[_Plot], root: str) -> list[PlotContent]:
    """A plot of each quantity with the lines of all nodes."""
    quantities = dict.fromkeys(plot.quantity for plot in plots)
    return [PlotContent(_title(each), f"/{root}/{each}") for each in quantities]


def _histograms(parts: Iterable[Sequence[str]]) -> list[PlotContent]:
    charts = [part for part in parts if part[0] == "histogram" and len(part) == 3]
    charts.sort(key=lambda part: ("SYNC" not in part[2], part))
    return [
        PlotContent(
            f"{part[1]} {_words(part[2].removeprefix(part[1]))} [count per us]",
            "/" + "/".join(part),
        )
        for part in charts[:MAX_CHARTS]
    ]


def _worlds(parts: Iterable[Sequence[str]]) -> list[World]:
    shapes: dict[int, int] = {}
    for part in parts:
        if part[0] == "world" and len(part) > 2:
            group, number = int(part[1]), int(part[2])
            shapes[group] = max(shapes.get(group, 0), number + 1)
    return [world_of(group, len(shapes), count) for group, count in sorted(shapes.items())]


def _title(quantity: str) -> str:
    """Title of a plot, from how the quantity is called in entities.

    >>> _title("bus_load"), _title("pdo_response_us"), _title("vibration_velocity_mm_s")
    ('Bus load', 'PDO response [us]', 'Vibration velocity [mm/s]')
    """
    for title in (*QUANTITIES.values(), *TIMING):
        name = slug(title)
        if quantity == name:
            return title
        if quantity.startswith(f"{name}_"):
            return f"{title} [{quantity.removeprefix(f'{name}_').replace('_', '/')}]"
    return _words(quantity).capitalize()


def _rank(plot: _Plot) -> tuple[int, str, tuple[int, str]]:
    titles = (*QUANTITIES.values(), *TIMING)
    found = (i for i, title in enumerate(titles) if plot.is_of([title]))
    return next(found, len(titles)), plot.quantity, _numbered(plot.subject)


def _numbered(subject: str) -> tuple[int, str]:
    """Nodes by number.

    >>> sorted(["node_10_tilt", "node_2_guide"], key=_numbered)
    ['node_2_guide', 'node_10_tilt']
    """
    numbers = [int(part) for part in subject.split("_") if part.isdecimal()]
    return (numbers[0] if numbers else 0), subject


def _words(name: str) -> str:
    return name.replace("_", " ")
