"""PDOs that are missed, and silence that owes nothing: restarts, clocks, timers, settings."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.tables import TimingTables
from syncline_schemas.batch import FrameBatch, FrameFlag
from tests.analyzer.timing_builder import (
    MS,
    SECOND,
    T0,
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

PERIOD = 50 * MS
SETTLED_NS = 2 * MS


def told(kind: int, timer_ms: int = 0) -> Context:
    """TPDO1 of node 1 with its type as it was read."""
    ctx = context()
    learn(ctx, 1, 0x1800, 1, 0x181)
    learn(ctx, 1, 0x1800, 2, kind)
    if timer_ms:
        learn(ctx, 1, 0x1800, 5, timer_ms)
    return ctx


def pdos(times_ns: Iterable[int], can_id: int = 0x181, *, moving: bool = True) -> list[Row]:
    """A PDO at each of these times, each with a new value unless told otherwise."""
    return [
        frame(t, can_id, (k if moving else 7).to_bytes(2, "little")) for k, t in enumerate(times_ns)
    ]


def missed(tables: TimingTables, can_id: int = 0x181) -> int:
    return next(row.missed for row in tables.pdos if row.cob_id == can_id)


def shifted(frames: FrameBatch, at_ns: int, by_ns: int) -> FrameBatch:
    """The frames with the recorder's clock set at a time."""
    t_ns = frames.t_ns + np.where(frames.t_ns >= T0 + at_ns, by_ns, 0)
    return FrameBatch(t_ns, frames.bus, frames.can_id, frames.flags, frames.dlc, frames.data)


def test_a_node_that_starts_while_sync_is_out_counts_from_the_first_sync() -> None:
    """Every 2nd SYNC, the other ones after a restart that ends before SYNC comes again."""
    times = [*regular(60, PERIOD), *regular(60, PERIOD, 6 * SECOND)]
    answers = [t + MS for t in [*times[0:60:2], *times[61:120:2]]]
    states = [
        state(1, "OPERATIONAL", 0, 3 * SECOND),
        state(1, "INITIALISING", 3 * SECOND, 5 * SECOND),
        state(1, "OPERATIONAL", 5 * SECOND, 10 * SECOND),
    ]
    assert missed(timing(told(2), ordered(syncs(times), pdos(answers)), states=states)) == 0


def test_a_setting_written_while_sync_is_out_hides_no_restart() -> None:
    """The SYNC before it came long ago, and the node started meanwhile: it counts from the first."""
    ctx = told(2)
    times = [*regular(60, PERIOD), *regular(60, PERIOD, 6 * SECOND)]
    answers = [t + MS for t in [*times[0:60:2], *times[61:120:2]]]
    learn(ctx, 9, 0x1800, 1, 0x1A9, seq=91, t_ns=5 * SECOND, source="sdo-write")
    beats = [frame(t, 0x709, b"\x05") for t in regular(3, 500 * MS, 4800 * MS)]
    states = [
        state(1, "OPERATIONAL", 0, 3 * SECOND),
        state(1, "INITIALISING", 3 * SECOND, 5 * SECOND),
        state(1, "OPERATIONAL", 5 * SECOND, 10 * SECOND),
    ]
    frames = ordered(syncs(times), pdos(answers), beats)
    assert missed(timing(ctx, frames, states=states)) == 0


def test_a_node_that_restarts_and_answers_no_sync_misses_them() -> None:
    answers = [t + MS for t in regular(30, 2 * PERIOD)]
    states = [
        state(1, "OPERATIONAL", 0, 3 * SECOND),
        state(1, "INITIALISING", 3 * SECOND, 4 * SECOND),
        state(1, "OPERATIONAL", 4 * SECOND, 10 * SECOND),
    ]
    tables = timing(told(2), ordered(syncs(regular(200, PERIOD)), pdos(answers)), states=states)
    assert 57 <= missed(tables) <= 60


