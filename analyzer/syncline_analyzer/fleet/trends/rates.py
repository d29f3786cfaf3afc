"""Whether events come more often from a day on; many tracks at a time.

Matrices are (tracks, bins), vectors (tracks,).
"""

import numpy as np

from syncline_analyzer.fleet.trends.limits import MIN_SIDE, RATE_DAYS
from syncline_analyzer.fleet.trends.statistics import (
    Bools,
    Floats,
    Ints,
    normal_of_student,
    normal_p,
)
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class Rises:
    """Of each track the day from which on events come more often, as far as chance does not explain it.

    Attributes:
        onset: first bin of the higher rate.
        before, after: rates.
        more: events after the onset beyond what the rate before would bring.
        days: bins after the onset that have events.
        p: probability that chance makes it, also with the day of the most events left out.
        judged: whether there are bins enough on either side.
    """

    onset: Ints
    before: Floats
    after: Floats
    more: Floats
    days: Ints
    p: Floats
    judged: Bools


def rises_of(count: Floats, time: Floats) -> Rises:
    """The clearest rise of each track.

    Args:
        count: events.
        time: in which they were counted.
    """
    tracks, bins = count.shape
    seen = time > 0
    best = np.full(tracks, -np.inf)
    onset, places = np.zeros(tracks, np.int64), np.zeros(tracks, np.int64)
    for place in range(MIN_SIDE, bins - MIN_SIDE + 1):
        at = np.full(tracks, place)
        enough = (seen[:, :place].sum(axis=1) >= MIN_SIDE) & seen[:, place]
        enough &= seen[:, place:].sum(axis=1) >= MIN_SIDE
        places += enough
        z = np.where(enough, _z(count, time, at), -np.inf)
        better = z > best
        best, onset = np.where(better, z, best), np.where(better, place, onset)
    late = np.arange(bins) >= onset[:, None]
    most = np.argmax(np.where(late, count, -1.0), axis=1)
    rest, rest_time = count.copy(), time.copy()
    rest[np.arange(tracks), most] = 0.0
    rest_time[np.arange(tracks), most] = 0.0
    z = np.minimum(best, _z(rest, rest_time, onset))
    z = np.where(np.isfinite(z), np.maximum(z, 0.0), 0.0)
    before, after = _rates(count, time, onset)
    more = (count * late).sum(axis=1) - np.nan_to_num(before) * (time * late).sum(axis=1)
    days = ((count > 0) & late).sum(axis=1)
    # Only rises are told: one side of the distribution, at one of many places.
    p = np.minimum(normal_p(z) / 2 * np.maximum(places, 1), 1.0)
    return Rises(onset, before, after, more, days, p, (places > 0) & (days >= RATE_DAYS))


def _sums(count: Floats, time: Floats, at: Ints) -> tuple[Floats, Floats, Floats, Floats]:
    late = np.arange(count.shape[1]) >= at[:, None]
    sides = ((each * side).sum(axis=1) for side in (~late, late) for each in (count, time))
    count_before, time_before, count_after, time_after = sides
    return count_before, time_before, count_after, time_after


def _rates(count: Floats, time: Floats, at: Ints) -> tuple[Floats, Floats]:
    count_before, time_before, count_after, time_after = _sums(count, time, at)
    nothing = np.full(len(count), np.nan)
    before = np.divide(count_before, time_before, out=nothing.copy(), where=time_before > 0)
    after = np.divide(count_after, time_after, out=nothing.copy(), where=time_after > 0)
    return before, after


def _z(count: Floats, time: Floats, at: Ints) -> Floats:
    """Normal value of a rise at a bin, below zero for a fall: by chance alone, or as bins differ."""
    return np.minimum(_z_of_chance(count, time, at), _z_of_bins(count, time, at))


def _z_of_chance(count: Floats, time: Floats, at: Ints) -> Floats:
    """Likelihood ratio of two Poisson rates against one."""
    count_before, time_before, count_after, time_after = _sums(count, time, at)
    whole, whole_time = count_before + count_after, time_before + time_after
    share = np.divide(time_after, whole_time, out=np.full_like(whole, 0.5), where=whole_time > 0)
    expected = whole * share
    deviance = 2 * (_term(count_after, expected) + _term(count_before, whole - expected))
    ratio: Floats = np.sqrt(np.maximum(deviance, 0.0)) * np.sign(count_after - expected)
    return ratio


def _term(count: Floats, expected: Floats) -> Floats:
    ratio = np.divide(count, expected, out=np.ones_like(count), where=(count > 0) & (expected > 0))
    term: Floats = count * np.log(ratio)
    return term


def _z_of_bins(count: Floats, time: Floats, at: Ints) -> Floats:
    """Difference of the square roots of the rates, whose error hardly depends on the rate.

    Events of
    a bin vary by `mean + beyond * mean**2` (negative binomial), `beyond` as the bins of both sides
    tell it: the more bins differ, the less a longer time in one of them tells.
    """
    late = np.arange(count.shape[1]) >= at[:, None]
    before, after = (np.nan_to_num(each)[:, None] for each in _rates(count, time, at))
    rate = np.where(late, after, before)
    mean = rate * time
    square = (mean**2).sum(axis=1)
    more = ((count - mean) ** 2 - mean).sum(axis=1)
    beyond = np.divide(np.maximum(more, 0.0), square, out=np.zeros_like(square), where=square > 0)
    weight = time / (1 + beyond[:, None] * mean)
    told = np.divide(count, time, out=np.zeros_like(count), where=time > 0) * weight
    roots, errors = [], []
    for side in (~late, late):
        whole = (weight * side).sum(axis=1)
        nothing = np.zeros_like(whole)
        mean_rate = np.divide((told * side).sum(axis=1), whole, out=nothing.copy(), where=whole > 0)
        roots.append(np.sqrt(mean_rate))
        errors.append(np.divide(0.25, whole, out=nothing + np.inf, where=whole > 0))
    error = np.sqrt(errors[0] + errors[1])
    t = np.divide(roots[1] - roots[0], error, out=np.zeros_like(error), where=np.isfinite(error))
    days = np.maximum((time > 0).sum(axis=1), 3).astype(np.float64)
    # Where the bins differ no more than chance makes them, nothing was estimated.
    return np.where(beyond > 0, normal_of_student(t, days - 2), t)
