"""Figures of PDOs: phase, requests, repeats, timers, deadlines, jitter, against written scripts."""

from collections.abc import Sequence

import numpy as np
import pytest

from syncline_analyzer.context import Context
from syncline_analyzer.results import PdoRow
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
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

NODE = 5
PDO = 0x185
RPDO = 0x205


def told(ctx: Context, transmission_type: int, **more: int) -> Context:
    """A context in which TPDO1 of the node was read to be of a type."""
    learn(ctx, NODE, 0x1800, 1, PDO)
    learn(ctx, NODE, 0x1800, 2, transmission_type)
    for name, sub in (("inhibit_100us", 3), ("timer_ms", 5)):
        if name in more:
            learn(ctx, NODE, 0x1800, sub, more[name])
    return ctx


def pdos(times: Sequence[int], can_id: int = PDO, data: bytes | None = None) -> list[Row]:
    """A PDO at these times; its data count up unless they are given."""
    return [
        frame(t, can_id, k.to_bytes(4, "little") if data is None else data)
        for k, t in enumerate(times)
    ]


def row_of(
    ctx: Context, *parts: FrameBatch | Gap, can_id: int = PDO, size: int = 1 << 20
) -> PdoRow:
    tables = timing(ctx, *parts, size=size, block_frames=min(size, 1 << 16))
    return next(row for row in tables.pdos if row.cob_id == can_id)


def after(times: Sequence[int], every: int, first: int, delay: int = MS) -> list[int]:
    """Answers to every n-th SYNC, from one on."""
    return [t + delay for t in times[first::every]]


@pytest.mark.parametrize("first", [0, 1, 3])
@pytest.mark.parametrize("size", [1 << 20, 100])
def test_the_phase_counts_from_the_first_sync(first: int, size: int) -> None:
    times = regular(400, 10 * MS)
    frames = ordered(syncs(times), pdos(after(times, 4, first)))
    row = row_of(told(context(), 4), frames, size=size)
    assert (row.every, row.phase, row.phase_basis) == (4, first, "first SYNC")
    assert (row.phase_share, row.phase_changes) == (1.0, 0)
    assert row.answered == 100
    assert row.missed == 0


def test_the_phase_is_that_of_the_counter_where_there_is_one() -> None:
    times = regular(400, 10 * MS)
    counted = [frame(t, 0x80, bytes([(k + 6) % 20 + 1])) for k, t in enumerate(times)]
    row = row_of(told(context(), 4), ordered(counted, pdos(after(times, 4, 2))))
    assert row.phase_basis == "SYNC counter"
    assert row.phase == (2 + 7) % 4
    assert row.phase_share == 1.0


def test_a_counter_that_n_does_not_divide_numbers_nothing() -> None:
    times = regular(400, 10 * MS)
    counted = [frame(t, 0x80, bytes([k % 10 + 1])) for k, t in enumerate(times)]
    row = row_of(told(context(), 4), ordered(counted, pdos(after(times, 4, 2))))
    assert (row.phase, row.phase_basis) == (2, "first SYNC")


def test_a_phase_that_moves_is_told() -> None:
    times = regular(400, 10 * MS)
    answers = [*after(times[:200], 4, 0), *after(times[202:], 4, 0)]
    row = row_of(told(context(), 4), ordered(syncs(times), pdos(answers)))
    assert (row.phase_changes, row.phase) == (1, 0)
    assert row.phase_share == pytest.approx(0.5)


def test_a_gap_hides_how_many_syncs_so_the_phase_begins_anew() -> None:
    before, later = regular(200, 10 * MS), regular(100, 10 * MS, 2013 * MS)
    row = row_of(
        told(context(), 4),
        ordered(syncs(before), pdos(after(before, 4, 0))),
        Gap(1995 * MS, 2012 * MS, "adapter lost", 3),
        ordered(syncs(later), pdos(after(later, 4, 1))),
    )
    assert row.phase_share == 1.0


def test_type_0_answers_when_the_value_changes_and_owes_nothing() -> None:
    times = regular(400, 10 * MS)
    answers = [times[k] + MS for k in (3, 50, 51, 200)]
    row = row_of(told(context(), 0), ordered(syncs(times), pdos(answers)))
    assert (row.transmission_type, row.missed, row.extra, row.answered) == (0, 0, 0, 4)
    assert row.response_us is not None
    assert row.response_us.median == 1000
    assert (row.every, row.phase) == (None, None)


