"""SYNC periods and missing SYNCs, against time lines whose truth is known by construction."""

import numpy as np
import pytest

from syncline_analyzer.folds.timing.tables import TimingTables
from syncline_analyzer.results import SyncRow
from syncline_schemas.batch import FrameBatch, Gap
from tests.analyzer.timing_builder import (
    MS,
    SECOND,
    T0,
    US,
    context,
    frame,
    learn,
    ordered,
    regular,
    state,
    syncs,
    timing,
)


def only(tables: TimingTables) -> SyncRow:
    (row,) = tables.sync
    return row


def without(times: list[int], *numbers: int) -> list[int]:
    return [t for k, t in enumerate(times) if k not in numbers]


def test_periods_are_the_differences_of_the_stamps() -> None:
    times = [0, 10 * MS, 21 * MS, 30 * MS]
    row = only(timing(context(), ordered(syncs(times))))
    assert row.count == 4
    assert row.period_us is not None
    assert (row.period_us.min, row.period_us.median, row.period_us.max) == (9000, 10000, 11000)
    assert row.missing == 0


def test_one_sync_is_missing_per_whole_median() -> None:
    tables = timing(context(), ordered(syncs(without(regular(100, 10 * MS), 20, 50, 51))))
    assert only(tables).missing == 3
    assert [(h.missing, h.start_ns, h.end_ns, h.evidence) for h in tables.holes] == [
        (1, T0 + 190 * MS, T0 + 210 * MS, [19, 20]),
        (2, T0 + 490 * MS, T0 + 520 * MS, [48, 49]),
    ]


def test_a_clock_that_is_set_back_later_makes_up_for_no_missing_sync() -> None:
    times = without(regular(200, 10 * MS), 50, 51)
    times[150:] = [t - 900 * MS for t in times[150:]]
    tables = timing(context(), FrameBatch.from_rows(syncs(times)))
    assert [(h.missing, h.evidence) for h in tables.holes] == [(2, [49, 50])]


def test_a_period_below_one_and_a_half_medians_misses_nothing() -> None:
    times = regular(50, 10 * MS)
    times[30:] = [t + 4_900_000 for t in times[30:]]
    assert only(timing(context(), ordered(syncs(times)))).missing == 0


def test_a_slower_sync_is_a_new_rhythm_not_a_loss() -> None:
    fast = regular(100, 10 * MS)
    slow = regular(40, 20 * MS, fast[-1] + 20 * MS)
    assert only(timing(context(), ordered(syncs(fast + slow)))).missing == 0


def test_no_period_goes_over_a_gap() -> None:
    before = ordered(syncs(regular(20, 10 * MS)))
    after = ordered(syncs(regular(20, 10 * MS, 5 * SECOND)))
    gap = Gap(T0 + 200 * MS, T0 + 5 * SECOND, "adapter lost")
    row = only(timing(context(), before, gap, after))
    assert (row.count, row.missing) == (40, 0)
    assert row.period_us is not None
    assert row.period_us.max == 10_000


def test_a_gap_of_another_bus_changes_nothing() -> None:
    times = regular(40, 10 * MS)
    before, after = ordered(syncs(times[:20])), ordered(syncs(times[25:]))
    gap = Gap(T0, T0, "adapter lost", bus=1)
    assert only(timing(context(buses=("can0", "can1")), before, gap, after)).missing == 5


def test_a_clock_that_steps_back_gives_no_negative_period() -> None:
    times = regular(20, 10 * MS)
    stepped = times[:10] + [t - SECOND for t in times[10:]]
    batch = FrameBatch.from_rows(syncs(stepped))
    row = only(timing(context(), batch))
    assert row.period_us is not None
    assert row.period_us.min == 10_000
    assert row.missing == 0


def counted(times: list[int], counters: list[int]) -> FrameBatch:
    return ordered(frame(t, 0x80, bytes([c])) for t, c in zip(times, counters, strict=True))


def test_the_counter_tells_what_is_lost_even_when_the_time_does_not() -> None:
    counters = [1, 2, 3, 4, 1, 2, 4, 1, 3]
    tables = timing(context(), counted(regular(9, 10 * MS), counters))
    row = only(tables)
    assert (row.missing, row.counter_jumps) == (2, 2)
    assert [hole.evidence for hole in tables.holes] == [[5, 6], [7, 8]]


def test_the_overflow_is_1019h_where_it_is_known() -> None:
    ctx = context()
    learn(ctx, 5, 0x1019, 0, 10)
    tables = timing(ctx, counted(regular(3, 10 * MS), [1, 2, 1]))
    assert only(tables).missing == 8


