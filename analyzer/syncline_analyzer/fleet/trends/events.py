"""Events that come more often: on many machines alike, and on single ones more than on the others."""

import numpy as np

from syncline_analyzer.fleet.trends.levels import Judged, fleets_of
from syncline_analyzer.fleet.trends.limits import (
    FLEET_RATE_FACTOR,
    LIMITS,
    MANY,
    MIN_MANY,
    RATE_EVENTS,
    RATE_FACTOR,
    RATE_MORE,
)
from syncline_analyzer.fleet.trends.rates import Rises, rises_of
from syncline_analyzer.fleet.trends.statistics import Bools, Floats, Ints
from syncline_analyzer.fleet.trends.tracks import Tracks
from syncline_analyzer.fleet.trends.trend import Trend

_BROAD = 2 * MANY
"""Share of the machines on which events come more often, less that on which they come less often."""
_FEW, _STORM = 3.0, 2.0
"""Most events of a machine in one bin that count for its fleet, or so many times those of the next."""
_LEFT_OUT = 3
"""Machines without which a fleet must show it too."""
_SURE = 0.01


def event_trends(tracks: Tracks) -> tuple[Judged, Judged]:
    """Rising rates of the fleets, and of single machines."""
    fleets, usual = _of_fleets(tracks)
    return fleets, _of_machines(tracks, usual)


def _of_machines(tracks: Tracks, usual: Floats) -> Judged:
    rises = rises_of(tracks.amount, tracks.over * usual)
    possible = rises.judged & (tracks.amount.sum(axis=1) >= RATE_EVENTS)
    large = possible & _large(tracks, rises, RATE_FACTOR)
    trends = [
        _trend(tracks, rises, number, np.array([number]), of_fleet=False)
        for number in np.flatnonzero(large).tolist()
    ]
    judged = (tracks.amount.sum(axis=1) >= RATE_EVENTS) & (rises.p <= 1)
    return Judged(trends, rises.p[judged])


def _of_fleets(tracks: Tracks) -> tuple[Judged, Floats]:
    """Trends of fleets, and by how much their rate differs from the first one; (tracks, bins)."""
    usual = np.ones(tracks.amount.shape)
    trends, p = [], []
    for _, members in fleets_of(tracks.group):
        count = _without_storms(tracks.amount[members])
        weight = _weights(count)
        count, time = count * weight, tracks.over[members] * weight
        if count.sum() < RATE_EVENTS:
            continue
        rises = rises_of(count.sum(axis=0)[None], time.sum(axis=0)[None])
        p.append(float(rises.p[0]))
        if not _large(tracks, rises, FLEET_RATE_FACTOR)[0]:
            continue
        more = _more(count, time, int(rises.onset[0]))
        shown = np.argsort(-more, kind="stable")
        rest = shown[_LEFT_OUT:]
        others = rises_of(count[rest].sum(axis=0)[None], time[rest].sum(axis=0)[None])
        broad = (more > 0).sum() - (more < 0).sum()
        if broad < max(MIN_MANY, _BROAD * len(members)) or others.p[0] > _SURE:
            continue
        concerned = members[shown[more[shown] > 0]]
        trends.append(_trend(tracks, rises, 0, concerned, of_fleet=True))
        factor = rises.after[0] / max(rises.before[0], 0.5 / time.sum())
        usual[members, int(rises.onset[0]) :] = factor
    return Judged(trends, np.array(p, np.float64)), usual


def _without_storms(count: Floats) -> Floats:
    """Counts of machines, the highest of each brought down towards the next."""
    next_one = np.sort(count, axis=1)[:, -2:-1] if count.shape[1] > 1 else count
    return np.minimum(count, np.maximum(_FEW, _STORM * next_one))


def _weights(count: Floats) -> Floats:
    """Weights of machines: one with many more events than usual counts no more than others do."""
    total = count.sum(axis=1, keepdims=True)
    some = total[total > 0]
    most = _STORM * float(np.median(some)) if len(some) else 1.0
    weight: Floats = np.minimum(1.0, most / np.maximum(total, 1.0))
    return weight


def _more(count: Floats, time: Floats, onset: int) -> Floats:
    """Events of each machine after a bin beyond what its rate over all would bring."""
    whole = time.sum(axis=1)
    share = np.divide(time[:, onset:].sum(axis=1), whole, out=np.zeros_like(whole), where=whole > 0)
    more: Floats = count[:, onset:].sum(axis=1) - share * count.sum(axis=1)
    return more


def _large(tracks: Tracks, rises: Rises, factor: float) -> Bools:
    before, after = np.nan_to_num(rises.before), np.nan_to_num(rises.after)
    often = (after >= factor * before) & (after - before >= LIMITS[tracks.quantity].floor)
    return rises.judged & often & (rises.more >= RATE_MORE)


def _trend(tracks: Tracks, rises: Rises, number: int, members: Ints, *, of_fleet: bool) -> Trend:
    onset = int(rises.onset[number])
    count, time = tracks.amount[members].sum(axis=0), tracks.over[members].sum(axis=0)
    before, after = (
        float(count[side].sum() / max(time[side].sum(), 1e-12))
        for side in (slice(None, onset), slice(onset, None))
    )
    return Trend(
        kind="rate",
        tracks=tracks,
        members=tuple(members.tolist()),
        of_fleet=of_fleet,
        onset=onset,
        before=before,
        after=after,
        change=after - before,
        slope=0.0,
        size=float(rises.more[number] / RATE_MORE),
        p=float(rises.p[number]),
    )
