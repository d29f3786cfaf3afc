"""The decoded channels of a capture in Rerun as they are, without an analysis.

Rerun imports the MCAP file itself; a layout maps the fields of its messages to what is drawn.
"""

from collections.abc import Callable, Sequence
from itertools import accumulate, groupby
from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import VisualizerComponentMapping

from syncline_analyzer.layouts.channels import DecodedChannel
from syncline_analyzer.views.palette import STATE_COLOURS, line_colour, rgba
from syncline_analyzer.views.rerun_layout import CaptureBlueprint
from syncline_schemas.canopen.nmt import NmtState

TIMELINE = "message_publish_time"
"""Rerun's name for the stamps closest to the wire."""
_BOOT_UP = "boot-up"
_BOOT_UP_OR_NO_STATE = "boot-up or no state"


def write_plain(captures: Sequence[Path], channels: Sequence[DecodedChannel], path: Path) -> Path:
    """Write a recording of captures as Rerun imports them, with a layout for their channels."""
    recording = rr.RecordingStream("syncline-channels", send_properties=False)
    recording.save(path, default_blueprint=plain_blueprint(channels))
    try:
        for channel in _of(channels, "heartbeat"):
            recording.log(channel.topic, _state_colours(), static=True)
        for capture in captures:
            recording.log_file_from_path(capture)
        recording.flush()
    finally:
        recording.disconnect()
    return path


def plain_blueprint(channels: Sequence[DecodedChannel]) -> CaptureBlueprint:
    """NMT states, a plot per node, and a log of EMCYs."""
    link = rrb.TimeAxis(link="LinkToGlobal")
    rows: list[Any] = []
    if states := _of(channels, "heartbeat"):
        rows.append(
            rrb.StateTimelineView(
                name="NMT states", time_view=link, **_shown(states, lambda each: [_state(each)])
            )
        )
    with_numbers = [each for each in channels if each.numbers]
    plots = [
        _plot(label, list(group), link)
        for label, group in groupby(with_numbers, key=lambda each: each.label)
    ]
    if plots:
        rows.append(rrb.Tabs(*plots, active_tab=0))
    logs = [
        rrb.TextLogView(name=name, **_shown(chosen, lambda each: [_text(each)]))
        for name, chosen in (("EMCY log", _of(channels, "emcy")), ("SDO log", _of(channels, "sdo")))
        if chosen
    ]
    if logs:
        rows.append(rrb.Tabs(*logs, active_tab=0))
    return CaptureBlueprint(
        rrb.Vertical(*rows),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _plot(label: str, channels: Sequence[DecodedChannel], link: rrb.TimeAxis) -> rrb.TimeSeriesView:
    counts = accumulate((len(each.numbers) for each in channels), initial=0)
    firsts = dict(zip((each.topic for each in channels), counts, strict=False))
    shown = _shown(channels, lambda each: _lines(each, firsts[each.topic]))
    return rrb.TimeSeriesView(name=label, axis_x=link, **shown)


def _of(channels: Sequence[DecodedChannel], service: str) -> list[DecodedChannel]:
    return [each for each in channels if each.service == service]


def _shown(
    channels: Sequence[DecodedChannel], look: Callable[[DecodedChannel], list[Any]]
) -> dict[str, Any]:
    """Which entities a view holds, and how each is drawn."""
    return {
        "origin": "/canopen",
        "contents": [f"+ {each.topic}" for each in channels],
        "overrides": {each.topic: look(each) for each in channels},
    }


def _mapping(channel: DecodedChannel, target: str, field: str) -> VisualizerComponentMapping:
    return VisualizerComponentMapping(
        target,
        "SourceComponent",
        source_component=f"{channel.schema}:message",
        selector=f".{field}",
    )


def _state_colours() -> rr.StateConfiguration:
    colours = {
        **STATE_COLOURS,
        _BOOT_UP: STATE_COLOURS[NmtState.INITIALISING],
        _BOOT_UP_OR_NO_STATE: STATE_COLOURS[NmtState.UNKNOWN],
    }
    states = [*map(str, NmtState), _BOOT_UP, _BOOT_UP_OR_NO_STATE]
    return rr.StateConfiguration(
        values=states, labels=states, colors=[rgba(colours[state]) for state in states]
    )


def _state(channel: DecodedChannel) -> Any:
    change = rr.StateChange.from_fields()
    return change.visualizer(mappings=[_mapping(channel, "StateChange:state", "state_name")])


def _lines(channel: DecodedChannel, first: int) -> list[Any]:
    """The numbers of a channel, in the colours from `first` on."""
    return [
        rr.SeriesLines(
            names=f"{channel.service.upper()} {field.label}"
            + (f" [{field.unit}]" if field.unit else ""),
            colors=[line_colour(first + number)],
            aggregation_policy="MinMax",
        ).visualizer(mappings=[_mapping(channel, "Scalars:scalars", field.name)])
        for number, field in enumerate(channel.numbers)
    ]


def _text(channel: DecodedChannel) -> Any:
    log = rr.TextLog.from_fields()
    return log.visualizer(mappings=[_mapping(channel, "TextLog:text", "text")])