def test_syncs_that_were_never_sent_break_no_counter_but_are_missing() -> None:
    times = [*regular(10, 10 * MS), *regular(10, 10 * MS, 130 * MS)]
    row = only(timing(context(), counted(times, [k % 4 + 1 for k in range(20)])))
    assert (row.missing, row.counter_jumps) == (3, 0)


def test_a_lost_sync_is_not_counted_twice() -> None:
    times = without(regular(12, 10 * MS), 6)
    row = only(timing(context(), counted(times, [k % 4 + 1 for k in range(12) if k != 6])))
    assert (row.missing, row.counter_jumps) == (1, 1)


def test_the_counter_starts_again_after_a_gap() -> None:
    before = counted(regular(6, 10 * MS), [1, 2, 3, 4, 1, 2])
    after = counted(regular(6, 10 * MS, SECOND), [4, 1, 2, 3, 4, 1])
    gap = Gap(T0 + 60 * MS, T0 + SECOND, "overrun")
    assert only(timing(context(), before, gap, after)).missing == 0


def test_without_times_syncs_are_only_counted() -> None:
    tables = timing(context(timed=False), FrameBatch.from_rows(syncs([0] * 30)))
    row = only(tables)
    assert (row.count, row.period_us, row.missing) == (30, None, 0)
    assert tables.series == []


def test_an_identifier_moved_by_1005h_is_the_sync() -> None:
    ctx = context()
    learn(ctx, 5, 0x1005, 0, 0x40000085)
    row = only(timing(ctx, ordered(syncs(regular(5, 10 * MS), 0x85))))
    assert (row.cob_id, row.count) == (0x85, 5)


@pytest.mark.parametrize("seconds", [3, 9])
def test_syncs_are_missing_beside_a_long_time_with_two_producers(seconds: int) -> None:
    """The second one makes more than half of the periods shorter."""
    first = without(regular(400, 50 * MS), 30, 31, 32, 390)
    second = regular(seconds * 20, 50 * MS, 3 * SECOND + 18 * MS)
    row = only(timing(context(), ordered(syncs(first), syncs(second))))
    assert row.missing == 4


@pytest.mark.parametrize("block", [1, 7, 64])
def test_blocks_do_not_change_the_result(block: int) -> None:
    times = without(regular(200, 10 * MS), 40, 41, 120)
    whole = timing(context(), ordered(syncs(times)))
    parts = timing(context(), ordered(syncs(times)), size=block, block_frames=max(block, 32))
    assert parts.sync == whole.sync
    assert parts.holes == whole.holes


def test_jitter_is_told_where_it_is() -> None:
    rng = np.random.default_rng(3)
    times = np.array(regular(1000, 20 * MS))
    times[400:500] += rng.integers(0, 8 * MS, 100)
    (row,) = timing(context(), ordered(syncs(times.tolist()))).sync_jitter
    assert T0 + times[395] <= row.start_ns <= T0 + times[420]
    assert T0 + times[480] <= row.end_ns <= T0 + times[501]
    assert row.off <= row.periods <= 101
    off = np.abs(np.diff(times) - 20 * MS)
    assert row.worst_us == off.max() / 1000
    assert row.off == int((off > 2 * MS).sum())


@pytest.mark.parametrize(
    ("late_ns", "resolution_ns", "bitrate"),
    [
        (1_900_000, 1, 500_000),
        (8 * MS, 10 * MS, 500_000),
        (3 * MS, 1, 50_000),
    ],
    ids=["below a tenth", "below the stamps' step", "one frame in the way at 50 kbit/s"],
)
def test_small_jitter_is_not_told(late_ns: int, resolution_ns: int, bitrate: int) -> None:
    times = [t + (late_ns if k % 2 else 0) for k, t in enumerate(regular(200, 20 * MS))]
    ctx = context(bitrate=bitrate, resolution_ns=resolution_ns)
    assert timing(ctx, ordered(syncs(times))).sync_jitter == []


def test_a_late_sync_now_and_then_is_no_jitter() -> None:
    times = [t + (6 * MS if k % 60 == 30 else 0) for k, t in enumerate(regular(600, 20 * MS))]
    assert timing(context(), ordered(syncs(times))).sync_jitter == []


def test_a_backlog_that_is_stamped_at_once_is_no_jitter() -> None:
    times = [k * MS for k in range(15)] + regular(500, 20 * MS, 30 * MS)
    assert timing(context(), ordered(syncs(times))).sync_jitter == []