def test_what_was_due_while_the_clock_was_set_back_is_not_told() -> None:
    """The node starts anew; some of that time the stamps go through once more."""
    answers = [t + MS for t in [*regular(60, PERIOD), *regular(60, PERIOD, 7 * SECOND)]]
    frames = ordered(syncs(regular(200, PERIOD)), pdos(answers))
    frames = shifted(frames, 5 * SECOND, -4 * SECOND)
    states = [
        state(1, "OPERATIONAL", 0, 3 * SECOND),
        state(1, "INITIALISING", 3 * SECOND, 3 * SECOND + 1),
        state(1, "OPERATIONAL", 3 * SECOND + 1, 6 * SECOND),
    ]
    assert missed(timing(told(1), frames, states=states)) == 0


def test_a_state_that_the_clock_was_set_back_over_may_be_lost() -> None:
    """PRE-OPERATIONAL began and ended at the same stamp, or so it seems."""
    answers = [t + MS for t in [*regular(80, PERIOD), *regular(60, PERIOD, 5 * SECOND)]]
    frames = ordered(syncs(regular(160, PERIOD)), pdos(answers))
    frames = shifted(frames, 4800 * MS, -2 * SECOND)
    states = [
        state(1, "OPERATIONAL", 0, 4 * SECOND),
        state(1, "OPERATIONAL", 4 * SECOND, 6 * SECOND),
    ]
    assert missed(timing(told(1), frames, states=states)) == 0


def test_a_clock_that_is_set_back_hides_nothing_of_a_node_that_runs_all_along() -> None:
    answers = [t + MS for k, t in enumerate(regular(199, PERIOD)) if k not in (110, 111)]
    frames = shifted(ordered(syncs(regular(200, PERIOD)), pdos(answers)), 5 * SECOND, -2 * SECOND)
    states = [state(1, "OPERATIONAL", 0, 8 * SECOND)]
    assert missed(timing(told(1), frames, states=states)) == 2


@pytest.mark.parametrize(("evidence", "expected"), [(100, 2), (250, 0), (None, 0)])
def test_a_node_that_was_started_before_the_clock_was_set_back_runs_after_it(
    evidence: int | None, expected: int
) -> None:
    """Its start and what it missed bear stamps of the time that comes twice."""
    answers = [
        t + MS for k, t in enumerate(regular(199, PERIOD)) if k >= 72 and k not in (130, 131)
    ]
    frames = shifted(ordered(syncs(regular(200, PERIOD)), pdos(answers)), 5 * SECOND, -2 * SECOND)
    started = replace(state(1, "OPERATIONAL", 3500 * MS, 8 * SECOND), evidence=evidence)
    states = [state(1, "PRE-OPERATIONAL", 0, 3500 * MS), started]
    assert missed(timing(told(1), frames, states=states)) == expected


def test_the_first_sync_after_a_start_stays_excused_where_the_clock_is_set_back_just_then() -> None:
    """By its stamp the SYNC that it did not answer lies in the time before the reset."""
    answers = [t + MS for k, t in enumerate(regular(199, PERIOD)) if k < 70 or k > 100]
    frames = shifted(ordered(syncs(regular(200, PERIOD)), pdos(answers)), 5 * SECOND, -2 * SECOND)
    started = replace(state(1, "OPERATIONAL", 4995 * MS, 8 * SECOND), evidence=169)
    states = [
        state(1, "OPERATIONAL", 0, 3500 * MS),
        state(1, "INITIALISING", 3500 * MS, 4995 * MS),
        started,
    ]
    assert missed(timing(told(1), frames, states=states)) == 0


@pytest.mark.parametrize(("last", "expected"), [("OPERATIONAL", 2), ("PRE-OPERATIONAL", 0)])
def test_a_capture_that_ends_where_its_stamps_go_twice(last: str, expected: int) -> None:
    """A node that is OPERATIONAL at the end was so before the clock was set back."""
    answers = [t + MS for k, t in enumerate(regular(119, PERIOD)) if k not in (70, 71)]
    frames = shifted(ordered(syncs(regular(120, PERIOD)), pdos(answers)), 5 * SECOND, -2 * SECOND)
    states = [state(1, "OPERATIONAL", 0, 4 * SECOND)]
    if last != "OPERATIONAL":
        states.append(state(1, last, 4 * SECOND, 4 * SECOND))
    assert missed(timing(told(1), frames, states=states)) == expected


