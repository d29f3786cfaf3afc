"""PDO timing against time lines whose truth is known by construction."""

from collections.abc import Iterable, Sequence

import numpy as np
import pytest

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.rhythm import Rhythm
from syncline_analyzer.folds.timing.tables import TimingTables
from syncline_analyzer.results import PdoRow
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.wire_length import data_phase_bits, wire_bits
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
    state,
    syncs,
    timing,
)

PERIOD = 10 * MS
DATA = bytes([1, 2, 3, 4])


def answers(
    numbers: Iterable[int], can_id: int = 0x181, after_ns: int = MS, data: bytes = DATA
) -> list[Row]:
    """A PDO after each of these SYNCs."""
    return [frame(k * PERIOD + after_ns, can_id, data) for k in numbers]


def row_of(tables: TimingTables, can_id: int = 0x181) -> PdoRow:
    return next(row for row in tables.pdos if row.cob_id == can_id)


def told_type(kind: int, node: int = 1) -> Context:
    ctx = context()
    learn(ctx, node, 0x1800, 2, kind)
    learn(ctx, node, 0x1800, 1, 0x180 + node)
    return ctx


def without(count: int, *missing: int) -> list[int]:
    return [k for k in range(count) if k not in missing]


def test_the_response_is_the_time_since_the_last_sync() -> None:
    delays = [1 * MS, 2 * MS, 3 * MS]
    pdos = [frame(k * PERIOD + d, 0x181, DATA) for k, d in enumerate(delays)]
    row = row_of(timing(told_type(1), ordered(syncs(regular(4, PERIOD)), pdos)))
    assert row.response_us is not None
    assert (row.response_us.min, row.response_us.median, row.response_us.max) == (1000, 2000, 3000)
    assert row.response_us.std == pytest.approx(np.std([1000, 2000, 3000]))
    assert (row.transmission_type, row.type_source) == (1, "sdo-read")


def test_the_bounds_of_the_device_time_hold_by_hand() -> None:
    """SYNC ends at 0; the bus is busy with 201h, then the PDO that was ready at 300 us follows."""
    bit_ns = 2000
    blocker, pdo = frame(0, 0x201, bytes(8)), frame(0, 0x181, DATA)
    blocker_bits, pdo_bits = wire_bits(FrameBatch.from_rows([blocker, pdo])).tolist()
    blocker_end = 250 * US + (blocker_bits - 3) * bit_ns
    pdo_end = blocker_end + pdo_bits * bit_ns
    batch = ordered(
        syncs([0, PERIOD]), [frame(blocker_end, 0x201, bytes(8)), frame(pdo_end, 0x181, DATA)]
    )
    (responses,) = timing(told_type(1), batch).responses
    low, high = responses.device_low_us[0], responses.device_high_us[0]
    # Everything that was on the bus since the SYNC, the SYNC's intermission included, may have
    # kept the device waiting; without it the PDO starts right when the device is ready.
    assert low == pytest.approx((pdo_end - (blocker_bits + pdo_bits) * bit_ns) / 1000)
    assert high == pytest.approx((pdo_end - (pdo_bits - 3) * bit_ns) / 1000)
    assert low <= 300 <= high


def test_an_immediate_answer_has_zero_as_lower_bound() -> None:
    bits = int(wire_bits(FrameBatch.from_rows([frame(0, 0x181, DATA)]))[0])
    pdos = [frame(k * PERIOD + bits * 2000, 0x181, DATA) for k in range(3)]
    (responses,) = timing(told_type(1), ordered(syncs(regular(3, PERIOD)), pdos)).responses
    assert responses.device_low_us.tolist() == [0, 0, 0]
    assert responses.device_high_us.tolist() == [6, 6, 6]


def test_a_frame_with_bit_rate_switch_in_between_counts_at_the_slow_rate() -> None:
    """What its data phase took is not known without the data bit rate: at most that."""
    flags = int(FrameFlag.FD | FrameFlag.BRS)
    both = FrameBatch.from_rows([frame(0, 0x201, bytes(8), flags=flags), frame(0, 0x181, DATA)])
    bits = int(wire_bits(both).sum() + data_phase_bits(both).sum())
    batch = ordered(
        syncs([0, PERIOD]),
        [frame(500 * US, 0x201, bytes(8), flags=flags), frame(MS, 0x181, DATA)],
    )
    (responses,) = timing(told_type(1), batch).responses
    assert responses.device_low_us[0] == pytest.approx(1000 - 2 * bits)


