"""Frames that an event timer owes: missing ones, and those that only waited for the bus."""

import numpy as np
import pytest
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.overdue import lacking_after
from syncline_analyzer.folds.timing.rhythm import Missed, Operational

TIMER = 1000


def lacking(stamps: list[float], timer: int = TIMER) -> dict[int, int]:
    """Missing frames by the number of the period."""
    periods: NDArray[np.int64] = np.diff(np.array(stamps)).astype(np.int64)
    rows, counts = lacking_after(periods, timer)
    return dict(zip(rows.tolist(), counts.tolist(), strict=True))


def ticks(count: int, every: float = TIMER) -> list[float]:
    return [every * k for k in range(count)]


def test_a_missing_frame_is_missing() -> None:
    stamps = ticks(100)
    del stamps[50]
    assert lacking(stamps) == {49: 1}
    del stamps[60:63]
    assert lacking(stamps) == {49: 1, 59: 3}


def test_a_late_frame_is_not_missing() -> None:
    stamps = ticks(100)
    stamps[50] += 0.9 * TIMER
    assert lacking(stamps) == {}


@pytest.mark.parametrize("late", [3, 9, 16])
def test_frames_that_queue_behind_a_full_bus_are_not_missing(late: int) -> None:
    """All of them are sent, each a little sooner after the one before."""
    stamps = ticks(200)
    for k in range(late * 3):
        stamps[50 + k] += max(late - k / 3, 0) * TIMER
    assert lacking(stamps) == {}


def test_a_missing_frame_is_found_between_late_ones() -> None:
    random = np.random.default_rng(3)
    stamps = [t + 0.9 * TIMER * random.random() for t in ticks(300)]
    assert lacking(stamps) == {}
    del stamps[150]
    assert sum(lacking(stamps).values()) == 1


def test_periods_of_two_lengths_do_not_make_another_timer() -> None:
    """Under load the median of the periods is none that the device keeps."""
    stamps = [t + (0.6 * TIMER if k % 3 == 0 else 0.0) for k, t in enumerate(ticks(300))]
    assert lacking(stamps) == {}


@pytest.mark.parametrize("clock", [0.95, 0.999, 1.05])
def test_a_clock_that_is_off_hides_nothing(clock: float) -> None:
    stamps = ticks(300, clock * TIMER)
    assert lacking(stamps) == {}
    del stamps[150]
    assert lacking(stamps) == {149: 1}


def test_where_events_restart_the_timer_nothing_makes_up_for_a_silence() -> None:
    stamps = [200.0 * k for k in range(100)]
    stamps = stamps[:50] + [t + 3000 for t in stamps[50:]]
    assert lacking(stamps) == {49: 2}


@pytest.mark.parametrize(
    ("start", "end", "settle"),
    [
        (0, 10**9, 0),
        (0, 10**9, TIMER),
        (150_000_500, 200_000_000, 0),
        (1, 120_000_999, 77),
        (9, 9, 0),
    ],
)
def test_moments_beyond_those_that_are_kept_count_where_their_node_ran(
    start: int, end: int, settle: int
) -> None:
    missed = Missed()
    missed.add_evenly(0, TIMER, 250_000, 7)
    found = missed.within([Operational(start, end, False)], TIMER, settle)
    due = range(TIMER, 250_001 * TIMER, TIMER)
    assert found.count == sum(each - settle >= start and each + TIMER <= end for each in due)


def test_a_silence_of_many_years_takes_no_memory() -> None:
    """The clock of a recorder without a battery was set while it recorded."""
    missed = Missed()
    missed.add_evenly(0, TIMER, 10**13, 7)
    found = missed.within([Operational(0, 10**16, False)], TIMER)
    assert found.count == 10**13 - 1
