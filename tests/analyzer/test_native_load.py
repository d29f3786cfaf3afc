"""Compiled loops of bus load and of distributions, against numpy's and against plain loops."""

from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from syncline_analyzer.distribution import FINE_BINS
from syncline_analyzer.folds.timing import load_busy
from syncline_analyzer.folds.timing.load_busy import BURST_NS, Busy
from syncline_schemas import native

pytestmark = pytest.mark.skipif(not native.available(), reason="the library is not built")

SEEDS = st.integers(0, 2**32 - 1)
Part = tuple[NDArray[np.int64], NDArray[np.float64]]


def traffic(rng: np.random.Generator, bit_ns: float, tick_ns: int) -> list[Part | None]:
    """Frames in parts, some of them stamped in bundles; None where listening ended."""
    parts: list[Part | None] = []
    now, slack = 10**18, rng.choice([1.05, 2.0, 20.0])
    for _ in range(int(rng.integers(1, 5))):
        count = int(rng.integers(1, 300))
        wire_ns = rng.choice([47, 55, 111, 130], count) * bit_ns
        ends = np.cumsum(wire_ns * rng.uniform(1, slack, count))
        t_ns = now + (np.ceil(ends / tick_ns) * tick_ns).astype(np.int64)
        if rng.random() < 0.4:
            first, last = np.sort(rng.integers(0, count, 2))
            t_ns[first:last] = t_ns[last]
        parts.append((t_ns, wire_ns))
        if rng.random() < 0.2:
            parts.append(None)
        now = int(t_ns[-1]) + int(rng.integers(0, 9)) * tick_ns
    return parts


def busy(parts: list[Part | None], bit_ns: float, tick_ns: int) -> list[object]:
    """What is told after each part."""
    bus, told = Busy(), list[object]()
    for part in parts:
        if part is None:
            bus.close()
        else:
            bus.add(*part, bit_ns, tick_ns)
        told.append((bus.burst, bus.longest, bus.peak(1), bus.stretch(1, bit_ns)))
    return told


@given(
    seed=SEEDS,
    bitrate=st.sampled_from([1_000_000, 500_000, 125_000, 83_333]),
    tick_ns=st.sampled_from([1, 1000, 100_000, 1_000_000]),
)
@settings(max_examples=150, deadline=None)
def test_busy_buses_are_those_of_numpy(seed: int, bitrate: int, tick_ns: int) -> None:
    bit_ns = 1e9 / bitrate
    parts = traffic(np.random.default_rng(seed), bit_ns, tick_ns)
    ours = busy(parts, bit_ns, tick_ns)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "available", lambda: False)
        assert ours == busy(parts, bit_ns, tick_ns)


@given(seed=SEEDS)
@settings(max_examples=100, deadline=None)
def test_stretches_of_a_plain_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 60))
    t_ns = 10**18 + np.cumsum(rng.integers(0, 400, count))
    wire_ns = rng.integers(50, 200, count) + rng.choice([0.0, 0.5])
    before_ns = None if rng.random() < 0.5 else int(t_ns[0]) - int(rng.integers(0, 400))
    soon, too_soon, rows = native.stretches(t_ns, wire_ns, before_ns, -100.0, 120.0)

    stretches: list[list[int]] = [] if before_ns is None else [[-1]]
    early, last_ns = [], before_ns
    for row, (now, took) in enumerate(zip(t_ns.tolist(), wire_ns.tolist(), strict=True)):
        idle = 0.0 if last_ns is None else now - last_ns - took
        early.append(idle < -100)
        if last_ns is None or not -100 <= idle <= 120:
            stretches.append([])
        stretches[-1].append(row)
        last_ns = now
    begun = [each for each in stretches if each[0] >= 0]
    lasts = [int(t_ns[each[-1]]) - (int(t_ns[each[0]]) - round(wire_ns[each[0]])) for each in begun]
    expected = [count] * 4
    if begun:
        longest = begun[lasts.index(max(lasts))]
        expected = [begun[0][0], begun[-1][0], longest[0], longest[-1]]
    assert (soon.tolist(), too_soon, rows) == (early, sum(early), expected)


def busy_between(starts: list[float], ends: list[float], since: float, until: float) -> float:
    """How long frames were on the wire between two moments."""
    each = zip(starts, ends, strict=True)
    return sum(max(0.0, min(end, until) - max(start, since)) for start, end in each)


@given(seed=SEEDS, slack=st.sampled_from([1.2, 4.0, 30.0]))
@settings(max_examples=40, deadline=None)
def test_the_fullest_window_of_a_plain_loop(seed: int, slack: float) -> None:
    """Of frames that never overlap, which the wire may have carried."""
    rng = np.random.default_rng(seed)
    wire_ns = rng.integers(100_000, 500_000, 150).astype(np.float64)
    t_ns = np.cumsum((wire_ns * rng.uniform(1, slack, 150)).astype(np.int64) + 1)
    ends = (t_ns - t_ns[0]).astype(float).tolist()
    starts = [end - took for end, took in zip(ends, wire_ns, strict=True)]
    windows = ends + [start + BURST_NS for start in starts]
    windows = [end for end in windows if BURST_NS <= end <= ends[-1]]
    nothing = np.zeros(0)
    found = native.fullest_window(t_ns, wire_ns, 0, int(t_ns[0]), BURST_NS, 0.0, nothing, nothing)
    carried = [busy_between(starts, ends, end - BURST_NS, end) for end in windows]
    assert found is not None
    assert found[0] == pytest.approx(max(carried), abs=1e-3)
    assert carried[windows.index(found[1])] == pytest.approx(max(carried), abs=1e-3)


