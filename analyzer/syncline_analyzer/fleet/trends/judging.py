"""All trends of a data set: judged together, and what belongs together told once."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from syncline_analyzer.fleet.quantities import QUANTITIES
from syncline_analyzer.fleet.trends.events import event_trends
from syncline_analyzer.fleet.trends.levels import Judged, level_trends
from syncline_analyzer.fleet.trends.limits import FALSE_DISCOVERIES, MANY, MIN_MANY
from syncline_analyzer.fleet.trends.statistics import false_discovery
from syncline_analyzer.fleet.trends.tracks import Tracks
from syncline_analyzer.fleet.trends.trend import Kind, Trend
from syncline_analyzer.fleet.trends.wear import wear_trends

_SAME_DAYS = 1
"""Bins that the onsets of one thing may lie apart."""
_SAME_DRIFT = 7


def trends_of(all_tracks: Iterable[Tracks]) -> list[Trend]:
    """Trends of all quantities; each is told once, of the fleet, the machine or the node."""
    fleets: list[Judged] = []
    machines: list[Judged] = []
    wear: list[Trend] = []
    for tracks in all_tracks:
        if QUANTITIES[tracks.quantity].kind == "events":
            of_fleets, of_machines = event_trends(tracks)
        else:
            of_fleets, of_machines = level_trends(tracks)
        fleets.append(of_fleets)
        machines.append(of_machines)
        if QUANTITIES[tracks.quantity].kind == "growth":
            wear.extend(wear_trends(tracks))
    own, shared = _shared(_sure(machines))
    of_fleets_all = _joined([*_sure(fleets), *shared], _fleet_place)
    return [*of_fleets_all, *_joined(own, _machine_place), *wear]


def _sure(judged: Sequence[Judged]) -> list[Trend]:
    """Trends at the rate of false discoveries that is allowed over all that was judged."""
    p = np.concatenate([np.zeros(0), *(each.p for each in judged)])
    rates = dict(zip(p.tolist(), false_discovery(p).tolist(), strict=True))
    rated = [replace(trend, q=rates.get(trend.p, 1.0)) for each in judged for trend in each.trends]
    return [trend for trend in rated if trend.q <= FALSE_DISCOVERIES]


def _shared(trends: Sequence[Trend]) -> tuple[list[Trend], list[Trend]]:
    """Trends of single machines, and what many of them show from the same days on."""
    own: list[Trend] = []
    shared: list[Trend] = []
    steps = [trend for trend in trends if trend.kind != "drift"]
    own.extend(trend for trend in trends if trend.kind == "drift")
    for alike in _grouped(steps, lambda trend: (trend.tracks.quantity, trend.kind, _sign(trend))):
        left = sorted(alike, key=lambda trend: trend.onset)
        while left:
            near = max((_near(left, trend.onset) for trend in left), key=_machine_count)
            fleet = len({label.machine for label in near[0].tracks.labels})
            if _machine_count(near) < max(MIN_MANY, MANY * fleet):
                break
            shared.append(_together(near, of_fleet=True))
            left = [trend for trend in left if trend not in near]
        own.extend(left)
    return own, shared


def _near(trends: Sequence[Trend], onset: int) -> list[Trend]:
    return [trend for trend in trends if abs(trend.onset - onset) <= _SAME_DAYS]


def _machine_count(trends: Sequence[Trend]) -> int:
    return len({machine for trend in trends for machine in trend.machines})


def _joined(trends: Sequence[Trend], place: Callable[[Trend], tuple[object, ...]]) -> list[Trend]:
    """Trends of one place with onsets near one another as one."""
    found = []
    for alike in _grouped(trends, place):
        left = sorted(alike, key=lambda trend: -trend.size)
        while left:
            apart = _SAME_DRIFT if left[0].slope else _SAME_DAYS
            near = [trend for trend in left if abs(trend.onset - left[0].onset) <= apart]
            found.append(_together(near, of_fleet=left[0].of_fleet))
            left = [trend for trend in left if trend not in near]
    return found


def _together(trends: Sequence[Trend], *, of_fleet: bool) -> Trend:
    """One trend of several, told as the clearest."""
    ordered = sorted(trends, key=lambda trend: -trend.size)
    members = tuple(dict.fromkeys(each for trend in ordered for each in trend.members))
    q, p = min(trend.q for trend in trends), min(trend.p for trend in trends)
    joined = replace(ordered[0], members=members, of_fleet=of_fleet, q=q, p=p)
    if of_fleet and not ordered[0].of_fleet:
        return replace(
            joined,
            onset=min(trend.onset for trend in trends),
            before=_middle([trend.before for trend in trends]),
            after=_middle([trend.after for trend in trends]),
            change=float(np.median([trend.change for trend in trends])),
        )
    return joined


def _middle(values: Sequence[float | None]) -> float | None:
    """Median of those that are known."""
    known = [each for each in values if each is not None]
    return float(np.median(known)) if known else None


def _grouped(
    trends: Sequence[Trend], key: Callable[[Trend], tuple[object, ...]]
) -> list[list[Trend]]:
    groups: dict[tuple[object, ...], list[Trend]] = {}
    for trend in trends:
        groups.setdefault(key(trend), []).append(trend)
    return list(groups.values())


def _sign(trend: Trend) -> bool:
    return trend.change > 0


def _fleet_place(trend: Trend) -> tuple[str, Kind, bool]:
    return trend.tracks.quantity, trend.kind, _sign(trend)


def _machine_place(trend: Trend) -> tuple[str, Kind, bool, str, str]:
    return *_fleet_place(trend), trend.lead.machine, trend.lead.bus
