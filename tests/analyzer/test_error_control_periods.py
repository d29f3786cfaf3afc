"""Periods of heartbeats and guard requests, against written scripts and the simulator."""

import numpy as np
import pytest

from syncline_analyzer.context import Context
from syncline_analyzer.results import ErrorControlRow
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from tests.analyzer.test_timing_truth import analyzed
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
    timing,
)

NODE = 5
ID = 0x700 + NODE
OPERATIONAL = b"\x05"


def beats(times: list[int], byte: bytes = OPERATIONAL) -> list[Row]:
    return [frame(t, ID, byte) for t in times]


def guarded(times: list[int], answer_ns: int = 2 * MS, silent: tuple[int, ...] = ()) -> list[Row]:
    """Requests, and answers with the toggle bit."""
    rows = [frame(t, ID, flags=FrameFlag.REMOTE) for t in times]
    for k, t in enumerate(times):
        if k not in silent:
            rows.append(frame(t + answer_ns, ID, bytes([0x05 | (k % 2) << 7])))
    return rows


def only(ctx: Context, *parts: FrameBatch | Gap, size: int = 1 << 20) -> ErrorControlRow:
    (row,) = timing(ctx, *parts, size=size, block_frames=min(size, 1 << 16)).error_control_periods
    return row


def test_periods_of_a_heartbeat_by_its_setting() -> None:
    ctx = context()
    learn(ctx, NODE, 0x1017, 0, 100)
    rng = np.random.default_rng(8)
    offsets = rng.integers(0, 900 * US, 500)
    times = (np.array(regular(500, 100 * MS)) + offsets).tolist()
    row = only(ctx, ordered(beats(times)))
    periods = np.diff(times) / 1000
    assert (row.kind, row.count, row.missing) == ("heartbeat", 500, 0)
    assert (row.expected_us, row.expected_source) == (100_000, "sdo-read")
    assert row.period_us is not None
    assert row.period_us.p99 == pytest.approx(np.quantile(periods, 0.99))
    assert row.deviation_us == pytest.approx(np.median(periods) - 100_000)
    assert row.jitter_us is not None
    assert row.jitter_us.std == pytest.approx(periods.std())
    assert row.worst_us == pytest.approx(periods.max())
    assert row.worst_seq == int(periods.argmax()) + 1


@pytest.mark.parametrize("size", [1 << 20, 64, 7, 1])
@pytest.mark.parametrize("set_ms", [None, 100])
def test_heartbeats_that_did_not_come(size: int, set_ms: int | None) -> None:
    ctx = context()
    if set_ms:
        learn(ctx, NODE, 0x1017, 0, set_ms)
    times = [t for k, t in enumerate(regular(200, 100 * MS)) if k not in (50, 51, 120)]
    row = only(ctx, ordered(beats(times)), size=size)
    assert row.missing == 3
    assert row.missing_seq == [49, 117]


def test_a_late_heartbeat_is_not_missing() -> None:
    times = regular(200, 100 * MS)
    times[50] += 70 * MS
    assert only(context(), ordered(beats(times))).missing == 0


def test_a_boot_up_a_gap_and_another_setting_begin_anew() -> None:
    ctx = context()
    learn(ctx, NODE, 0x1017, 0, 100)
    learn(ctx, NODE, 0x1017, 0, 500, seq=141, source="sdo-write")
    first, again = regular(50, 100 * MS), regular(41, 100 * MS, 8 * SECOND)
    third, slow = regular(49, 100 * MS, 20 * SECOND), regular(50, 500 * MS, 25 * SECOND)
    boot = [frame(7 * SECOND, ID, b"\0")]
    gap = Gap(T0 + 13 * SECOND, T0 + 19 * SECOND, "test", None, 0)
    tables = timing(
        ctx,
        ordered(beats(first), boot, beats(again)),
        gap,
        ordered(beats(third), beats(slow)),
    )
    (row,) = tables.error_control_periods
    assert (row.missing, row.count) == (0, 190)
    assert row.period_us is not None
    assert (row.period_us.max, row.expected_us) == (500_000, 500_000)


@pytest.mark.parametrize("size", [1 << 20, 64, 7, 1])
def test_only_the_periods_since_1017h_was_written_are_held_against_it(size: int) -> None:
    """A master that slows a heartbeat down: most periods are of the former setting."""
    ctx = context()
    learn(ctx, NODE, 0x1017, 0, 1000, seq=300, source="sdo-write")
    fast, slow = regular(300, 100 * MS), regular(50, 1010 * MS, 31 * SECOND)
    row = only(ctx, ordered(beats(fast), beats(slow)), size=size)
    assert row.period_us is not None
    assert (row.period_us.median, row.expected_us) == (100_000, 1_000_000)
    assert row.deviation_us == 10_000


