"""The bit rate by the spacing of frames: found on a shared wire, and never found where there is none.

The frames are put on the wire here by hand and with the simulator's own wire lengths.
"""

from collections.abc import Iterable, Sequence
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.bit_rate import CANDIDATES, Estimate, estimate
from syncline_samples.wire import wire_bits
from tests.analyzer.wire_builder import Ready, Sent, arbitrated, machine


def stamped(sent: Iterable[Sent], step_ns: int = 1) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(spacings, bits) of frames with stamps of this step."""
    frames = list(sent)
    t_ns = np.array([each.end_ns for each in frames]).astype(np.int64) // step_ns * step_ns
    return np.diff(t_ns), np.array([each.bits for each in frames[1:]], np.int64)


def judged(sent: Iterable[Sent], step_ns: int = 1) -> Estimate | None:
    return estimate(*stamped(sent, step_ns), step_ns)


def confident(found: Estimate | None) -> int | None:
    """The bit rate that is used; None where there is none or only a guess."""
    return found.bitrate if found is not None and found.confident else None


def test_frames_back_to_back_tell_the_bit_rate_by_hand() -> None:
    """55, 95 and 120 bits at 500 kbit/s last 110, 190 and 240 us; nothing comes sooner."""
    apart = np.array([110, 190, 240, 3000, 1200, 900] * 10, np.int64) * 1000
    bits = np.array([55, 95, 120, 55, 95, 120] * 10, np.int64)
    found = estimate(apart, bits, 1000)
    assert found == Estimate(500_000, True, 30, 11_000)


def test_a_single_spacing_below_the_limit_among_many_is_no_other_bit_rate() -> None:
    apart = np.array([110, 190, 240, 3000, 1200, 900] * 10 + [60], np.int64) * 1000
    bits = np.array([55, 95, 120, 55, 95, 120] * 10 + [55], np.int64)
    assert confident(estimate(apart, bits, 1000)) == 500_000


def test_several_frames_in_a_row_prove_nothing_that_single_ones_contradict() -> None:
    """Two frames end as 500 kbit/s would have it by chance; the first of them came far too soon."""
    apart = np.array([60, 190, 3000, 100, 330, 3000] * 20, np.int64) * 1000
    bits = np.array([55, 70, 55, 95, 120, 55] * 20, np.int64)
    assert confident(estimate(apart, bits, 1000)) is None


@pytest.mark.parametrize("bitrate", CANDIDATES)
@pytest.mark.parametrize("step_ns", [1, 1000, 10_000])
def test_every_bit_rate_is_found_on_a_busy_bus(bitrate: int, step_ns: int) -> None:
    found = judged(arbitrated(machine(bitrate, 0.6), bitrate), step_ns)
    assert confident(found) in ((bitrate,) if step_ns < 10_000 else (bitrate, None))


@pytest.mark.parametrize("bitrate", [33_333, 83_333, 200_000, 400_000, 666_667])
def test_an_unusual_bit_rate_is_not_taken_for_another(bitrate: int) -> None:
    assert confident(judged(arbitrated(machine(bitrate, 0.6), bitrate), 1000)) is None


@pytest.mark.parametrize(
    ("bitrate", "answers"),
    [
        (333_333, ((394, 1), (401, 4), (428, 8), (434, 6), (435, 8), (441, 8), (442, 4), (447, 6))),
        (333_333, ((401, 6), (403, 8), (413, 8), (415, 1), (443, 4), (444, 8))),
        (400_000, ((389, 8), (397, 8), (401, 8), (402, 8), (403, 7), (415, 2), (429, 4), (442, 6))),
        (95_238, ((389, 8), (412, 6), (414, 4), (420, 0), (421, 2))),
    ],
)
def test_stamps_of_the_start_of_frames_are_not_taken_for_another_bit_rate(
    bitrate: int, answers: Sequence[tuple[int, int]]
) -> None:
    """Nodes that answer every SYNC with zeros: each spacing is as long as the frame before."""

    def sent(rate: int) -> list[Sent]:
        ready = [
            Ready(k * 10e6 + late, can_id, bytes(size))
            for k in range(100)
            for can_id, size, late in ((0x80, 0, 0), *((*each, 1e6) for each in answers))
        ]
        return arbitrated(ready, rate)

    begun = [
        each._replace(end_ns=each.end_ns - (each.bits - 3) * 1e9 / bitrate)
        for each in sent(bitrate)
    ]
    assert confident(judged(begun, 1000)) is None
    assert confident(judged(sent(bitrate), 1000)) is None
    assert confident(judged(sent(250_000), 1000)) == 250_000


@pytest.mark.parametrize("bitrate", [50_000, 100_000, 125_000])
def test_steps_of_100_us_suffice_for_slow_buses(bitrate: int) -> None:
    found = judged(arbitrated(machine(bitrate, 0.7), bitrate), 100_000)
    assert confident(found) == bitrate


@pytest.mark.parametrize("bitrate", [250_000, 500_000, 1_000_000])
def test_steps_of_1_ms_tell_nothing_wrong(bitrate: int) -> None:
    for seed in range(5):
        sent = arbitrated(machine(bitrate, 0.6, seed=seed), bitrate)
        assert confident(judged(sent, 1_000_000)) in (bitrate, None)


@given(
    st.sampled_from(CANDIDATES),
    st.floats(0.01, 0.95),
    st.integers(0, 1 << 30),
    st.sampled_from([1, 1000, 10_000, 100_000, 1_000_000]),
    st.sampled_from([(8,), (0, 1, 2, 4, 8), (2, 8), (4,)]),
    st.integers(50, 2000),
)
@settings(max_examples=60, deadline=None)
def test_a_shared_wire_is_never_judged_wrong(
    bitrate: int, load: float, seed: int, step_ns: int, lengths: Sequence[int], count: int
) -> None:
    sent = arbitrated(machine(bitrate, load, count, seed=seed, lengths=lengths), bitrate)
    assert confident(judged(sent, step_ns)) in (bitrate, None)


def test_stamps_may_be_coarser_than_is_said() -> None:
    """A converter writes microseconds, but the recorder counted milliseconds."""
    for seed in range(5):
        apart, bits = stamped(arbitrated(machine(50_000, 0.4, seed=seed), 50_000), 1_000_000)
        assert confident(estimate(apart, bits, 1000)) in (50_000, None)


@given(
    st.sampled_from(CANDIDATES),
    st.integers(20, 3000),
    st.integers(20, 3000),
    st.sampled_from([0, 1, 20]),
    st.booleans(),
    st.integers(0, 1 << 30),
)
@settings(max_examples=60, deadline=None)
def test_requests_and_answers_after_a_constant_time_are_never_judged_wrong(
    bitrate: int, request_us: int, answer_us: int, jitter_us: int, same: bool, seed: int
) -> None:
    """An idle bus: nothing is ever back to back, however steady the node answers."""
    rng = Random(seed)
    end, sent = 0.0, []
    data = [rng.randbytes(8), rng.randbytes(8)]
    for k in range(600):
        bits = wire_bits((0x605, 0x585)[k % 2], data[k % 2] if same else rng.randbytes(8))
        pause_us = (request_us, answer_us)[k % 2] + jitter_us * rng.random()
        end += pause_us * 1000 + bits * 1e9 / bitrate
        sent.append(Sent(end, bits))
    assert confident(judged(sent, 1000)) in (bitrate, None)


@given(st.sampled_from(CANDIDATES), st.floats(0.05, 0.9), st.integers(0, 1 << 30))
@settings(max_examples=40, deadline=None)
def test_bundles_of_a_usb_adapter_are_never_judged_wrong(
    bitrate: int, load: float, seed: int
) -> None:
    """Frames wait for the next millisecond and then come a few microseconds apart."""
    rng = Random(seed)
    last, late = 0.0, []
    for each in arbitrated(machine(bitrate, load, seed=seed), bitrate):
        last = max(np.ceil(each.end_ns / 1e6) * 1e6, last + rng.uniform(3e3, 30e3))
        late.append(Sent(last, each.bits))
    assert confident(judged(late, 1000)) in (bitrate, None)


@given(st.sampled_from(CANDIDATES), st.floats(0.05, 0.9), st.integers(0, 1 << 30))
@settings(max_examples=40, deadline=None)
def test_interrupts_of_a_busy_host_are_never_judged_wrong(
    bitrate: int, load: float, seed: int
) -> None:
    rng = Random(seed)
    last, late = 0.0, []
    for each in arbitrated(machine(bitrate, load, seed=seed), bitrate):
        slow = rng.expovariate(1 / 3e5) if rng.random() < 0.05 else 0
        last = max(last, each.end_ns + rng.expovariate(1 / 15e3) + slow)
        late.append(Sent(last, each.bits))
    assert confident(judged(late, 1000)) in (bitrate, None)


def test_frames_of_one_length_are_no_proof() -> None:
    """120 bits every 480 us are 250 kbit/s back to back, or 500 kbit/s with 240 us between."""
    found = estimate(np.full(500, 480_000), np.full(500, 120), 1000)
    assert confident(found) is None


def test_two_buses_in_one_are_no_bus() -> None:
    """Frames of two wires overlap: they come sooner than any wire carries them."""
    one = arbitrated(machine(250_000, 0.5, seed=1), 250_000)
    other = arbitrated(machine(250_000, 0.5, seed=2), 250_000)
    assert judged(sorted([*one, *other])) is None


def test_a_recorder_that_writes_everything_twice_tells_nothing() -> None:
    """Echoes that were not recognised: each frame again 30 us later."""
    sent = arbitrated(machine(500_000, 0.5), 500_000)
    echoed = sorted([*sent, *(each._replace(end_ns=each.end_ns + 30_000) for each in sent)])
    assert confident(judged(echoed)) in (500_000, None)


@pytest.mark.parametrize("count", [0, 1, 7])
def test_a_few_frames_tell_nothing(count: int) -> None:
    assert estimate(np.full(count, 240_000), np.full(count, 120), 1) is None


def test_what_does_not_count_is_left_out() -> None:
    """Spacings over gaps and error frames are marked with -1."""
    apart = np.array([110, 190, 240, 3000, 1200, 900] * 10, np.int64) * 1000
    bits = np.array([55, 95, 120, 55, 95, 120] * 10, np.int64)
    apart[::6] = -1
    found = estimate(apart, bits, 1000)
    assert found is not None
    assert (found.bitrate, found.frames) == (500_000, 20)
    assert estimate(np.full(60, -1), bits, 1000) is None
