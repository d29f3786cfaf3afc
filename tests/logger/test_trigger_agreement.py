"""Triggers tell what the analyzer tells: on the samples, and on random scenarios."""

from pathlib import Path
from random import Random

import pytest

pytest.importorskip("pandas")

from syncline_analyzer import open_session
from syncline_analyzer.readers import open_capture
from syncline_samples.fuzz import random_scenario
from syncline_schemas.description import BusDescription
from tests.analyzer.fuzz_case import make
from tests.logger.trigger_agreement import differences, events_of

SAMPLES = Path(__file__).parents[2] / "samples"
SEEDS = 60
HINDSIGHT = {
    "NodeIdChange": "only a trigger: node-lost",
    "DuplicateNode": "only a trigger: boot-up",
    "MasterSilent": "only a trigger: node-lost",
    "HeartbeatPeriod": "only a trigger: node-lost",
}
"""By the fault that is there: what only shows later, so that the analysis tells another story.

A number that a node gave up for another one, the boot-up of a second device under a number, a node
that stopped because its guarding did, a heartbeat that was only slow.
"""


@pytest.mark.parametrize(
    "path", sorted(SAMPLES.glob("*.mcap")), ids=lambda path: path.name.removesuffix(".mcap")
)
def test_triggers_of_a_sample_are_what_the_analysis_finds(path: Path) -> None:
    description = BusDescription.load(path.with_suffix(".toml"))
    reader = open_capture(path)
    items = list(reader.batches())
    analysis = open_session(path, description=path.with_suffix(".toml")).analysis
    assert differences(items, analysis, reader.facts.buses, description) == []
    told = {event.kind for event in events_of(items, reader.facts.buses, description)}
    assert bool(told) == (path.stem == "bad_day")


@pytest.mark.parametrize("first", range(0, SEEDS, 10))
def test_triggers_of_random_scenarios_are_what_the_analysis_finds(first: int) -> None:
    for seed in range(first, first + 10):
        case = make(random_scenario(Random(seed)))
        known = [
            HINDSIGHT.get(type(fault).__name__, "nothing of it") for fault in case.scenario.faults
        ]
        found = differences(case.items, case.analysis, ["can0"], case.description)
        assert [each for each in found if not each.startswith(tuple(known))] == [], seed
