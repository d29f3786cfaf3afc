"""SYNC, PDO timing and angles against the simulator's truth and the facts of real captures."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.angle.fold import AngleFold, AngleTables
from syncline_analyzer.folds.control import ControlFold
from syncline_analyzer.folds.timing.fold import TimingFold
from syncline_analyzer.folds.timing.tables import TimingTables
from syncline_analyzer.readers import open_capture
from syncline_analyzer.shadow import Shadow
from syncline_samples.machine import Run
from syncline_samples.scenarios import SCENARIOS
from syncline_schemas.batch import Gap
from syncline_schemas.description import BusDescription

CAPTURES = Path(__file__).parents[3] / "shared" / "captures"
NAMES = ("healthy_line", "bad_day", "jittery_sync")


@cache
def analyzed(name: str) -> tuple[Run, TimingTables, AngleTables]:
    """A scenario, simulated and folded in the order of the engine."""
    scenario = SCENARIOS[name]()
    run = scenario.run()
    description = BusDescription.loads(run.description_toml)
    ctx = Context(
        ["can0"],
        Shadow(lambda bus: "can0", description),
        True,
        {"can0": scenario.bitrate},
        scenario.stamp_resolution_ns,
        description,
    )
    control, timing, angle = ControlFold(ctx), TimingFold(ctx), AngleFold(ctx)
    seq = end_ns = 0
    for item in run.batches:
        for fold in (control, timing, angle):
            if isinstance(item, Gap):
                fold.gap(item)
            else:
                fold.update(IndexedBatch(item, seq))
        if not isinstance(item, Gap):
            seq, end_ns = seq + len(item), int(item.t_ns[-1])
    states = control.finish(end_ns).nmt.states
    return run, timing.finish(end_ns, states), angle.finish(end_ns)


@pytest.mark.parametrize("name", NAMES)
def test_the_true_device_time_lies_within_the_bounds(name: str) -> None:
    run, tables, _ = analyzed(name)
    step = run.scenario.stamp_resolution_ns
    truth = {(p.cob_id, p.end_ns // step): p for p in run.truth.pdos if p.sync_ns is not None}
    compared = 0
    for responses in tables.responses:
        columns = (responses.t_ns, responses.device_low_us, responses.device_high_us)
        for t_ns, low, high in zip(*columns, strict=True):
            pdo = truth.get((responses.cob_id, int(t_ns) // step))
            if pdo is not None and pdo.sync_ns is not None:
                compared += 1
                assert low <= (pdo.queued_ns - pdo.sync_ns) / 1000 <= high
    assert compared > 0.95 * sum(len(responses.seq) for responses in tables.responses)


@pytest.mark.parametrize("name", NAMES)
def test_missed_pdos_are_those_of_the_script(name: str) -> None:
    run, tables, _ = analyzed(name)
    expected: dict[int, list[int]] = {}
    for missed in run.truth.missed:
        expected.setdefault(missed.cob_id, []).append(missed.sync_ns)
    got = {row.cob_id: row.missed for row in tables.pdos if row.missed}
    assert got == {cob_id: len(times) for cob_id, times in expected.items()}
    for cob_id, times in expected.items():
        holes = [hole for hole in tables.holes if hole.cob_id == cob_id]
        assert [(hole.start_ns, hole.missing) for hole in holes] == [(times[0], len(times))]


@pytest.mark.parametrize("name", NAMES)
def test_syncs_are_those_of_the_script(name: str) -> None:
    run, tables, _ = analyzed(name)
    (row,) = tables.sync
    blind = [item for item in run.batches if isinstance(item, Gap)]
    heard = sum(not any(gap.start_ns <= t < gap.end_ns for gap in blind) for t in run.truth.sync_ns)
    assert row.count == heard
    assert row.missing == (3 if name == "bad_day" else 0)
    assert bool(tables.sync_jitter) == (name != "healthy_line")


@pytest.mark.parametrize("name", NAMES)
def test_bus_load_is_that_of_the_bus(name: str) -> None:
    run, tables, _ = analyzed(name)
    mean = tables.bus_load[0].mean_percent
    assert mean is not None
    # The truth counts from power-on, before the first frame, and error frames too.
    assert mean == pytest.approx(100 * run.truth.bus_load, rel=0.03)


@pytest.mark.parametrize("name", NAMES)
def test_angles_are_those_of_the_machine(name: str) -> None:
    """Every sample of a PDO equals the value that the simulated device put into it."""
    run, _, tables = analyzed(name)
    step = run.scenario.stamp_resolution_ns
    truth = {(p.node, p.end_ns // step): p for p in run.truth.pdos}
    compared = 0
    for trace in tables.trace_data:
        axis = {0x6010: 0, 0x6110: 0, 0x6020: 1, 0x6120: 1, 0x6004: 0}[trace.object >> 8]
        for t_ns, value in zip(trace.t_ns, trace.value, strict=True):
            pdo = truth.get((trace.node, int(t_ns) // step))
            if pdo is None:
                continue
            compared += 1
            if trace.unit == "deg":
                off = (value - pdo.values[axis] / 1000 + 180) % 360 - 180
                assert abs(off) <= 0.1
            else:
                assert value == pdo.values[0]
    assert compared > 1000


def test_a_jump_is_found_and_a_preset_explains_one() -> None:
    _, _, tables = analyzed("bad_day")
    jumps = [event for event in tables.events if event.kind == "jump"]
    assert [(jump.node, jump.after) for jump in jumps] == [(20, 0.0)]
    cuts = {(event.node, event.text) for event in tables.events if event.kind == "cut"}
    assert (3, "preset (6003h written)") in cuts
    assert {node for node, text in cuts if text.startswith("capture gap")} == {1, 2, 3, 4, 10, 20}


def test_a_healthy_line_has_neither_jumps_nor_cuts() -> None:
    _, tables, angles = analyzed("healthy_line")
    assert [event for event in angles.events if event.kind != "ambiguous"] == []
    assert tables.holes == []
    assert {row.flags["out_of_range"] for row in angles.traces} == {0}


def intervals() -> list[Any]:
    """(file, facts) of every capture with times."""
    found = []
    for path in sorted(CAPTURES.glob("facts/*.json")):
        record = json.loads(path.read_text(encoding="utf-8"))
        file = next(CAPTURES.glob(record["file"] + "*"), None)
        if file is not None and record["facts"]["has_timestamps"]:
            found.append(pytest.param(file, record["facts"], id=record["file"]))
    return found or [pytest.param(None, None, marks=pytest.mark.skip(reason="no captures here"))]


@pytest.mark.parametrize(("file", "facts"), intervals())
def test_intervals_equal_the_facts_of_real_captures(file: Path, facts: dict[str, Any]) -> None:
    reader = open_capture(file)
    ctx = Context(reader.facts.buses, Shadow(lambda bus: "bus"))
    fold, seq = TimingFold(ctx), 0
    for item in reader.batches():
        if isinstance(item, Gap):
            fold.gap(item)
            continue
        fold.update(IndexedBatch(item, seq))
        seq += len(item)
    tables = fold.finish(0)
    backlog = sum(row.backlog for row in tables.sync)
    rows: dict[int, Any] = {row.cob_id: (row.frames, row.period_us) for row in tables.pdos}
    rows |= {row.cob_id: (row.count, row.period_us) for row in tables.sync}
    expected = {int(can_id, 16): of for can_id, of in facts["pdo_range_ids"].items()}
    if facts["sync"]["count"]:
        expected[0x80] = facts["sync"]
    assert set(expected) <= set(rows)
    for can_id, told in expected.items():
        count, period = rows[can_id]
        assert count == told["count"]
        if told.get("interval"):
            if backlog:
                assert period.min / 1000 > told["interval"]["min_ms"]
            else:
                assert period.min / 1000 == pytest.approx(told["interval"]["min_ms"], abs=1e-3)
            assert period.max / 1000 == pytest.approx(told["interval"]["max_ms"], rel=1e-6)
            assert period.median / 1000 == pytest.approx(told["interval"]["median_ms"], rel=1e-4)


def test_one_number_by_numpy_alone() -> None:
    """The median response of one PDO, computed from the raw frames in another way."""
    run, tables, _ = analyzed("healthy_line")
    frames = [batch for batch in run.batches if not isinstance(batch, Gap)]
    t_ns = np.concatenate([batch.t_ns for batch in frames])
    can_id = np.concatenate([batch.can_id for batch in frames])
    sync = t_ns[can_id == 0x80]
    pdo = t_ns[can_id == 0x28A]
    pdo = pdo[pdo > sync[0]]
    response = pdo - sync[np.searchsorted(sync, pdo) - 1]
    row = next(row for row in tables.pdos if row.cob_id == 0x28A)
    assert row.response_us is not None
    assert row.response_us.median == np.median(response) / 1000
    assert row.response_us.std == pytest.approx(response.std() / 1000)
