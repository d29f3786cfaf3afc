"""The EMCY machines of the simulated devices against the errors that the analyzer finds."""

from random import Random

import pytest

from syncline_samples import faults, scenarios
from syncline_samples.devices.errors import ERRORS
from syncline_samples.machine import DeviceSpec, Scenario
from syncline_samples.machine import Run as Simulated
from syncline_schemas.description import BusDescription
from tests.analyzer.control_runs import Run, run_items

DEVICES: dict[str, DeviceSpec] = {
    spec.device: spec
    for spec in (
        *scenarios.six_devices(),
        scenarios.io_module(scenarios.CABINET, "cabinet", 500),
    )
}
TOLD_APART = ("lir-da158", "lir-da158a", "lir-ma158k", "lir-918")
"""Devices whose errors all have bits of their own."""
Steps = tuple[tuple[float, str, int], ...]


def steps_of(device: str, seed: int) -> tuple[Steps, set[int]]:
    """Errors that come and go in a random order, and those that are left."""
    random, active, steps = Random(seed), set[int](), []
    for number in range(8):
        code = random.choice(sorted(ERRORS[device]))
        steps.append((0.5 * number, "-" if code in active else "+", code))
        active ^= {code}
    return tuple(steps), active


def simulated(spec: DeviceSpec, steps: Steps) -> tuple[Simulated, Run]:
    what = (faults.Errors(spec.node_id, 8.0, steps), faults.ErrorHistory(spec.node_id, 14.0, 8))
    run = Simulated(Scenario("errors", 16.0, (spec,), what, sync_us=200_000, seed=3))
    items = list(run.stream())
    description = BusDescription.loads(run.description_toml)
    return run, run_items(items, run.bus_names, description)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("device", sorted(DEVICES))
def test_errors_of_every_device_in_any_order(device: str, seed: int) -> None:
    """The bits left tell what is active, and 1003h holds what the bus told."""
    steps, active = steps_of(device, seed)
    truth, run = simulated(DEVICES[device], steps)
    told = [row for row in run.analysis.emcy if row.transition != "reset"]
    assert [row.code for row in told] == [row.code for row in truth.truth.emcy]
    for row, real in zip(told, truth.truth.emcy, strict=True):
        assert set(real.active) <= set(row.active)
        if device in TOLD_APART:
            assert set(real.active) == set(row.active)
    still = {row.code for row in run.analysis.errors if row.status == "still active"}
    assert active <= still
    entries = [row for row in run.analysis.error_history if row.code]
    assert entries
    assert {row.seen for row in entries} == {"seen"}
    invented = [f for f in run.findings() if f.id in ("emcy.history_unseen", "emcy.active_before")]
    assert invented == []
