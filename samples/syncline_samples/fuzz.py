"""Random scenarios: machines of a few devices, and scripts of what goes wrong on them.

Each choice is drawn from a `random.Random`, so that a seed is a scenario. Faults come one after the
other with time to recover between them: the truth of a run then says exactly what an analyzer must
report.
"""

from dataclasses import replace
from random import Random

from syncline_samples.faults import (
    BlockCrcWrong,
    BlockSegmentsLost,
    PdoRequests,
    RecordingBegins,
    RemoteOnHeartbeat,
)
from syncline_samples.fuzz_plan import Plan, is_lir, period_ms, readable, some
from syncline_samples.fuzz_scripts import ENDINGS, SCRIPTS
from syncline_samples.machine import LIR_MODELS, DeviceSpec, Scenario
from syncline_samples.motion import Shaft, Tilt
from syncline_samples.sdo_client import write

BITRATES = (100_000, 125_000, 250_000, 500_000, 1_000_000)
BLOCK_BITRATE = 250_000
"""From here on a kilobyte in one block does not hold up heartbeats and guard requests."""
SYNCS_US = (0, 20_000, 25_000, 50_000, 50_000, 100_000)
COUNTER_OVERFLOWS = (0, 0, 0, 2, 10, 60, 240)
HEARTBEATS_MS = (100, 150, 200, 250, 300, 500)
GUARDS_MS = (100, 200, 300)
DEVICES = (*LIR_MODELS, "jn2100", "haomiao-38", "io")
OUTPUT_SYNCS_US = (0, 30_000, 70_000)
"""SYNC periods beside RPDOs every 200 ms, which else would look as if they answered every n-th."""
_LIR_READY_S, _READY_S = 5.6, 1.9
"""By when the master has started every node; a LIR is silent for 4 s after a reset."""
_LATE_SHARE = 0.1
"""Scenarios in which somebody begins to record a machine that is already at work."""
_LEARN_S = 3.0
"""Until a recording shows the usual periods and patterns."""
_AS_DATA_SHARE = 0.1
_ENDING_SHARE = 0.15
"""Scenarios that end with something from which the machine does not recover."""


def random_scenario(random: Random, *, most_faults: int = 3) -> Scenario:
    """A machine with up to four devices and up to `most_faults` scripts of faults."""
    node_ids = random.sample(range(1, 127), random.randint(1, 4))
    devices = tuple(_device(random, node_id) for node_id in node_ids)
    slow = any(is_lir(spec) for spec in devices)
    rpdo_node = random.choice((0, *(s.node_id for s in devices if s.device == "io")))
    sync_us = random.choice(OUTPUT_SYNCS_US if rpdo_node else SYNCS_US)
    plan = Plan(random, devices, sync_us, _LIR_READY_S if slow else _READY_S)
    plan.wait(2.5 * max(period_ms(spec) for spec in devices) / 1000)
    if random.random() < _LATE_SHARE:
        _begin_late(plan)
    for _ in range(random.randint(0, most_faults)):
        plan.wait(plan.between(0.3, 1.2))
        random.choice(SCRIPTS)(plan)
    if most_faults and random.random() < _ENDING_SHARE:
        plan.wait(plan.between(0.3, 1.2))
        random.choice(ENDINGS)(plan)
    bitrate = random.choice(BITRATES)
    if any(isinstance(fault, BlockSegmentsLost | BlockCrcWrong) for fault in plan.faults):
        bitrate = max(bitrate, BLOCK_BITRATE)
    return Scenario(
        "fuzz",
        round(plan.now_s + plan.between(1.5, 2.5), 3),
        devices,
        tuple(plan.faults),
        bitrate=bitrate,
        sync_us=sync_us,
        sync_jitter_us=random.choice((0, 5, 50)),
        sync_counter=random.choice(COUNTER_OVERFLOWS),
        rpdo_node=rpdo_node,
        seed=random.randint(1, 1_000_000),
        stamp_jitter_ns=random.choice((0, 0, 20_000)),
        stamp_resolution_ns=random.choice((1, 1, 1000, 10_000)),
        remote_as_data=random.random() < _AS_DATA_SHARE and not _remote_frames(plan),
    )


def _remote_frames(plan: Plan) -> bool:
    """Whether remote frames, stored as data frames, would look like empty heartbeats or PDOs."""
    return any(isinstance(fault, RemoteOnHeartbeat | PdoRequests) for fault in plan.faults)


def _begin_late(plan: Plan) -> None:
    begin_s = plan.between(0.2, plan.now_s)
    plan.faults.append(RecordingBegins(begin_s))
    plan.late = True
    plan.wait(max(0.0, begin_s + _LEARN_S - plan.now_s))


def _device(random: Random, node_id: int) -> DeviceSpec:
    device = random.choice(DEVICES)
    spec = DeviceSpec(node_id, device, f"{device} at {node_id}", drift_ppm=random.randint(-80, 80))
    if device == "jn2100":
        lower, upper = random.randint(-20_000, 0), random.randint(0, 20_000)
        spec = replace(spec, motion=Tilt((0, 0, lower), (7, upper, 0), (13, 0, lower)))
    elif device != "io":
        speed = random.choice((0, 10, 60, 150))
        shaft = Shaft((0, speed), (4, speed), (8, -speed), (12, speed), start_turns=100)
        spec = replace(spec, motion=shaft)
    habits = replace(
        spec,
        empty_heartbeat=random.choice((b"\0", b"")),
        sizeless=random.random() < 0.1,
    )
    return _supervised(random, habits)


def _supervised(random: Random, spec: DeviceSpec) -> DeviceSpec:
    """With heartbeat, written or stored, or with guarding; and with what the master reads."""
    jobs = some(random, readable(spec))
    if spec.device in (*LIR_MODELS, "jn2100") and random.random() < 0.4:
        ms, factor = random.choice(GUARDS_MS), random.randint(2, 4)
        guarding = (write(0x100C, 0, ms, 2), write(0x100D, 0, factor, 1))
        return replace(spec, guard_ms=ms, life_factor=factor, jobs=(*jobs, *guarding))
    ms = random.choice(HEARTBEATS_MS)
    if spec.device in LIR_MODELS and random.random() < 0.4:
        quiet = random.random() < 0.2
        spec = replace(spec, stored_heartbeat_ms=ms, heartbeat_ms=ms, quiet_after_boot_up=quiet)
        return replace(spec, jobs=() if quiet else jobs)
    return replace(spec, heartbeat_ms=ms, jobs=(*jobs, write(0x1017, 0, ms, 2)))
