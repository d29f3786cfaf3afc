"""Adapter stamps mapped onto the recorder's clock: simulated adapters whose true time is known."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from syncline_logger.adapter_clock import AHEAD_NS, AdapterClock, Knot, Unwrapped, lower_line
from syncline_logger.clock import RecorderClock

SECOND = 1_000_000_000
UTC_NS = 1_763_780_000_000_000_000
SHORTEST_DELAY_NS = 300_000


class Machine:
    """UTC and elapsed time that a test moves."""

    def __init__(self) -> None:
        self.elapsed_ns = 77 * SECOND
        self.utc_offset_ns = UTC_NS
        self.clock = RecorderClock(
            lambda: self.elapsed_ns + self.utc_offset_ns, lambda: self.elapsed_ns
        )


@dataclass
class Adapter:
    """An adapter with a clock of its own: frames at true times, their stamps, their arrivals."""

    drift_ppm: float = 0.0
    start_ns: int = 0
    resolution_ns: int = 1_000

    def stamps(self, true_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        passed = true_ns - true_ns[0]
        stamps = self.start_ns + passed + np.rint(passed * self.drift_ppm * 1e-6).astype(np.int64)
        coarse: NDArray[np.int64] = stamps // self.resolution_ns * self.resolution_ns
        return coarse


def arrivals(
    true_ns: NDArray[np.int64], rng: np.random.Generator, jitter_ns: int, poll_ns: int = 0
) -> NDArray[np.int64]:
    """When frames reach the recorder: in order, after a delay, at the polls of the driver."""
    delay = SHORTEST_DELAY_NS + rng.exponential(jitter_ns, len(true_ns)).astype(np.int64)
    arrived = np.maximum.accumulate(true_ns + delay)
    if poll_ns:
        arrived = -(-arrived // poll_ns) * poll_ns
    return arrived


@dataclass
class Mapped:
    """t of each frame, the error that was stated for it, and the knot that made it."""

    t_ns: NDArray[np.int64]
    stated_ns: NDArray[np.int64]
    knots: list[Knot]
    adapter: AdapterClock


def mapped(
    machine: Machine, stamps: NDArray[np.int64], arrived: NDArray[np.int64], resolution_ns: int
) -> Mapped:
    """What the recorder makes of the stamps; frames that arrive together are read together."""
    adapter = AdapterClock(machine.clock, resolution_ns)
    cuts = np.flatnonzero(np.diff(arrived)) + 1
    t, stated, knots = [], [], []
    for part, at in zip(np.split(stamps, cuts), np.split(arrived, cuts), strict=True):
        machine.elapsed_ns = int(at[0])
        t.append(adapter.t_ns(part, int(at[0])))
        stated.append(np.full(len(part), adapter.residual_ns))
        knots += adapter.take_knots()
    return Mapped(np.concatenate(t), np.concatenate(stated), knots, adapter)


def error(
    machine: Machine, got: Mapped, true_ns: NDArray[np.int64], arrived: NDArray[np.int64]
) -> NDArray[np.int64]:
    """t against the true time plus the shortest delay, which nothing can tell."""
    shortest_ns = np.min(arrived - true_ns)
    difference: NDArray[np.int64] = got.t_ns - (true_ns + machine.utc_offset_ns + shortest_ns)
    return difference


def periodic(machine: Machine, seconds: float, period_ns: int) -> NDArray[np.int64]:
    times: NDArray[np.int64] = machine.elapsed_ns + np.arange(0, round(seconds * SECOND), period_ns)
    return times


traffic = st.sampled_from([(30, 2_000_000), (90, 10_000_000), (400, 100_000_000), (3_000, SECOND)])


@given(
    traffic,
    st.floats(-200, 200),
    st.sampled_from([100_000, 1_000_000, 4_000_000]),
    st.sampled_from([0, 1_000_000, 16_000_000]),
    st.sampled_from([1_000, 1_000_000]),
    st.integers(0, 2**32),
)
@settings(max_examples=20, deadline=None, derandomize=True, phases=[Phase.generate])
def test_the_stated_error_holds(
    load: tuple[int, int], drift_ppm: float, jitter_ns: int, poll_ns: int, step_ns: int, seed: int
) -> None:
    machine = Machine()
    rng = np.random.default_rng(seed)
    true_ns = periodic(machine, *load)
    true_ns += rng.integers(0, load[1], len(true_ns)) // 2
    arrived = arrivals(true_ns, rng, jitter_ns, poll_ns)
    got = mapped(machine, Adapter(drift_ppm, 0, step_ns).stamps(true_ns), arrived, step_ns)
    assert np.all(np.abs(error(machine, got, true_ns, arrived)) <= got.stated_ns)
    assert got.adapter.restarts == 0
    assert np.all(np.diff(got.t_ns) >= 0)
    late = got.stated_ns[len(got.stated_ns) // 2 :]
    assert late.max() <= 4 * step_ns + 2 * jitter_ns + poll_ns + 1_000_000


def test_a_day_of_drift_is_no_error() -> None:
    machine = Machine()
    rng = np.random.default_rng(1)
    true_ns = periodic(machine, 86_400, 8 * SECOND)
    arrived = arrivals(true_ns, rng, 1_000_000)
    got = mapped(machine, Adapter(drift_ppm=50).stamps(true_ns), arrived, 1_000)
    later = slice(1_000, None)
    assert np.abs(error(machine, got, true_ns, arrived)[later]).max() < 500_000
    assert abs(got.adapter.drift_ppb + 50_000) < 100
    assert np.median(got.stated_ns[later]) < 2_000_000


def test_what_was_mapped_can_be_undone() -> None:
    machine = Machine()
    rng = np.random.default_rng(2)
    true_ns = periodic(machine, 100, 5_000_000)
    stamps = Adapter(drift_ppm=120, start_ns=5 * SECOND).stamps(true_ns)
    got = mapped(machine, stamps, arrivals(true_ns, rng, 1_000_000), 1_000)
    assert len(got.knots) > 10
    begins = np.array([knot.mapped_ns for knot in got.knots])
    knot_of = np.searchsorted(begins, got.t_ns, side="right") - 1
    undone = np.empty_like(stamps)
    for number, knot in enumerate(got.knots):
        rows = knot_of == number
        undone[rows] = knot.stamps_ns(got.t_ns[rows])
    assert np.abs(undone - stamps).max() <= 1


def test_in_a_silence_the_drift_is_followed() -> None:
    machine = Machine()
    rng = np.random.default_rng(3)
    talk_ns = periodic(machine, 60, 10_000_000)
    true_ns = np.concatenate([talk_ns, talk_ns + 3_600 * SECOND])
    arrived = arrivals(true_ns, rng, 500_000)
    got = mapped(machine, Adapter(drift_ppm=200).stamps(true_ns), arrived, 1_000)
    assert got.adapter.restarts == 0
    after = slice(len(talk_ns), None)
    assert np.abs(error(machine, got, true_ns, arrived)[after]).max() < 3_000_000


@pytest.mark.parametrize("start_ns", [0, 5_000 * SECOND])
def test_an_adapter_that_starts_anew(start_ns: int) -> None:
    machine = Machine()
    rng = np.random.default_rng(4)
    first_ns = periodic(machine, 60, 10_000_000)
    again_ns = first_ns + 62 * SECOND
    true_ns = np.concatenate([first_ns, again_ns])
    arrived = arrivals(true_ns, rng, 500_000)
    stamps = np.concatenate(
        [
            Adapter(drift_ppm=80, start_ns=900 * SECOND).stamps(first_ns),
            Adapter(drift_ppm=80, start_ns=start_ns).stamps(again_ns),
        ]
    )
    got = mapped(machine, stamps, arrived, 1_000)
    assert got.adapter.restarts == 1
    assert np.abs(error(machine, got, true_ns, arrived)).max() < 10_000_000
    assert np.all(np.diff(got.t_ns) >= 0)


def test_an_adapter_whose_clock_stood_still() -> None:
    machine = Machine()
    rng = np.random.default_rng(5)
    true_ns = periodic(machine, 120, 10_000_000)
    arrived = arrivals(true_ns, rng, 500_000)
    stamps = Adapter().stamps(true_ns)
    stamps[6_000:] -= 20 * SECOND
    stamps[6_000:] = np.maximum(stamps[6_000:], stamps[5_999])
    got = mapped(machine, stamps, arrived, 1_000)
    assert got.adapter.restarts == 1
    assert np.abs(error(machine, got, true_ns, arrived)[-2_000:]).max() < 5_000_000


def test_frames_that_waited_long_are_stamped_when_they_came() -> None:
    machine = Machine()
    rng = np.random.default_rng(6)
    true_ns = periodic(machine, 120, 10_000_000)
    arrived = arrivals(true_ns, rng, 500_000)
    held = (true_ns > true_ns[5_000]) & (true_ns < true_ns[9_000])
    arrived[held] = true_ns[9_000]
    got = mapped(machine, Adapter(drift_ppm=30).stamps(true_ns), arrived, 1_000)
    assert got.adapter.restarts == 0
    assert np.abs(error(machine, got, true_ns, arrived)[4_000:]).max() < 2_000_000


def test_utc_that_was_set_forward_is_followed_at_once() -> None:
    machine = Machine()
    rng = np.random.default_rng(7)
    true_ns = periodic(machine, 20, 10_000_000)
    arrived = arrivals(true_ns, rng, 100_000)
    adapter = AdapterClock(machine.clock, 1_000)
    stamps = Adapter().stamps(true_ns)
    for row in range(1_000):
        machine.elapsed_ns = int(arrived[row])
        adapter.one_t_ns(int(stamps[row]), machine.elapsed_ns)
    machine.utc_offset_ns += 3_600 * SECOND
    machine.clock.sample()
    machine.elapsed_ns = int(arrived[1_000])
    t_ns = adapter.one_t_ns(int(stamps[1_000]), machine.elapsed_ns)
    assert abs(t_ns - (true_ns[1_000] + machine.utc_offset_ns)) < 2_000_000
    machine.utc_offset_ns -= 7_200 * SECOND
    machine.clock.sample()
    assert adapter.one_t_ns(int(stamps[1_001]), int(arrived[1_001])) > t_ns
    assert adapter.restarts == 0


def test_one_by_one_is_the_same_as_together() -> None:
    machine = Machine()
    stamps = np.arange(0, 40 * SECOND, 100_000_000)
    one, many = AdapterClock(machine.clock), AdapterClock(machine.clock)
    alone = [one.one_t_ns(stamp, 7 * SECOND + stamp) for stamp in stamps.tolist()]
    together = [many.t_ns(stamps[n : n + 1], 7 * SECOND + int(stamps[n])) for n in range(400)]
    assert alone == np.concatenate(together).tolist()
    assert one.take_knots() == many.take_knots() != []
    assert one.take_knots() == []


@given(
    st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 10**9)), min_size=1, max_size=30),
)
def test_the_line_lies_below_all_points(points: list[tuple[int, int]]) -> None:
    spaced, at = [], 0
    for gap, offset in points:
        at += 1 + gap * 1_000_000
        spaced.append((at, offset))
    line = lower_line(spaced)
    assert all(offset >= line.offset_at(at) - 1 for at, offset in spaced)
    assert any(abs(offset - line.offset_at(at)) <= 1 for at, offset in spaced)


@given(
    st.sampled_from([(60_000, 1_000_000), (65_536, 1_000_000), (1 << 32, 1_000)]),
    st.lists(st.integers(0, 400 * SECOND), min_size=1, max_size=40),
    st.lists(st.integers(0, 20_000_000), min_size=40, max_size=40),
    st.integers(0, 2**40),
)
def test_a_counter_that_wraps_goes_on(
    counter: tuple[int, int], gaps: list[int], delays: list[int], start: int
) -> None:
    wrap, unit_ns = counter
    true_ns = (start + np.cumsum(gaps)) // unit_ns * unit_ns
    unwrapped = Unwrapped(wrap, unit_ns)
    got = [
        int(unwrapped.stamps_ns(np.array([at // unit_ns % wrap]), at + delay)[0])
        for at, delay in zip(true_ns.tolist(), delays, strict=False)
    ]
    assert np.diff(got).tolist() == np.diff(true_ns).tolist()


def test_a_counter_that_wraps_within_what_came_together() -> None:
    counts = np.array([59_990, 59_999, 3, 1, 40_000])
    got = Unwrapped(60_000, 1_000_000).stamps_ns(counts, 0) // 1_000_000
    assert np.diff(got).tolist() == [9, 4, -2, 39_999]


def test_a_knot_in_numbers() -> None:
    knot = Knot(1_000, 5_000_000, 200_000, 0)
    assert knot.t_ns(np.array([1_000, 1_001_000])).tolist() == [5_000_000, 6_000_200]
    assert knot.stamps_ns(np.array([6_000_200])).tolist() == [1_001_000]


def test_all_arrivals_may_have_been_late_at_first() -> None:
    adapter = AdapterClock(Machine().clock)
    adapter.one_t_ns(0, 5)
    assert adapter.residual_ns is not None
    assert adapter.residual_ns >= AHEAD_NS
