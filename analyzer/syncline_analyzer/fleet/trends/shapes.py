"""Which shape a series of levels has: a step, a drift, or neither; many series at a time.

Matrices are (tracks, bins), vectors (tracks,).
"""

from dataclasses import fields

import numpy as np

from syncline_analyzer.fleet.trends.limits import MIN_DAYS, MIN_SIDE
from syncline_analyzer.fleet.trends.statistics import (
    Bools,
    Floats,
    Ints,
    drift_z,
    medians,
    normal_p,
    pair_signs,
    persistence,
    quantiles,
    rising_share,
    slopes,
    spreads,
    step_z,
    totals,
    weighted_medians,
)
from syncline_schemas.records import dataclass

_AT_ONCE = 256
_SHARE_OF_KNEE = 0.85
"""A drift begins within the series where that leaves so little of what a straight line leaves over."""
_LEAST_HELD = 3
"""Bins before the knee of a drift."""
_LEAST_RUN = 8
"""Bins after it."""


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """The shape of each track that fits best, and how sure it is.

    Attributes:
        is_step: the best step leaves no more over than the best drift.
        onset: first bin of the new level, or bin in which the drift begins.
        change: of the step; what the drift amounts to from its onset to the last bin.
        slope: of the drift per bin; 0 for steps.
        spread: standard deviation of what is left over, no less than the quantum.
        concord: of a step the share of pairs across it that differ in its direction; of a drift
            that of rising less falling pairs, in its direction.
        p: probability that chance makes it.
        wander: what a straight line through all bins amounts to; NaN where nothing can tell.
        judged: whether there are bins enough.
    """

    is_step: Bools
    onset: Ints
    change: Floats
    slope: Floats
    spread: Floats
    concord: Floats
    p: Floats
    wander: Floats
    judged: Bools


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    at: Ints
    change: Floats
    spread: Floats
    left: Floats
    concord: Floats
    z: Floats
    places: Ints


@dataclass(frozen=True, slots=True, eq=False)
class _Drift:
    onset: Ints
    slope: Floats
    change: Floats
    spread: Floats
    left: Floats
    concord: Floats
    z: Floats
    wander: Floats


def shapes_of(value: Floats, epoch: Ints, quantum: float) -> Shapes:
    """The shape of each track.

    Args:
        value: levels, NaN where there are none.
        epoch: only bins of one epoch are compared; levels of epochs are laid onto one another.
        quantum: spread below which two bins never differ.
    """
    parts = [
        _shapes(value[begin : begin + _AT_ONCE], epoch[begin : begin + _AT_ONCE], quantum)
        for begin in range(0, max(len(value), 1), _AT_ONCE)
    ]
    return Shapes(
        *(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(Shapes))
    )


def _shapes(value: Floats, epoch: Ints, quantum: float) -> Shapes:
    step = _step(aligned(value, epoch), epoch, quantum)
    drift = _drift(value, epoch, quantum)
    days = np.isfinite(value).sum(axis=1)
    is_step = (step.places > 0) & (step.left <= drift.left)
    judged = np.where(is_step, days >= 2 * MIN_SIDE, (days >= MIN_DAYS) & np.isfinite(drift.slope))
    # Either shape was chosen after both were tried, and the step's place among many.
    p = np.where(is_step, normal_p(step.z) * 2 * np.maximum(step.places, 1), normal_p(drift.z) * 2)

    def chosen(of_step: Floats, of_drift: Floats) -> Floats:
        return np.where(is_step, of_step, np.nan_to_num(of_drift))

    return Shapes(
        is_step,
        np.where(is_step, step.at, drift.onset),
        chosen(step.change, drift.change),
        chosen(np.zeros(len(value)), drift.slope),
        chosen(step.spread, drift.spread),
        chosen(step.concord, drift.concord),
        np.minimum(p, 1.0),
        drift.wander,
        judged,
    )


def aligned(value: Floats, epoch: Ints) -> Floats:
    """Levels with each epoch laid onto the one before, by the medians of the days next to the change.

    What changes with it is taken for a difference of the devices or recorders, and for no trend.
    """
    found = value.copy()
    for each in range(1, int(epoch.max(initial=0)) + 1):
        own = np.where(epoch == each, value, np.nan)
        before = np.where(epoch < each, found, np.nan)
        shift = medians(_nearest(before[:, ::-1])) - medians(_nearest(own))
        found = np.where(epoch == each, value + np.nan_to_num(shift)[:, None], found)
    return found


def _nearest(value: Floats) -> Floats:
    """The first values of each row, all others NaN."""
    number = np.isfinite(value).cumsum(axis=1)
    return np.where(number <= MIN_SIDE, value, np.nan)


