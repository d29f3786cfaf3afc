"""Trends of levels: of fleets, and of single machines against their fleet."""

from collections.abc import Iterator

import numpy as np

from syncline_analyzer.fleet.quantities import QUANTITIES
from syncline_analyzer.fleet.trends.fleets import common, less_common
from syncline_analyzer.fleet.trends.limits import (
    APART,
    CLEAR_DRIFT,
    CLEAR_STEP,
    LIMITS,
    MIN_MACHINES,
    RISING,
    SEPARATION,
)
from syncline_analyzer.fleet.trends.shapes import (
    Shapes,
    aligned,
    reach,
    shapes_of,
    weekends_levelled,
)
from syncline_analyzer.fleet.trends.statistics import SIGMA, Bools, Floats, Ints, medians
from syncline_analyzer.fleet.trends.tracks import Tracks
from syncline_analyzer.fleet.trends.trend import Trend
from syncline_schemas.records import dataclass

_SHARING = 0.5
"""Share of a fleet's machines that must move with it; a machine does from so much of its change on."""
_ALIKE = 0.7
"""How far the changes of a fleet's machines may lie apart, as a share of the change."""
_BY_ITSELF = 0.4
"""Share of the floor by which a machine moves that moves against its fleet."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Trends that are large enough, with the probabilities of all that were judged beside them.

    Attributes:
        p: of the tracks (or fleets) that could hold a trend of the least size.
    """

    trends: list[Trend]
    p: Floats


def level_trends(tracks: Tracks) -> tuple[Judged, Judged]:
    """Trends of the fleets, and of single machines."""
    laid = aligned(tracks.value, tracks.epoch)
    of_all = np.full((int(tracks.group.max()) + 1, tracks.value.shape[1]), np.nan)
    for group, members in fleets_of(tracks.group):
        of_all[group] = common(laid[members])
    return _of_fleets(tracks, laid, of_all), _of_machines(tracks, laid, of_all)


def fleets_of(group: Ints) -> Iterator[tuple[int, Ints]]:
    """Groups of enough tracks, and which these are."""
    for number, count in enumerate(np.bincount(group).tolist()):
        if count >= MIN_MACHINES:
            yield number, np.flatnonzero(group == number)


def _of_fleets(tracks: Tracks, laid: Floats, of_all: Floats) -> Judged:
    limits = LIMITS[tracks.quantity]
    shapes = shapes_of(of_all, np.zeros(of_all.shape, np.int64), limits.quantum)
    trends = []
    possible = np.zeros(len(of_all), np.bool_)
    for group, members in fleets_of(tracks.group):
        level = float(medians(medians(laid[members])[None])[0])
        least = max(limits.floor, limits.share * abs(level))
        possible[group] = shapes.judged[group] and reach(of_all[group : group + 1])[0] >= least
        if not (possible[group] and _large(tracks, shapes, np.full(len(of_all), least))[group]):
            continue
        shown = _change_at(laid[members], shapes, group) / shapes.change[group]
        moving = members[np.nan_to_num(shown) >= _SHARING]
        alike = SIGMA * float(medians(np.abs(shown - medians(shown[None]))[None])[0]) <= _ALIKE
        if alike and len(moving) >= _SHARING * np.isfinite(shown).sum():
            ordered = moving[np.argsort(-shown[np.isin(members, moving)], kind="stable")]
            size = abs(shapes.change[group]) / least
            trends.append(_trend(tracks, shapes, group, ordered, laid, float(size), of_fleet=True))
    return Judged(trends, shapes.p[possible])


def _of_machines(tracks: Tracks, laid: Floats, of_all: Floats) -> Judged:
    limits = LIMITS[tracks.quantity]
    rest = weekends_levelled(less_common(tracks.value, of_all[tracks.group]), tracks.weekend)
    shapes = shapes_of(rest, tracks.epoch, limits.quantum)
    least = np.maximum(limits.floor, limits.share * np.abs(_level_before(laid, shapes)))
    possible = shapes.judged & (reach(rest) >= limits.floor)
    large = possible & _large(tracks, shapes, least)
    large &= np.abs(shapes.change) >= APART * _wander_of_fleet(tracks.group, shapes)
    trends = []
    for number in np.flatnonzero(large).tolist():
        own = _change_at(laid[number : number + 1], shapes, number)[0]
        if own * np.sign(shapes.change[number]) >= _BY_ITSELF * least[number]:
            size = float(abs(shapes.change[number]) / least[number])
            members = np.array([number])
            trends.append(_trend(tracks, shapes, number, members, laid, size, of_fleet=False))
    return Judged(trends, shapes.p[possible])


def _large(tracks: Tracks, shapes: Shapes, least: Floats) -> Bools:
    """Whether shapes are large, clear and steady enough to be told."""
    size = np.abs(shapes.change)
    clear = np.where(shapes.is_step, CLEAR_STEP, CLEAR_DRIFT) * shapes.spread
    steady = shapes.concord >= np.where(shapes.is_step, SEPARATION, RISING)
    told = (size >= least) & (size >= clear) & steady & shapes.judged
    if not LIMITS[tracks.quantity].falling:
        told &= shapes.change > 0
    return told


def _level_before(laid: Floats, shapes: Shapes) -> Floats:
    early = np.arange(laid.shape[1]) < np.maximum(shapes.onset, 1)[:, None]
    level = medians(np.where(early, laid, np.nan))
    return np.nan_to_num(np.where(np.isfinite(level), level, medians(laid)))


def _wander_of_fleet(group: Ints, shapes: Shapes) -> Floats:
    """How far the machines of a track's fleet wander by themselves; 0 without a fleet."""
    found = np.zeros(len(group))
    for _, members in fleets_of(group):
        wander = shapes.wander[members]
        off = np.abs(wander - medians(wander[None]))
        found[members] = np.nan_to_num(SIGMA * medians(off[None]))
    return found


def _change_at(laid: Floats, shapes: Shapes, number: int) -> Floats:
    """By how much tracks change where a shape does; (tracks,)."""
    before, after = _ends(laid, shapes, number)
    return after - before


def _ends(laid: Floats, shapes: Shapes, number: int) -> tuple[Floats, Floats]:
    """Levels of tracks on either side of a step; of a drift in its first and last fifth."""
    bins = np.arange(laid.shape[1])
    onset = int(shapes.onset[number])
    if shapes.is_step[number]:
        early, late = bins < onset, bins >= onset
    else:
        valid = np.flatnonzero(np.isfinite(laid).any(axis=0))
        begin, end = int(valid[0]), int(valid[-1])
        fifth = max(2, (end - onset) // 5)
        early, late = (bins >= begin) & (bins <= onset + fifth), bins > end - fifth - 1
    sides = (medians(np.where(side, laid, np.nan)) for side in (early, late))
    before, after = sides
    return before, after


def _trend(
    tracks: Tracks,
    shapes: Shapes,
    number: int,
    members: Ints,
    laid: Floats,
    size: float,
    *,
    of_fleet: bool,
) -> Trend:
    counted = QUANTITIES[tracks.quantity].kind != "level"
    is_step = bool(shapes.is_step[number])
    before, after = (medians(side[None]) for side in _ends(laid[members], shapes, number))
    return Trend(
        kind="rate" if counted else "step" if is_step else "drift",
        tracks=tracks,
        members=tuple(members.tolist()),
        of_fleet=of_fleet,
        onset=int(shapes.onset[number]),
        before=_number(before[0]),
        after=_number(after[0]),
        change=float(shapes.change[number]),
        slope=0.0 if is_step else float(shapes.slope[number]),
        size=size,
        p=float(shapes.p[number]),
    )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
