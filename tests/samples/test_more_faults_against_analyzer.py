"""One fault at a time on a machine of four devices: the analyzer tells that one and no other."""

from pathlib import Path

import pytest

from syncline_samples import faults
from syncline_samples.machine import DeviceSpec, Fault, Scenario
from syncline_samples.master import RESET_COMMUNICATION
from syncline_samples.motion import Shaft, Tilt
from syncline_samples.node import State
from syncline_samples.scenarios import haomiao, io_module, jn2100_guarded, lir_stored_heartbeat
from syncline_samples.sdo_client import read, write, write_block
from tests.samples.one_story import told_alone

ENCODER, TILT, LIFT, CABINET = 5, 11, 20, 30
AT_S = 13.0
"""Late enough after the first reset for a restart to be unexpected."""

SDO: tuple[Fault, ...] = (
    faults.SdoTwoClients(CABINET, AT_S),
    faults.SdoServerAborts(CABINET, AT_S),
    faults.SdoClientAborts(CABINET, AT_S),
    faults.SdoClientStops(CABINET, AT_S),
    faults.SdoClientStops(CABINET, AT_S, server_timeout_ms=0),
    faults.SdoServerStops(CABINET, AT_S),
    faults.SdoLate(CABINET, AT_S),
    faults.SdoLate(CABINET, AT_S, on_timeout="abort"),
    faults.SdoLate(CABINET, AT_S, then=(read(0x1018, 1),)),
    faults.SdoReset(CABINET, AT_S),
    faults.BlockSegmentsLost(CABINET, AT_S),
    faults.BlockSegmentsLost(CABINET, AT_S, write_block(0x2F02, 0, bytes(600)), (1, 21)),
    faults.BlockCrcWrong(CABINET, AT_S),
    faults.BlockCrcWrong(CABINET, AT_S, write_block(0x1F50, 1, bytes(333))),
    faults.NodeSearch(AT_S),
)
NMT: tuple[Fault, ...] = (
    faults.GuardToggleStuck(TILT, AT_S),
    faults.GuardUnanswered(TILT, AT_S),
    faults.LeavesOperational(TILT, AT_S, State.STOPPED),
    faults.LeavesOperational(CABINET, AT_S),
    faults.LeavesOperational(ENCODER, AT_S),
    faults.BootLoop(CABINET, AT_S),
    faults.BootLoop(ENCODER, AT_S),
    faults.HeartbeatPeriod(LIFT, AT_S, 200),
    faults.HeartbeatPeriod(LIFT, AT_S, 60),
    faults.UnknownState(LIFT, AT_S),
    faults.HeartbeatPeriod(CABINET, AT_S, 120),
    faults.HeartbeatIrregular(LIFT, AT_S),
    faults.HeartbeatsMissing(LIFT, AT_S),
    faults.MalformedCommand(AT_S),
    faults.MalformedCommand(AT_S, b"\x01\x05\x00"),
    faults.MalformedCommand(AT_S, b"\x55\x05"),
)
EMCY: tuple[Fault, ...] = (
    faults.Errors(ENCODER, AT_S, ((0, "+", 0x7320), (0.4, "+", 0x5530), (0.8, "-", 0x7320))),
    faults.Errors(TILT, AT_S, ((0, "+", 0x4200), (1, "-", 0x4200))),
    faults.EmcyInhibitTime(TILT, AT_S),
    faults.EmcyInhibitTime(TILT, AT_S, hasty=True),
    faults.EmcyInhibitTime(ENCODER, AT_S),
    faults.EmcyMalformed(LIFT, AT_S),
    faults.EmcyMalformed(LIFT, AT_S, dlc=0),
    faults.ErrorHistory(TILT, AT_S),
    faults.EmcyWhileStopped(TILT, AT_S),
)
SETTINGS: tuple[Fault, ...] = (
    faults.MovePdo(LIFT, AT_S, 0x3A5, 2),
    faults.MovePdo(CABINET, AT_S, 0x1F0),
    faults.MovePdo(CABINET, AT_S, 0x2F0, 1, receive=True),
    faults.RemapPdo(LIFT, AT_S, (0x60040020, 0x65000010), 2),
    faults.RemapPdo(CABINET, AT_S, (0x64010110, 0x60000108)),
    faults.MoveEmcy(CABINET, AT_S, 0x0F1),
    faults.MoveSync(AT_S, 0x90, (LIFT, TILT, CABINET)),
    faults.MoveSdo(CABINET, AT_S, 0x640, 0x5C0),
    faults.Storage(LIFT, AT_S, (write(0x1800, 5, 50, 2),)),
    faults.Storage(LIFT, AT_S, (write(0x1800, 5, 50, 2),), what="load"),
    faults.Storage(LIFT, AT_S, (write(0x1800, 5, 50, 2),), "", specifier=RESET_COMMUNICATION),
    faults.ResetBySdo(TILT, AT_S),
    faults.FactoryReset(TILT, AT_S),
    faults.NodeIdChange(LIFT, AT_S, 33),
    faults.NodeIdChange(ENCODER, AT_S, 35),
)
BUS: tuple[Fault, ...] = (
    faults.RecordingBegins(AT_S - 5),
    faults.Overrun(AT_S),
    faults.Overrun(AT_S, 200),
    faults.ControllerState(AT_S),
    faults.ControllerState(AT_S, passive=False),
    faults.ErrorFrames(AT_S),
    faults.ErrorFrames(AT_S, count=3),
    faults.ErrorFrames(AT_S, kind="ack"),
    faults.LssSession(CABINET, AT_S),
    faults.LssSession(CABINET, AT_S, 41),
    faults.LssSession(CABINET, AT_S, 41, refused=True),
    faults.LssSession(CABINET, AT_S, bit_rate=3, reset=False),
    faults.TimeService(1.5),
    faults.TimeService(1.5, offset_ms=3_600_000),
    faults.TimeService(1.5, jump_after_s=AT_S, jump_ms=5000),
    faults.BusPowerOff(AT_S, 0.3),
    faults.TpdoStops(LIFT, AT_S),
    faults.TpdoStops(LIFT, AT_S, 1),
    faults.ExtraPdos(LIFT, AT_S),
    faults.PdoRequests(TILT, AT_S),
    faults.PdoInhibitTime(CABINET, AT_S),
    faults.PdoInhibitTime(CABINET, AT_S, hasty=False),
    faults.WrongLengthPdos(LIFT, AT_S),
    faults.SyncOutage(AT_S),
    faults.SecondSyncProducer(AT_S),
    faults.ClockStep(AT_S, 1500),
)


