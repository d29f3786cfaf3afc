"""Triggers tell what the analyzer tells: on the samples, and on random scenarios."""

from collections.abc import Sequence
from pathlib import Path
from random import Random

import pytest

pytest.importorskip("pandas")

from syncline_analyzer import open_session
from syncline_analyzer.folds.emcy.story import Message, Story
from syncline_analyzer.folds.nmt.table import BootUp
from syncline_analyzer.readers import open_capture
from syncline_logger.triggers.knowledge import Knowledge
from syncline_logger.triggers.node_watch import NodeWatch
from syncline_logger.triggers.quiet import BusQuiet
from syncline_samples.fuzz import random_scenario
from syncline_schemas.description import BusDescription, NodeEntry
from syncline_schemas.devices import load_device
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


BYTES = (0x00, 0x01, 0x02, 0x80)


def random_emcys(random: Random, codes: Sequence[int]) -> list[bytes | None]:
    """EMCYs of a node that repeats itself, clears errors in part and restarts (None)."""
    told: list[bytes | None] = []
    for _ in range(40):
        before = [each for each in told if each]
        if before and random.random() < 0.3:
            told.append(random.choice(before[-2:]))
        elif random.random() < 0.05:
            told.append(None)
        else:
            code = random.choice([0, 0, *codes])
            maker = bytes(random.choice(BYTES) for _ in range(2)) + bytes(3)
            told.append(code.to_bytes(2, "little") + bytes([random.choice(BYTES)]) + maker)
    return told


@pytest.mark.parametrize("device", [None, "jn2100", "lir-da158"])
def test_errors_are_raised_where_the_analysis_raises_them(device: str | None) -> None:
    known = load_device(device) if device else None
    codes = [0x1000, 0x3100, 0x3200, 0x8110, 0x8130, 0xFF00]
    for seed in range(400):
        emcys = random_emcys(Random(seed), codes)
        entry = {5: NodeEntry(device=known)} if known else {}
        watch = NodeWatch(0, 5, Knowledge(entry), BusQuiet())
        events: list[int] = []
        messages, boot_ups = [], []
        for seq, data in enumerate(emcys):
            t_ns = seq * 10**9
            if data is None:
                boot_ups.append(BootUp("can0", 5, seq, t_ns, 0, None, None, False, False))
                list(watch.zero(t_ns, t_ns, None))
            else:
                messages.append(Message(seq, t_ns, data))
                events += [event.t_ns for event in watch.emcy(data, t_ns, t_ns)]
        story = Story("can0", 5, known)
        story.tell(messages, boot_ups)
        assert events == sorted(row.raised_ns for row in story.errors()), seed


@pytest.mark.parametrize("first", range(0, SEEDS, 10))
def test_triggers_of_random_scenarios_are_what_the_analysis_finds(first: int) -> None:
    for seed in range(first, first + 10):
        case = make(random_scenario(Random(seed)))
        known = [
            HINDSIGHT.get(type(fault).__name__, "nothing of it") for fault in case.scenario.faults
        ]
        found = differences(case.items, case.analysis, ["can0"], case.description)
        assert [each for each in found if not each.startswith(tuple(known))] == [], seed
