"""How fast it turned between the samples of a piece, and where it cannot have turned so fast."""

from collections.abc import Iterator
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.angle.link import Link, Step
from syncline_analyzer.folds.angle.samples import Samples
from syncline_schemas.measurement import EncoderScale, ambiguous_rpm, count_steps
from syncline_schemas.records import dataclass

MAX_EVENTS = 1000
SLACK_NS = 1_000_000
"""How much later than usual after its sampling a value may be sent."""
MINUTE_NS = 60e9
ENOUGH = 16
"""Spans from which the usual one is taken anew."""
NO_SPEED = 2.0
"""A speed of so many times what the device can do is one of the stamps, not of the shaft."""
TOLD_APART = 0.25
"""Of a range: beyond, the other way round is not even three times as far, so no speed is told."""
SEVERAL = 5
"""So many steps that are too big may be those of a device that measures less often than it sends."""
MEASURED_NS = 500_000_000
"""It measures more often than this."""
SELDOM = 1.5
"""A source that is heard so much less often than another one takes its speed where it is unsure."""
ON_AND_ON_NS = 100_000_000
ON_AND_ON = 16
"""Turning is judged as a whole over so long and so many steps: the slack counts once."""
MARGIN = 1.02
CLOSE = 1.25
"""Steps at the ends of a fast motion differ by no more than so many times."""
PAUSES = 10
"""A span of so many usual ones is a pause."""
JUMP, AMBIGUOUS = 2, 4

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Jump:
    """A step that the device cannot make: `speed_rpm` over `span_ns` beats the limit."""

    row: int
    before: float
    after: float
    span_ns: int
    speed_rpm: float


@dataclass(slots=True, eq=False)
class Speeds:
    """What the samples of a piece tell of its speed.

    rpm: (n,), NaN where unknown. flags: (n,). fast, fast_rpm: rows, ascending, at which it turns on
    and on faster than it may, and how fast. broken: rows at which its line breaks, in any source.
    span_ns: (n,) time since the sample before of the same source, 0 where unknown; or empty.
    """

    rpm: Floats
    flags: Integers
    jumps: list[Jump] = field(default_factory=list)
    fast: Rows = field(default_factory=lambda: np.zeros(0, np.intp))
    fast_rpm: Floats = field(default_factory=lambda: np.zeros(0))
    broken: Rows = field(default_factory=lambda: np.zeros(0, np.intp))
    span_ns: Integers = field(default_factory=lambda: np.zeros(0, np.int64))


