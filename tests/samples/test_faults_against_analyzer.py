"""One fault at a time on one encoder: the analyzer tells that one and no other."""

from pathlib import Path

import pytest

from syncline_analyzer import open_session
from syncline_samples.comparison import compare
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
    RemoteOnHeartbeat,
    SdoAccess,
    SdoRefused,
    SdoSilent,
    SyncJitter,
    WatchdogReset,
)
from syncline_samples.generate import candump_log
from syncline_samples.machine import DeviceSpec, Fault, Scenario
from syncline_samples.master import PRE_OPERATIONAL, RESET_COMMUNICATION, RESET_NODE, STOP
from syncline_samples.motion import Shaft
from syncline_samples.sdo_client import read, write

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
)


ON_HAOMIAO = (AngleJump, WatchdogReset)
"""Its speed limit is printed, and it says 00h when it boots."""


def scenario(*faults: Fault) -> Scenario:
    spec = DeviceSpec(
        NODE,
        "haomiao-38" if any(isinstance(each, ON_HAOMIAO) for each in faults) else "lir-ma158k",
        "drum",
        Shaft((0, 60), (10, 60), start_turns=100),
        stored_heartbeat_ms=200,
        heartbeat_ms=200,
        drift_ppm=15,
    )
    return Scenario("one_fault", 25.0, (spec,), faults)


@pytest.mark.parametrize("fault", FAULTS, ids=repr)
def test_one_fault_is_one_story(fault: Fault, tmp_path: Path) -> None:
    run = scenario(fault).run()
    log, description = tmp_path / "one.log", tmp_path / "one.toml"
    log.write_bytes(candump_log(run))
    description.write_text(run.description_toml, encoding="utf-8")
    outcome = compare(run.truth.findings, open_session(log, description=description).findings())
    assert outcome.missing == []
    assert outcome.unexpected == []


def test_without_a_fault_there_is_no_finding(tmp_path: Path) -> None:
    log = tmp_path / "one.log"
    log.write_bytes(candump_log(scenario().run()))
    assert open_session(log).findings() == []
