"""A random scenario, what was recorded of it, and what the analyzer made of that."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.engine import analyze
from syncline_analyzer.results import Analysis
from syncline_samples.faults import ClockStep
from syncline_samples.machine import Scenario
from syncline_samples.node import Node
from syncline_samples.truth import Truth
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.description import BusDescription

MS = 1_000_000
S = 1_000_000_000
Item = FrameBatch | Gap


@dataclass(frozen=True)
class Case:
    """One scenario with its truth, the recorded stream, and the analysis of the stream.

    All times of the truth are true ones; `stamps` turns them into those of the recorder, whose
    clock may have been set meanwhile.
    """

    scenario: Scenario
    truth: Truth
    items: list[Item]
    description: BusDescription
    analysis: Analysis
    numbered: dict[int, Node]
    """The simulated devices by the number that they have at the end."""

    @cached_property
    def frames(self) -> FrameBatch:
        """All frames that were recorded; the row is the `seq`."""
        return FrameBatch.concat([item for item in self.items if isinstance(item, FrameBatch)])

    @property
    def deaf(self) -> list[tuple[int, int]]:
        """Stretches in which the recorder heard nothing."""
        return self.truth.deaf

    @cached_property
    def steps(self) -> list[tuple[int, int]]:
        """When the recorder's clock was set, and by how much [ns]."""
        found = [fault for fault in self.scenario.faults if isinstance(fault, ClockStep)]
        return [(self.at(each.at_s), each.step_ms * MS) for each in found]

    @cached_property
    def slack_ns(self) -> int:
        """How far a stamp may lie from the true time."""
        return self.scenario.stamp_jitter_ns + self.scenario.stamp_resolution_ns

    def at(self, seconds: float) -> int:
        """True UTC of a time of the run."""
        return self.scenario.epoch_ns + round(seconds * S)

    def heard(self, t_ns: int) -> bool:
        """Whether the recorder heard the bus."""
        return not any(start <= t_ns < end for start, end in self.deaf)

    def stamp(self, t_ns: int) -> int:
        """What the recorder's clock shows."""
        return t_ns + sum(step for at_ns, step in self.steps if at_ns <= t_ns)

    @cached_property
    def _sent(self) -> FrameBatch:
        frames = self.frames
        sent = (frames.flags & (FrameFlag.ERROR | FrameFlag.REMOTE)) == 0
        if self.scenario.remote_as_data:
            sent &= (frames.can_id & 0x780 != 0x700) | (frames.dlc > 0)
        return frames[sent]

    def signs(self, node: int) -> NDArray[np.int64]:
        """Stamps of the frames that a node sent on its predefined identifiers."""
        frames = self._sent
        base = frames.can_id & 0x780
        own = ((base >= 0x180) & (base < 0x600) & (base & 0x80 != 0)) | (base == 0x700)
        own |= (base == 0x080) & (frames.dlc == 8)
        found: NDArray[np.int64] = frames.t_ns[((frames.can_id & 0x7F) == node) & own]
        return found

    def beats(self, node: int) -> NDArray[np.int64]:
        """Stamps of the error-control messages of a node."""
        frames = self._sent
        found: NDArray[np.int64] = frames.t_ns[frames.can_id == 0x700 + node]
        return found

    def period_ns(self, node: int) -> int:
        """Period of a node's error control; the master beats every 500 ms."""
        for spec in self.scenario.devices:
            if spec.node_id == node:
                return (spec.heartbeat_ms or spec.guard_ms) * MS
        return 500 * MS


def make(scenario: Scenario) -> Case:
    """Run a scenario and analyze what was recorded."""
    run = scenario.run()
    items = joined(run.batches)
    description = BusDescription.loads(scenario.description_toml)
    analysis = analyzed(scenario, items, description)
    numbered = {node.node_id: node for node in run.machine.nodes.values()}
    return Case(scenario, run.truth, items, description, analysis, numbered)


def joined(items: Iterable[Item]) -> list[Item]:
    """The same stream in as few batches as its gaps allow."""
    found: list[Item] = []
    for frames, group in groupby(items, key=lambda item: isinstance(item, FrameBatch)):
        if frames:
            found.append(
                FrameBatch.concat([item for item in group if isinstance(item, FrameBatch)])
            )
        else:
            found.extend(group)
    return found


def analyzed(
    scenario: Scenario,
    items: Sequence[Item],
    description: BusDescription,
    buses: Sequence[str] = ("can0",),
) -> Analysis:
    """The analysis of a stream, as if it came out of a capture."""
    facts = CaptureFacts(
        Path("fuzz"),
        "simulated",
        list(buses),
        resolution_ns=scenario.stamp_resolution_ns,
        bitrates=dict.fromkeys(buses, scenario.bitrate),
    )
    stream: list[tuple[int, Item]] = []
    seq = 0
    for item in items:
        stream.append((seq, item))
        seq += len(item) if isinstance(item, FrameBatch) else 0
    return analyze(stream, [facts], facts.buses, description=description, devices={})
