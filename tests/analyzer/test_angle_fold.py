"""Angle traces against the device sheets' vectors and shafts whose motion is known."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from syncline_analyzer.context import Context
from syncline_analyzer.folds.angle.fold import AngleFold, AngleTables
from syncline_analyzer.folds.angle.state import MAX_SAMPLES
from syncline_analyzer.results import TRACE_FLAGS, Trace, TraceEventRow
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.description import BusDescription
from tests.analyzer.timing_builder import (
    MS,
    SECOND,
    T0,
    Row,
    angles,
    batches,
    context,
    frame,
    learn,
    ordered,
    position,
)

VECTORS = Path(__file__).parents[3] / "shared" / "devices" / "vectors"
LIR_RANGE = 131072


def vectors() -> list[Any]:
    """Vectors in which a PDO of an encoder or an inclinometer is decoded to an angle."""
    found = [
        pytest.param(vector, id=vector["id"])
        for path in sorted(VECTORS.glob("*.json"))
        for vector in json.loads(path.read_text(encoding="utf-8"))
        if any({"pos", "long", "delta", "veff"} & set(f["expect"]) for f in vector["frames"])
        and "R" not in vector["frames"][0]["frame"]
    ]
    return found or [pytest.param(None, marks=pytest.mark.skip(reason="no vectors here"))]


def settled(vector: dict[str, Any]) -> Context:
    """The device of a vector with the settings that its context names, as read from it."""
    node = int(vector["frames"][0]["frame"][:3], 16) & 0x7F
    ctx = context(devices={node: vector["device"]})
    told = vector["context"]
    if vector["device"] == "haomiao-38":
        learn(ctx, node, 0x6000, 0, 4 if told["cpr"] == 4096 else 0)
        learn(ctx, node, 0x6001, 0, told["cpr"])
    elif "cpr" in told:
        learn(ctx, node, 0x6001, 0, told["cpr"])
        learn(ctx, node, 0x6002, 0, told["range"])
    for name, index in (("res", 0x6000), ("quad", 0x2040)):
        if name in told:
            learn(ctx, node, index, 0, told[name])
    if vector["id"] == "JN10":
        learn(ctx, node, 0x2047, 0, 1)
    return ctx


@pytest.mark.parametrize("vector", vectors())
def test_vectors_of_the_device_sheets(vector: dict[str, Any]) -> None:
    ctx = settled(vector)
    frames = []
    for k, part in enumerate(vector["frames"]):
        can_id, data = part["frame"].split("#")
        frames.append(frame(k * SECOND, int(can_id, 16), bytes.fromhex(data)))
    traces = {trace.object >> 8: trace for trace in angles(ctx, ordered(frames)).trace_data}
    for k, part in enumerate(vector["frames"]):
        for name, value in part["expect"].items():
            match name:
                case "pos":
                    assert traces[0x6004].columns["position"][k] == value
                case "turn":
                    assert traces[0x6004].columns["turn"][k] == value
                case "deg":
                    assert traces[0x6004].columns["angle_deg"][k] == pytest.approx(value, abs=5e-6)
                case "delta":
                    cpr = vector["context"]["cpr"]
                    turned = np.diff(traces[0x6004].columns["unwrapped_deg"])[k - 1]
                    assert turned * cpr / 360 == pytest.approx(value)
                case "long" | "lat":
                    pair = (0x6010, 0x6110) if name == "long" else (0x6020, 0x6120)
                    index = next(index for index in pair if index in traces)
                    assert traces[index].value[k] == pytest.approx(value)
                case "veff":
                    assert (traces[0x5C10].value[k], traces[0x5C10].unit) == (value, "mm/s")
                case "apeak":
                    assert (traces[0x5C11].value[k], traces[0x5C11].unit) == (value, "g")


def lir(**known: int) -> Context:
    """A 17-bit single-turn LIR as node 1, whose scale was read."""
    ctx = context(devices={1: "lir-da158"})
    for index, value in {0x6001: LIR_RANGE, 0x6002: LIR_RANGE, 0x6502: 1}.items():
        learn(ctx, 1, index, 0, value)
    return ctx


def multiturn() -> Context:
    """A LIR-MA158K with 8192 x 4096 counts as node 1."""
    ctx = context(devices={1: "lir-ma158k"})
    for index, value in {0x6001: 8192, 0x6002: 1 << 25, 0x6502: 4096}.items():
        learn(ctx, 1, index, 0, value)
    return ctx


def shaft(
    rpm: float, count: int, period_ns: int, *, cpr: int, total: int, start: int = 0
) -> list[Row]:
    """TPDO1 of node 1 on a shaft that turns evenly."""
    return [
        frame(
            k * period_ns,
            0x181,
            position((start + round(rpm / 60e9 * k * period_ns * cpr)) % total),
        )
        for k in range(count)
    ]


def only(tables: AngleTables) -> Trace:
    (trace,) = tables.trace_data
    return trace


def flagged(trace: Trace, name: str) -> list[int]:
    return np.flatnonzero(trace.flags >> TRACE_FLAGS.index(name) & 1).tolist()


def kinds(tables: AngleTables, kind: str) -> list[TraceEventRow]:
    return [event for event in tables.events if event.kind == kind]


@pytest.mark.parametrize("rpm", [25.0, -25.0, 40.0])
def test_speed_and_unwrapped_angle_of_an_even_turn(rpm: float) -> None:
    frames = shaft(rpm, 400, 20 * MS, cpr=LIR_RANGE, total=LIR_RANGE)
    trace = only(angles(lir(), ordered(frames)))
    t_s = (trace.t_ns - T0) / 1e9
    np.testing.assert_allclose(trace.columns["unwrapped_deg"], rpm * 6 * t_s, atol=0.01)
    np.testing.assert_allclose(trace.columns["speed_rpm"][1:], rpm, atol=0.05)
    assert np.isnan(trace.columns["speed_rpm"][0])
    assert len(flagged(trace, "wrap")) == int(abs(rpm) / 60 * 7.98) + (rpm < 0)
    assert flagged(trace, "jump") == []


def test_a_wrap_of_the_whole_range_is_no_jump() -> None:
    frames = shaft(60, 100, 20 * MS, cpr=8192, total=1 << 25, start=(1 << 25) - 5000)
    tables = angles(multiturn(), ordered(frames))
    assert len(flagged(only(tables), "wrap")) == 1
    assert tables.events == []


def test_sampled_too_slowly_is_ambiguous() -> None:
    slow = only(angles(lir(), ordered(shaft(10, 20, 515 * MS, cpr=LIR_RANGE, total=LIR_RANGE))))
    assert flagged(slow, "ambiguous") == list(range(1, 20))
    fast = only(angles(lir(), ordered(shaft(10, 20, 2 * MS, cpr=LIR_RANGE, total=LIR_RANGE))))
    assert flagged(fast, "ambiguous") == []


def test_no_speed_is_told_where_either_way_would_do() -> None:
    def speeds(rpm: int) -> np.ndarray[Any, np.dtype[np.float64]]:
        often = shaft(rpm, 40, 250 * MS, cpr=LIR_RANGE, total=LIR_RANGE)
        seldom = moved(shaft(rpm, 20, 500 * MS, cpr=LIR_RANGE, total=LIR_RANGE))
        speed = only(angles(lir(), ordered(often, seldom))).columns["speed_rpm"]
        return speed[np.isfinite(speed)]

    assert len(speeds(130)) == 0
    assert len(speeds(55)) == 58
    assert speeds(55) == pytest.approx(55, rel=0.01)


def jumping(at: int = 50, by: int = 40 * 8192) -> list[Row]:
    before = shaft(60, 100, 20 * MS, cpr=8192, total=1 << 25)
    after = shaft(60, 100, 20 * MS, cpr=8192, total=1 << 25, start=by)
    return before[:at] + after[at:]


def moved(rows: list[Row]) -> list[Row]:
    """The same values in TPDO2, 7 ms later."""
    return [(t + 7 * MS, bus, 0x281, flags, dlc, data) for t, bus, _, flags, dlc, data in rows]


def test_a_jump_beats_the_speed_limit() -> None:
    tables = angles(multiturn(), ordered(jumping()))
    (event,) = kinds(tables, "jump")
    assert (event.seq, event.t_ns) == (50, T0 + SECOND)
    assert event.after is not None
    assert event.before is not None
    assert event.after - event.before == pytest.approx(40 * 8192, abs=200)
    assert flagged(only(tables), "jump") == [50]
    assert set(only(tables).segment.tolist()) == {0}


def test_a_jump_is_no_speed_in_any_pdo_that_shows_it() -> None:
    speed = only(angles(multiturn(), ordered(jumping(), moved(jumping())))).columns["speed_rpm"]
    assert np.flatnonzero(np.isnan(speed)).tolist() == [0, 1, 100, 101]
    assert np.nanmax(np.abs(speed)) == pytest.approx(60, rel=0.01)


def test_frames_in_a_bundle_are_too_near_for_a_speed() -> None:
    frames = [
        (T0 + (k // 5 * 100 + 100) * MS + k % 5 * 50_000, *row[1:])
        for k, row in enumerate(shaft(900, 200, 20 * MS, cpr=8192, total=1 << 25))
    ]
    speed = only(angles(multiturn(), FrameBatch.from_rows(frames))).columns["speed_rpm"]
    assert np.nanmax(np.abs(speed)) < 12_000
    assert np.isfinite(speed).any()


def test_a_fast_shaft_is_no_jump() -> None:
    tables = angles(multiturn(), ordered(shaft(2900, 200, 20 * MS, cpr=8192, total=1 << 25)))
    assert tables.events == []


def test_bunched_stamps_are_no_jump() -> None:
    """An adapter that hands frames over in bundles of five, 100 ms apart."""
    frames = [
        (T0 + (k // 5 * 100 + 100) * MS + k % 5 * 50_000, *row[1:])
        for k, row in enumerate(shaft(900, 200, 20 * MS, cpr=8192, total=1 << 25))
    ]
    assert kinds(angles(multiturn(), FrameBatch.from_rows(frames)), "jump") == []


def test_one_jump_seen_by_two_pdos_is_told_once() -> None:
    second = moved(jumping())
    ctx = multiturn()
    assert len(kinds(angles(ctx, ordered(jumping(), second)), "jump")) == 1


@pytest.mark.parametrize("answer_ns", [-5 * MS, 5 * MS, 45 * MS], ids=["before", "at", "after"])
def test_a_preset_explains_a_jump_and_cuts(answer_ns: int) -> None:
    """The value may change a little before or after the answer to the write of 6003h."""
    frames = ordered(jumping())
    t_ns = SECOND + answer_ns
    seq = int(np.searchsorted(frames.t_ns, T0 + t_ns))
    ctx = multiturn()
    learn(ctx, 1, 0x6003, 0, 40 * 8192, seq=seq, t_ns=t_ns, source="sdo-write")
    tables = angles(ctx, frames)
    assert kinds(tables, "jump") == []
    assert [event.text for event in kinds(tables, "cut")] == ["preset (6003h written)"]
    segment = only(tables).segment
    assert segment[49] == 0
    assert segment[50] == 1


def test_a_preset_long_before_explains_nothing() -> None:
    ctx = multiturn()
    learn(ctx, 1, 0x6003, 0, 40 * 8192, seq=10, t_ns=200 * MS, source="sdo-write")
    assert len(kinds(angles(ctx, ordered(jumping())), "jump")) == 1


def test_the_set_input_of_a_haomiao_lands_on_the_preset_value() -> None:
    ctx = context(devices={1: "haomiao-38"})
    for index, value in {0x6000: 0, 0x6001: 8192, 0x6003: 1000}.items():
        learn(ctx, 1, index, 0, value)
    before = shaft(0, 50, 20 * MS, cpr=8192, total=1 << 25, start=5_000_000)
    after = shaft(0, 100, 20 * MS, cpr=8192, total=1 << 25, start=1000)
    tables = angles(ctx, ordered(before, after[50:]))
    (event,) = kinds(tables, "preset")
    assert [cut.text for cut in kinds(tables, "cut")] == ["preset by wire"]
    assert "it landed at the preset value 1000" in event.text
    other = shaft(0, 100, 20 * MS, cpr=8192, total=1 << 25, start=900_000)
    (event,) = kinds(angles(ctx, ordered(before, other[50:])), "jump")
    assert "preset" not in event.text


def test_a_gap_and_a_reset_cut() -> None:
    whole = shaft(60, 100, 20 * MS, cpr=8192, total=1 << 25)
    first, rest = ordered(whole[:30]), ordered(whole[40:], [frame(1_510 * MS, 0x701, b"\0")])
    tables = angles(multiturn(), first, Gap(T0 + 600 * MS, T0 + 800 * MS, "overrun"), rest)
    texts = [event.text for event in kinds(tables, "cut")]
    assert texts == ["capture gap: overrun", "boot-up"]
    trace = only(tables)
    assert trace.segment.tolist() == [0] * 30 + [1] * 36 + [2] * 24
    starts = [0, 30, 66]
    assert np.isnan(trace.columns["speed_rpm"][starts]).all()
    assert tables.traces[0].cuts == 2


def test_endless_empty_state_bytes_are_one_boot_up_at_most() -> None:
    beats = [frame(k * 100 * MS + MS, 0x701, b"\0") for k in range(5, 20)]
    tables = angles(lir(), ordered(shaft(5, 100, 20 * MS, cpr=LIR_RANGE, total=LIR_RANGE), beats))
    assert tables.traces[0].cuts == 1


def test_sdo_reads_and_pdos_join_one_trace() -> None:
    frames = ordered(shaft(0, 10, 20 * MS, cpr=8192, total=1 << 25, start=700))
    ctx = multiturn()
    learn(ctx, 1, 0x6004, 0, 701, seq=5, t_ns=90 * MS)
    trace = only(angles(ctx, frames))
    assert trace.raw.tolist() == [700] * 6 + [701] + [700] * 4
    assert trace.t_ns[6] == T0 + 90 * MS


def test_a_scale_that_is_only_a_default_says_so() -> None:
    ctx = context(devices={10: "jn2100"})
    tables = angles(ctx, ordered([frame(0, 0x18A, position(3300, 300, bits=16))]))
    by_object = {trace.object >> 8: trace for trace in tables.trace_data}
    assert by_object[0x6010].value.tolist() == [330.0]
    assert by_object[0x6010].assumed == ["angle_def", "quad", "res"]
    assert tables.traces[0].flags["scale_assumed"] == 1


def test_a_setting_of_the_user_is_not_assumed() -> None:
    text = '[node.10]\ndevice = "jn2100"\n[node.10.overrides]\nres = 10\nquad = 0\nangle_def = 0\n'
    ctx = context(description=BusDescription.loads(text))
    tables = angles(ctx, ordered([frame(0, 0x18A, position(-2370, 300, bits=16))]))
    assert tables.trace_data[0].value.tolist() == [-23.7]
    assert tables.traces[0].flags["scale_assumed"] == 0


def test_a_write_to_6000h_rescales_from_then_on() -> None:
    frames = ordered(frame(k * 10 * MS, 0x18A, position(100, 200, bits=16)) for k in range(10))
    ctx = context(devices={10: "jn2100"})
    learn(ctx, 10, 0x6000, 0, 100)
    learn(ctx, 10, 0x6000, 0, 10, seq=5, t_ns=45 * MS, source="sdo-write")
    trace = angles(ctx, frames).trace_data[0]
    np.testing.assert_allclose(trace.value, [10.0] * 5 + [1.0] * 5)
    assert trace.segment.tolist() == [0] * 5 + [1] * 5


def test_the_scale_is_what_is_known_at_that_moment() -> None:
    """6000h is read while the PDOs run: before it the factory value is assumed."""
    frames = ordered(frame(k * 10 * MS, 0x18A, position(100, 200, bits=16)) for k in range(10))
    ctx = context(devices={10: "jn2100"})
    learn(ctx, 10, 0x2040, 0, 2)
    learn(ctx, 10, 0x2044, 0, 0)
    learn(ctx, 10, 0x6000, 0, 10, seq=4, t_ns=35 * MS)
    tables = angles(ctx, frames)
    trace = tables.trace_data[0]
    np.testing.assert_allclose(trace.value, [10.0] * 4 + [1.0] * 6)
    assert flagged(trace, "scale_assumed") == [0, 1, 2, 3]
    assert {event.text for event in kinds(tables, "cut")} == {"another scale"}
    learn(ctx, 10, 0x6000, 0, 10, seq=8, t_ns=75 * MS)
    assert angles(ctx, frames).traces[0].cuts == 1


@pytest.mark.parametrize("index", [0x2042, 0x2046], ids=["teach", "zero"])
def test_teach_and_zero_cut_both_axes(index: int) -> None:
    frames = ordered(frame(k * 10 * MS, 0x18A, position(100, 200, bits=16)) for k in range(10))
    ctx = context(devices={10: "jn2100"})
    learn(ctx, 10, index, 0, 1, seq=5, t_ns=45 * MS, source="sdo-write")
    tables = angles(ctx, frames)
    assert [row.cuts for row in tables.traces] == [1, 1]


def test_an_impossible_angle_is_out_of_range() -> None:
    ctx = context(devices={10: "jn2100"})
    learn(ctx, 10, 0x2040, 0, 1)
    good, bad = position(-300, 0, bits=16), position(-2370, 0, bits=16)
    frames = ordered(frame(k * 10 * MS, 0x18A, bad if 3 <= k < 6 else good) for k in range(10))
    tables = angles(ctx, frames)
    assert flagged(tables.trace_data[0], "out_of_range") == [3, 4, 5]
    (event,) = kinds(tables, "out of range")
    assert event.seq == 3
    assert event.after == pytest.approx(-237.0)
    assert event.text.startswith("assumed: ")


def test_counts_above_the_range_are_out_of_range() -> None:
    frames = ordered([frame(0, 0x181, position(5)), frame(20 * MS, 0x181, position(LIR_RANGE))])
    assert flagged(only(angles(lir(), frames)), "out_of_range") == [1]


def test_short_frames_hold_no_value() -> None:
    frames = ordered([frame(0, 0x181, position(5)), frame(20 * MS, 0x181, b"\1\2")])
    trace = only(angles(lir(), frames))
    assert np.isnan(trace.value).tolist() == [False, True]


@pytest.mark.parametrize("block_frames", [1, 1 << 16])
def test_a_short_frame_is_no_jump(block_frames: int) -> None:
    """Two of four bytes are not the position 823214 modulo 65536."""
    whole, short = position(823_214), position(823_214)[:2]
    data = (whole, whole, short, short, whole, whole)
    frames = ordered([frame(k * 20 * MS, 0x181, part) for k, part in enumerate(data)])
    ctx = context(devices={1: "haomiao-38"})
    tables = angles(ctx, frames, block_frames=block_frames)
    assert [event.kind for event in tables.events] == []
    assert np.isnan(only(tables).value).tolist() == [False, False, True, True, False, False]


def test_vibration_is_only_valid_in_its_mode() -> None:
    ctx = context(devices={10: "jn2100"})
    frames = ordered([frame(0, 0x38A, position(125, 981))])
    assert angles(ctx, frames).traces == []
    learn(ctx, 10, 0x2047, 0, 1)
    assert [row.unit for row in angles(ctx, frames).traces] == ["mm/s", "g"]


def test_without_a_device_a_cia_406_encoder_is_traced_by_what_was_read() -> None:
    ctx = context()
    for (index, sub), value in {
        (0x1000, 0): 0x0002_0196,
        (0x1800, 1): 0x2AA,
        (0x1A00, 0): 1,
        (0x1A00, 1): 0x6004_0020,
        (0x6001, 0): 4096,
        (0x6002, 0): 4096 * 16,
    }.items():
        learn(ctx, 5, index, sub, value)
    tables = angles(ctx, ordered([frame(0, 0x2AA, position(4096 + 1024))]))
    trace = only(tables)
    assert (trace.columns["turn"][0], trace.columns["angle_deg"][0]) == (1, 90)


def test_a_guessed_pdo_carries_no_angle() -> None:
    assert angles(context(), ordered([frame(0, 0x181, position(5))])).traces == []


def test_without_times_there_is_no_speed_and_no_jump() -> None:
    ctx = multiturn()
    ctx.timed = False
    rows = [(T0, *row[1:]) for row in jumping()]
    tables = angles(ctx, FrameBatch.from_rows(rows))
    assert tables.events == []
    assert np.isnan(only(tables).columns["speed_rpm"]).all()


def test_a_long_trace_is_thinned_and_keeps_its_peaks() -> None:
    count = MAX_SAMPLES + 50_000
    counts = np.full(count, 1000, np.int64)
    counts[[77_777, 222_222]] = [1900, 100]
    data = np.zeros((count, 8), np.uint8)
    data[:, :4] = counts.astype("<u4").view(np.uint8).reshape(-1, 4)
    frames = FrameBatch(
        T0 + np.arange(count) * 20 * MS,
        np.zeros(count, np.uint8),
        np.full(count, 0x181, np.uint32),
        np.zeros(count, np.uint16),
        np.full(count, 4, np.uint8),
        data,
    )
    tables = angles(multiturn(), frames)
    trace = only(tables)
    assert len(trace.seq) <= MAX_SAMPLES
    assert {77_777, 222_222} <= set(trace.seq.tolist())
    row = tables.traces[0]
    assert (row.samples, row.min, row.max) == (count, 100, 1900)


@pytest.mark.parametrize("size", [1, 13, 60])
def test_blocks_do_not_change_the_result(size: int) -> None:
    beat = [frame(1_510 * MS, 0x701, b"\0")]
    second = moved(jumping())
    frames = ordered(jumping(), second, beat)
    whole = angles(multiturn(), frames)
    parts = angles(multiturn(), frames, size=size, block_frames=size)
    assert parts.traces == whole.traces
    assert parts.events == whole.events
    for name, column in only(whole).columns.items():
        np.testing.assert_allclose(only(parts).columns[name], column, err_msg=name)


def mapped(*objects: int, node: int = 5, **known: int) -> Context:
    """A node of which nothing is known but the mapping of its TPDO1 that was written to it."""
    ctx = context()
    learn(ctx, node, 0x1A00, 0, len(objects), source="sdo-write")
    for sub, value in enumerate(objects, 1):
        learn(ctx, node, 0x1A00, sub, value, source="sdo-write")
    for name, value in known.items():
        learn(ctx, node, int(name.removeprefix("o"), 16), 0, value)
    return ctx


def test_a_position_that_is_mapped_on_the_way_is_traced_from_then_on() -> None:
    ctx = context()
    fold = AngleFold(ctx, 5)
    frames = ordered([frame(k * MS, 0x185, position(1000 + k, 7)) for k in range(20)])
    for batch in batches(frames, 5):
        if batch.seq0 == 10:
            learn(ctx, 5, 0x1A00, 1, 0x6004_0020, seq=12, source="sdo-write")
            learn(ctx, 5, 0x1A00, 0, 1, seq=12, source="sdo-write")
        fold.update(batch)
    assert only(fold.finish(T0 + 20 * MS)).value.tolist() == list(range(1012, 1020))


def test_a_position_mapped_on_an_unknown_node_is_traced_as_raw_counts() -> None:
    ctx = mapped(0x6004_0020, 0x6030_0110)
    tables = angles(ctx, ordered([frame(0, 0x185, position(1000, 0, 7))]))
    trace = only(tables)
    assert (trace.value[0], trace.unit) == (1000, "counts")
    assert np.isnan(trace.columns["angle_deg"][0])
    assert {"cpr", "range", "profile"} <= set(trace.assumed)
    assert trace.name == "Position value (CiA 406 encoder assumed)"
    assert flagged(trace, "scale_assumed") == [0]
    assert not flagged(trace, "out_of_range")


def test_the_hardware_scale_of_an_unknown_node_gives_an_angle() -> None:
    ctx = mapped(0x6004_0020, o6501=4096, o6502=16)
    trace = only(angles(ctx, ordered([frame(0, 0x185, position(4096 + 1024))])))
    assert (trace.columns["turn"][0], trace.columns["angle_deg"][0]) == (1, 90)
    assert "scaling" in trace.assumed


def test_slopes_mapped_on_an_unknown_node_need_their_resolution() -> None:
    frames = ordered([frame(0, 0x185, (-1234).to_bytes(2, "little", signed=True))])
    counts = only(angles(mapped(0x6010_0010), frames))
    assert (counts.value[0], counts.unit) == (-1234, "counts")
    assert {"res", "profile"} <= set(counts.assumed)
    degrees = only(angles(mapped(0x6010_0010, o6000=10), frames))
    assert (degrees.value[0], degrees.unit) == (pytest.approx(-12.34), "deg")


@pytest.mark.parametrize("device_type", [0x0002_0192, 0x0000_0191, 0x0008_019A])
def test_another_profile_has_no_encoder_position(device_type: int) -> None:
    ctx = mapped(0x6004_0020, o1000=device_type)
    assert angles(ctx, ordered([frame(0, 0x185, position(1000))])).traces == []


def test_a_known_profile_is_not_called_assumed() -> None:
    trace = only(
        angles(mapped(0x6004_0020, o1000=0x0002_0196), ordered([frame(0, 0x185, position(1000))]))
    )
    assert trace.name == "Position value"
    assert "profile" not in trace.assumed


def narrow(per_turn: int, total: int) -> Context:
    """A CiA 406 encoder whose 6004h is mapped with 16 bits."""
    known = {"o1000": 0x0002_0196, "o6000": 0, "o6001": per_turn, "o6002": total}
    return mapped(0x6004_0010, **known)


def in_16_bits(step: int, count: int = 400) -> list[Row]:
    return [
        frame(k * 20 * MS, 0x185, (k * step % 65536).to_bytes(2, "little")) for k in range(count)
    ]


@pytest.mark.parametrize("step", [300, -300])
def test_a_position_of_which_16_bits_are_sent_wraps_at_65536(step: int) -> None:
    trace = only(angles(narrow(4096, 1 << 24), ordered(in_16_bits(step))))
    turned = np.diff(trace.columns["unwrapped_deg"])
    np.testing.assert_allclose(turned, step * 360 / 4096)
    np.testing.assert_allclose(
        trace.columns["angle_deg"], np.arange(400) * step % 4096 * 360 / 4096, atol=1e-9
    )
    assert np.isnan(trace.columns["turn"]).all()


def test_16_bits_of_a_finer_encoder_tell_motion_but_no_angle() -> None:
    tables = angles(narrow(1 << 18, 1 << 18), ordered(in_16_bits(300)))
    trace = only(tables)
    assert np.diff(trace.columns["unwrapped_deg"]) == pytest.approx(300 * 360 / (1 << 18))
    assert np.isnan(trace.columns["angle_deg"]).all()
    assert "only 16 bits are sent" in tables.traces[0].shows


def test_an_sdo_read_of_32_bits_joins_a_pdo_of_16() -> None:
    ctx = narrow(4096, 1 << 24)
    for k in (100, 200, 200):
        learn(ctx, 5, 0x6004, 0, 5 * 65536 + k * 300 % 65536, seq=k + k // 200, t_ns=k * 20 * MS)
    frames = ordered(in_16_bits(300))
    for size in (50, 1 << 16):
        trace = only(angles(ctx, frames, block_frames=size))
        assert set(trace.segment.tolist()) == {0}
        assert np.abs(np.diff(trace.columns["unwrapped_deg"])).max() <= 600 * 360 / 4096
