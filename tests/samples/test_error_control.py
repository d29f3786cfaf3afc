"""Heartbeat, node guarding and NMT faults of the simulator against CiA 301 7.2.8 and the sheets."""

import numpy as np
import pytest

from syncline_samples.faults import (
    BootLoop,
    GuardToggleStuck,
    GuardUnanswered,
    HeartbeatIrregular,
    HeartbeatPeriod,
    HeartbeatsMissing,
    LeavesOperational,
    MalformedCommand,
    RemoteOnHeartbeat,
)
from syncline_samples.machine import DeviceSpec, Fault, Run, Scenario
from syncline_samples.node import State
from syncline_samples.scenarios import io_module
from syncline_samples.sdo_client import write
from syncline_schemas.batch import FrameBatch, FrameFlag

SECOND = 1_000_000_000
GUARD_MS = 100


def run(*faults: Fault, remote_as_data: bool = False) -> Run:
    guarding = (write(0x100C, 0, GUARD_MS, 2), write(0x100D, 0, 3, 1))
    devices = (
        DeviceSpec(4, "jn2100", "tilt", jobs=guarding, guard_ms=GUARD_MS),
        io_module(30, "cabinet", 200),
    )
    script = Scenario("nmt", 8.0, devices, faults, sync_us=0, remote_as_data=remote_as_data)
    return script.run()


def frames_of(run: Run) -> FrameBatch:
    return FrameBatch.concat([item for item in run.batches if isinstance(item, FrameBatch)])


def state_bytes(run: Run, node: int) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and first bytes of the data frames on 700h + node after the first two seconds."""
    frames = frames_of(run)
    rows = (frames.can_id == 0x700 + node) & ((frames.flags & FrameFlag.REMOTE) == 0)
    t_s = (frames.t_ns[rows] - run.scenario.epoch_ns) / SECOND
    return t_s[t_s > 2], frames.data[rows, 0][t_s > 2]


def test_stuck_toggle_bits_are_counted() -> None:
    result = run(GuardToggleStuck(4, 4.0, count=5))
    _, answers = state_bytes(result, 4)
    repeated = int((answers[1:] >> 7 == answers[:-1] >> 7).sum())
    assert repeated == result.truth.counts["toggle_errors", 4] == 5


def test_toggle_bits_change_without_a_fault() -> None:
    result = run()
    _, answers = state_bytes(result, 4)
    assert (answers[1:] >> 7 != answers[:-1] >> 7).all()
    assert result.truth.counts["toggle_errors", 4] == 0


def test_unanswered_guard_requests_leave_holes_and_no_toggle_error() -> None:
    result = run(GuardUnanswered(4, 4.0, count=2))
    t_s, answers = state_bytes(result, 4)
    assert np.diff(t_s).max() == pytest.approx(3 * GUARD_MS / 1000, rel=0.02)
    assert (answers[1:] >> 7 != answers[:-1] >> 7).all()
    counts = result.truth.counts
    assert counts["guard_requests", 4] - counts["guard_answers", 4] == 2


def test_a_logger_may_store_guard_requests_as_empty_data_frames() -> None:
    plain, stored = run(), run(remote_as_data=True)
    before, after = frames_of(plain), frames_of(stored)
    assert plain.truth.remote_frames > 50
    assert stored.truth.remote_frames == 0
    assert not (after.flags & FrameFlag.REMOTE).any()
    rows = (before.flags & FrameFlag.REMOTE) != 0
    assert (after.dlc[rows] == 0).all()
    assert np.array_equal(before.t_ns, after.t_ns)


@pytest.mark.parametrize("to", [State.PRE_OPERATIONAL, State.STOPPED])
@pytest.mark.parametrize("node", [4, 30])
def test_a_node_leaves_operational_and_says_so(node: int, to: State) -> None:
    result = run(LeavesOperational(node, 4.0, to, for_s=2.0))
    t_s, answers = state_bytes(result, node)
    inside = answers[(t_s > 4.01) & (t_s < 6)] & 0x7F
    assert set(inside.tolist()) == {{"STOPPED": 4, "PRE-OPERATIONAL": 0x7F}[to.value]}
    assert [row.state for row in result.truth.states if row.node == node][-2:] == [
        to.value,
        "OPERATIONAL",
    ]


def test_boot_loop_sends_boot_ups() -> None:
    result = run(BootLoop(30, 4.0, count=3, every_ms=700))
    assert sum(not row.commanded and row.node == 30 for row in result.truth.boot_ups) == 1 + 3
    t_s, answers = state_bytes(result, 30)
    assert t_s[answers == 0] == pytest.approx([4.1, 4.8, 5.5], abs=0.01)


@pytest.mark.parametrize("percent", [50, 120, 200])
def test_heartbeat_of_another_period(percent: int) -> None:
    t_s, _ = state_bytes(run(HeartbeatPeriod(30, 4.0, percent, for_s=3.0)), 30)
    inside = np.diff(t_s[(t_s > 4.0) & (t_s < 7.0)])
    assert inside == pytest.approx(0.2 * percent / 100, rel=0.01)
    assert np.diff(t_s[t_s < 4.0]) == pytest.approx(0.2, rel=0.01)


def test_irregular_heartbeats_stay_near_their_raster() -> None:
    t_s, _ = state_bytes(run(HeartbeatIrregular(30, 4.0, percent=40)), 30)
    periods = np.diff(t_s[(t_s > 4.0) & (t_s < 7.0)])
    assert periods.std() > 0.015
    assert periods.min() >= 0.12
    assert periods.max() <= 0.28


def test_missing_heartbeats_leave_one_hole() -> None:
    t_s, _ = state_bytes(run(HeartbeatsMissing(30, 4.0, count=3)), 30)
    assert np.diff(t_s).max() == pytest.approx(0.8, rel=0.01)


def test_malformed_commands_move_nobody() -> None:
    for data in (b"\x02", b"\x02\x00\x00", b"\x55\x00"):
        result = run(MalformedCommand(4.0, data))
        assert [row.state for row in result.truth.states if row.node == 30][-1] == "OPERATIONAL"
        told = [row for row in result.truth.commands if row.specifier == data[0]]
        assert len(told) == (len(data) == 2)


@pytest.mark.parametrize("empty", [b"", b"\x00"])
def test_empty_heartbeats_of_a_lir_are_a_zero_byte_or_none(empty: bytes) -> None:
    """Both readings of the manual's "empty" state byte (sheet skbis-lir-canopen, LB03 and LB04)."""
    spec = DeviceSpec(5, "lir-ma158k", "drum", stored_heartbeat_ms=200, empty_heartbeat=empty)
    script = Scenario("empty", 9.0, (spec,), (RemoteOnHeartbeat(5, 7.0, count=1),), sync_us=0)
    result = script.run()
    frames = frames_of(result)
    rows = (frames.can_id == 0x705) & ((frames.flags & FrameFlag.REMOTE) == 0)
    late = rows & (frames.t_ns > result.scenario.epoch_ns + 7 * SECOND)
    assert set(frames.dlc[late].tolist()) == {len(empty)}
    assert not frames.data[late].any()
    assert result.truth.counts["empty_heartbeats", 5] == int(late.sum()) > 8
