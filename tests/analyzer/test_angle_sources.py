"""One trace from several sources: values of another age or width, frozen ones, cuts by wire."""

from typing import Any

import numpy as np
import pytest

from syncline_analyzer.context import Context
from syncline_analyzer.folds.angle.fold import AngleTables
from syncline_analyzer.results import Trace
from tests.analyzer.test_angle_fold import LIR_RANGE, flagged, kinds, lir, mapped, multiturn, only
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

TOTAL = 1 << 25


def sent(
    counts: Any,
    *,
    count: int,
    period_us: int = 10_000,
    can_id: int = 0x181,
    late_us: int = 0,
    age_us: int = 0,
    bits: int = 32,
    total: int = TOTAL,
) -> list[Row]:
    """A TPDO of a shaft at `counts(t_s)`; each value is `age_us` old."""
    rows = []
    for k in range(count):
        t_us = k * period_us + late_us
        value = int(counts((t_us - age_us) / 1e6)) % total % (1 << bits)
        rows.append(frame(t_us * 1000, can_id, value.to_bytes(bits // 8, "little")))
    return rows


def even(rpm: float, per_turn: int = 8192) -> Any:
    return lambda t_s: 100_000 + rpm / 60 * per_turn * t_s


def swinging(t_s: float) -> float:
    """20 deg to and fro about 0, 3 times a second."""
    return float(LIR_RANGE * 20 / 360 * np.sin(6 * np.pi * t_s))


@pytest.mark.parametrize("block_frames", [100, 1 << 16])
def test_values_of_another_age_turn_nothing_back(block_frames: int) -> None:
    """TPDO2 follows SYNC with a value 2 ms old: 3.6 deg at 300 rpm (LIR-DA158 trap 28)."""
    often = sent(even(300), count=1500)
    old = sent(even(300), count=750, period_us=20_000, late_us=1000, age_us=2000, can_id=0x281)
    tables = angles(multiturn(), ordered(often, old), block_frames=block_frames)
    row, trace = tables.traces[0], only(tables)
    assert row.direction_changes == 0
    assert row.sources == {"181h": 1500, "281h": 750}
    assert row.speed_max_rpm == pytest.approx(300, rel=0.01)
    turned = np.unwrap(trace.columns["angle_deg"], period=360)
    assert np.ptp(trace.columns["unwrapped_deg"]) == pytest.approx(np.ptp(turned), abs=4)


def test_a_swing_over_the_end_of_the_range_wraps_once_each_way() -> None:
    kind: dict[str, Any] = {"total": LIR_RANGE}
    often = sent(swinging, count=2000, period_us=3000, **kind)
    old = sent(
        swinging, count=500, period_us=12_000, late_us=1200, age_us=4000, can_id=0x281, **kind
    )
    tables = angles(lir(), ordered(often, old))
    assert tables.traces[0].direction_changes == pytest.approx(36, abs=1)
    assert tables.traces[0].flags["wrap"] == pytest.approx(36, abs=1)
    line = only(tables).columns["unwrapped_deg"]
    assert np.abs(line).max() == pytest.approx(20, abs=0.1)


def in_two_widths() -> Trace:
    """16 bits every 10 ms, all 32 every 100 ms, from 65000 up."""
    ctx = mapped(0x6004_0010, o1000=0x0002_0196, o6000=0, o6001=8192, o6002=TOTAL)
    learn(ctx, 5, 0x1A01, 0, 1, source="sdo-write")
    learn(ctx, 5, 0x1A01, 1, 0x6004_0020, source="sdo-write")
    rising: Any = lambda t_s: 65_000 + 3700 * t_s
    low = sent(rising, count=1000, can_id=0x185, bits=16)
    whole = sent(rising, count=100, period_us=100_000, late_us=2000, age_us=2000, can_id=0x285)
    return only(angles(ctx, ordered(low, whole)))


def test_a_wide_pdo_keeps_its_upper_bits_beside_a_narrow_one() -> None:
    trace = in_two_widths()
    wide = np.diff(trace.t_ns, prepend=0) == 2 * MS
    assert wide.sum() == 100
    assert trace.raw[wide].max() == pytest.approx(65_000 + 3700 * 9.9, abs=1)
    assert trace.raw[~wide].max() < 65_536
    truth = 65_000 + 3700 * (trace.t_ns - T0) / 1e9
    np.testing.assert_allclose(trace.columns["position"], truth, atol=10)
    np.testing.assert_array_equal(trace.columns["turn"], trace.columns["position"] // 8192)
    np.testing.assert_allclose(trace.columns["unwrapped_deg"], truth * 360 / 8192, atol=0.5)
    assert set(trace.segment.tolist()) == {0}


def haomiao(preset: int = 0) -> Context:
    ctx = context(devices={1: "haomiao-38"})
    for index, value in {0x6000: 0, 0x6001: 8192, 0x6003: preset}.items():
        learn(ctx, 1, index, 0, value)
    return ctx


def wired(second: bool = False) -> AngleTables:
    """2.2 rpm one way; at 5 s the set input puts the position back to 1000."""
    turning: Any = lambda t_s: 2647 + 300 * t_s if t_s < 5 else 1000 + 300 * (t_s - 5)
    rows = sent(turning, count=1000)
    old = sent(turning, count=500, period_us=20_000, late_us=3000, age_us=4000, can_id=0x281)
    return angles(haomiao(1000), ordered(rows, old if second else []))


@pytest.mark.parametrize("second", [False, True])
def test_a_preset_by_wire_cuts(second: bool) -> None:
    tables = wired(second)
    row, trace = tables.traces[0], only(tables)
    assert [event.text for event in kinds(tables, "cut")] == ["preset by wire"]
    (event,) = kinds(tables, "preset")
    assert event.t_ns == pytest.approx(T0 + 5 * SECOND, abs=10 * MS)
    assert kinds(tables, "jump") == []
    assert row.cuts == 1
    assert row.direction_changes == 0
    assert row.speed_max_rpm == pytest.approx(2.2, abs=1)
    assert trace.segment[trace.t_ns < T0 + 4990 * MS].max() == 0
    assert trace.segment[trace.t_ns > T0 + 5010 * MS].min() == 1


@pytest.mark.parametrize("block_frames", [64, 200, 1 << 16])
def test_the_cut_does_not_depend_on_the_blocks(block_frames: int) -> None:
    turning: Any = lambda t_s: 50_000 if t_s < 5 else 0
    rows = sent(turning, count=1000)
    tables = angles(haomiao(), ordered(rows), block_frames=block_frames)
    assert only(tables).segment.tolist() == [0] * 500 + [1] * 500
    assert tables.traces[0].cuts == 1


def test_spikes_and_steps_are_no_motion_of_a_shaft_at_rest() -> None:
    def resting(t_s: float) -> int:
        return 60_000 + 4096 * (abs(t_s - 7) < 0.004) + 8000 * (t_s >= 14)

    tables = angles(lir(), ordered(sent(resting, count=2000, total=LIR_RANGE)))
    row = tables.traces[0]
    assert [event.kind for event in tables.events] == ["spike", "step"]
    assert row.speed_max_rpm == 0
    assert row.direction_changes == 0


def test_frozen_samples_tell_no_rest_no_motion_and_no_line() -> None:
    stuck: Any = lambda t_s: 1000 + 2000 * min(t_s, 8)
    going: Any = lambda t_s: 1000 + 2000 * t_s
    frames = ordered(
        sent(going, count=2000),
        sent(stuck, count=1000, period_us=20_000, late_us=4300, can_id=0x281),
    )
    tables = angles(multiturn(), frames)
    row, trace = tables.traces[0], only(tables)
    assert row.flags["frozen"] == 600
    assert (row.direction_changes, row.rest_samples, row.noise_deg) == (0, 0, None)
    frozen = flagged(trace, "frozen")
    assert np.isnan(trace.columns["unwrapped_deg"][frozen]).all()
    others = np.delete(trace.columns["unwrapped_deg"], frozen)
    assert np.diff(others).min() > -1


def fine(count: int = 475) -> AngleTables:
    """0.001 deg: 16 bits repeat every 65.536 deg; up by 0.1 deg each 20 ms, over 180 deg."""
    ctx = context(devices={10: "jn2100"})
    for index, value in {0x6000: 1, 0x2040: 1, 0x2044: 0, 0x2042: 2, 0x2046: 2}.items():
        learn(ctx, 10, index, 0, value)
    rows = []
    for k in range(count):
        true = (150_000 + 100 * k + 180_000) % 360_000 - 180_000
        rows.append(frame(k * 20 * MS, 0x18A, position(true % 65_536, 0, bits=16)))
        wide = true.to_bytes(4, "little", signed=True) + bytes(4)
        rows.append(frame(k * 20 * MS + MS, 0x28A, wide))
    return angles(ctx, ordered(rows))


def test_16_bits_that_repeat_within_the_circle_step_modulo_65_536_deg() -> None:
    tables = fine()
    rows = {row.object >> 8: row for row in tables.traces}
    assert rows[0x6010].speed_max_rpm == pytest.approx(5 / 6, rel=0.01)
    assert rows[0x6010].direction_changes == 0
    lines = {t.object >> 8: t.columns["unwrapped_deg"] for t in tables.trace_data}
    np.testing.assert_allclose(np.diff(lines[0x6010]), 0.1, atol=1e-6)
    np.testing.assert_allclose(np.diff(lines[0x6110]), 0.1, atol=1e-6)
    assert "modulo 65.536 deg" in rows[0x6010].shows


@pytest.mark.parametrize(("definition", "dead"), [(1, True), (0, False)])
def test_a_direction_at_slope_0_is_flagged_and_tells_no_motion(definition: int, dead: bool) -> None:
    ctx = context(devices={10: "jn2100"})
    for index, value in {0x6000: 100, 0x2040: 2, 0x2044: definition, 0x2042: 2, 0x2046: 2}.items():
        learn(ctx, 10, index, 0, value)
    rng = np.random.default_rng(2)
    slope = np.where(np.arange(400) < 200, rng.integers(0, 3, 400), 300)
    way = np.where(np.arange(400) < 200, rng.integers(0, 3600, 400), 900)
    rows = [
        frame(k * 20 * MS, 0x18A, position(int(slope[k]), int(way[k]), bits=16)) for k in range(400)
    ]
    tables = angles(ctx, ordered(rows))
    lateral = next(row for row in tables.traces if row.object >> 8 == 0x6020)
    trace = next(t for t in tables.trace_data if t.object >> 8 == 0x6020)
    assert flagged(trace, "singular") == (list(range(200)) if dead else [])
    if dead:
        assert lateral.speed_max_rpm == 0
        assert lateral.direction_changes == 0
        assert (lateral.unwrapped_min_deg, lateral.unwrapped_max_deg) == (90, 90)
