"""LSS, TIME, SYNC and PDO faults, power, and the recorder's own troubles, on simulated buses."""

from datetime import UTC, datetime
from typing import cast

import canopen
import numpy as np
import pytest
from canopen.lss import LssMaster
from canopen.timestamp import TimeProducer as OtherTimeProducer

from syncline_samples.bus import Frame
from syncline_samples.buses import Buses
from syncline_samples.devices import IoModule
from syncline_samples.faults import (
    BusPowerOff,
    ControllerState,
    ErrorFrames,
    ExtraPdos,
    LssSession,
    Overrun,
    PdoInhibitTime,
    PowerLoss,
    RecorderGap,
    RecordingBegins,
    SecondSyncProducer,
    SyncOutage,
    TimeService,
    TpdoStops,
    WrongLengthPdos,
)
from syncline_samples.generate import candump_log
from syncline_samples.machine import Fault, Run, Scenario
from syncline_samples.motion import Shaft
from syncline_samples.scenarios import haomiao, io_module
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from tests.samples.bench import Bench

SECOND = 1_000_000_000
LIFT, CABINET = 20, 30


def scenario(*faults: Fault, seconds: float = 8.0, name: str = "can0", seed: int = 1) -> Scenario:
    devices = (haomiao(LIFT, "lift", Shaft((0, 0), (5, 50)), 200), io_module(CABINET, "I/O", 200))
    return Scenario(
        "services",
        seconds,
        devices,
        faults,
        sync_us=50_000,
        rpdo_node=CABINET,
        bus_name=name,
        seed=seed,
    )


def run(*faults: Fault) -> Run:
    return scenario(*faults).run()


def heard(result: Run, from_s: float = 0.0, to_s: float = 99.0) -> FrameBatch:
    frames = FrameBatch.concat([item for item in result.batches if isinstance(item, FrameBatch)])
    t_s = (frames.t_ns - result.scenario.epoch_ns) / SECOND
    return frames[(t_s >= from_s) & (t_s < to_s)]


def times(result: Run, can_id: int, from_s: float = 0.0, to_s: float = 99.0) -> np.ndarray:
    """Seconds of the run at which data frames of an identifier came."""
    frames = heard(result, from_s, to_s)
    rows = (frames.can_id == can_id) & (frames.flags == 0)
    t_s: np.ndarray = (frames.t_ns[rows] - result.scenario.epoch_ns) / SECOND
    return t_s


class LssWire:
    """python-canopen's LSS master on our bus."""

    def __init__(self) -> None:
        self.bench = Bench()
        self.module = IoModule(self.bench.world, 30)
        self.bench.boot(self.module)
        self.master = LssMaster()
        self.master.network = cast(canopen.Network, self)
        self.bench.bus.listen(0x7E4, self._answer)

    def _answer(self, frame: Frame, t_ns: int) -> None:
        self.master.on_message_received(0x7E4, bytearray(frame.data), 0.0)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.bench.bus.send(Frame(can_id, bytes(data)), self)
        self.bench.wait(5)


def test_another_lss_master_selects_and_configures() -> None:
    wire = LssWire()
    assert wire.master.send_switch_state_selective(0, 1, 1, 1)
    assert wire.master.inquire_node_id() == 30
    assert wire.master.inquire_lss_address(0x5B) == 1
    wire.master.configure_node_id(41)
    wire.master.store_configuration()
    wire.master.send_switch_state_global(0)
    assert wire.module.node_id == 30, "until the reset"
    wire.bench.ask("000#811E", 400)
    assert wire.module.node_id == 41


def test_another_lss_master_is_refused() -> None:
    wire = LssWire()
    wire.module.lss.refuses = True
    wire.master.send_switch_state_global(1)
    with pytest.raises(canopen.lss.LssError):
        wire.master.configure_node_id(41)