def test_impossible_stamps_do_not_fill_a_window() -> None:
    """Frames of half the time, and twenty of them at once."""
    t_ns, wire_ns = np.arange(1, 201) * 200_000, np.full(200, 1e5)
    t_ns[100:120] = t_ns[119]
    soon = np.diff(t_ns, prepend=0) < 1e5
    spoiled = load_busy._Spoiled.by(t_ns, soon, int(t_ns[0]))
    found = native.fullest_window(
        t_ns, wire_ns, 0, int(t_ns[0]), BURST_NS, 0.0, spoiled.after, spoiled.until
    )
    assert found is not None
    assert found[0] == 5e6


@given(seed=SEEDS)
@settings(max_examples=50, deadline=None)
def test_tallies_of_a_plain_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    keys = rng.integers(0, 50, int(rng.integers(0, 200))).astype(np.uint32)
    weights = rng.integers(0, 130, len(keys)).astype(np.float64)
    counts, sums = np.zeros(50, np.int64), np.zeros(50)
    native.tally(keys, weights, counts, sums)
    expected: Counter[int] = Counter()
    for key, weight in zip(keys.tolist(), weights.tolist(), strict=True):
        expected[key] += weight
    assert counts.tolist() == [keys.tolist().count(key) for key in range(50)]
    assert sums.tolist() == [expected[key] for key in range(50)]


@pytest.mark.parametrize("dtype", [np.int64, np.float64])
def test_bins_of_a_plain_loop(dtype: type[np.int64] | type[np.float64]) -> None:
    rng = np.random.default_rng(1)
    values: NDArray[Any] = (10.0 ** rng.uniform(-2, 18.9, 2000)).astype(dtype)
    values[:5] = (0, 1, 100, 199, 200)
    fine, coarse = np.zeros(100, np.int64), np.zeros(500, np.int64)
    above = native.histogram(values, 100.0, 1.0, fine, 52 - 3, 1023 << 3, coarse)
    far = [value for value in values.tolist() if not 100 <= value < 200]
    near = [value for value in values.tolist() if 100 <= value < 200]
    edges = [2**octave * (1 + eighth / 8) - 1 for octave in range(63) for eighth in range(8)]
    counted = [sum(low <= value < high for value in far) for low, high in pairwise(edges[:500])]
    assert above.tolist() == [float(value) - 100 for value in values.tolist()]
    assert coarse[:-1].tolist() == counted
    assert fine.tolist() == [
        sum(low <= value < low + 1 for value in near) for low in range(100, 200)
    ]


@pytest.mark.parametrize("compiled", [True, False])
def test_stamps_too_far_apart_for_their_distance_tell_no_burst(
    monkeypatch: pytest.MonkeyPatch, compiled: bool
) -> None:
    """As of a damaged capture: 300 years lie between two frames."""
    monkeypatch.setattr(native, "available", lambda: compiled)
    early = np.arange(1, 201) * 200_000 - 2**62
    late = early + 2**62 + 2**62
    bus = Busy()
    for t_ns in (early[:100], np.concatenate((early[100:], late[:100])), late[100:]):
        bus.add(t_ns, np.full(len(t_ns), 1e5), 1e3, 1)
    assert bus.burst is not None
    assert bus.burst[0] == pytest.approx(0.5)
    assert bus.burst[1] == early[0]


def test_the_earliest_stamps_that_there_are_tell_a_stretch() -> None:
    bus, t_ns = Busy(), np.arange(1, 4) * 100_000 + np.iinfo(np.int64).min
    bus.add(t_ns, np.full(3, 1e5), 1e3, 1)
    assert bus.longest == load_busy.Stretch(-(2**63), int(t_ns[-1]), 3)


def test_columns_of_other_lengths_are_refused() -> None:
    t_ns, wire_ns, none = np.arange(3), np.ones(3), np.zeros(0)
    counts = np.zeros(FINE_BINS, np.int64)
    with pytest.raises(ValueError, match="columns of other"):
        native.stretches(t_ns, wire_ns[:2], None, 0.0, 0.0)
    with pytest.raises(ValueError, match="columns of other"):
        native.fullest_window(t_ns[:0], none, 0, 0, 1.0, 0.0, none, none)
    with pytest.raises(ValueError, match="columns of other"):
        native.fullest_window(t_ns, wire_ns, 0, 0, 1.0, 0.0, none, wire_ns)
    with pytest.raises(ValueError, match="columns of other"):
        native.tally(np.array([4], np.uint32), wire_ns[:1], counts[:4], np.zeros(4))
    with pytest.raises(ValueError, match="columns of other"):
        native.tally(np.array([3], np.uint32), wire_ns[:1], counts[:4], np.zeros(3))
    with pytest.raises(ValueError, match="columns of other"):
        native.histogram(wire_ns, 0.0, 1.0, counts, 45, 0, counts[:0])
    with pytest.raises(ValueError, match="columns of other"):
        native.histogram(wire_ns, 0.0, 1.0, counts, 45, -1, counts)