def _step(value: Floats, epoch: Ints, quantum: float) -> _Step:
    """The place that leaves the least over when either side is its median, well within an epoch."""
    tracks, bins = value.shape
    valid = np.isfinite(value)
    left = np.full(tracks, np.inf)
    at, places = np.zeros(tracks, np.int64), np.zeros(tracks, np.int64)
    for place in range(MIN_SIDE, bins - MIN_SIDE + 1):
        own = valid & (epoch == epoch[:, place : place + 1])
        enough = own[:, :place].sum(axis=1) >= MIN_SIDE
        enough &= own[:, place:].sum(axis=1) >= MIN_SIDE
        enough &= valid[:, place]
        rest = totals(np.abs(_without_step(value, np.full(tracks, place))))
        places += enough
        better = enough & (rest < left)
        left, at = np.where(better, rest, left), np.where(better, place, at)
    residual = _without_step(value, at)
    spread = np.maximum(spreads(residual), quantum)
    late = np.arange(bins) >= at[:, None]
    before, after = (medians(np.where(side, value, np.nan)) for side in (~late, late))
    change = np.nan_to_num(after - before)
    # Within epochs: what is laid onto one another would prove itself.
    signs, pairs = pair_signs(value, epoch)
    across = ~late[:, :, None] & late[:, None, :] & pairs
    agree = (signs * np.sign(change)[:, None, None] * across > 0).sum(axis=(1, 2))
    counts = (valid & ~late).sum(axis=1), (valid & late).sum(axis=1)
    z = step_z(change, spread, counts, persistence(residual, spread, quantum))
    concord = agree / np.maximum(across.sum(axis=(1, 2)), 1)
    return _Step(at, change, spread, left, concord, z, places)


def _without_step(value: Floats, at: Ints) -> Floats:
    late = np.arange(value.shape[1]) >= at[:, None]
    before, after = (medians(np.where(side, value, np.nan)) for side in (~late, late))
    return value - np.where(late, after[:, None], before[:, None])


def _drift(value: Floats, epoch: Ints, quantum: float) -> _Drift:
    """A straight line, or one with a knee where that leaves clearly less over."""
    bins = value.shape[1]
    time = np.arange(bins, dtype=np.float64)
    valid = np.isfinite(value)
    begin = np.argmax(valid, axis=1)
    end = bins - 1 - np.argmax(valid[:, ::-1], axis=1)
    slope = slopes(value, epoch)
    wander = slope * (end - begin)
    residual = _levelled(value - np.nan_to_num(slope)[:, None] * time, epoch)
    left, onset = totals(np.abs(residual)), begin
    single = np.where(valid, epoch, -1).max(axis=1) == np.where(valid, epoch, 1 << 30).min(axis=1)
    straight = left
    for knee in range(_LEAST_HELD, bins - _LEAST_RUN + 1):
        ran = np.maximum(time - knee, 0.0)
        held = medians(np.where(time <= knee, value, np.nan))
        rise = np.divide(value - held[:, None], ran, out=np.full_like(value, np.nan), where=ran > 0)
        steep = weighted_medians(rise, np.broadcast_to(ran, value.shape))
        rest = value - held[:, None] - np.nan_to_num(steep)[:, None] * ran
        cost = totals(np.abs(rest))
        enough = valid[:, :knee].sum(axis=1) >= _LEAST_HELD
        enough &= valid[:, knee + 1 :].sum(axis=1) >= _LEAST_RUN
        better = single & enough & (cost < left) & (cost < _SHARE_OF_KNEE * straight)
        left, onset = np.where(better, cost, left), np.where(better, knee, onset)
        slope = np.where(better, steep, slope)
        residual = np.where(better[:, None], rest, residual)
    spread = np.maximum(spreads(residual), quantum)
    change = slope * (end - onset)
    count = (valid & (np.arange(bins) >= onset[:, None])).sum(axis=1)
    z = drift_z(np.nan_to_num(change), spread, count, persistence(residual, spread, quantum))
    concord = rising_share(value, epoch)
    return _Drift(onset, slope, change, spread, left, concord * np.sign(slope), z, wander)


def _levelled(value: Floats, epoch: Ints) -> Floats:
    """Values less the median of their epoch."""
    found = np.full_like(value, np.nan)
    for each in np.unique(epoch):
        own = np.where(epoch == each, value, np.nan)
        rows = np.isfinite(own)
        found[rows] = (own - medians(own)[:, None])[rows]
    return found


def reach(value: Floats) -> Floats:
    """Widest change that a track may hold on both sides of a step: order does not count; (tracks,)."""
    count = np.maximum(np.isfinite(value).sum(axis=1), 1)
    ordered = np.sort(value, axis=1)
    rows = np.arange(len(value))
    low = np.minimum(2, count - 1)
    width: Floats = np.nan_to_num(ordered[rows, count - 1 - low] - ordered[rows, low])
    return width


def weekends_levelled(value: Floats, weekend: Bools) -> Floats:
    """Levels with the weekends laid onto the weekdays where they differ in each of three weeks or more."""
    if not weekend.any() or weekend.all():
        return value
    starts = np.flatnonzero(weekend & ~np.roll(weekend, 1))
    differences = []
    for start in starts:
        near = np.arange(value.shape[1])
        around = (near >= start - 3) & (near < start + 5)
        own = medians(np.where(around & weekend, value, np.nan))
        other = medians(np.where(around & ~weekend, value, np.nan))
        differences.append(own - other)
    each = np.stack(differences, axis=1)
    shift = medians(each)
    weeks = np.isfinite(each).sum(axis=1)
    low, high = quantiles(each, 0.0), quantiles(each, 1.0)
    rhythm = (weeks >= 3) & (np.sign(low) == np.sign(high)) & (low != 0)
    levelled: Floats = value - np.where(rhythm, shift, 0.0)[:, None] * weekend
    return levelled
