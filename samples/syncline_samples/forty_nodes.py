"""A bus with forty nodes: a long conveyor with four faults.

Not a sample of its own: `mcap_capture(forty_nodes().run())` makes the bytes of a capture where a
test or a picture needs it.
"""

from dataclasses import replace

from syncline_samples.faults import CableLoose, Emcy, MissedPdos, WatchdogReset
from syncline_samples.machine import DeviceSpec, Fault, Scenario
from syncline_samples.motion import Shaft, Tilt
from syncline_samples.scenarios import (
    haomiao,
    io_module,
    jn2100_guarded,
    lir_guarded,
    lir_heartbeat,
    lir_stored_heartbeat,
)

NODES = 40
_KINDS = 8
"""Devices of one stretch of the conveyor; the stretches are alike."""


def forty_nodes(seconds: float = 30.0, sync_us: int = 50_000) -> Scenario:
    """Forty nodes on one bus; 7, 12, 23 and 40 have a bad day, the others none."""
    devices = tuple(_device(node_id) for node_id in range(1, NODES + 1))
    faults: tuple[Fault, ...] = (
        WatchdogReset(12, 12.0),
        MissedPdos(7, 15.0, pdo=2, count=5),
        Emcy(23, 18.0, 0x5530, 0x80),
        CableLoose(40, 22.0, 4.0),
    )
    return Scenario("forty_nodes", seconds, devices, faults, sync_us=sync_us, seed=40)


def _device(node_id: int) -> DeviceSpec:
    """The kinds follow one another along the conveyor; no two shafts turn alike."""
    stretch, place = divmod(node_id - 1, _KINDS)
    rpm, letter = 20 + 3 * node_id, "ABCDE"[stretch]
    shaft = Shaft((0, 0), (8, 0), (12, rpm), (20, rpm), (24, -rpm), (28, 0), start_turns=node_id)
    tilt = Tilt((0, 0, 0), (6, 0, 0), (14, 200 * node_id, -4_000), (24, -9_000, 3_000), (30, 0, 0))
    made = (
        lir_heartbeat(node_id, "lir-da158", f"infeed roller {letter}", shaft, 500),
        lir_heartbeat(node_id, "lir-da158a", f"outfeed roller {letter}", shaft, 500),
        lir_stored_heartbeat(node_id, "lir-ma158k", f"belt drive {letter}", shaft, 500),
        lir_heartbeat(node_id, "lir-da158a", f"guide roller {letter}", shaft, 500),
        jn2100_guarded(node_id, f"table tilt {letter}", tilt, 200),
        haomiao(node_id, f"lift {letter}", shaft, 1000),
        lir_guarded(node_id, "lir-918", f"winder {letter}", shaft, 400),
        io_module(node_id, f"cabinet {letter}", 500),
    )[place]
    return replace(made, drift_ppm=(node_id * 7) % 80 - 40)
