"""Several machines on several buses of one recorder."""

from dataclasses import dataclass, field, replace
from operator import attrgetter

import numpy as np

from syncline_samples.machine import Run, Scenario
from syncline_samples.truth import Truth
from syncline_schemas.batch import FrameBatch, Gap


@dataclass(slots=True)
class Buses:
    """Scenarios recorded at the same time, one bus each; node ids may be the same on all.

    The frames are merged by their stamps: give clock steps to none of the scenarios, or to all.

    Attributes:
        batches: what the recorder delivered, with the number of each scenario as the bus.
        runs: the run of each scenario, with its truth.
    """

    scenarios: tuple[Scenario, ...]
    batches: list[FrameBatch | Gap] = field(default_factory=list)
    runs: list[Run] = field(default_factory=list)

    def run(self) -> "Buses":
        """Run all scenarios to their ends."""
        self.runs = [scenario.run() for scenario in self.scenarios]
        frames, gaps = [], []
        for number, run in enumerate(self.runs):
            for item in run.batches:
                if isinstance(item, Gap):
                    gaps.append(replace(item, bus=number))
                else:
                    frames.append(replace(item, bus=np.full(len(item), number, np.uint8)))
        merged = FrameBatch.concat(frames)
        merged = merged[np.argsort(merged.t_ns, kind="stable")]
        self.batches = list(_with_gaps(merged, sorted(gaps, key=attrgetter("end_ns"))))
        return self

    @property
    def truths(self) -> list[Truth]:
        """What really happened on each bus."""
        return [run.truth for run in self.runs]

    @property
    def bus_names(self) -> list[str]:
        """Interface names by bus number."""
        return [scenario.bus_name for scenario in self.scenarios]

    @property
    def description_toml(self) -> str:
        """The description of all buses."""
        return "\n".join(scenario.description_toml for scenario in self.scenarios)


def _with_gaps(frames: FrameBatch, gaps: list[Gap]) -> list[FrameBatch | Gap]:
    items: list[FrameBatch | Gap] = []
    begin = 0
    for gap in gaps:
        end = int(np.searchsorted(frames.t_ns, gap.end_ns))
        items += [frames[begin:end], gap]
        begin = end
    items.append(frames[begin:])
    return [item for item in items if isinstance(item, Gap) or len(item)]
