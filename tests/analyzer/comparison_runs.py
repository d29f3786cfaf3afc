"""A small machine whose golden run is compared with runs in which something was changed."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from syncline_analyzer.comparison import Comparison, ComparisonRow, compare
from syncline_analyzer.results import Analysis
from syncline_samples.machine import DeviceSpec, Fault, Scenario
from syncline_samples.motion import Shaft, Tilt
from syncline_samples.scenarios import GUIDE, LIFT, PLATFORM, haomiao, jn2100_guarded, lir_heartbeat
from syncline_schemas.batch import FrameBatch, Gap
from tests.analyzer.fuzz_case import Case, analyzed, make

SECONDS = 45.0
PATTERN = Shaft((0, 0), (9, 0), (13, 50), (25, 50), (29, -50), (35, -50), (38, 0))
SWAY = Tilt((0, 0, 0), (8, 0, 0), (18, 12_000, -4_000), (30, -9_000, 6_500), (40, 0, 0))


def machine(**changes: Any) -> Scenario:
    """An encoder with heartbeat, a guarded inclinometer, an encoder with an event timer."""
    devices = (
        lir_heartbeat(GUIDE, "lir-da158a", "guide roller", PATTERN, 250),
        jn2100_guarded(PLATFORM, "platform tilt", SWAY, 100),
        haomiao(LIFT, "lift", PATTERN, 500),
    )
    plain: dict[str, Any] = {"devices": devices, "sync_us": 50_000, "seed": 11}
    return Scenario("compared", **{"seconds": SECONDS} | plain | changes)


def with_device(node: int, change: Callable[[DeviceSpec], DeviceSpec]) -> Scenario:
    """The machine with one device changed."""
    base = machine()
    return replace(base, devices=tuple(change(d) if d.node_id == node else d for d in base.devices))


def with_faults(*faults: Fault) -> Scenario:
    """The machine with something happening to it."""
    return replace(machine(), faults=faults)


@cache
def golden_case() -> Case:
    """The healthy run."""
    return make(machine())


def golden() -> Analysis:
    """Its analysis."""
    return golden_case().analysis


def against(scenario: Scenario) -> Comparison:
    """Golden against a run of another scenario."""
    return compare(golden(), make(replace(scenario, seed=scenario.seed + 1)).analysis)


def against_frames(frames: FrameBatch, *gaps: Gap) -> Comparison:
    """Golden against frames of its own that were changed; gaps stand behind the frames before them."""
    items: list[FrameBatch | Gap] = []
    for gap in sorted(gaps, key=lambda gap: gap.start_ns):
        items += [frames[frames.t_ns < gap.start_ns], gap]
        frames = frames[frames.t_ns >= gap.end_ns]
    case = golden_case()
    return compare(golden(), analyzed(case.scenario, [*items, frames], case.description))


def answering(frames: FrameBatch, node: int, index: int, sub: int, value: int) -> FrameBatch:
    """The frames with another value in the expedited answers to reads of an object."""
    data = frames.data.copy()
    asked = index.to_bytes(2, "little") + bytes([sub])
    rows = (frames.can_id == 0x580 + node) & ((data[:, 0] & 0xE0) == 0x40)
    rows &= (data[:, 1:4] == np.frombuffer(asked, np.uint8)).all(axis=1)
    assert rows.any()
    data[rows, 4:8] = np.frombuffer(value.to_bytes(4, "little"), np.uint8)
    return replace(frames, data=data)


def kinds(comparison: Comparison) -> set[str]:
    """Kinds of the differences."""
    return {row.kind for row in comparison.rows}


def the_row(comparison: Comparison, kind: str, node: int | None = None) -> ComparisonRow:
    """The only difference of a kind, of a node where one is given."""
    found = [row for row in comparison.rows if row.kind == kind and node in (None, row.node)]
    assert len(found) == 1, [row.text for row in comparison.rows]
    return found[0]


def serious(comparison: Comparison) -> list[str]:
    """What is told as an error or a warning."""
    return [f"{row.kind}: {row.text}" for row in comparison.rows if row.severity != "info"]
