"""One fault at a time on one encoder: the analyzer tells that one and no other."""

from pathlib import Path

import pytest

from syncline_samples.faults import (
    AngleJump,
    CableLoose,
    ClockStep,
    Command,
    CommandIgnored,
    DuplicateNode,
    Emcy,
    EmcyStorm,
    MissedPdos,
    MissingSyncs,
    NodeBusOff,
    PdoOutsideOperational,
    PowerLoss,
    Preset,
    RecorderBusOff,
    RemoteOnHeartbeat,
    SdoAccess,
    SdoRefused,
    SdoSilent,
    SyncJitter,
    WatchdogReset,
)
from syncline_samples.machine import DeviceSpec, Fault, Scenario
from syncline_samples.master import PRE_OPERATIONAL, RESET_COMMUNICATION, RESET_NODE, STOP
from syncline_samples.motion import Shaft
from syncline_samples.sdo_client import read, write
from tests.samples.one_story import told, told_alone

NODE = 5
FAULTS: tuple[Fault, ...] = (
    AngleJump(NODE, 12.0),
    CableLoose(NODE, 12.0, 3.0),
    ClockStep(12.0, -250),
    ClockStep(12.0, 250),
    Command(12.0, STOP, NODE),
    Command(12.0, PRE_OPERATIONAL, NODE),
    Command(12.0, RESET_NODE, NODE),
    Command(12.0, RESET_COMMUNICATION, 0),
    CommandIgnored(NODE, 12.0),
    DuplicateNode(NODE, 12.0, heartbeat_ms=230),
    Emcy(NODE, 12.0, 0x7320, 0x01, alarms=1, for_s=3.0),
    Emcy(NODE, 12.0, 0x5530, 0x80),
    EmcyStorm(NODE, 12.0),
    MissedPdos(NODE, 12.0),
    MissedPdos(NODE, 12.0, count=1),
    MissingSyncs(12.0),
    MissingSyncs(12.0, count=1),
    NodeBusOff(NODE, 12.0),
    PdoOutsideOperational(NODE, 12.0),
    PowerLoss(NODE, 12.0, 0.1),
    PowerLoss(NODE, 12.0, 4.0),
    Preset(NODE, 12.0, 1000),
    RemoteOnHeartbeat(NODE, 12.0),
    SdoAccess(NODE, 12.0, (read(0x1000), write(0x1029, 1, 0), read(0x6004))),
    SdoRefused(NODE, 12.0),
    SdoSilent(NODE, 12.0),
    SyncJitter(12.0, 6.0, 5000),
    WatchdogReset(NODE, 12.0),
    RecorderBusOff(12.0, 0.5),
    RecorderBusOff(12.0, 3.0),
)


ON_HAOMIAO = (AngleJump,)
"""Its speed limit is printed."""


def scenario(*faults: Fault, device: str = "") -> Scenario:
    on_haomiao = any(isinstance(each, ON_HAOMIAO) for each in faults)
    spec = DeviceSpec(
        NODE,
        device or ("haomiao-38" if on_haomiao else "lir-ma158k"),
        "drum",
        Shaft((0, 60), (10, 60), start_turns=100),
        stored_heartbeat_ms=200,
        heartbeat_ms=200,
        drift_ppm=15,
    )
    return Scenario("one_fault", 25.0, (spec,), faults)


@pytest.mark.parametrize("fault", FAULTS, ids=repr)
def test_one_fault_is_one_story(fault: Fault, tmp_path: Path) -> None:
    told_alone(scenario(fault), tmp_path)


@pytest.mark.parametrize("heartbeat_ms", [60, 230, 500, 700])
def test_a_second_device_is_told_by_its_cadence(heartbeat_ms: int, tmp_path: Path) -> None:
    """On a Haomiao, whose own heartbeat comes every 200 ms and whose twin runs as it does."""
    fault = DuplicateNode(NODE, 4.0, heartbeat_ms=heartbeat_ms)
    told_alone(scenario(fault, device="haomiao-38"), tmp_path)


@pytest.mark.parametrize("device", ["lir-da158", "lir-da158a", "lir-918", "haomiao-38"])
@pytest.mark.parametrize("boot_ms", [20, 80, 150])
def test_a_restart_is_told_whatever_the_boot_up_byte(
    device: str, boot_ms: int, tmp_path: Path
) -> None:
    told_alone(scenario(WatchdogReset(NODE, 12.0, boot_ms), device=device), tmp_path)


def test_without_a_fault_there_is_no_finding(tmp_path: Path) -> None:
    assert told(scenario(), tmp_path) == []
