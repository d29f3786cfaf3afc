"""The scenarios of the samples and the demo."""

from dataclasses import replace

from syncline_samples.faults import (
    AngleJump,
    CableLoose,
    CommandIgnored,
    Emcy,
    MasterSilent,
    MissedPdos,
    MissingSyncs,
    NodeBusOff,
    Preset,
    RecorderGap,
    RemoteOnHeartbeat,
    SdoAccess,
    SdoRefused,
    SdoSilent,
    SyncJitter,
    WatchdogReset,
)
from syncline_samples.machine import DeviceSpec, Fault, Scenario
from syncline_samples.master import IDENTITY
from syncline_samples.motion import Shaft, Tilt
from syncline_samples.sdo_client import SdoJob, read, write, write_text

ENTRY, GUIDE, PRESS, WINDER, PLATFORM, LIFT, CABINET = 1, 2, 3, 4, 10, 20, 30
"""Node ids of the machine."""

_NAMES = (read(0x1000), read(0x1008), *IDENTITY)


def _lir_jobs(*more: SdoJob) -> tuple[SdoJob, ...]:
    scale = tuple(read(index) for index in (0x6000, 0x6001, 0x6002, 0x6502))
    types = tuple(read(0x1800 + pdo, sub) for pdo in (0, 1) for sub in (2, 5))
    return (*_NAMES, *more, *scale, *types)


def lir_heartbeat(node_id: int, device: str, name: str, shaft: Shaft, ms: int) -> DeviceSpec:
    """A LIR with a heartbeat that the master writes; TPDO2 answers every SYNC."""
    jobs = _lir_jobs(write(0x1017, 0, ms), write(0x1801, 2, 1))
    return DeviceSpec(node_id, device, name, shaft, heartbeat_ms=ms, jobs=jobs)


def lir_stored_heartbeat(node_id: int, device: str, name: str, shaft: Shaft, ms: int) -> DeviceSpec:
    """A LIR whose heartbeat stands in its EEPROM: it boots with 7Fh."""
    jobs = _lir_jobs(read(0x1017), write(0x1801, 2, 1), write(0x1800, 5, 200))
    return DeviceSpec(
        node_id, device, name, shaft, stored_heartbeat_ms=ms, heartbeat_ms=ms, jobs=jobs
    )


def lir_guarded(node_id: int, device: str, name: str, shaft: Shaft, ms: int) -> DeviceSpec:
    """A LIR that the master guards; life time factor 3; TPDO2 answers every second SYNC."""
    jobs = _lir_jobs(write(0x100C, 0, ms), write(0x100D, 0, 3))
    return DeviceSpec(node_id, device, name, shaft, guard_ms=ms, jobs=jobs)


def jn2100_guarded(node_id: int, name: str, tilt: Tilt, ms: int) -> DeviceSpec:
    """A JN2100 that the master guards; life time factor 3; all TPDOs answer every SYNC."""
    settings = tuple(read(index) for index in (0x6000, 0x2040, 0x2042, 0x2044, 0x2046, 0x2047))
    types = tuple(read(0x1800 + pdo, 2) for pdo in range(3))
    guarding = (write(0x100C, 0, ms, 2), write(0x100D, 0, 3, 1))
    jobs = (*_NAMES, *settings, *types, *guarding)
    return DeviceSpec(node_id, "jn2100", name, tilt, guard_ms=ms, jobs=jobs)


def haomiao(node_id: int, name: str, shaft: Shaft, ms: int) -> DeviceSpec:
    """A Haomiao encoder with heartbeat; TPDO1 every 250 ms, TPDO2 on every SYNC."""
    scale = tuple(read(index) for index in (0x6000, 0x6001))
    types = tuple(read(0x1800 + pdo, 2) for pdo in (0, 1))
    jobs = (*_NAMES, *scale, *types, write(0x1017, 0, ms, 2), write(0x1800, 5, 250, 2))
    return DeviceSpec(node_id, "haomiao-38", name, shaft, heartbeat_ms=ms, jobs=jobs)


def io_module(node_id: int, name: str, ms: int) -> DeviceSpec:
    """An I/O module with heartbeat, no device of the catalogue."""
    jobs = (*_NAMES, write(0x1017, 0, ms, 2))
    return DeviceSpec(node_id, "io", name, None, heartbeat_ms=ms, jobs=jobs)