def encoder_speeds(
    link: Link, scale: EncoderScale, piece: Samples, value: Floats, width: Floats
) -> Speeds:
    """Speeds of an encoder; `value` and `width`: counts (n,) and what they repeat after.

    Samples of one source are compared with one another: two PDOs carry values of different age.
    """
    found = Speeds(np.full(len(piece.seq), np.nan), np.zeros(len(piece.seq), np.int64))
    per_turn = scale.counts_per_turn
    if per_turn is None or scale.range_counts is None:
        return found
    heard: list[tuple[float, Rows, Rows]] = []
    fast: list[tuple[Rows, Floats]] = []
    for source, rows, values, t_ns in _of_source(link, piece, value):
        span = np.diff(t_ns)
        if not len(span):
            continue
        target = rows[-len(span) :]
        total = int(width[rows].min())
        step = count_steps(values.astype(np.int64), total)
        forward = span > 0
        found.rpm[target] = _rpm(step, np.where(forward, span, np.nan), per_turn)
        if scale.max_rpm is None:
            continue
        unsure = forward & (ambiguous_rpm(total, per_turn, 1e-9) < scale.max_rpm * span)
        found.flags[target[unsure]] = AMBIGUOUS
        if unsure.any():
            found.span_ns = found.span_ns if len(found.span_ns) else np.zeros_like(found.flags)
            found.span_ns[target[unsure]] = span[unsure]
        found.rpm[target[unsure & (np.abs(step) > TOLD_APART * total)]] = np.nan
        usual_ns = _usual_ns(link, source, span)
        heard.append((usual_ns, target, target[unsure]))
        allowed_ns = np.maximum(span, usual_ns) + SLACK_NS
        fastest = np.abs(_rpm(np.maximum(np.abs(step) - 2, 0), allowed_ns, per_turn))
        beyond = fastest > scale.max_rpm
        if np.count_nonzero(beyond) >= SEVERAL:
            _learn_measuring(link, source, step, t_ns)
        measured_ns = link.measured_ns.get(source, 0.0)
        if measured_ns > SELDOM * usual_ns:
            beyond &= fastest * allowed_ns > scale.max_rpm * (measured_ns + SLACK_NS)
        line = np.concatenate((link.steps.get(source, (0, 0)), step))
        turning = beyond & _goes_on(line)
        link.steps[source] = (int(line[-2]), int(line[-1]))
        limit = MARGIN * scale.max_rpm * per_turn / MINUTE_NS
        mean = _on_and_on(step, span, usual_ns, unsure, limit) * (MINUTE_NS / per_turn)
        rate = np.where(mean > 0.0, mean, np.abs(found.rpm[target]))
        turns = turning | (mean > 0.0)
        fast.append((target[turns], rate[turns]))
        too_fast = np.flatnonzero(beyond & ~turning)
        # A jump is no turning, and frames handed over in a bundle are too near for a speed.
        found.rpm[target[too_fast]] = np.nan
        no_speed = np.abs(found.rpm[target]) > NO_SPEED * scale.max_rpm
        found.rpm[target[no_speed & ~(turns & (2 * span >= usual_ns))]] = np.nan
        found.broken = np.union1d(found.broken, target[too_fast])
        found.jumps += [
            Jump(int(target[k]), values[k], values[k + 1], int(span[k]), float(fastest[k]))
            for k in too_fast[:MAX_EVENTS].tolist()
        ]
        found.flags[target[too_fast[MAX_EVENTS:]]] |= JUMP
    _borrow(found.rpm, heard)
    found.jumps = _first_of_each(found.jumps, piece, link)
    if fast:
        rows = np.concatenate([each for each, _ in fast])
        order = np.argsort(rows, kind="stable")
        found.fast = rows[order]
        found.fast_rpm = np.concatenate([each for _, each in fast])[order]
    return found


def circle_speeds(link: Link, piece: Samples, angle: Floats, width: Floats, step: Step) -> Speeds:
    """Speeds of an inclinometer; `angle` in degrees (n,)."""
    found = Speeds(np.full(len(angle), np.nan), np.zeros(len(angle), np.int64))
    for _, rows, values, t_ns in _of_source(link, piece, angle):
        span = np.diff(t_ns)
        if len(span):
            target = rows[-len(span) :]
            moved = step(np.diff(values), width[target])
            known_ns = np.where(span > 0, span, np.nan)
            found.rpm[target] = moved / 360.0 * MINUTE_NS / known_ns
    return found


def _on_and_on(
    step: Integers, span: Integers, usual_ns: float, unsure: NDArray[np.bool_], limit: float
) -> Floats:
    """Counts per ns over each stretch that as a whole is beyond `limit`; (n,), 0 elsewhere.

    The two biggest steps of a stretch count as its usual ones, so that a jump is no turning.
    """
    rate = np.zeros(len(step))
    if usual_ns <= 0.0:
        return rate
    many = max(ON_AND_ON, int(np.ceil(ON_AND_ON_NS / usual_ns)))
    whole = len(step) // many * many
    if not whole:
        return rate
    steps, spans = step[:whole].reshape(-1, many), span[:whole].reshape(-1, many)
    way = steps.sum(axis=1)
    longest = spans.max(axis=1)
    late_ns = SLACK_NS + np.maximum(longest - usual_ns, 0.0)
    good = (spans.min(axis=1) > 0) & (longest <= PAUSES * usual_ns)
    good &= ~unsure[:whole].reshape(-1, many).any(axis=1)
    lasted = np.maximum(spans.sum(axis=1), 1)
    least = limit * (lasted + late_ns)
    # Two median steps move no further than the two biggest.
    far = np.flatnonzero(good & (np.abs(way) > least))
    if len(far):
        along = steps[far] * np.sign(way[far])[:, None]
        ranked = np.sort(along, axis=1)
        moved = np.abs(way[far]) - ranked[:, -2:].sum(axis=1) + 2 * np.median(along, axis=1)
        beyond = np.zeros(len(way))
        beyond[far] = np.where(moved > least[far], moved / lasted[far], 0.0)
        rate[:whole] = np.repeat(beyond, many)
    return rate