def scenario(*script: Fault) -> Scenario:
    shaft = Shaft((0, 0), (5, 50))
    devices: tuple[DeviceSpec, ...] = (
        lir_stored_heartbeat(ENCODER, "lir-ma158k", "drum", shaft, 200),
        jn2100_guarded(TILT, "tilt", Tilt((0, 0, 0), (5, 9000, 100), (10, 0, 0)), 200),
        haomiao(LIFT, "lift", shaft, 300),
        io_module(CABINET, "cabinet", 500),
    )
    return Scenario("more", 18.0, devices, script, sync_us=60_000, rpdo_node=CABINET)


@pytest.mark.parametrize("fault", [*SDO, *NMT, *EMCY, *SETTINGS, *BUS], ids=repr)
def test_one_fault_is_one_story(fault: Fault, tmp_path: Path) -> None:
    told_alone(scenario(fault), tmp_path)


def test_a_second_device_in_step_with_the_first_is_told(tmp_path: Path) -> None:
    told_alone(scenario(faults.DuplicateNode(CABINET, AT_S, "io", 500)), tmp_path)


def test_a_power_cycle_of_the_whole_bus_accuses_nobody(tmp_path: Path) -> None:
    told_alone(scenario(faults.BusPowerOff(AT_S, 3.0)), tmp_path)
