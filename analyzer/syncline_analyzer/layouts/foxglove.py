"""A Foxglove layout for the decoded channels of captures: states, EMCY, and what PDOs carry.

Foxglove has no wildcards in message paths, so a layout names the topics of its captures.
"""

import json
from collections.abc import Sequence
from itertools import groupby
from typing import Any

from syncline_analyzer.layouts.channels import DecodedChannel

Json = dict[str, Any]
_COLOURS = (
    "#4e98e2", "#f5774d", "#5cb85c", "#b46ad2", "#e0c341", "#3cc8d2", "#ff82aa", "#aabe5a",
)  # fmt: skip
_STATES_SHARE, _EMCY_SHARE = 38, 45
"""Percent of the height that state lanes take, and that EMCYs take of the left side below."""


def foxglove_layout(channels: Sequence[DecodedChannel]) -> str:
    """The layout as JSON text, to be imported in Foxglove."""
    panels: dict[str, Json] = {}
    panels["StateTransitions!nmt"] = _transitions(
        "NMT states", _paths(channels, "heartbeat", "state_name")
    )
    emcy = _paths(channels, "emcy", "text")
    raw = [each for each in channels if each.service in ("emcy", "sdo")]
    panels["StateTransitions!emcy"] = _transitions("EMCY", emcy)
    panels["StateTransitions!network"] = _transitions(
        "NMT commands and SDO transfers",
        [
            *_paths(channels, "nmt", "command_name"),
            *_paths(channels, "sdo", "text"),
        ],
    )
    log = _tabs(panels, "log", [(each.label + f" {each.service}", _raw(each)) for each in raw])
    plots = _tabs(panels, "plots", list(_plots(channels)))
    words = _split("column", "StateTransitions!emcy", log, _EMCY_SHARE)
    below = _split("row", words, plots, 40)
    above = _split("row", "StateTransitions!nmt", "StateTransitions!network", 65)
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("column", above, below, _STATES_SHARE),
    }
    return json.dumps(layout, indent=2) + "\n"


def _paths(channels: Sequence[DecodedChannel], service: str, field: str) -> list[Json]:
    """One series per channel of a service."""
    return [
        _path(f"{each.topic}.{field}", each.label) for each in channels if each.service == service
    ]


def _path(value: str, label: str) -> Json:
    return {"value": value, "label": label, "enabled": True, "timestampMethod": "publishTime"}


def _transitions(title: str, paths: list[Json]) -> Json:
    return {"foxglovePanelTitle": title, "isSynced": True, "paths": paths}


def _raw(channel: DecodedChannel) -> tuple[str, Json]:
    name = channel.topic.strip("/").replace("/", "-")
    return f"RawMessages!{name}", {"topicPath": channel.topic, "diffEnabled": False}


def _plots(channels: Sequence[DecodedChannel]) -> list[tuple[str, tuple[str, Json]]]:
    """One plot per node: every number of its PDOs."""
    with_numbers = [each for each in channels if each.numbers]
    plots = []
    for label, group in groupby(with_numbers, key=lambda each: each.label):
        members = list(group)
        series = [
            _path(f"{each.topic}.{field.name}", _series(each, field.label, field.unit))
            for each in members
            for field in each.numbers
        ]
        for number, each in enumerate(series):
            each["color"] = _COLOURS[number % len(_COLOURS)]
        name = f"Plot!{members[0].bus}-node{members[0].node}"
        plots.append((label, (name, _plot(label, series))))
    return plots


def _series(channel: DecodedChannel, label: str, unit: str) -> str:
    return f"{channel.service.upper()} {label}" + (f" [{unit}]" if unit else "")


def _plot(title: str, paths: list[Json]) -> Json:
    return {
        "foxglovePanelTitle": title,
        "paths": paths,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }


def _tabs(panels: dict[str, Json], name: str, tabs: list[tuple[str, tuple[str, Json]]]) -> str:
    """A panel of tabs with one panel in each; notes both in `panels`."""
    for _, (panel, config) in tabs:
        panels[panel] = config
    shown = [{"title": title, "layout": panel} for title, (panel, _) in tabs]
    panels[f"Tab!{name}"] = {"activeTabIdx": 0, "tabs": shown}
    return f"Tab!{name}"


def _split(direction: str, first: str | Json, second: str | Json, percent: int) -> Json:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percent}
