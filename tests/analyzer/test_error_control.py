"""Guard answers, heartbeat paces and doubled cadences, against plain loops and by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.folds.bus.clock import BusSilence
from syncline_analyzer.folds.nmt.cadence import Doubles, Periods
from syncline_analyzer.folds.nmt.guarding import GUARD_ANSWER_NS, Guarding, Talk
from syncline_analyzer.folds.nmt.pace import HeartbeatPeriods
from syncline_analyzer.folds.nmt.quiet import Quiet

MS = 1_000_000
_MESSAGES = st.lists(
    st.tuples(
        st.sampled_from(["request", "stored request", "state", "toggled"]), st.integers(-5, 160)
    ),
    min_size=1,
    max_size=60,
)


def talk(messages: list[tuple[str, int]]) -> Talk:
    """Messages with the time [ms] that passed before each."""
    kinds = np.array([kind for kind, _ in messages])
    return Talk(
        np.arange(len(messages)),
        np.cumsum([passed for _, passed in messages]) * MS,
        np.char.endswith(kinds, "request"),
        kinds == "request",
        kinds == "toggled",
    )


def part(whole: Talk, begin: int, end: int) -> Talk:
    return whole.rows(slice(begin, end))


def answers_by_hand(whole: Talk) -> list[bool]:
    """The rule in words: right after a request, within 100 ms, and no heartbeat by habit.

    After two requests within 20 ms the second message is right after one as well.
    """
    found, asked, in_row = [], None, 0
    times = whole.t_ns.tolist()
    for row, t_ns in enumerate(times):
        if whole.request[row]:
            asked = t_ns
            found.append(False)
            continue
        if whole.request[max(row - 3, 0) : row].tolist() == [True, True, False]:
            hurried = times[row - 2] - times[row - 3] <= 20 * MS
            asked = times[row - 1] if hurried else None
        soon = asked is not None and t_ns - asked <= GUARD_ANSWER_NS
        answer = soon and (bool(whole.toggled[row]) or in_row < 3)
        in_row = 0 if answer else in_row + 1
        asked = None
        found.append(answer)
    return found


@given(_MESSAGES)
@settings(max_examples=300, deadline=None)
def test_guard_answers_are_what_the_rule_says(messages: list[tuple[str, int]]) -> None:
    whole = talk(messages)
    assert Guarding().follow(whole).tolist() == answers_by_hand(whole)


@given(_MESSAGES, st.integers(1, 9))
@settings(max_examples=300, deadline=None)
def test_guarding_does_not_depend_on_batches(messages: list[tuple[str, int]], size: int) -> None:
    whole = talk(messages)
    once, pieces = Guarding(), Guarding()
    found = once.follow(whole).tolist()
    told = [
        answer
        for begin in range(0, len(messages), size)
        for answer in pieces.follow(part(whole, begin, begin + size)).tolist()
    ]
    assert told == found
    for guarding in (once, pieces):
        guarding.gap()
    for name in ("missed", "unanswered", "doubled", "doubled_at", "both_at", "in_row", "pauses"):
        assert getattr(once, name) == getattr(pieces, name), name
    assert once.periods.quantiles() == pieces.periods.quantiles()


def test_missing_answers_are_counted_after_the_first_one() -> None:
    search = [("request", 100)] * 5
    asked = [("request", 100), ("state", 1), ("request", 99), ("toggled", 1)]
    silent = [("request", 100)] * 3
    guarding = Guarding()
    guarding.follow(talk([*search, *asked, *silent, *asked]))
    guarding.gap()
    assert guarding.missed == 3
    assert [(run.seq, run.number) for run in guarding.unanswered] == [(9, 3)]


def test_requests_that_the_recorder_took_twice_are_no_missing_answers() -> None:
    twice = [("request", 100), ("request", 0), ("state", 1), ("state", 0)]
    guarding = Guarding()
    guarding.follow(talk(twice * 20))
    assert (guarding.missed, guarding.doubled) == (0, 0)


def beats(*periods_ms: float) -> HeartbeatPeriods:
    """Paces of heartbeats with these periods."""
    passed = (np.array(periods_ms) * MS).astype(np.int64)
    steady = np.ones(len(passed), np.bool_)
    followed = HeartbeatPeriods()
    times = np.cumsum(passed)
    followed.note(np.arange(len(passed)), times, passed, steady, np.zeros(len(passed), np.bool_))
    followed.finish()
    return followed


def test_a_changed_period_begins_a_new_pace() -> None:
    paces = beats(*[100.0] * 40, *[1000.0] * 30).paces
    assert [pace.median_ns // MS for pace in paces] == [100, 1000]
    assert sum(pace.number for pace in paces) == 70


@given(st.lists(st.floats(20, 2000), min_size=1, max_size=80), st.integers(1, 20))
@settings(max_examples=200, deadline=None)
def test_paces_do_not_depend_on_batches(periods: list[float], size: int) -> None:
    passed = (np.array(periods) * MS).astype(np.int64)
    seq, times = np.arange(len(passed)), np.cumsum(passed)
    steady, late = passed % 7 != 0, passed % 5 == 0
    once, pieces = HeartbeatPeriods(), HeartbeatPeriods()
    once.note(seq, times, passed, steady, late)
    for at in range(0, len(passed), size):
        cut = slice(at, at + size)
        pieces.note(seq[cut], times[cut], passed[cut], steady[cut], late[cut])
    once.finish()
    pieces.finish()
    assert (once.paces, once.late, once.halved) == (pieces.paces, pieces.late, pieces.halved)
    assert once.stretches == pieces.stretches
    assert once.quantiles(once.late) == pieces.quantiles(pieces.late)


@pytest.mark.parametrize("grid", [0.0, 0.25])
def test_a_second_cadence_in_the_middle_must_keep_to_the_first(grid: float) -> None:
    """A timer that was set to half its period begins anew, at any moment."""
    shift = 500 * grid
    halved = beats(*[500.0] * 24, 250 + shift, *[250.0] * 40).halved
    assert (halved is None) == (grid != 0.0)


def doubles(passed_ms: np.ndarray) -> Doubles:
    passed = (passed_ms * MS).astype(np.int64)
    found = Doubles()
    found.note(np.arange(len(passed)), np.cumsum(passed), passed, np.ones(len(passed), np.bool_))
    return found


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), st.integers(20, 3000))
@settings(max_examples=150, deadline=None)
def test_one_producer_that_jitters_does_not_alternate(seed: int, jitter: float, n: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.sort(100 * np.arange(n) + rng.uniform(0, 100 * jitter, n))
    assert doubles(np.diff(times)).count == 0


@pytest.mark.parametrize("phase", [3, 17, 30, 42])
@pytest.mark.parametrize("size", [1, 5, 1000])
def test_two_producers_alternate(phase: int, size: int) -> None:
    passed = np.tile([phase, 100 - phase], 30) * MS
    found = Doubles()
    for at in range(0, len(passed), size):
        cut = slice(at, at + size)
        seq, t_ns = np.arange(len(passed))[cut], np.cumsum(passed)[cut]
        found.note(seq, t_ns, passed[cut], np.ones(len(seq), np.bool_))
    assert found.count == 58
    assert found.short_ns == pytest.approx(phase * MS)
    assert found.pair_ns == 100 * MS


def test_a_clock_that_is_set_makes_no_other_pair_of_intervals() -> None:
    """Heartbeats that wait behind the PDOs of every second SYNC; one producer sends them."""
    passed = np.tile([103.2, 96.8], 30)
    passed[32] += 3485
    found = doubles(passed[:38])
    assert found.count > 20
    assert found.pair_ns == pytest.approx(200 * MS)
    assert found.stepped


def test_periods_tell_their_extremes_exactly() -> None:
    periods = Periods()
    periods.add(np.array([100, 101, 99, 250, 100]) * MS)
    quantiles = periods.quantiles([400 * MS])
    assert quantiles is not None
    assert (quantiles.min, quantiles.max) == (99_000, 400_000)
    assert quantiles.median == pytest.approx(100_000, rel=1e-3)
    assert Periods().quantiles() is None


def test_only_silences_longer_than_usual_are_those_of_the_bus() -> None:
    usual = [BusSilence(100 * n * MS, 100 * (n + 1) * MS, n) for n in range(10)]
    quiet = Quiet([*usual, BusSilence(1000 * MS, 1500 * MS, 11)])
    assert quiet.within(0, 1000 * MS) == 0
    assert quiet.within(900 * MS, 2000 * MS) == 400 * MS
    assert Quiet([]).within(0, 1) == 0