def test_an_error_frame_in_between_leaves_no_lower_bound() -> None:
    error = frame(500 * US, 0x88, bytes(8), flags=int(FrameFlag.ERROR))
    batch = ordered(syncs([0, PERIOD]), [error], answers([0], after_ns=5 * MS))
    (responses,) = timing(told_type(1), batch).responses
    assert responses.device_low_us.tolist() == [0]


def test_without_a_bit_rate_there_are_no_bounds() -> None:
    ctx = context(bitrate=None)
    learn(ctx, 1, 0x1800, 2, 1)
    tables = timing(ctx, ordered(syncs(regular(5, PERIOD)), answers(range(5))))
    row = row_of(tables)
    assert row.response_us is not None
    assert row.device_us_low is None
    assert row.device_us_high is None
    assert tables.bus_load[0].mean_percent is None


def test_coarse_stamps_widen_the_bounds() -> None:
    ctx = context(resolution_ns=10 * MS)
    learn(ctx, 1, 0x1800, 2, 1)
    batch = ordered(
        syncs(regular(5, 20 * MS)), [frame(20 * MS * k, 0x181, DATA) for k in range(1, 5)]
    )
    (responses,) = timing(ctx, batch).responses
    assert (responses.device_low_us == 0).all()
    assert (responses.device_high_us >= 9_000).all()