def test_a_slave_is_selected_by_its_whole_identity_only() -> None:
    wire = LssWire()
    assert wire.bench.ask("7E5#4301000000000000") == [], "the serial number alone"
    for wrong in ("4000000000000000", "4102000000000000", "4201000000000000"):
        assert wire.bench.ask(f"7E5#{wrong}") == []
    assert wire.bench.ask("7E5#4301000000000000") == []


def test_a_slave_that_waits_does_not_answer() -> None:
    wire = LssWire()
    wire.master.RESPONSE_TIMEOUT = 0.01
    with pytest.raises(canopen.lss.LssError):
        wire.master.inquire_node_id()


def test_lss_session_is_in_the_truth() -> None:
    result = run(LssSession(CABINET, 4.0, 41))
    assert len(times(result, 0x7E5)) == sum(row.request for row in result.truth.lss) == 9
    assert len(times(result, 0x7E4)) == sum(not row.request for row in result.truth.lss) == 5
    assert len(times(result, 0x700 + 41, 5.0)) > 10
    assert len(times(result, 0x700 + CABINET, 5.0)) == 0


class TimeNetwork:
    data = b""

    def send_message(self, can_id: int, data: bytes) -> None:
        self.data = bytes(data)


def test_time_is_told_as_the_other_producer_tells_it() -> None:
    result = run(TimeService(2.0, 1.5))
    frames = heard(result)
    rows = np.flatnonzero(frames.can_id == 0x100)
    assert len(rows) == 4
    for row, told in zip(rows.tolist(), result.truth.time, strict=True):
        network = TimeNetwork()
        other = OtherTimeProducer(cast(canopen.network.Network, network))
        other.transmit(told.told_ns // 1_000_000 / 1000 + 0.0001)
        assert frames.payload(row) == network.data
    first = datetime.fromtimestamp(result.truth.time[0].told_ns / 1e9, UTC)
    assert first.isoformat() == "2026-03-02T06:00:02+00:00"


def test_a_clock_of_the_time_producer_jumps() -> None:
    truth = run(TimeService(2.0, 1.0, 60_000, jump_after_s=2.5, jump_ms=-5000)).truth
    ahead = [round((row.told_ns - row.t_ns) / 1e6) for row in truth.time]
    assert ahead == [60_000] * 3 + [55_000] * 3


def test_the_whole_bus_loses_power() -> None:
    result = run(BusPowerOff(4.0, 1.5))
    assert len(heard(result, 4.01, 5.5)) == 0
    boots = [row.node for row in result.truth.boot_ups if row.t_ns > result.scenario.epoch_ns + 5e9]
    assert boots[:3] == [LIFT, CABINET, 127]
    finals = {row.node: row.state for row in result.truth.states}
    assert set(finals.values()) == {"OPERATIONAL"}
    assert np.diff(times(result, 0x77F, 6.4)) == pytest.approx(0.5, abs=0.01)


def test_a_tpdo_stops_and_the_heartbeat_goes_on() -> None:
    result = run(TpdoStops(LIFT, 4.0, 2, 2.0))
    assert len(times(result, 0x280 + LIFT, 4.01, 6.0)) == 0
    assert len(times(result, 0x700 + LIFT, 4.0, 6.0)) == 10
    assert len(result.truth.missed) == 40


def test_extra_pdos_come_between_the_syncs() -> None:
    plain, extra = run(), run(ExtraPdos(LIFT, 4.0))
    more = len(times(extra, 0x280 + LIFT)) - len(times(plain, 0x280 + LIFT))
    assert more == 5


@pytest.mark.parametrize("hasty", [True, False])
def test_inhibit_time_is_kept_or_not(hasty: bool) -> None:
    result = run(PdoInhibitTime(CABINET, 4.0, inhibit_ms=50, every_ms=20, hasty=hasty))
    shortest = np.diff(times(result, 0x180 + CABINET, 4.05, 4.6)).min()
    assert (shortest < 0.021) if hasty else (shortest > 0.0499)


def test_pdos_of_a_wrong_length() -> None:
    frames = heard(run(WrongLengthPdos(LIFT, 4.0, dlc=3)))
    rows = np.flatnonzero(frames.can_id == 0x280 + LIFT)
    assert (frames.dlc[rows] == 3).sum() == pytest.approx(40, abs=1)
    assert set(frames.dlc[rows].tolist()) == {3, 4}


def test_no_sync_for_a_while() -> None:
    t_s = times(run(SyncOutage(4.0, 1.0)), 0x080)
    assert np.diff(t_s).max() == pytest.approx(1.05, abs=0.001)


def test_a_second_sync_producer_interleaves() -> None:
    result = run(SecondSyncProducer(4.0, 2.0))
    t_s = times(result, 0x080, 4.1, 5.9)
    assert set(np.round(np.diff(t_s), 3).tolist()) <= {0.018, 0.019, 0.031, 0.032}
    assert len(times(result, 0x080)) == len(result.truth.sync_ns)


def test_a_recording_begins_late() -> None:
    plain, late = run(), run(RecordingBegins(4.0))
    assert len(heard(late)) == len(heard(plain, 4.0)) == late.truth.frames
    assert late.truth.lost_frames == 0
    assert all(isinstance(item, FrameBatch) for item in late.batches)
    assert late.truth.deaf == [(late.scenario.epoch_ns, late.scenario.epoch_ns + 4 * SECOND)]
    assert late.truth.counts["heartbeats", LIFT] < plain.truth.counts["heartbeats", LIFT]


def errors(result: Run) -> list[tuple[int, bytes]]:
    frames = heard(result)
    rows = np.flatnonzero((frames.flags & FrameFlag.ERROR) != 0)
    return [(int(frames.can_id[row]), bytes(frames.data[row])) for row in rows]


def test_overrun_is_told_after_the_loss() -> None:
    """linux/can/error.h: class 004h, data[1] = 01h is a receive overflow."""
    result = run(Overrun(4.0, 200))
    assert errors(result) == [(0x004, bytes([0, 1, 0, 0, 0, 0, 0, 0]))]
    assert result.truth.lost_frames > 5
    assert len(heard(result, 4.0, 4.2)) == 0


def test_controller_states_carry_counters() -> None:
    """Classes 004h and 200h; data[1] = 04h warning, 10h passive, 40h active; data[7] counts."""
    states = [(data[1], data[7]) for can_id, data in errors(run(ControllerState(4.0)))]
    assert states == [(0x04, 96), (0x10, 128), (0x40, 40)]
    assert {can_id for can_id, _ in errors(run(ControllerState(4.0)))} == {0x204}


@pytest.mark.parametrize(("kind", "classes"), [("stuff", 0x88), ("ack", 0xA8), ("crc", 0x88)])
def test_error_frames_have_their_classes(kind: str, classes: int) -> None:
    result = run(ErrorFrames(4.0, count=12, kind=kind))
    assert [can_id for can_id, _ in errors(result)] == [classes] * 12
    assert result.truth.error_frames == 12


def test_two_buses_have_the_same_nodes_and_their_own_truth() -> None:
    first = scenario(PowerLoss(LIFT, 4.0, 1.0))
    second = scenario(RecorderGap(5.0, 1.0), name="can1", seed=2)
    both = Buses((first, second)).run()
    frames = FrameBatch.concat([item for item in both.batches if isinstance(item, FrameBatch)])
    assert (np.diff(frames.t_ns) >= 0).all()
    for number, truth in enumerate(both.truths):
        assert int((frames.bus == number).sum()) == truth.frames
    gaps = [item for item in both.batches if isinstance(item, Gap)]
    assert [(gap.bus, gap.lost_frames) for gap in gaps] == [(1, both.truths[1].lost_frames)]
    lines = candump_log(both).decode().splitlines()
    assert {line.split()[1] for line in lines} == {"can0", "can1"}
    assert both.description_toml.count("node.20") == 2
