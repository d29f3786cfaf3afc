"""The recorder's clock under clock steps."""

from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_logger.clock import STEP_THRESHOLD_NS, RecorderClock


class FakeClocks:
    """UTC and a monotonic clock that a test moves."""

    def __init__(self, utc_ns: int = 1_700_000_000_000_000_000) -> None:
        self.utc_ns = utc_ns
        self.monotonic_ns = 5_000

    def pass_time(self, ns: int, step_ns: int = 0) -> None:
        self.monotonic_ns += ns
        self.utc_ns += ns + step_ns

    def clock(self) -> RecorderClock:
        return RecorderClock(lambda: self.utc_ns, lambda: self.monotonic_ns)


def test_it_is_utc_while_nothing_steps() -> None:
    clocks = FakeClocks()
    clock = clocks.clock()
    clocks.pass_time(1_000_000_000)
    assert clock.now_ns() == clocks.utc_ns
    assert clock.sample().step_ns == 0


def test_it_follows_utc_forward_and_says_by_how_much() -> None:
    clocks = FakeClocks()
    clock = clocks.clock()
    clocks.pass_time(1_000, step_ns=86_400_000_000_000)
    reading = clock.sample()
    assert reading.step_ns == 86_400_000_000_000
    assert clock.now_ns() == clocks.utc_ns
    assert clock.sample().step_ns == 0


def test_it_does_not_follow_utc_back_but_says_so() -> None:
    clocks = FakeClocks()
    clock = clocks.clock()
    before = clock.now_ns()
    clocks.pass_time(1_000, step_ns=-3_600_000_000_000)
    assert clock.sample().step_ns == -3_600_000_000_000
    assert clock.now_ns() == before + 1_000


def test_slewing_is_no_step() -> None:
    clocks = FakeClocks()
    clock = clocks.clock()
    clocks.pass_time(1_000_000_000, step_ns=STEP_THRESHOLD_NS - 1)
    assert clock.sample().step_ns == 0


@given(st.lists(st.tuples(st.integers(0, 10**12), st.integers(-(10**13), 10**13), st.booleans())))
@settings(max_examples=100)
def test_it_never_steps_back(moves: list[tuple[int, int, bool]]) -> None:
    clocks = FakeClocks()
    clock = clocks.clock()
    times = [clock.now_ns()]
    for ns, step_ns, sampled in moves:
        clocks.pass_time(ns, step_ns)
        if sampled:
            clock.sample()
        times.append(clock.now_ns())
    assert all(later >= earlier for earlier, later in pairwise(times))


def test_the_sleep_of_the_machine_is_told_and_is_no_step() -> None:
    clocks = FakeClocks()
    slept_ns = 0
    clock = RecorderClock(
        lambda: clocks.utc_ns, lambda: clocks.monotonic_ns, lambda: clocks.monotonic_ns + slept_ns
    )
    clocks.pass_time(1_000_000_000)
    clock.sample()
    slept_ns = 3_600_000_000_000
    clocks.pass_time(1_000_000_000, step_ns=slept_ns)
    assert clock.now_ns() == clocks.utc_ns, "log time needs no sample to be right again"
    reading = clock.sample()
    assert (reading.slept_ns, reading.step_ns) == (slept_ns, 0)
    assert reading.elapsed_ns - reading.monotonic_ns == slept_ns
    assert clock.sample().slept_ns == 0


def test_a_pause_between_the_readings_is_no_step() -> None:
    clocks = FakeClocks()
    pauses = iter([0, 0, 50_000_000, 40_000_000, 0])

    def utc_ns() -> int:
        clocks.pass_time(next(pauses, 0))
        return clocks.utc_ns

    clock = RecorderClock(utc_ns, lambda: clocks.monotonic_ns)
    clock.sample()
    reading = clock.sample()
    assert (reading.step_ns, reading.uncertainty_ns) == (0, 0)


def test_what_is_uncertain_is_no_step() -> None:
    clocks = FakeClocks()

    def utc_ns() -> int:
        clocks.pass_time(10_000_000)
        return clocks.utc_ns

    clock = RecorderClock(utc_ns, lambda: clocks.monotonic_ns)
    clocks.pass_time(0, step_ns=9_000_000)
    reading = clock.sample()
    assert (reading.step_ns, reading.uncertainty_ns) == (0, 10_000_000)


def test_the_machines_own_clocks() -> None:
    reading = RecorderClock().sample()
    assert reading.slept_ns == 0
    assert reading.uncertainty_ns >= 0
    assert abs(reading.elapsed_ns + reading.offset_ns - reading.utc_ns) < 60_000_000_000