@pytest.mark.parametrize(
    ("every", "missing", "expected"),
    [(1, (20, 21, 60), 3), (2, (30, 31, 32, 33), 2), (5, (25,), 1)],
)
def test_a_due_sync_without_a_pdo_is_missed(
    every: int, missing: Sequence[int], expected: int
) -> None:
    sent = [k for k in without(100, *missing) if k % every == 0]
    row = row_of(timing(told_type(every), ordered(syncs(regular(101, PERIOD)), answers(sent))))
    assert row.missed == expected
    due = [k for k in missing if k % every == 0]
    frames = ordered(syncs(regular(101, PERIOD)), answers(sent))
    missed_t = frames.t_ns[row.missed_seq]
    assert ((missed_t - T0) // PERIOD).tolist() == due


def test_the_last_sync_may_still_be_answered() -> None:
    tables = timing(told_type(1), ordered(syncs(regular(50, PERIOD)), answers(range(49))))
    assert row_of(tables).missed == 0


def test_a_pdo_that_stops_for_good_is_missed_to_the_end() -> None:
    tables = timing(told_type(1), ordered(syncs(regular(50, PERIOD)), answers(range(40))))
    assert row_of(tables).missed == 9
    assert [hole.missing for hole in tables.holes] == [9]


def test_the_type_is_inferred_and_says_so() -> None:
    sent = [k for k in without(240, 60) if k % 3 == 0]
    batch = ordered(syncs(regular(241, PERIOD)), answers(sent, 0x2A3))
    row = row_of(timing(context(), batch), 0x2A3)
    assert row.transmission_type == 3
    assert row.type_source == "inferred: synchronous, every 3rd SYNC"
    assert row.pdo == "TPDO2 (guess)"
    assert row.missed == 1


def test_a_timer_near_the_sync_is_not_taken_for_an_answer() -> None:
    rng = np.random.default_rng(5)
    times = np.arange(100) * (10 * PERIOD) + 9 * MS + rng.integers(0, 3 * MS, 100)
    pdos = [frame(int(t), 0x181, DATA) for t in times]
    row = row_of(timing(context(), ordered(syncs(regular(1001, PERIOD)), pdos)))
    assert row.type_source.startswith("inferred: cyclic, 100")
    assert (row.missed, row.extra, row.response_us) == (0, 0, None)


def test_a_pdo_without_rhythm_is_event_driven() -> None:
    rng = np.random.default_rng(6)
    times = np.sort(rng.integers(0, 10 * SECOND, 100))
    pdos = [frame(int(t), 0x181, DATA) for t in times]
    row = row_of(timing(context(), ordered(syncs(regular(1001, PERIOD)), pdos)))
    assert row.type_source == "inferred: event-driven"


def test_few_frames_tell_nothing() -> None:
    row = row_of(timing(context(), ordered(syncs(regular(5, PERIOD)), answers(range(4)))))
    assert (row.transmission_type, row.type_source) == (None, "unknown")


def test_a_default_is_dropped_when_the_frames_contradict_it() -> None:
    """JN2100: 1800h:2 is 1 from the factory; here it is sent by a timer, so it was changed."""
    pdos = [frame(k * 37 * MS, 0x18A, DATA) for k in range(60)]
    ctx = context(devices={10: "jn2100"})
    row = row_of(timing(ctx, ordered(syncs(regular(300, PERIOD)), pdos)), 0x18A)
    assert row.type_source == "inferred: cyclic, 37 ms"
    same = timing(ctx, ordered(syncs(regular(60, PERIOD)), answers(range(59), 0x18A)))
    assert row_of(same, 0x18A).type_source == "eds-default"
    assert row_of(same, 0x18A).pdo == "TPDO1"


def haomiao_types(sync_ns: list[int], pdo_ns: list[int], timer_ms: int | None = None) -> str:
    """Where the type of TPDO1 comes from: FEh by the EDS, which tells no event timer."""
    ctx = context(devices={1: "haomiao-38"})
    if timer_ms is not None:
        learn(ctx, 1, 0x1800, 5, timer_ms)
    pdos = [frame(t, 0x181, DATA) for t in pdo_ns]
    return row_of(timing(ctx, ordered(syncs(sync_ns), pdos))).type_source


def test_a_timer_in_step_with_a_steady_sync_does_not_contradict_the_default() -> None:
    steady, timer = regular(1001, 20 * MS), regular(200, 100 * MS, 3 * MS)
    assert haomiao_types(steady, timer) == "eds-default"
    assert haomiao_types(steady, timer, timer_ms=100) == "eds-default"


def test_a_timer_that_is_off_cannot_have_sent_what_comes_with_the_sync() -> None:
    steady, timer = regular(1001, 20 * MS), regular(200, 100 * MS, 3 * MS)
    answered = "inferred: synchronous, every 5th SYNC"
    assert haomiao_types(steady, timer, timer_ms=0) == answered
    assert haomiao_types(steady, timer, timer_ms=250) == answered


def test_frames_that_waver_with_the_sync_answer_it_whatever_the_default() -> None:
    rng = np.random.default_rng(11)
    wavering = (np.array(regular(1001, 20 * MS)) + rng.integers(0, 2 * MS, 1001)).tolist()
    answered = [t + 600 * US + int(late) for t, late in zip(
        wavering[::5], rng.integers(0, 100 * US, 201), strict=True
    )]  # fmt: skip
    assert haomiao_types(wavering, answered) == "inferred: synchronous, every 5th SYNC"
    timer = [t + int(late) for t, late in zip(
        regular(200, 100 * MS, 3 * MS), rng.integers(0, 100 * US, 200), strict=True
    )]  # fmt: skip
    assert haomiao_types(wavering, timer) == "eds-default"


def test_answers_that_a_node_queued_and_sends_at_once_are_not_extra_ones() -> None:
    """They were due in the silence before, as long as they come no later than it lasted."""
    queued = [frame(60 * PERIOD + MS + k * 300 * US, 0x181, DATA) for k in range(3)]
    later = [frame(61 * PERIOD + MS + k * 300 * US, 0x181, DATA) for k in range(1, 4)]
    frames = ordered(syncs(regular(100, PERIOD)), answers(without(100, *range(50, 61))), queued)
    row = row_of(timing(told_type(1), ordered_with(frames, later)))
    assert (row.missed, row.extra, row.extra_alone) == (10, 5, 0)
    much_later = [frame(90 * PERIOD + 2 * MS, 0x181, DATA)]
    row = row_of(timing(told_type(1), ordered_with(frames, much_later)))
    assert (row.extra, row.extra_alone) == (3, 1)


def test_after_a_long_silence_no_queue_explains_extra_answers_for_as_long() -> None:
    """A node that lost power answers again; much later it sends some PDOs twice."""
    frames = ordered(syncs(regular(300, PERIOD)), answers(without(300, *range(50, 150))))
    extra = [frame(k * PERIOD + 5 * MS, 0x181, DATA) for k in range(190, 230, 10)]
    row = row_of(timing(told_type(1), ordered_with(frames, extra)))
    assert (row.missed, row.extra, row.extra_alone) == (100, 4, 4)


def ordered_with(frames: FrameBatch, rows: Sequence[Row]) -> FrameBatch:
    both = FrameBatch.concat([frames, FrameBatch.from_rows(rows)])
    return both[np.argsort(both.t_ns, kind="stable")]


def test_an_extra_pdo_is_counted_but_no_answer() -> None:
    batch = ordered(
        syncs(regular(20, PERIOD)), answers(range(20)), answers([5, 9], after_ns=6 * MS)
    )
    row = row_of(timing(told_type(1), batch))
    assert (row.extra, row.missed) == (2, 0)
    assert row.response_us is not None
    assert row.response_us.max == 1000


def test_late_is_after_the_synchronous_window() -> None:
    ctx = told_type(1)
    learn(ctx, 1, 0x1007, 0, 2000)
    batch = ordered(
        syncs(regular(20, PERIOD)), answers(range(10)), answers(range(10, 13), after_ns=3 * MS)
    )
    assert row_of(timing(ctx, batch)).late == 3


def test_nothing_is_missed_outside_operational() -> None:
    batch = ordered(syncs(regular(101, PERIOD)), answers(without(100, *range(30, 60))))
    rows = [
        state(1, "OPERATIONAL", 0, 295 * MS),
        state(1, "PRE-OPERATIONAL", 295 * MS, 595 * MS),
        state(1, "OPERATIONAL", 595 * MS, SECOND + MS),
    ]
    assert row_of(timing(told_type(1), batch, states=rows)).missed == 0
    assert row_of(timing(told_type(1), batch, states=[])).missed == 30


def test_a_start_shifts_the_phase_of_every_second_sync() -> None:
    sent = [*range(0, 30, 2), *range(61, 100, 2)]
    rows = [
        state(1, "OPERATIONAL", 0, 295 * MS),
        state(1, "PRE-OPERATIONAL", 295 * MS, 595 * MS),
        state(1, "OPERATIONAL", 595 * MS, SECOND + MS),
    ]
    batch = ordered(syncs(regular(101, PERIOD)), answers(sent))
    assert row_of(timing(told_type(2), batch, states=rows)).missed == 0


def test_the_silence_before_a_seen_change_of_state_is_the_change() -> None:
    batch = ordered(syncs(regular(101, PERIOD)), answers(without(60, 20)))
    rows = [
        state(1, "OPERATIONAL", 0, 800 * MS),
        state(1, "LOST", 800 * MS, SECOND + MS),
    ]
    assert row_of(timing(told_type(1), batch, states=rows)).missed == 1


@pytest.mark.parametrize(("index", "value"), [(0x2800, 1), (0x1800, 0)], ids=["repeat", "type 0"])
def test_silence_that_a_setting_explains_is_no_miss(index: int, value: int) -> None:
    ctx = context(devices={1: "lir-da158a"})
    learn(ctx, 1, 0x1800, 2, 1)
    learn(ctx, 1, index, 2 if index == 0x1800 else 0, value)
    batch = ordered(syncs(regular(101, PERIOD)), answers(without(100, *range(30, 60))))
    assert row_of(timing(ctx, batch)).missed == 0


def test_missing_periods_of_a_told_event_timer() -> None:
    ctx = told_type(0xFE)
    learn(ctx, 1, 0x1800, 5, 100)
    pdos = [frame(k * 100 * MS, 0x181, DATA) for k in without(50, 20, 21, 30)]
    tables = timing(ctx, ordered(pdos))
    assert row_of(tables).missed == 3
    assert [hole.missing for hole in tables.holes] == [2, 1]


def test_no_period_is_missing_before_the_whole_bus_falls_silent() -> None:
    """The heartbeat makes the silence known long after the event timer could."""
    ctx = told_type(0xFE)
    learn(ctx, 1, 0x1800, 5, 100)
    pdos = [frame(k * 100 * MS, 0x181, DATA) for k in without(100, *range(50, 90))]
    rows = [
        state(1, "OPERATIONAL", 0, 6400 * MS),
        state(1, "UNKNOWN", 6400 * MS, 9 * SECOND),
        state(1, "OPERATIONAL", 9 * SECOND, 10 * SECOND),
    ]
    assert row_of(timing(ctx, ordered(pdos), states=rows)).missed == 0


def test_a_gap_is_no_silence() -> None:
    before = ordered(syncs(regular(30, PERIOD)), answers(range(30)))
    after = ordered(syncs(regular(30, PERIOD, SECOND)), answers(range(102, 129)))
    gap = Gap(T0 + 300 * MS, T0 + SECOND, "adapter lost")
    row = row_of(timing(told_type(1), before, gap, after))
    assert row.missed == 0
    assert row.period_us is not None
    assert row.period_us.max == 10_000


def test_nothing_is_missed_in_a_backlog_or_before_a_pause() -> None:
    """SYNCs that were stamped at once, and the last one before the producer paused."""
    burst = [frame(k * MS - PERIOD, 0x80) for k in range(5)]
    later = [frame(t, 0x80) for t in regular(50, PERIOD, 3 * SECOND)]
    batch = ordered(
        burst,
        syncs(regular(50, PERIOD)),
        answers(range(49)),
        later,
        answers(range(300, 349)),
    )
    assert row_of(timing(told_type(1), batch)).missed == 0


def test_answers_in_a_backlog_are_not_measured() -> None:
    """SYNC and answer 0.4 ms apart, back to back, before the regular ones."""
    wire = [(frame(k * 400 * US, 0x80), frame(k * 400 * US + 350 * US, 0x181)) for k in range(9)]
    live = [t + 10 * MS for t in regular(100, PERIOD)]
    regular_part = [row for t in live for row in (frame(t, 0x80), frame(t + 900 * US, 0x181))]
    batch = ordered([row for pair in wire for row in pair], regular_part)
    ctx = context(bitrate=250_000)
    learn(ctx, 1, 0x1800, 2, 1)
    row = row_of(timing(ctx, batch))
    assert row.response_us is not None
    assert (row.response_us.min, row.response_us.max) == (900, 900)
    assert row.period_us is not None
    assert row.period_us.min == PERIOD / US
    assert row.missed == 0


def test_a_pdo_after_a_pause_of_the_sync_is_no_answer_to_the_sync_before_it() -> None:
    later = regular(50, PERIOD, 3 * SECOND)
    first = frame(3 * SECOND - 2 * MS, 0x181, DATA)
    batch = ordered(syncs(regular(50, PERIOD)), syncs(later), answers(range(49)), [first])
    row = row_of(timing(told_type(1), batch))
    assert row.response_us is not None
    assert row.response_us.max == 1000


def test_a_type_written_later_starts_a_new_rhythm() -> None:
    ctx = told_type(1)
    frames = ordered(syncs(regular(200, PERIOD)), answers(range(100)), answers(range(100, 200, 4)))
    change = int(np.flatnonzero(frames.t_ns >= T0 + 99 * PERIOD + 2 * MS)[0])
    learn(ctx, 1, 0x1800, 2, 4, seq=change, source="sdo-write")
    row = row_of(timing(ctx, frames))
    assert (row.transmission_type, row.type_source, row.missed) == (4, "sdo-write", 0)


def test_without_times_only_the_order_counts() -> None:
    rows = [row for k in range(30) for row in (frame(0, 0x80), frame(0, 0x181, DATA))]
    ctx = context(timed=False)
    tables = timing(ctx, FrameBatch.from_rows(rows))
    row = row_of(tables)
    assert (row.frames, row.period_us, row.response_us) == (30, None, None)
    assert row.type_source == "unknown"
    assert tables.responses == []


def test_stamps_that_step_back_give_no_negative_response() -> None:
    frames = ordered(syncs(regular(30, PERIOD)), answers(range(30)))
    t_ns = frames.t_ns.copy()
    t_ns[31:] -= SECOND
    stepped = FrameBatch(t_ns, frames.bus, frames.can_id, frames.flags, frames.dlc, frames.data)
    row = row_of(timing(told_type(1), stepped))
    assert row.response_us is not None
    assert row.response_us.min >= 0
    assert row.period_us is not None
    assert row.period_us.min >= 0


def test_buses_are_kept_apart() -> None:
    ctx = context(buses=("can0", "can1"))
    one = [*syncs(regular(30, PERIOD)), *answers(range(30))]
    other = [(t + 3 * MS, 1, can_id, flags, dlc, data) for t, _, can_id, flags, dlc, data in one]
    alone = timing(context(), ordered(one))
    both = timing(ctx, ordered(one, other))
    first, second = both.pdos
    assert first == alone.pdos[0]
    assert second.bus == "can1"
    assert second.device_us_low == first.device_us_low


def busy(count: int = 400) -> FrameBatch:
    rng = np.random.default_rng(9)
    parts = [syncs(regular(count, PERIOD))]
    for k, every in enumerate((1, 2, 4)):
        numbers = [n for n in range(0, count, every) if rng.random() > 0.02]
        delays = rng.integers(300 * US, 900 * US, len(numbers)) + k * MS
        parts.append(
            [
                frame(n * PERIOD + int(d), 0x181 + k, rng.bytes(8))
                for n, d in zip(numbers, delays, strict=True)
            ]
        )
    # Beside the SYNC and its answers, and never two at a time: no frames overlap.
    slots = rng.choice(10 * count, 900, replace=False)
    times = slots // 10 * PERIOD + 4 * MS + slots % 10 * 500 * US + rng.integers(0, 200 * US, 900)
    parts.append([frame(int(t), 0x205, rng.bytes(8)) for t in times])
    return ordered(*parts)


@pytest.mark.parametrize("size", [1, 97, 1000])
def test_blocks_do_not_change_the_result(size: int) -> None:
    def ctx() -> Context:
        made = context()
        for node, every in ((1, 1), (2, 2), (3, 4)):
            learn(made, node, 0x1800, 1, 0x180 + node)
            learn(made, node, 0x1800, 2, every)
        return made

    whole = timing(ctx(), busy())
    parts = timing(ctx(), busy(), size=size, block_frames=150)
    assert parts.pdos == whole.pdos
    assert parts.holes == whole.holes
    assert parts.bus_load == whole.bus_load
    for got, expected in zip(parts.responses, whole.responses, strict=True):
        np.testing.assert_array_equal(got.response_us, expected.response_us)
        np.testing.assert_array_equal(got.device_low_us, expected.device_low_us)
        assert got.histogram.sum() == len(got.seq)


@pytest.mark.parametrize(
    ("index", "sub", "value"), [(0x1014, 0, 0x185), (0x1012, 0, 0x8000_0185), (0x1201, 2, 0x185)]
)
def test_an_identifier_given_to_another_service_is_no_pdo(index: int, sub: int, value: int) -> None:
    ctx = context()
    learn(ctx, 5, index, sub, value, source="sdo-write")
    frames = ordered([frame(0, 0x185, bytes(8)), frame(MS, 0x186, bytes(8))])
    assert [row.cob_id for row in timing(ctx, frames).pdos] == [0x186]


def test_a_service_that_is_switched_off_takes_no_identifier() -> None:
    ctx = context()
    learn(ctx, 5, 0x1014, 0, 0x8000_0185, source="sdo-write")
    frames = ordered([frame(0, 0x185, bytes(8))])
    assert [row.cob_id for row in timing(ctx, frames).pdos] == [0x185]


def test_fewer_answers_tell_what_the_device_does_by_default() -> None:
    """22 answers to every second SYNC, one of them missing: 91 % of the SYNC periods."""
    rhythm = Rhythm()
    rhythm.answered(np.delete(np.arange(0, 46, 2), 11))
    assert [rhythm.every(), rhythm.every(2), rhythm.every(1)] == [None, 2, None]
