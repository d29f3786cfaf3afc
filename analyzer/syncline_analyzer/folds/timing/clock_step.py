"""Whether the recorder's clock was set in a silence: each identifier goes on as if it had not been."""

from collections.abc import Sequence

from syncline_analyzer.distribution import Distribution
from syncline_schemas.named_tuples import NamedTuple

HEARTBEATS = range(0x701, 0x780)
SYNC = 0x80
STAMP_NS = 1_000_000
"""Stamps of a frame may be off by so much by arbitration and the recorder's own delay [ns]."""
RUNNING = 1.5
"""What was heard so many periods before a silence ran when it began."""
_LEARN = 8
"""Periods from which an identifier is known to come steadily."""
_OUTLIERS = 4
"""So many periods may be long for reasons of their own: a restart, other silences, the step itself."""
_WITNESS = 0.05
"""A witness of a clock step keeps its period within this share of it."""
_MIN_STEP = 3.0
"""A step is at least so many times as long as the witnesses' uncertainty."""
_AGREE = 0.9
_DRIFT = 2e-4
"""Two clocks of devices differ by less than this share of the time."""
_SURE_DRIFT = 1e-5
"""Two clocks of devices differ by at least this share of a long time."""


class Witness(NamedTuple):
    """An identifier that comes steadily: its period, and how far it may be off [ns]."""

    period_ns: float
    spread_ns: float


class Crossing(NamedTuple):
    """How a witness that ran when a silence began went on after it.

    `across_ns` is what the stamps say passed between its frames around the silence, None where it
    did not come again; `left_ns` from the former to the end of what was heard. `pending` is what the
    silence met behind a SYNC and what came again before the next one: it did not wait for that.
    """

    can_id: int
    witness: Witness
    across_ns: int | None
    left_ns: int
    pending: bool = False


class Step(NamedTuple):
    """By how much the clock was set forward [ns], and how many identifiers say so."""

    by_ns: int
    witnesses: int


def witness(periods: Distribution) -> Witness | None:
    """What an identifier's periods say of it; None where it does not come steadily."""
    if periods.count < _LEARN:
        return None
    usual = periods.quantile(0.5)
    longest = min(_OUTLIERS, periods.count // 4) / (periods.count - 1)
    high = periods.quantile(min(0.95, 1.0 - longest))
    spread = max(high - periods.quantile(0.05), STAMP_NS)
    return Witness(usual, spread) if spread <= max(_WITNESS * usual, STAMP_NS) else None


def forward_step(crossings: Sequence[Crossing]) -> Step | None:
    """The step that explains a silence, unless it may as well have been one.

    When the clock is set, each identifier goes on after one period, so that all stamps between two
    of its frames are too long by the same time. In a true silence they are whole multiples of each
    period instead; where both hold, only a silence so long that no two devices would keep their
    phase over it is taken for a step.
    """
    known = {each.can_id: each for each in crossings if each.across_ns is not None}
    if len(known) < 3:
        return None
    excess = {can_id: _excess(each) for can_id, each in known.items()}
    # With all that it imports it takes longer to load than all the rest of this module.
    from statistics import median

    by_ns = median(excess.values())
    if by_ns < _MIN_STEP * min(each.witness.spread_ns for each in known.values()):
        return None
    missing = [each for each in crossings if each.across_ns is None and _was_due(each, by_ns)]
    agree = {
        can_id for can_id, each in known.items() if abs(excess[can_id] - by_ns) <= _slack(each)
    }
    beats = known.keys() & set(HEARTBEATS)
    if not beats <= agree or len(agree) < _AGREE * len(known) or len(known) < len(missing):
        return None
    if not _excludes_silence(list(known.values()), by_ns):
        return None
    return Step(round(by_ns), len(agree))


def _excess(each: Crossing) -> float:
    return (each.across_ns or 0) - each.witness.period_ns


def _slack(each: Crossing) -> float:
    return 2 * each.witness.spread_ns


def _was_due(each: Crossing, by_ns: float) -> bool:
    """Whether a witness would have come again before the end, had the clock been set."""
    return each.left_ns > by_ns + RUNNING * each.witness.period_ns + _slack(each)


def _excludes_silence(known: Sequence[Crossing], by_ns: float) -> bool:
    """Whether the devices cannot have gone on unheard for that long.

    What follows SYNC tells no more than SYNC itself, unless it was on its way already; the PDOs of a
    node tell no more than its heartbeat.
    """
    tightest = min(each.witness.spread_ns for each in known)
    if sum(each.can_id in HEARTBEATS for each in known) >= 2 and _SURE_DRIFT * by_ns > 4 * tightest:
        return True
    sync_ns = next((each.witness.period_ns for each in known if each.can_id == SYNC), 0.0)
    clocks: dict[int, bool] = {}
    for each in known:
        waits = _follows(each, sync_ns) and not each.pending
        clock = SYNC if waits else each.can_id & 0x7F
        clocks[clock] = clocks.get(clock, False) or _out_of_phase(each)
    misses = sum(clocks.values())
    return misses >= max(2, len(clocks) / 3)


def _follows(each: Crossing, sync_ns: float) -> bool:
    """Whether frames may answer every n-th SYNC."""
    if each.can_id in HEARTBEATS or not sync_ns:
        return False
    period, spread = each.witness
    return abs(period - max(1, round(period / sync_ns)) * sync_ns) <= spread


def _out_of_phase(each: Crossing) -> bool:
    """Whether what passed is no whole number of periods."""
    period, spread = each.witness
    across = each.across_ns or 0
    off = abs(across / period - round(across / period)) * period
    return off > 2 * spread + _DRIFT * across