def test_requests_and_their_answers_are_counted() -> None:
    asked = regular(50, 100 * MS)
    answers = [t + 2 * MS + k * 10 * US for k, t in enumerate(asked) if k not in (10, 11)]
    requests = [frame(t, PDO, flags=FrameFlag.REMOTE) for t in asked]
    tables = timing(told(context(), 0xFD), ordered(requests, pdos(answers)))
    (row,) = tables.pdos
    assert (row.asked, row.asked_answered, row.missed) == (50, 48, 0)
    assert row.answer_us is not None
    assert (row.answer_us.min, row.answer_us.max) == (2000, 2490)
    slowest = [each for each in tables.worst if each.quantity == "answer"]
    assert (slowest[0].value_us, slowest[0].t_ns) == (2490, T0 + answers[-1])


@pytest.mark.parametrize("size", [1, 3, 7])
def test_blocks_do_not_change_the_answers(size: int) -> None:
    asked = regular(20, 100 * MS)
    requests = [frame(t, PDO, flags=FrameFlag.REMOTE) for t in asked]
    frames = ordered(requests, pdos([t + 2 * MS for t in asked if t != asked[4]]))
    row = row_of(told(context(), 0xFD), frames, size=size)
    assert (row.asked, row.asked_answered) == (20, 19)


def test_repeats_are_counted() -> None:
    data = [b"\1", b"\1", b"\1", b"\2", b"\3", b"\3", b"\3", b"\3", b"\1"]
    times = regular(len(data), 10 * MS)
    rows = [frame(t, PDO, each) for t, each in zip(times, data, strict=True)]
    for size in (1, 2, 5, 100):
        row = row_of(context(), ordered(rows), size=size)
        assert (row.repeats, row.longest_repeat) == (5, 4)


def test_the_repeat_counter_of_the_device_is_told() -> None:
    ctx = context(devices={NODE: "lir-da158"})
    learn(ctx, NODE, 0x2800, 0, 3)
    row = row_of(told(ctx, 0xFE), ordered(pdos(regular(20, 10 * MS))))
    assert (row.repeat_counter, row.repeat_source) == (3, "sdo-read")


