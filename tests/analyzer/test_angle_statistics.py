"""Statistics, silences and sources of angle traces against motions that the test knows."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.angle.fold import AngleFold
from syncline_analyzer.folds.angle.statistics import WINDOW, Circle, Rest, Reversals
from syncline_analyzer.results import TraceRow
from syncline_schemas.batch import Gap
from tests.analyzer.test_angle_fold import LIR_RANGE, flagged, kinds, lir, multiturn, only
from tests.analyzer.timing_builder import (
    MS,
    SECOND,
    T0,
    Row,
    angles,
    context,
    frame,
    learn,
    ordered,
    position,
)


def pdos(counts: Any, *, period_ns: int = 20 * MS, start_ns: int = 0) -> list[Row]:
    """TPDO1 of node 1."""
    return [
        frame(start_ns + k * period_ns, 0x181, position(int(c) % LIR_RANGE))
        for k, c in enumerate(counts)
    ]


def row_of(counts: Any) -> TraceRow:
    return angles(lir(), ordered(pdos(counts))).traces[0]


def test_the_mean_of_an_angle_about_zero_is_no_180_deg() -> None:
    """Half of the samples at 359 deg, half at 1 deg: the vector sum says 0 deg."""
    degree = LIR_RANGE / 360
    row = row_of(np.tile(np.round([359 * degree, degree]), 100))
    assert row.mean_deg is not None
    assert min(row.mean_deg, 360 - row.mean_deg) < 0.01
    vector = abs(np.exp(1j * np.radians([359.0, 1.0])).mean())
    assert row.std_deg == pytest.approx(math.degrees(math.sqrt(-2 * math.log(vector))), abs=0.01)


def test_angles_that_cancel_out_have_no_mean() -> None:
    row = row_of(np.tile([0, LIR_RANGE // 4, LIR_RANGE // 2, 3 * LIR_RANGE // 4], 40))
    assert (row.mean_deg, row.std_deg) == (None, None)


@given(
    st.lists(st.floats(-720, 720), min_size=1, max_size=60),
    st.integers(0, 60),
)
def test_the_circle_agrees_with_complex_numbers(values: list[float], cut: int) -> None:
    circle = Circle()
    circle.add(np.array(values[:cut]))
    circle.add(np.array([*values[cut:], np.nan]))
    total = np.exp(1j * np.radians(values)).mean()
    assert circle.length == pytest.approx(abs(total), abs=1e-9)
    if abs(total) > 1e-3:
        assert circle.mean_deg is not None
        turned = np.exp(1j * math.radians(circle.mean_deg)) / total * abs(total)
        assert abs(np.angle(turned)) < 1e-6


def test_a_tilt_of_both_signs_has_a_mean_of_its_range() -> None:
    ctx = context(devices={10: "jn2100"})
    for index, value in {0x6000: 10, 0x2040: 1, 0x2044: 0}.items():
        learn(ctx, 10, index, 0, value)
    rows = [frame(k * 10 * MS, 0x18A, position(-300 - k % 2 * 100, 0, bits=16)) for k in range(200)]
    assert angles(ctx, ordered(rows)).traces[0].mean_deg == pytest.approx(-3.5)


def test_noise_is_told_of_the_samples_at_rest() -> None:
    rng = np.random.default_rng(5)
    scatter = np.round(rng.normal(0, 12, 640))
    turning = np.arange(640) * 400
    counts = np.concatenate((scatter + 5000, turning + 5000, scatter + 5000 + 640 * 400))
    row = row_of(counts)
    windows = scatter.reshape(-1, WINDOW) * 360 / LIR_RANGE
    assert 1000 <= row.rest_samples <= 1280
    assert row.noise_deg == pytest.approx(np.sqrt(windows.var(axis=1).mean()), rel=0.05)
    assert row.noise_peak_deg == pytest.approx(np.ptp(windows, axis=1).max(), rel=0.2)


@pytest.mark.parametrize(
    "line",
    [
        np.linspace(0, 5, WINDOW),
        np.linspace(0, 0.2, WINDOW),
        np.sin(np.linspace(0, 2 * np.pi, WINDOW)),
        np.sin(np.linspace(1, 1 + 4 * np.pi, WINDOW)),
        np.concatenate((np.zeros(WINDOW - 6), np.arange(6.0))),
    ],
    ids=["turning", "slow", "to and fro", "twice to and fro", "starting"],
)
def test_what_moves_is_not_at_rest(line: Any) -> None:
    rest = Rest()
    rest.add(line, 0.001)
    assert (rest.samples, rest.noise_deg) == (0, None)


def test_what_stands_has_no_noise() -> None:
    row = row_of(np.full(WINDOW, 700))
    assert (row.rest_samples, row.noise_deg, row.noise_peak_deg) == (WINDOW, 0.0, 0.0)


def turning_back(line: list[float], play: float) -> int:
    """Changes of direction, one sample after the other."""
    held, way, count = line[0], 0, 0
    for value in line:
        moved = min(max(held, value - play / 2), value + play / 2)
        now = int(np.sign(moved - held))
        count += bool(now and way and now != way)
        held, way = moved, now or way
    return count


@given(st.lists(st.integers(-60, 60), min_size=1, max_size=200), st.integers(1, 200))
def test_directions_agree_with_a_play_that_is_moved_step_by_step(line: list[int], cut: int) -> None:
    eighths = [value / 8 for value in line]
    reversals = Reversals()
    reversals.add(np.array(eighths[:cut]), 0.0)
    reversals.add(np.array(eighths[cut:]), 0.0)
    assert reversals.count == turning_back(eighths, 1.0)


def test_noise_is_no_change_of_direction() -> None:
    rng = np.random.default_rng(7)
    there = np.arange(500) * 300.0
    way = np.concatenate((there, there[::-1], there)) + rng.integers(-50, 50, 1500)
    assert row_of(way).direction_changes == 2


def test_without_a_scale_nothing_is_told_in_degrees() -> None:
    ctx = context()
    learn(ctx, 5, 0x1A00, 0, 1, source="sdo-write")
    learn(ctx, 5, 0x1A00, 1, 0x6004_0020, source="sdo-write")
    rows = [frame(k * 20 * MS, 0x185, position(k)) for k in range(100)]
    row = angles(ctx, ordered(rows)).traces[0]
    assert row.unit == "counts"
    assert [row.mean_deg, row.std_deg, row.noise_deg, row.direction_changes] == [None] * 4
    assert row.sources == {"185h": 100}


def test_an_aliased_shaft_tells_no_directions() -> None:
    """72 rpm in steps of 500 ms: 0.6 turns forward look like 0.4 back."""
    steps = np.arange(60) * LIR_RANGE * 72 // 120
    fast = angles(lir(), ordered(pdos(steps, period_ns=500 * MS))).traces[0]
    assert fast.direction_changes is None
    slow = angles(lir(), ordered(pdos(steps // 10, period_ns=500 * MS))).traces[0]
    assert slow.direction_changes == 0


def polled(ctx: Context, times: list[int], values: list[int], start_seq: int = 1) -> None:
    for k, (t_ns, value) in enumerate(zip(times, values, strict=True)):
        learn(ctx, 1, 0x6004, 0, value, seq=start_seq + k, t_ns=t_ns)


def test_each_sdo_read_is_a_sample_also_of_the_same_value() -> None:
    ctx = lir()
    polled(ctx, [k * SECOND for k in range(1, 7)], [700, 700, 700, 701, 701, 700])
    trace = only(angles(ctx, ordered([frame(k * SECOND, 0x080) for k in range(10)])))
    assert trace.raw.tolist() == [700, 700, 700, 701, 701, 700]
    assert ((trace.t_ns - T0) / SECOND).tolist() == [1, 2, 3, 4, 5, 6]


def test_two_polled_axes_that_stand_still_make_a_pose_at_every_read() -> None:
    ctx = context(devices={10: "jn2100"})
    for index, value in {0x6000: 10, 0x2040: 1, 0x2044: 2, 0x2042: 2, 0x2046: 2}.items():
        learn(ctx, 10, index, 0, value)
    for k in range(5):
        learn(ctx, 10, 0x6110, 0, 1000, seq=2 * k + 1, t_ns=(2 * k + 1) * 10 * MS)
        learn(ctx, 10, 0x6120, 0, 500 + k, seq=2 * k + 2, t_ns=(2 * k + 2) * 10 * MS)
    tables = angles(ctx, ordered([frame(k * 10 * MS, 0x080) for k in range(20)]))
    assert tables.tilts[0].samples == 5


@pytest.mark.parametrize("block_frames", [3, 1 << 16])
def test_both_pdos_and_sdo_reads_join_one_trace(block_frames: int) -> None:
    ctx = multiturn()
    one = [frame(k * 40 * MS, 0x181, position(1000 + k)) for k in range(10)]
    two = [frame(k * 40 * MS + 20 * MS, 0x281, position(1000 + k)) for k in range(10)]
    polled(ctx, [90 * MS, 170 * MS], [1002, 1002], start_seq=7)
    tables = angles(ctx, ordered(one, two), block_frames=block_frames)
    assert tables.traces[0].sources == {"SDO": 2, "181h": 10, "281h": 10}
    assert len(only(tables).raw) == 22


def test_a_silence_cuts_a_cyclic_trace() -> None:
    counts = np.concatenate((np.full(100, 700), np.full(100, 900)))
    rows = [r for r in pdos(counts) if not 2 * SECOND <= r[0] - T0 < 3 * SECOND]
    tables = angles(lir(), ordered(rows))
    assert [event.text for event in kinds(tables, "cut")] == ["no samples for 1.02 s"]
    assert flagged(only(tables), "silence") == [100]
    assert only(tables).segment.tolist() == [0] * 100 + [1] * 50
    assert np.isnan(only(tables).columns["speed_rpm"][100])


def standing(counter: int | None = None, **known: int) -> list[str]:
    """Cuts of an encoder that is silent for 5 s, having sent two equal samples before."""
    ctx = lir()
    if counter is not None:
        learn(ctx, 1, 0x2800, 0, counter)
    for name, value in known.items():
        learn(ctx, 1, 0x1800, int(name[3:]), value)
    moving = pdos(np.arange(60) * 100)
    rest = [frame(6 * SECOND + k * 20 * MS, 0x181, position(5900 + 100 * k)) for k in range(60)]
    return [event.text for event in kinds(angles(ctx, ordered(moving, rest)), "cut")]


def test_silence_at_standstill_is_no_loss_where_the_device_is_told_to_be_silent() -> None:
    assert standing(counter=2) == []
    assert standing(sub2=0) == []
    assert standing(sub2=0xFE, sub5=0) == []


def test_silence_is_a_cut_where_the_device_ought_to_send() -> None:
    assert standing(counter=0, sub2=0xFE, sub5=20) == ["no samples for 4.82 s"]


def test_a_value_that_stood_over_a_silence_is_marked_and_not_cut() -> None:
    assert standing() == []
    moved = [frame(6 * SECOND + k * 20 * MS, 0x181, position(9000 + 100 * k)) for k in range(60)]
    tables = angles(lir(), ordered(pdos(np.arange(60) * 100), moved))
    assert len(kinds(tables, "cut")) == 1


def test_a_slower_cycle_is_cut_once_at_most() -> None:
    slow = pdos(np.arange(60), period_ns=SECOND, start_ns=3 * SECOND)
    tables = angles(lir(), ordered(pdos(np.arange(100)), slow))
    assert len(kinds(tables, "cut")) <= 1


def test_a_capture_gap_is_cut_once() -> None:
    tables = angles(
        lir(),
        ordered(pdos(np.full(100, 700))),
        Gap(T0 + 2 * SECOND, T0 + 9 * SECOND, "overrun"),
        ordered(pdos(np.full(100, 800), start_ns=9 * SECOND)),
    )
    assert [event.text for event in kinds(tables, "cut")] == ["capture gap: overrun"]
    assert flagged(only(tables), "silence") == []


def test_a_line_is_not_drawn_through_a_lost_stretch() -> None:
    rows = [r for r in pdos(np.full(100, 700)) if not 600 * MS <= r[0] - T0 < SECOND]
    fold = AngleFold(lir())
    fold.update(IndexedBatch(ordered(rows), 0))
    lost = [("can0", 1, T0 + 700 * MS, T0 + SECOND), ("can0", 2, T0 + 100 * MS, T0 + SECOND)]
    tables = fold.finish(T0 + 2 * SECOND, (), lost)
    assert tables.trace_data[0].segment.tolist() == [0] * 30 + [1] * 50
    assert [event.text for event in kinds(tables, "cut")] == ["node lost for 0.3 s"]
    assert tables.traces[0].cuts == 1
