"""Random scenarios: the tables of the analyzer are the truth of the script.

A scenario that fails is told by its seed; `python -m benchmarks.fuzz 1 --seed SEED --minimal` says
what of it is needed to fail.
"""

from dataclasses import replace
from random import Random

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from syncline_samples.faults import BootLoop, ClockStep, RecordingBegins, WatchdogReset
from syncline_samples.fuzz import random_scenario
from syncline_samples.machine import Scenario
from syncline_samples.motion import Shaft
from syncline_samples.scenarios import haomiao, lir_stored_heartbeat
from tests.analyzer.fuzz_case import make
from tests.analyzer.fuzz_checks import wrong
from tests.analyzer.fuzz_invariants import INVARIANTS, Invariant

SEEDS = st.integers(0, 2**32 - 1)
"""A seed cannot be made smaller: what fails is shrunk by its faults and devices instead."""


def fuzzed(count: int) -> settings:
    """So many scenarios, the same ones each time."""
    return settings(
        max_examples=count,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
    )


def scenario_of(seed: int, **limits: int) -> Scenario:
    return random_scenario(Random(seed), **limits)


def test_a_restart_soon_after_a_loop_is_one_more_of_it() -> None:
    """Of the first restarts the reset of the machine, less than 10 s before them, may be the cause."""
    shaft = Shaft((0, 0), (5, 50))
    node = haomiao(5, "lift", shaft, 200)
    script = (BootLoop(5, 13.0, every_ms=637), WatchdogReset(5, 17.0, boot_ms=20))
    case = make(Scenario("loop", 22.0, (node, haomiao(6, "beside", shaft, 200)), script))
    assert wrong(case) == []
    (loop,) = [finding for finding in case.analysis.findings if finding.severity != "info"]
    assert (loop.id, "5 times" in loop.text) == ("nmt.boot_loop", True)


def test_a_first_7fh_may_be_a_heartbeat_though_the_clock_is_set_back_after_it() -> None:
    """The recorder begins while the encoder restarts; later messages have earlier stamps."""
    node = lir_stored_heartbeat(5, "lir-da158a", "drum", Shaft((0, 0), (5, 50)), 200)
    script = (RecordingBegins(2.6), ClockStep(7.2, -2800))
    assert wrong(make(Scenario("late", 12.0, (node,), script))) == []


@fuzzed(500)
@given(SEEDS)
def test_the_tables_are_the_truth(seed: int) -> None:
    assert wrong(make(scenario_of(seed))) == []


@fuzzed(60)
@given(SEEDS)
def test_where_nothing_is_wrong_nothing_is_found(seed: int) -> None:
    """A machine whose PDOs wait for SYNC needs one."""
    scenario = scenario_of(seed, most_faults=0)
    scenario = replace(scenario, sync_us=scenario.sync_us or 50_000)
    findings = make(scenario).analysis.findings
    assert [finding for finding in findings if finding.severity != "info"] == []


@pytest.mark.parametrize("invariant", INVARIANTS, ids=lambda each: each.__name__)
@fuzzed(40)
@given(SEEDS)
def test_the_way_of_recording_changes_nothing(invariant: Invariant, seed: int) -> None:
    assert list(invariant(make(scenario_of(seed)), Random(seed))) == []