def test_a_setting_that_no_heartbeat_followed_says_nothing_of_them() -> None:
    ctx = context()
    learn(ctx, NODE, 0x1017, 0, 1000, seq=300, source="sdo-write")
    row = only(ctx, ordered(beats(regular(300, 100 * MS))))
    assert (row.expected_us, row.expected_source, row.deviation_us) == (None, None, None)


def test_nothing_is_missing_while_the_node_starts() -> None:
    """A device whose boot-up is no 00h: only the states tell that it was starting."""
    times = [*regular(50, 100 * MS), *regular(50, 100 * MS, 8 * SECOND)]
    states = [
        state(NODE, "OPERATIONAL", 0, 5 * SECOND),
        state(NODE, "INITIALISING", 4_900 * MS, 8 * SECOND),
        state(NODE, "OPERATIONAL", 8 * SECOND, 13 * SECOND),
    ]
    other = [frame(t, ID + 1, OPERATIONAL) for t in regular(140, 100 * MS, 37 * MS)]
    for known, missing in ((states, 0), ([], 30)):
        tables = timing(context(), ordered(beats(times), other), states=known)
        (row, _) = tables.error_control_periods
        assert (row.node, row.missing) == (NODE, missing)


def test_a_node_that_keeps_a_slower_period_than_it_was_set_to_misses_none() -> None:
    ctx = context()
    learn(ctx, NODE, 0x1017, 0, 100)
    row = only(ctx, ordered(beats(regular(100, 160 * MS))))
    assert (row.missing, row.deviation_us) == (0, 60_000)


@pytest.mark.parametrize("size", [1 << 20, 5, 1])
def test_guard_requests_and_answers(size: int) -> None:
    ctx = context()
    learn(ctx, NODE, 0x100C, 0, 200, source="sdo-write")
    rows = guarded(regular(60, 200 * MS), silent=(20, 21, 40))
    row = only(ctx, ordered(rows), size=size)
    assert (row.kind, row.count, row.missing) == ("guarding", 60, 3)
    assert row.missing_seq == [40, 41, 78]
    assert (row.expected_us, row.expected_source) == (200_000, "sdo-write")
    assert row.period_us is not None
    assert row.answer_us is not None
    assert (row.period_us.median, row.answer_us.median) == (200_000, 2000)


@pytest.mark.parametrize("size", [1 << 20, 100])
def test_requests_that_a_logger_wrote_down_as_empty_frames(size: int) -> None:
    rows = [
        (t, bus, can_id, 0, n, data)
        for t, bus, can_id, _, n, data in guarded(regular(60, MS * 200))
    ]
    row = only(context(), ordered(rows), size=size)
    assert (row.kind, row.count, row.missing) == ("guarding", 60, 0)


def test_a_log_without_times_has_no_periods() -> None:
    tables = timing(context(timed=False), ordered(beats(regular(50, 100 * MS))))
    assert tables.error_control_periods == []


def test_the_worst_periods_are_among_the_worst_cases() -> None:
    times = regular(50, 100 * MS)
    times[30] += 20 * MS
    worst = timing(context(), ordered(beats(times))).worst
    assert (worst[0].quantity, worst[0].node, worst[0].cob_id) == ("heartbeat period", NODE, ID)
    assert (worst[0].seq, worst[0].value_us) == (30, 120_000)


def test_clocks_of_simulated_devices_show_in_their_heartbeats() -> None:
    """The script says how fast the clock of each device runs; a period of 1 s shows 50 ppm."""
    run, tables, _ = analyzed("healthy_line")
    rows = {row.node: row for row in tables.error_control_periods if row.kind == "heartbeat"}
    specs = {spec.node_id: spec for spec in run.scenario.devices if spec.heartbeat_ms}
    assert set(rows) >= set(specs)
    for node, spec in specs.items():
        row = rows[node]
        assert row.missing == 0
        assert row.expected_us == spec.heartbeat_ms * 1000
        assert row.period_us is not None
        off_ppm = (row.period_us.median / row.expected_us - 1) * 1e6
        assert off_ppm == pytest.approx(spec.drift_ppm, abs=15)
    guards = {row.node: row for row in tables.error_control_periods if row.kind == "guarding"}
    for spec in run.scenario.devices:
        if spec.guard_ms:
            row = guards[spec.node_id]
            assert (row.expected_us, row.missing) == (spec.guard_ms * 1000, 0)
            assert row.period_us is not None
            assert row.period_us.median == pytest.approx(spec.guard_ms * 1000, rel=0.01)