def _borrow(speed: Floats, heard: list[tuple[float, Rows, Rows]]) -> None:
    """Take the speed of a source that comes seldom from the one that comes most often."""
    heard.sort(key=lambda each: each[0])
    for usual_ns, _, guessed in heard[1:]:
        often_ns, often, _ = heard[0]
        if usual_ns > SELDOM * often_ns:
            speed[guessed] = _last_before(speed, often, guessed)


def _of_source(
    link: Link, piece: Samples, value: Floats
) -> Iterator[tuple[int, Rows, Floats, Integers]]:
    """(source, rows, values, stamps) by source, with the sample before the piece in front.

    A value that stands for none, means nothing or is too short is left out: it takes time, no step.
    """
    use = piece.told
    # Sources are COB-IDs or -1, so counting them beats sorting them.
    for source in (np.flatnonzero(np.bincount(piece.source + 1)) - 1).tolist():
        rows = np.flatnonzero((piece.source == source) & use)
        if not len(rows):
            continue
        values, t_ns = value[rows], piece.t_ns[rows]
        if source in link.sources:
            before_ns, before = link.sources[source]
            values = np.concatenate(([before], values))
            t_ns = np.concatenate(([before_ns], t_ns))
        link.sources[source] = (int(t_ns[-1]), float(values[-1]))
        yield source, rows, values, t_ns


def _learn_measuring(
    link: Link, source: int, step: NDArray[np.int64], t_ns: NDArray[np.int64]
) -> None:
    """Learn after what time the value of a source usually changes."""
    apart = np.diff(t_ns[1:][step != 0])
    apart = apart[(apart > 0) & (apart < MEASURED_NS)]
    if len(apart) >= SEVERAL:
        link.measured_ns[source] = float(np.median(apart))


def _goes_on(line: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether each step but the first two is one of several alike: turning; a jump stands alone.

    It may be the first or the last one of three, which must be closer alike then: a trace may begin
    or end while the shaft turns, and a shaft may turn fast after a jump.
    """
    alike, close = _alike(line, 2.0), _alike(line, CLOSE)
    following = np.concatenate((alike[2:], [True]))
    later = np.concatenate((close[2:], [False]))
    latest = np.concatenate((later[1:], [False]))
    found: NDArray[np.bool_] = alike[1:] & following
    found |= (close[1:] & close[:-1]) | (later & latest)
    return found


def _alike(line: NDArray[np.int64], times: float) -> NDArray[np.bool_]:
    """Whether each step but the first goes the way of the one before, and about as far."""
    size = np.abs(line)
    alike: NDArray[np.bool_] = (np.sign(line[1:]) == np.sign(line[:-1])) & (line[1:] != 0)
    return alike & (times * size[:-1] >= size[1:]) & (size[:-1] <= times * size[1:])


def _last_before(values: Floats, known: NDArray[np.intp], wanted: NDArray[np.intp]) -> Floats:
    """For each wanted row the value of the last known row before it, NaN without one."""
    at = np.searchsorted(known, wanted) - 1
    return np.where(at >= 0, values[known[np.maximum(at, 0)]], np.nan)


def _rpm(step: NDArray[np.int64], span_ns: Floats | NDArray[np.int64], per_turn: int) -> Floats:
    rpm: Floats = step * (MINUTE_NS / per_turn) / span_ns
    return rpm


def _usual_ns(link: Link, source: int, span: NDArray[np.int64]) -> float:
    """Mean time between samples of a source, pauses left out.

    Adapters may hand frames over in bundles, so that single spans say little.
    """
    forward = span[span > 0]
    if len(forward) >= ENOUGH or source not in link.spacing_ns:
        regular = forward[forward <= 10 * np.quantile(forward, 0.9)] if len(forward) else forward
        link.spacing_ns[source] = float(regular.mean()) if len(regular) else 0.0
    return link.spacing_ns[source]


def _first_of_each(jumps: list[Jump], piece: Samples, link: Link) -> list[Jump]:
    """One jump is seen by every source that was heard before it: keep the first that shows it."""
    kept: list[Jump] = []
    for jump in sorted(jumps, key=lambda jump: jump.row):
        t_ns = int(piece.t_ns[jump.row])
        if link.jump_ns is None or not t_ns - jump.span_ns < link.jump_ns <= t_ns:
            link.jump_ns = t_ns
            kept.append(jump)
    return kept