def held_up(*rows: tuple[int, str, int, int]) -> TimingTables:
    """SYNC with a hole from 2 s to 5 s, and what the nodes did."""
    batch = ordered(syncs(regular(101, 20 * MS) + regular(101, 20 * MS, 5 * SECOND)))
    return timing(context(), batch, states=[state(*row) for row in rows])


@pytest.mark.parametrize("name", ["LOST", "INITIALISING", "UNKNOWN"])
def test_a_hole_that_the_nmt_explains_is_not_held_against_the_sync_producer(name: str) -> None:
    tables = held_up((1, "OPERATIONAL", 0, 2100 * MS), (1, name, 2100 * MS, 4900 * MS))
    assert (only(tables).missing, tables.holes) == (0, [])


@pytest.mark.parametrize(
    "row",
    [
        (1, "LOST", 2100 * MS, 3 * SECOND),
        (1, "LOST", 6 * SECOND, 7 * SECOND),
        (1, "PRE-OPERATIONAL", 2100 * MS, 4900 * MS),
        (1, "UNKNOWN", 0, 7 * SECOND),
    ],
    ids=["for a part only", "at another time", "a node that is there", "never known"],
)
def test_a_hole_that_nothing_explains_is_told(row: tuple[int, str, int, int]) -> None:
    tables = held_up(row)
    assert only(tables).missing == 149
    assert [hole.missing for hole in tables.holes] == [149]


BACKLOG = [k * 200 * US for k in range(15)]
"""At 500 kbit/s frames of 47 bits come every 94 us at best; these are delivered a little slower."""


def delivered(
    first: list[int], *, bitrate: int | None = 250_000, after: int = 500
) -> tuple[SyncRow, TimingTables]:
    """SYNCs at the start of the capture, then regular ones from 15 ms after them."""
    times = first + regular(after, 20 * MS, first[-1] + 15 * MS)
    tables = timing(context(bitrate=bitrate), ordered(syncs(times)))
    return only(tables), tables


@pytest.mark.parametrize("bitrate", [250_000, None])
def test_a_backlog_at_the_start_is_counted_and_not_judged(bitrate: int | None) -> None:
    row, tables = delivered(BACKLOG, bitrate=bitrate)
    assert (row.count, row.backlog, row.missing) == (515, 15, 0)
    assert row.period_us is not None
    assert row.period_us.min == 20_000
    assert tables.sync_jitter == []
    assert tables.series[0].value.min() == 20_000


def test_a_backlog_after_a_gap_or_a_pause_is_not_judged() -> None:
    start = 20 * SECOND
    later = [start + t for t in BACKLOG]
    again = later + regular(500, 20 * MS, later[-1] + 15 * MS)
    first, second = ordered(syncs(regular(500, 20 * MS))), ordered(syncs(again))
    gap = Gap(T0 + 10 * SECOND, T0 + start, "adapter lost")
    assert only(timing(context(bitrate=250_000), first, gap, second)).backlog == 15
    assert only(timing(context(bitrate=250_000), first, second)).backlog == 15


def test_a_faster_sync_at_the_start_is_no_backlog() -> None:
    row, _ = delivered([k * MS for k in range(15)])
    assert row.backlog == 0
    assert row.period_us is not None
    assert row.period_us.min == 1000


def test_real_jitter_at_the_start_is_still_found() -> None:
    uneven = [t + (9 * MS if k % 2 else 0) for k, t in enumerate(regular(40, 20 * MS))]
    row, tables = delivered(uneven)
    assert row.backlog == 0
    (jitter,) = tables.sync_jitter
    assert jitter.start_ns == T0


def test_settings_of_another_bus_do_not_cut_the_periods_of_this_one() -> None:
    wavering = [t + k * k % 29 * 300 * US for k, t in enumerate(regular(120, 25 * MS))]
    other = [frame(t, 0x185, bytes(2), bus=1) for t in regular(290, 10 * MS, 3 * MS + 100 * US)]
    alone = timing(context(buses=("can0", "can1")), ordered(syncs(wavering)))
    both = context(buses=("can0", "can1"))
    frames = ordered(syncs(wavering), other)
    for k, at_ns in enumerate((700 * MS, 1500 * MS, 2100 * MS)):
        seq = int(np.searchsorted(frames.t_ns, T0 + at_ns))
        learn(both, 5, 0x1800, 2, k + 1, seq=seq, t_ns=at_ns, source="sdo-write", bus=1)
    (told,), (expected,) = timing(both, frames).sync_jitter, alone.sync_jitter
    assert (told.worst_us, told.period_us) == (expected.worst_us, expected.period_us)