@pytest.mark.parametrize(("step_ms", "left_out"), [(67, ()), (1000, ()), (0, (60,)), (67, (60,))])
def test_a_cyclic_pdo_is_not_missed_where_others_are_as_late(
    step_ms: int, left_out: tuple[int, ...]
) -> None:
    """The clock was set forward, or nobody was heard; a PDO that is late alone is missed."""
    times = [t + 13 * MS for k, t in enumerate(regular(100, 2 * PERIOD)) if k not in left_out]
    frames = ordered(syncs(regular(200, PERIOD)), pdos(times))
    tables = timing(told(0xFE, 100), shifted(frames, 4170 * MS, step_ms * MS))
    assert missed(tables) == len(left_out)


def test_a_timer_that_is_shortened_owes_nothing_of_before() -> None:
    change_ns = 9999 * MS
    times = [*regular(20, 500 * MS), *regular(50, 100 * MS, change_ns + 100 * MS)]
    frames = ordered(pdos(times), [frame(change_ns, 0x581, bytes(8))])
    ctx = told(0xFE, 500)
    change = int(np.searchsorted(frames.t_ns, T0 + change_ns))
    learn(ctx, 1, 0x1800, 5, 100, seq=change, source="sdo-write")
    assert missed(timing(ctx, frames)) == 0


@pytest.mark.parametrize(
    ("can_id", "moving", "expected"),
    [(0x201, True, 0), (0x201, False, 0), (0x181, True, 0), (0x181, False, 10)],
    ids=["RPDO", "RPDO that stands still", "new values", "the same value each time"],
)
def test_a_pdo_in_step_with_sync_by_chance_owes_nothing(
    can_id: int, moving: bool, expected: int
) -> None:
    """Every 4th SYNC, and a pause of 40: new values at that pace may have stood still."""
    times = [k * PERIOD + MS for k in range(0, 4000, 4) if not 2000 < k <= 2040]
    frames = ordered(syncs(regular(4001, PERIOD)), pdos(times, can_id, moving=moving))
    tables = timing(context(), frames)
    (row,) = tables.pdos
    assert row.type_source == "inferred: synchronous, every 4th SYNC"
    assert row.missed == expected


@pytest.mark.parametrize("block_frames", [1 << 16, 64, 7])
@pytest.mark.parametrize(
    ("usual_ns", "other_ns"), [(MS, -MS), (-MS, MS)], ids=["after the SYNC", "before the SYNC"]
)
def test_a_timer_as_long_as_the_sync_period_owes_nothing(
    usual_ns: int, other_ns: int, block_frames: int
) -> None:
    """Now and then it comes on the other side of the SYNC; what is left out once is missed."""
    times = [
        k * PERIOD + (other_ns if k % 100 == 50 else usual_ns) for k in range(1, 1000) if k != 205
    ]
    frames = ordered(syncs(regular(1000, PERIOD)), pdos(times))
    tables = timing(context(), frames, block_frames=block_frames)
    (row,) = tables.pdos
    assert row.type_source == "inferred: synchronous, every SYNC"
    assert (row.missed, row.extra) == (1, 10)
    assert [hole.missing for hole in tables.holes] == [1]


def all_set(*nodes: int) -> Context:
    """TPDO1 of each node answers every SYNC within 3 ms."""
    ctx = context()
    for node in nodes:
        learn(ctx, node, 0x1800, 1, 0x180 + node)
        learn(ctx, node, 0x1800, 2, 1)
        learn(ctx, node, 0x1007, 0, 3_000)
    return ctx