def six_devices() -> tuple[DeviceSpec, ...]:
    """The line of the samples: each device once, turning and tilting slowly, each on its clock."""
    entry = Shaft((0, 0), (10, 0), (14, 40), (24, 40), (28, 0))
    guide = Shaft((0, 0), (9, 0), (13, 50), (25, 50), (29, -50), (35, -50), (38, 0))
    press = Shaft((0, 0), (8, 0), (12, 180), (40, 180), (44, 0), start_turns=17)
    winder = Shaft((0, 30), (60, 90), (120, 30), start_turns=2000)
    lift = Shaft(
        (0, 0), (10, 0), (12, 300), (20, 300), (24, -300), (32, -300), (34, 0), start_turns=900
    )
    platform = Tilt((0, 0, 0), (8, 0, 0), (18, 12_000, -4_000), (30, -9_000, 6_500), (40, 0, 0))
    devices = (
        lir_heartbeat(ENTRY, "lir-da158", "entry roller", entry, 500),
        lir_heartbeat(GUIDE, "lir-da158a", "guide roller", guide, 250),
        lir_stored_heartbeat(PRESS, "lir-ma158k", "press drive", press, 500),
        lir_guarded(WINDER, "lir-918", "winder", winder, 400),
        jn2100_guarded(PLATFORM, "platform tilt", platform, 100),
        haomiao(LIFT, "lift", lift, 1000),
    )
    return tuple(
        replace(spec, drift_ppm=ppm)
        for spec, ppm in zip(devices, (20, -35, 12, -8, 40, -50), strict=True)
    )


def healthy_line(seconds: float = 60.0, sync_us: int = 50_000) -> Scenario:
    """All six devices at work, nothing wrong: an analyzer finds nothing."""
    return Scenario("healthy_line", seconds, six_devices(), sync_us=sync_us, seed=11)


def bad_day(seconds: float = 120.0, sync_us: int = 20_000) -> Scenario:
    """One fault after the other, each on a node of its own or well apart in time."""
    faults: tuple[Fault, ...] = (
        WatchdogReset(GUIDE, 13.0),
        Emcy(ENTRY, 18.0, 0x7320, 0x01, alarms=0x0001, for_s=6.0),
        Emcy(ENTRY, 20.0, 0x5530, 0x80),
        SdoAccess(CABINET, 25.0, (read(0x2F00, block=True), write_text(0x2F01, 0, b"moved to C"))),
        MissedPdos(WINDER, 28.0, pdo=2, count=5),
        MasterSilent(34.0, 0.42),
        AngleJump(LIFT, 42.0),
        Preset(PRESS, 46.0, 5000),
        CableLoose(PRESS, 50.0, 4.0),
        RecorderGap(60.0, 1.5),
        RemoteOnHeartbeat(PRESS, 66.0),
        MissingSyncs(72.0, 3),
        SdoRefused(GUIDE, 77.0),
        SdoSilent(CABINET, 82.0),
        CommandIgnored(ENTRY, 88.0),
        NodeBusOff(GUIDE, 96.0, for_s=1.0),
        SyncJitter(104.0, 8.0, jitter_us=sync_us // 4),
    )
    devices = (*six_devices(), io_module(CABINET, "cabinet I/O", 500))
    return Scenario(
        "bad_day", seconds, devices, faults, sync_us=sync_us, seed=12, rpdo_node=CABINET
    )


def jittery_sync(seconds: float = 30.0, sync_us: int = 25_000) -> Scenario:
    """Two devices and a SYNC producer that is late by up to a third of its period."""
    press, platform = six_devices()[2], six_devices()[4]
    faults: tuple[Fault, ...] = (SyncJitter(2.0, seconds, jitter_us=sync_us // 3),)
    return Scenario(
        "jittery_sync",
        seconds,
        (press, platform),
        faults,
        bitrate=250_000,
        sync_us=sync_us,
        sync_counter=60,
        seed=13,
        stamp_resolution_ns=1000,
    )


SCENARIOS = {"healthy_line": healthy_line, "bad_day": bad_day, "jittery_sync": jittery_sync}
"""The scenarios of the sample captures, by name."""
