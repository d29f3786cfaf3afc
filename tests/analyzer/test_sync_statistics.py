"""Figures of SYNC beyond its periods: drift, counter, doubled ones, what the stamps can show."""

from statistics import median

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from syncline_analyzer.folds.timing.doubled_sync import Doubled
from syncline_analyzer.folds.timing.usual import even
from syncline_analyzer.results import SyncRow, WorstRow
from syncline_schemas.batch import Gap
from tests.analyzer.timing_builder import (
    MS,
    SECOND,
    T0,
    US,
    Row,
    context,
    frame,
    learn,
    ordered,
    regular,
    syncs,
    timing,
)

PRODUCER = 1 << 30 | 0x80


def only(rows: list[SyncRow]) -> SyncRow:
    (row,) = rows
    return row


def counted(times: list[int], overflow: int, start: int = 1, skip: int | None = None) -> list[Row]:
    """SYNCs with a counter, which leaves one number out before one of them."""
    numbers = [start + k + (skip is not None and k >= skip) for k in range(len(times))]
    return [
        frame(t, 0x80, bytes([(number - 1) % overflow + 1]))
        for t, number in zip(times, numbers, strict=True)
    ]


def drifting(ppm: float, count: int = 2000, step_ns: int = 1) -> list[int]:
    times = np.arange(count) * 10 * MS * (1 + ppm / 1e6)
    return [int(t // step_ns) * step_ns for t in times.tolist()]


@pytest.mark.parametrize("ppm", [-80.0, 35.0, 900.0])
@pytest.mark.parametrize("step_ns", [1, US, 100 * US])
def test_drift_is_that_of_the_producers_clock(ppm: float, step_ns: int) -> None:
    ctx = context(resolution_ns=step_ns)
    learn(ctx, 1, 0x1005, 0, PRODUCER)
    learn(ctx, 1, 0x1006, 0, 10_000, source="sdo-write")
    row = only(timing(ctx, ordered(syncs(drifting(ppm, step_ns=step_ns)))).sync)
    assert (row.expected_us, row.expected_source) == (10_000, "1006h of node 1 (sdo-write)")
    assert row.drift_resolution_ppm is not None
    assert row.drift_resolution_ppm == pytest.approx(step_ns / (19.99 * SECOND) * 1e6, rel=0.01)
    assert row.drift_ppm == pytest.approx(ppm, abs=row.drift_resolution_ppm + 0.01)
    assert row.producer_nodes == [1]


def test_a_drift_that_the_stamps_hide_is_not_told() -> None:
    ctx = context(resolution_ns=MS)
    learn(ctx, 1, 0x1005, 0, PRODUCER)
    learn(ctx, 1, 0x1006, 0, 10_000)
    row = only(timing(ctx, ordered(syncs(drifting(20.0, step_ns=MS)))).sync)
    assert row.drift_ppm is None
    assert row.drift_resolution_ppm == pytest.approx(50, rel=0.01)
    assert row.deviation_us is None
    assert row.resolution_us == 1000
    assert row.jitter_us is not None
    assert row.jitter_us.std is None
    assert row.jitter_us.max_min in (None, 1000, 2000)


def test_another_period_than_the_one_set_is_no_drift() -> None:
    ctx = context()
    learn(ctx, 1, 0x1005, 0, PRODUCER)
    learn(ctx, 1, 0x1006, 0, 10_000)
    row = only(timing(ctx, ordered(syncs(regular(100, 12 * MS)))).sync)
    assert row.drift_ppm is None
    assert row.deviation_us == 2000
    assert row.mean_us == 12_000


def test_missing_syncs_and_a_gap_do_not_change_the_mean() -> None:
    ctx = context()
    learn(ctx, 1, 0x1005, 0, PRODUCER)
    learn(ctx, 1, 0x1006, 0, 10_000)
    times = [t for k, t in enumerate(drifting(50.0)) if k not in (50, 51, 700)]
    gap = Gap(T0 + times[300] + 1, T0 + times[310] - 1, "test", None, 0)
    tables = timing(ctx, ordered(syncs(times[:301])), gap, ordered(syncs(times[310:])))
    row = only(tables.sync)
    assert row.missing == 3
    assert row.drift_ppm == pytest.approx(50.0, abs=0.01)


def test_the_mean_counts_since_the_period_was_set_anew() -> None:
    ctx = context()
    learn(ctx, 1, 0x1005, 0, PRODUCER)
    learn(ctx, 1, 0x1006, 0, 10_000)
    learn(ctx, 1, 0x1006, 0, 20_000, seq=500, source="sdo-write")
    times = [*regular(500, 10 * MS), *regular(500, 20 * MS, 5 * SECOND)]
    row = only(timing(ctx, ordered(syncs(times)), size=100, block_frames=100).sync)
    assert (row.expected_us, row.mean_us) == (20_000, 20_000)


def test_1006h_of_those_that_take_it_counts_where_all_say_the_same() -> None:
    ctx = context()
    learn(ctx, 5, 0x1006, 0, 10_000)
    learn(ctx, 6, 0x1006, 0, 10_000)
    frames = ordered(syncs(regular(50, 10 * MS)))
    row = only(timing(ctx, frames).sync)
    assert row.expected_source == "1006h of node 5 that takes it (sdo-read)"
    assert row.producer_nodes == []
    learn(ctx, 6, 0x1006, 0, 20_000)
    assert only(timing(ctx, frames).sync).expected_us is None


def test_a_default_of_an_eds_tells_no_period() -> None:
    ctx = context()
    learn(ctx, 5, 0x1006, 0, 10_000, source="eds-default")
    assert only(timing(ctx, ordered(syncs(regular(50, 10 * MS)))).sync).expected_us is None


@pytest.mark.parametrize("told", [None, 10, 240])
def test_the_counter_shows_where_it_ends_whatever_was_told(told: int | None) -> None:
    ctx = context()
    if told:
        learn(ctx, 1, 0x1019, 0, told)
    times = regular(200, 10 * MS)
    row = only(timing(ctx, ordered(counted(times, 10))).sync)
    assert (row.counter_jumps, row.missing) == (0, 0)
    assert (row.counter_max, row.counter_overflow) == (10, told)
    assert row.counter_wraps == 19
    row = only(timing(ctx, ordered(counted(times, 10, skip=55))).sync)
    assert (row.counter_jumps, row.missing) == (1, 1)


@pytest.mark.parametrize("anew", [50, 99, 57], ids=["half-way", "one left", "57"])
@pytest.mark.parametrize("out", [0, 3], ids=["at once", "3 SYNCs later"])
def test_a_counter_that_begins_anew_loses_no_sync(anew: int, out: int) -> None:
    """Only those are missing that the time has room for."""
    ctx = context()
    learn(ctx, 1, 0x1019, 0, 100)
    times = [
        t for k, t in enumerate(regular(500, 10 * MS)) if not anew + 200 <= k < anew + 200 + out
    ]
    numbers = [*range(anew + 200), *range(300 - anew - out)]
    rows = [frame(t, 0x80, bytes([n % 100 + 1])) for t, n in zip(times, numbers, strict=True)]
    tables = timing(ctx, ordered(rows))
    row = only(tables.sync)
    assert (row.counter_jumps, row.missing) == (1, out)
    assert [hole.missing for hole in tables.holes] == [out] * bool(out)


def test_more_syncs_are_missing_than_the_counter_can_tell() -> None:
    times = [t for k, t in enumerate(regular(500, 10 * MS)) if not 203 <= k < 228]
    rows = [frame(t, 0x80, bytes([t // (10 * MS) % 10 + 1])) for t in times]
    assert only(timing(context(), ordered(rows)).sync).missing == 25


def test_the_same_counter_twice_is_no_lost_sync() -> None:
    rows = counted(regular(100, 10 * MS), 10)
    twice = frame(rows[40][0] - T0 + 200 * US, 0x80, rows[40][5])
    row = only(timing(context(), ordered(rows, [twice])).sync)
    assert (row.counter_jumps, row.missing, row.doubled) == (0, 0, 1)
    assert row.doubled_seq == [41]


def test_blocks_do_not_change_the_counter() -> None:
    """Some SYNCs without a counter, as of a second producer, between those with one."""
    rows = counted(regular(300, 10 * MS), 10, skip=200)
    plain = [frame(t, 0x80) for t in regular(5, 10 * MS, 503 * MS)]
    seen = {
        (row.counter_max, row.counter_wraps, row.counter_jumps)
        for size in (1 << 20, 64, 7, 1)
        for row in timing(context(), ordered(rows, plain), size=size, block_frames=size).sync
    }
    assert seen == {(10, 29, 1)}


@pytest.mark.parametrize("size", [1 << 20, 64])
def test_doubled_syncs_are_counted(size: int) -> None:
    times = regular(300, 10 * MS)
    more = [times[40] + 100 * US, times[120] + 5 * MS, times[121] + 3 * MS, times[250] + 1]
    row = only(timing(context(), ordered(syncs([*times, *more])), size=size, block_frames=64).sync)
    assert (row.doubled, row.missing, row.producers) == (4, 0, 1)


@pytest.mark.parametrize("late_ms", [1, 6, 9])
def test_late_syncs_are_not_doubled(late_ms: int) -> None:
    times = regular(300, 10 * MS)
    for at in (50, 130, 200):
        times[at] += late_ms * MS
    assert only(timing(context(), ordered(syncs(times))).sync).doubled == 0


def test_another_period_is_no_doubled_sync() -> None:
    times = [*regular(200, 10 * MS), *regular(200, 5 * MS, 2 * SECOND)]
    assert only(timing(context(), ordered(syncs(times))).sync).doubled == 0


def test_a_second_producer_is_counted() -> None:
    times = [*regular(200, 10 * MS), *regular(100, 10 * MS, 50 * MS + 3 * MS)]
    row = only(timing(context(), ordered(syncs(times))).sync)
    assert row.producers == 2
    assert row.doubled == pytest.approx(100, abs=2)


def test_the_worst_periods_are_kept_with_their_frames() -> None:
    times = [t for k, t in enumerate(regular(1000, 10 * MS)) if k not in (100, 101, 500)]
    times[700] += 2 * MS
    worst = timing(context(), ordered(syncs(times)), size=90, block_frames=90).worst
    longest = [row for row in worst if row.extreme == "longest"]
    assert [(row.seq, row.value_us) for row in longest[:3]] == [
        (100, 30_000),
        (498, 20_000),
        (700, 12_000),
    ]
    assert longest[0] == WorstRow(
        "can0", 0x80, None, "sync period", "longest", 30_000, 100, T0 + times[100]
    )
    (shortest, *_) = [row for row in worst if row.extreme == "shortest"]
    assert (shortest.seq, shortest.value_us) == (701, 8000)
    assert len(worst) == 20


def test_syncs_that_share_a_stamp_are_not_held_against_a_period_of_nothing() -> None:
    doubled = Doubled()
    doubled.add(np.arange(4), np.array([0, 0, 0, 10]), np.array([0.0, 0.0, 0.0, 10.0]))
    assert doubled.count == 0


@given(st.lists(st.integers(9_700_000, 10_300_000), min_size=16, max_size=50))
def test_even_periods_hide_nothing(periods: list[int]) -> None:
    usual = median(periods)
    near = all(abs(each - usual) <= 0.02 * usual for each in periods)
    assert even((min(periods), max(periods)), float(usual)) == near
    doubled = Doubled()
    doubled.add(np.arange(len(periods)), np.array(periods), np.full(len(periods), usual))
    assert doubled.count == 0


def test_even_blocks_lie_between_two_stretches_of_jitter() -> None:
    late = [2 * MS * (k % 2) for k in range(12)]
    steps = np.full(400, 10 * MS)
    for begin in (35, 305):
        steps[begin : begin + 12] += np.diff(late, append=0)
    frames = ordered(syncs(np.cumsum(steps).tolist()))
    for size in (50, 1000):
        rows = timing(context(), frames, size=size, block_frames=size).sync_jitter
        assert [(row.off, row.periods) for row in rows] == [(12, 12), (12, 12)]