def answers_of(node: int, count: int) -> list[Row]:
    return pdos([k * PERIOD + (2 + 3 * node) * MS // 8 for k in range(count)], 0x180 + node)


@pytest.mark.parametrize("step_ms", [6, 40, 5 * 50])
def test_no_node_is_late_where_the_clock_is_set_between_a_sync_and_its_answers(
    step_ms: int,
) -> None:
    frames = ordered(syncs(regular(401, PERIOD)), *(answers_of(node, 400) for node in (1, 2, 3)))
    frames = shifted(frames, 200 * PERIOD + MS // 4, step_ms * MS)
    tables = timing(all_set(1, 2, 3), frames)
    assert [(row.late, row.missed) for row in tables.pdos] == [(0, 0)] * 3
    (sync,) = tables.sync
    assert (sync.missing, sync.backlog) == (0, 0)
    assert sync.period_us is not None
    assert sync.period_us.max == PERIOD / 1000
    (step,) = tables.clock_steps
    assert (step.step_ns, step.witnesses) == (step_ms * MS, 4)


def test_nodes_are_late_where_sync_itself_keeps_its_phase() -> None:
    frames = ordered(syncs(regular(401, PERIOD)), *(answers_of(node, 400) for node in (1, 2, 3)))
    late = (frames.t_ns > T0 + 200 * PERIOD) & (frames.t_ns < T0 + 201 * PERIOD)
    t_ns = frames.t_ns + np.where(late, 6 * MS, 0)
    late_frames = FrameBatch(t_ns, frames.bus, frames.can_id, frames.flags, frames.dlc, frames.data)
    assert [row.late for row in timing(all_set(1, 2, 3), late_frames).pdos] == [1, 1, 1]


def test_a_node_that_is_late_with_its_own_sync_is_late() -> None:
    """It sends SYNC, too, and hung for 6 ms; another node sends on as ever."""
    frames = ordered(
        syncs(regular(401, PERIOD)),
        answers_of(1, 400),
        pdos([t + 13 * MS for t in regular(4100, 5 * MS)], 0x1A2),
    )
    mine = (frames.can_id != 0x1A2) & (frames.t_ns > T0 + 200 * PERIOD)
    t_ns = frames.t_ns + np.where(mine, 6 * MS, 0)
    order = np.argsort(t_ns, kind="stable")
    hung = FrameBatch(t_ns, frames.bus, frames.can_id, frames.flags, frames.dlc, frames.data)
    (row, _) = timing(all_set(1), hung[order]).pdos
    assert row.late == 1


def test_a_type_that_a_reset_takes_back_holds_from_there_on() -> None:
    """1 by default, 4 from the write to the reset, 1 again."""
    ctx = context(devices={1: "haomiao-38"})
    numbers = [*range(100), *range(103, 200, 4), *range(220, 320)]
    answers = pdos([k * PERIOD + MS for k in numbers], 0x281)
    frames = ordered(syncs(regular(321, PERIOD)), answers)
    write_ns, reset_ns = 100 * PERIOD + SETTLED_NS, 200 * PERIOD + SETTLED_NS
    written, reset = np.searchsorted(frames.t_ns, [T0 + write_ns, T0 + reset_ns]).tolist()
    learn(ctx, 1, 0x1801, 2, 4, seq=written, t_ns=write_ns, source="sdo-write")
    ctx.shadow.reset(0, 1, reset, T0 + reset_ns)
    states = [
        state(1, "OPERATIONAL", 0, reset_ns),
        state(1, "INITIALISING", reset_ns, 219 * PERIOD),
        state(1, "OPERATIONAL", 219 * PERIOD, 400 * PERIOD),
    ]
    assert missed(timing(ctx, frames, states=states), 0x281) == 0


@pytest.mark.parametrize(("errors", "held_back"), [(90, 1), (1, 0)])
def test_error_frames_may_hold_a_pdo_back_past_the_next_sync(errors: int, held_back: int) -> None:
    """A node that goes bus-off fills the bus; a few errors leave room for the PDO to be sent."""
    times = regular(100, PERIOD)
    late = {40: PERIOD + MS}
    answers = sorted(t + late.get(k, 2 * MS) for k, t in enumerate(times[:-1]))
    broken = [
        frame(t, 0x88, bytes(8), flags=FrameFlag.ERROR)
        for t in regular(errors, 480_000, times[40] + 3 * MS)
    ]
    ctx = context(bitrate=100_000)
    learn(ctx, 1, 0x1800, 2, 1)
    tables = timing(ctx, ordered(syncs(times), pdos(answers), broken))
    assert [(hole.missing, hole.held_back) for hole in tables.holes] == [(1, held_back)]
