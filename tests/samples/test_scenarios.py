"""The scenarios against physics, against the definitions of their services, and against each other."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from syncline_samples.faults import (
    ClockStep,
    Command,
    DuplicateNode,
    EmcyStorm,
    PdoOutsideOperational,
    PowerLoss,
    RecorderBusOff,
    RecorderGap,
)
from syncline_samples.machine import DeviceSpec, Fault, Run, Scenario
from syncline_samples.master import STOP
from syncline_samples.motion import Shaft
from syncline_samples.scenarios import (
    CABINET,
    ENTRY,
    GUIDE,
    LIFT,
    PLATFORM,
    PRESS,
    WINDER,
    bad_day,
    healthy_line,
    jittery_sync,
)
from syncline_samples.world import Delay
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.wire_length import wire_bits

SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def healthy() -> Run:
    return healthy_line().run()


@pytest.fixture(scope="module")
def bad() -> Run:
    return bad_day(sync_us=50_000).run()


def frames_of(run: Run) -> FrameBatch:
    return FrameBatch.concat([item for item in run.batches if isinstance(item, FrameBatch)])


def data_rows(frames: FrameBatch, can_id: int) -> np.ndarray:
    plain = (frames.flags & (FrameFlag.REMOTE | FrameFlag.ERROR)) == 0
    return np.flatnonzero((frames.can_id == can_id) & plain)


def seconds(run: Run, t_ns: int) -> float:
    return (t_ns - run.scenario.epoch_ns) / SECOND


def one_encoder(*faults: Fault, seconds: float = 20.0, device: str = "lir-da158a") -> Run:
    spec = DeviceSpec(5, device, "drum", Shaft((0, 60), (10, 60)), stored_heartbeat_ms=100)
    return Scenario("one_encoder", seconds, (spec,), faults).run()


def test_two_runs_are_equal() -> None:
    first, second = frames_of(bad_day(30).run()), frames_of(bad_day(30).run())
    assert np.array_equal(first.t_ns, second.t_ns)
    assert np.array_equal(first.can_id, second.can_id)
    assert np.array_equal(first.data, second.data)


def test_another_seed_gives_other_times() -> None:
    other = replace(healthy_line(10), seed=99)
    assert not np.array_equal(frames_of(healthy_line(10).run()).t_ns, frames_of(other.run()).t_ns)


def test_frames_never_overlap_on_the_wire(healthy: Run) -> None:
    """Two ends of frames are at least the second frame apart; its length by other code."""
    frames = frames_of(healthy)
    bit_ns = SECOND // healthy.bitrate
    assert (np.diff(frames.t_ns) >= wire_bits(frames)[1:] * bit_ns).all()


def test_bus_load_is_the_sum_of_the_wire_times(healthy: Run) -> None:
    bits = int(wire_bits(frames_of(healthy)).sum())
    load = bits / healthy.bitrate / healthy.scenario.seconds
    assert load == pytest.approx(healthy.truth.bus_load)
    assert 0.02 < load < 0.10


def test_healthy_line_has_nothing_to_report(healthy: Run) -> None:
    truth = healthy.truth
    assert truth.findings == []
    assert truth.emcy == []
    assert truth.missed == []
    assert {row.result for row in truth.sdo} == {"ok"}
    assert truth.error_frames == 0
    assert all(isinstance(item, FrameBatch) for item in healthy.batches)


def test_healthy_line_runs_through_the_boot_sequence(healthy: Run) -> None:
    last = {row.node: row for row in healthy.truth.states}
    assert set(last) == {ENTRY, GUIDE, PRESS, WINDER, PLATFORM, LIFT}
    assert {row.state for row in last.values()} == {"OPERATIONAL"}
    boot_ups = [row for row in healthy.truth.boot_ups if row.commanded]
    assert sorted(row.node for row in boot_ups) == [1, 2, 3, 4, 10, 20]
    reset_ns = healthy.truth.commands[0].t_ns
    quiet = {row.node: (row.t_ns - reset_ns) / SECOND for row in boot_ups}
    assert all(3.99 <= quiet[node] < 4.01 for node in (ENTRY, GUIDE, PRESS, WINDER))
    assert all(quiet[node] < 1 for node in (PLATFORM, LIFT))
    assert {row.node for row in boot_ups if row.byte == 0x7F} == {PRESS}


def test_synchronous_pdos_answer_each_sync_within_the_device_time(healthy: Run) -> None:
    usual_us = {GUIDE: (300, 360), PLATFORM: (900, 1150), LIFT: (500, 650)}
    for node, (low, high) in usual_us.items():
        delays = [
            (row.queued_ns - row.sync_ns) / 1000
            for row in healthy.truth.pdos
            if row.node == node and row.sync_ns is not None
        ]
        assert low - 0.1 <= min(delays)
        assert max(delays) <= high + 0.1, "a tenth for the drift of the device's clock"


def test_every_second_sync_for_type_2(healthy: Run) -> None:
    started = next(r for r in healthy.truth.states if (r.node, r.state) == (WINDER, "OPERATIONAL"))
    syncs = sum(t_ns > started.start_ns for t_ns in healthy.truth.sync_ns)
    rows = data_rows(frames_of(healthy), 0x280 + WINDER)
    assert len(rows) in (syncs // 2, (syncs + 1) // 2)


def test_heartbeats_keep_their_period(healthy: Run) -> None:
    frames = frames_of(healthy)
    for node, ms in ((ENTRY, 500), (GUIDE, 250), (LIFT, 1000)):
        rows = data_rows(frames, 0x700 + node)
        beating = frames.t_ns[rows[frames.data[rows, 0] == 5]]
        assert np.median(np.diff(beating)) == pytest.approx(ms * 1e6, rel=1e-3)


def test_guard_answers_toggle(healthy: Run) -> None:
    frames = frames_of(healthy)
    rows = data_rows(frames, 0x700 + PLATFORM)
    answers = frames.data[rows[frames.data[rows, 0] != 0], 0]
    assert answers[0] == 0x05
    assert (np.diff(answers >> 7) != 0).all()
    assert healthy.truth.counts["guard_answers", PLATFORM] == len(answers)


def test_positions_on_the_bus_are_those_of_the_shaft(healthy: Run) -> None:
    """300 rpm of the lift are five turns of 8192 counts in a second."""
    frames = frames_of(healthy)
    rows = data_rows(frames, 0x280 + LIFT)
    counts = frames.data[rows, :4].copy().view("<u4")[:, 0].astype(np.int64)
    t_s = (frames.t_ns[rows] - healthy.scenario.epoch_ns) / SECOND
    steady = (t_s > 13) & (t_s < 19)
    slope = np.polyfit(t_s[steady], counts[steady], 1)[0]
    assert slope == pytest.approx(5 * 8192, rel=1e-3)


def test_bad_day_expects_what_its_script_says(bad: Run) -> None:
    required = [(row.id, row.node) for row in bad.truth.required()]
    assert sorted(required, key=str) == sorted(
        [
            ("nmt.unexpected_reset", GUIDE),
            ("emcy.active", ENTRY),
            ("pdo.missed", WINDER),
            ("nmt.guarding_lost", PLATFORM),
            ("angle.jump", LIFT),
            ("nmt.node_lost", PRESS),
            ("capture.gap", None),
            ("config.rtr_on_heartbeat_node", PRESS),
            ("sync.missing", None),
            ("sdo.abort", GUIDE),
            ("sdo.no_answer", CABINET),
            ("nmt.command_ignored", ENTRY),
            ("error.bus_off", GUIDE),
            ("sync.jitter", None),
        ],
        key=str,
    )


def test_guarding_loss_takes_the_platform_to_pre_operational(bad: Run) -> None:
    emcy = [(row.code, row.register) for row in bad.truth.emcy if row.node == PLATFORM]
    assert emcy == [(0x8130, 0x11), (0x0000, 0x00)]
    states = [row.state for row in bad.truth.states if row.node == PLATFORM]
    assert states[-3:] == ["OPERATIONAL", "PRE-OPERATIONAL", "OPERATIONAL"]


def test_partial_clear_leaves_the_register_bit(bad: Run) -> None:
    told = [(row.code, row.register, row.alarms) for row in bad.truth.emcy if row.node == ENTRY]
    assert told == [(0x7320, 0x01, 1), (0x5530, 0x81, 1), (0x0000, 0x80, 0)]


def test_missed_pdos_are_missing_on_the_bus(bad: Run) -> None:
    rows = [row for row in bad.truth.missed if row.node == WINDER]
    assert len(rows) == 5
    t_ns = frames_of(bad).t_ns[data_rows(frames_of(bad), 0x280 + WINDER)]
    for row in rows:
        following = t_ns[(t_ns > row.sync_ns) & (t_ns < row.sync_ns + 90_000_000)]
        assert len(following) == 0


def test_missing_syncs_leave_a_hole(bad: Run) -> None:
    periods = np.diff(np.array(bad.truth.sync_ns)) / 1e6
    assert Counter(np.round(periods / 50).astype(int).tolist())[4] == 1


def test_heartbeats_are_empty_after_a_remote_frame(bad: Run) -> None:
    frames = frames_of(bad)
    rows = data_rows(frames, 0x700 + PRESS)
    after = rows[frames.t_ns[rows] > bad.scenario.epoch_ns + 68 * SECOND]
    assert (frames.data[after, 0] == 0).all()
    assert len(after) > 90


def test_block_and_segmented_transfers_carry_their_bytes(bad: Run) -> None:
    by_kind = {row.kind: row for row in bad.truth.sdo if row.node == CABINET and row.sub == 0}
    assert by_kind["block"].data == bytes(range(256)) * 4
    assert by_kind["segmented"].data in (b"moved to C", b"simulated I/O 8/8")
    assert {row.result for row in bad.truth.sdo} == {"ok", "abort", "no answer"}


def test_what_the_recorder_lost_is_what_another_recorder_heard(bad: Run) -> None:
    faults = [fault for fault in bad.scenario.faults if not isinstance(fault, RecorderGap)]
    whole = replace(bad.scenario, faults=tuple(faults)).run()
    assert whole.truth.frames == bad.truth.frames + bad.truth.lost_frames
    gaps = [item for item in bad.batches if isinstance(item, Gap)]
    assert [gap.lost_frames for gap in gaps] == [bad.truth.lost_frames]
    assert seconds(bad, gaps[0].start_ns) == 60.0
    assert seconds(bad, gaps[0].end_ns) == 61.5


def test_bus_off_is_a_burst_of_error_frames_then_silence_then_emcy(bad: Run) -> None:
    frames = frames_of(bad)
    errors = frames.t_ns[(frames.flags & FrameFlag.ERROR) != 0]
    assert len(errors) == 32
    rows = np.flatnonzero((frames.can_id & 0x7F) == GUIDE)
    nothing = frames.t_ns[rows][frames.t_ns[rows] > errors[-1]]
    assert nothing[0] - errors[-1] >= SECOND
    late = [row for row in bad.truth.emcy if row.node == GUIDE and row.t_ns > errors[-1]]
    assert [row.code for row in late] == [0x7510, 0x0000]


def test_power_loss_ends_in_a_boot_up() -> None:
    run = one_encoder(PowerLoss(5, 10.0, 2.0))
    states = [row.state for row in run.truth.states]
    assert states[-5:] == [
        "OPERATIONAL",
        "OFF",
        "INITIALISING",
        "PRE-OPERATIONAL",
        "OPERATIONAL",
    ]
    assert run.truth.boot_ups[-1].byte == 0x7F


def test_clock_step_shows_in_the_stamps_only() -> None:
    plain, stepped = one_encoder(), one_encoder(ClockStep(10.0, -250))
    moved = frames_of(plain).t_ns - frames_of(stepped).t_ns
    assert set(moved.tolist()) == {0, 250_000_000}
    assert (np.diff(frames_of(stepped).t_ns) < 0).sum() == 1


def test_emcy_storm_sends_every_change() -> None:
    run = one_encoder(EmcyStorm(5, 10.0, count=10))
    assert [row.code for row in run.truth.emcy] == [0x7320, 0x0000] * 10


def test_a_second_device_interleaves_its_heartbeat() -> None:
    run = one_encoder(DuplicateNode(5, 10.0))
    frames = frames_of(run)
    t_ns = frames.t_ns[data_rows(frames, 0x705)] - run.scenario.epoch_ns
    late = t_ns[(t_ns > 11 * SECOND) & (t_ns < 18 * SECOND)]
    assert len(late) == pytest.approx(7000 / 100 + 7000 / 700, abs=2)
    assert [row.byte for row in run.truth.boot_ups if row.node == 5] == [0x7F, 0x7F, 0x00]


def test_pdos_go_on_in_pre_operational() -> None:
    run = one_encoder(PdoOutsideOperational(5, 10.0, 2.0))
    state = next(row for row in run.truth.states if row.start_ns - run.scenario.epoch_ns > 9e9)
    assert state.state == "PRE-OPERATIONAL"
    t_ns = np.array([row.end_ns for row in run.truth.pdos])
    inside = t_ns[(t_ns > state.start_ns) & (t_ns < state.end_ns)]
    assert len(inside) > 10


def test_a_stopped_node_is_mute() -> None:
    run = one_encoder(Command(10.0, STOP, 5))
    frames = frames_of(run)
    late = frames.t_ns > run.scenario.epoch_ns + 10.1 * SECOND
    assert set(frames.can_id[late].tolist()) == {0x080, 0x705, 0x77F}


def test_response_time_can_be_chosen() -> None:
    spec = DeviceSpec(5, "haomiao-38", "drum", response=Delay(2_000_000))
    run = Scenario("slow", 10.0, (spec,)).run()
    delays = {row.queued_ns - row.sync_ns for row in run.truth.pdos if row.sync_ns is not None}
    assert delays == {2_000_000}


def test_jittery_sync_is_jittery_and_counts() -> None:
    run = jittery_sync().run()
    periods = np.diff(np.array(run.truth.sync_ns))[100:] / 1e6
    assert 16.6 < periods.min() < 20
    assert 30 < periods.max() < 33.4
    frames = frames_of(run)
    counters = frames.data[data_rows(frames, 0x080), 0]
    assert counters[:61].tolist() == [*range(1, 61), 1]
    assert (frames.t_ns % 1000 == 0).all()


def test_the_recorders_own_bus_off_is_two_error_frames_around_silence() -> None:
    run = one_encoder(RecorderBusOff(10.0, 1.0))
    frames = frames_of(run)
    rows = np.flatnonzero((frames.flags & FrameFlag.ERROR) != 0)
    assert frames.can_id[rows].tolist() == [0x40, 0x100]
    assert rows[1] == rows[0] + 1
    assert run.truth.lost_frames > 50