def test_the_event_timer_is_held_against_the_period() -> None:
    times = [round(t * 1.002) for t in regular(200, 20 * MS)]
    row = row_of(told(context(), 0xFF, timer_ms=20, inhibit_100us=50), ordered(pdos(times)))
    assert (row.event_timer_us, row.timer_source) == (20_000, "sdo-read")
    assert (row.inhibit_us, row.inhibit_source) == (5000, "sdo-read")
    assert row.timer_deviation_us == pytest.approx(40)
    coarse = ordered(pdos([t // MS * MS for t in times]))
    row = row_of(told(context(resolution_ns=MS), 0xFF, timer_ms=20), coarse)
    assert row.timer_deviation_us is None
    assert row.resolution_us == 1000


def test_a_late_frame_that_the_next_one_makes_up_for_is_not_missed() -> None:
    times = regular(100, 10 * MS)
    times[30] += 6 * MS
    times[60] += 9 * MS
    times[61] += 4 * MS
    for size in (1 << 20, 31, 32, 33, 1):
        row = row_of(told(context(), 0xFF, timer_ms=10), ordered(pdos(times)), size=size)
        assert row.missed == 0


@pytest.mark.parametrize("late_ms", [0, 3, -3])
def test_a_frame_that_did_not_come_is_missed(late_ms: int) -> None:
    times = [t for k, t in enumerate(regular(100, 10 * MS)) if k not in (30, 50, 51)]
    times[30] += late_ms * MS
    for size in (1 << 20, 30, 31, 1):
        row = row_of(told(context(), 0xFF, timer_ms=10), ordered(pdos(times)), size=size)
        assert row.missed == 3


def test_a_slow_clock_of_the_device_misses_nothing() -> None:
    times = regular(3000, 10_800 * US)
    times[1500] += 6 * MS
    row = row_of(told(context(), 0xFF, timer_ms=10), ordered(pdos(times)))
    assert row.missed == 0


def test_several_frames_per_sync_are_no_answers_to_it() -> None:
    """A timer or events that are faster than SYNC: one frame of each period is not the pattern."""
    rng = np.random.default_rng(2)
    every = np.cumsum(rng.integers(600 * US, 2000 * US, 2000)).tolist()
    row = row_of(context(), ordered(syncs(regular(300, 8 * MS)), pdos(every)))
    assert row.type_source == "inferred: event-driven"
    steady = (np.array(regular(2000, MS)) + rng.integers(0, 50 * US, 2000)).tolist()
    row = row_of(context(), ordered(syncs(regular(250, 8 * MS)), pdos(steady)))
    assert row.type_source.startswith("inferred: cyclic")
    assert (row.missed, row.extra) == (0, 0)


def test_a_few_second_frames_leave_the_pattern() -> None:
    times = regular(400, 10 * MS)
    more = [times[k] + 5 * MS for k in (20, 90, 300)]
    row = row_of(context(), ordered(syncs(times), pdos([*after(times, 1, 0), *more])))
    assert row.type_source == "inferred: synchronous, every SYNC"
    assert row.extra == 3


def deadline(ms: int = 50) -> Context:
    """A context in which RPDO1 of the node is watched."""
    ctx = context()
    learn(ctx, NODE, 0x1400, 1, RPDO)
    learn(ctx, NODE, 0x1400, 2, 0xFF)
    learn(ctx, NODE, 0x1400, 5, ms)
    return ctx


def test_an_rpdo_past_its_deadline_is_told() -> None:
    times = regular(100, 40 * MS)
    late = [*times[:40], *[t + 30 * MS for t in times[40:70]], *[t + 90 * MS for t in times[70:]]]
    states = [state(NODE, "OPERATIONAL", 0, 5 * SECOND)]
    frames = ordered(pdos(late, RPDO))
    (row,) = timing(deadline(), frames, states=states).pdos
    assert (row.pdo, row.deadline_us, row.overdue) == ("RPDO1", 50_000, 2)
    assert row.overdue_seq == [39, 69]
    assert row.overdue_first_ns == T0 + late[39] + 50 * MS
    (row,) = timing(deadline(), frames, states=[state(NODE, "STOPPED", 0, 5 * SECOND)]).pdos
    assert row.overdue == 0


def test_a_tpdo_has_no_deadline_and_an_rpdo_no_timer() -> None:
    (row,) = timing(deadline(), ordered(pdos(regular(50, 40 * MS), RPDO))).pdos
    assert (row.event_timer_us, row.timer_deviation_us, row.overdue) == (None, None, 0)
    row = row_of(told(context(), 0xFF, timer_ms=20), ordered(pdos(regular(50, 20 * MS))))
    assert row.deadline_us is None


def test_jitter_is_of_the_answers_and_of_the_single_periods() -> None:
    rng = np.random.default_rng(5)
    times = regular(500, 10 * MS)
    delays = rng.integers(500 * US, 900 * US, 500)
    answers = (np.array(times) + delays).tolist()
    row = row_of(told(context(), 1), ordered(syncs(times), pdos(answers)))
    assert row.jitter_us is not None
    assert row.jitter_us.std == pytest.approx(delays.std() / 1000)
    assert row.jitter_us.max_min == pytest.approx((delays.max() - delays.min()) / 1000)
    low, high = np.quantile(delays, (0.01, 0.99))
    assert row.jitter_us.p99_p1 == pytest.approx((high - low) / 1000)
    kept = [t for k, t in enumerate(answers) if k not in (100, 101)]
    row = row_of(told(context(), 1), ordered(syncs(times), pdos(kept)))
    assert row.missed == 2
    assert row.period_jitter_us is not None
    assert row.period_jitter_us.max_min is not None
    assert row.period_jitter_us.max_min < 1000


def test_event_driven_pdos_have_no_jitter() -> None:
    times = np.cumsum(np.random.default_rng(3).exponential(20 * MS, 300)).astype(int).tolist()
    row = row_of(told(context(), 0xFF), ordered(pdos(times)))
    assert (row.jitter_us, row.period_jitter_us) == (None, None)
    assert row.period_us is not None


def test_the_slowest_answers_are_kept_with_their_frames() -> None:
    times = regular(300, 10 * MS)
    delays = [MS + k % 7 * 10 * US + (3 * MS if k == 123 else 0) for k in range(300)]
    answers = [t + d for t, d in zip(times, delays, strict=True)]
    frames = ordered(syncs(times), pdos(answers))
    worst = timing(told(context(), 1), frames, size=50, block_frames=50).worst
    slowest = [row for row in worst if (row.cob_id, row.quantity) == (PDO, "response")]
    assert len(slowest) == 10
    assert (slowest[0].value_us, slowest[0].seq, slowest[0].node) == (4000 + 40, 247, NODE)


def test_a_sync_that_moved_away_leaves_no_second_frames() -> None:
    """PDOs that go on after the last SYNC of their identifier answer another one."""
    times = regular(200, 10 * MS)
    frames = ordered(syncs(times[:100]), pdos(after(times, 1, 0)))
    row = row_of(told(context(), 1), frames)
    assert (row.extra, row.extra_alone) == (0, 0)
