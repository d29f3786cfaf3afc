"""The control folds on the simulator's buses, against what really happened there."""

from functools import cache

import pytest

from syncline_analyzer.results import Finding, Link
from syncline_samples import faults, scenarios
from syncline_samples.machine import Fault, Scenario
from syncline_samples.machine import Run as Simulated
from syncline_samples.node import State
from syncline_samples.truth import ExpectedFinding
from syncline_schemas.batch import Gap
from syncline_schemas.description import BusDescription
from tests.analyzer.control_runs import MS, Run, run_items

FAMILIES = ("nmt.", "sdo.", "emcy.", "config.", "error.", "clock.", "capture.")
SLACK_NS = 60 * MS
"""States are told by messages that come up to an error-control period late; starts are exact."""


def one_fault(*what: Fault, seconds: float = 30.0) -> Scenario:
    """Seven nodes at work, and one thing that goes wrong."""
    devices = (*scenarios.six_devices(), scenarios.io_module(scenarios.CABINET, "cabinet", 500))
    return Scenario("one", seconds, devices, what, sync_us=50_000, seed=5)


FAULTS: dict[str, Scenario] = {
    "clock": one_fault(faults.ClockStep(15.0, -500)),
    "duplicate": one_fault(faults.DuplicateNode(scenarios.LIFT, 12.0)),
    "power": one_fault(faults.PowerLoss(scenarios.ENTRY, 15.0, 5.0)),
    "power dip": one_fault(faults.PowerLoss(scenarios.ENTRY, 15.0, 0.4)),
    "cable": one_fault(faults.CableLoose(scenarios.PRESS, 15.0, 4.0)),
    "ignored": one_fault(faults.CommandIgnored(scenarios.ENTRY, 15.0)),
    "refused": one_fault(faults.SdoRefused(scenarios.GUIDE, 15.0)),
    "mute": one_fault(faults.SdoSilent(scenarios.CABINET, 15.0)),
    "bus-off": one_fault(faults.NodeBusOff(scenarios.GUIDE, 15.0)),
    "remote": one_fault(faults.RemoteOnHeartbeat(scenarios.PRESS, 15.0)),
    "master": one_fault(faults.MasterSilent(15.0, 3.0)),
    "storm": one_fault(faults.EmcyStorm(scenarios.ENTRY, 15.0)),
    "gap": one_fault(faults.RecorderGap(15.0, 1.5)),
    "boot loop": one_fault(faults.BootLoop(scenarios.ENTRY, 14.0, count=5)),
    "slow heartbeat": one_fault(faults.HeartbeatPeriod(scenarios.LIFT, 10.0, 300, for_s=15.0)),
    "fast heartbeat": one_fault(faults.HeartbeatPeriod(scenarios.ENTRY, 10.0, 50, for_s=15.0)),
    "jittery heartbeat": one_fault(faults.HeartbeatIrregular(scenarios.GUIDE, 10.0, 40, 10.0)),
    "missing heartbeats": one_fault(faults.HeartbeatsMissing(scenarios.GUIDE, 12.0, 4)),
    "toggle": one_fault(faults.GuardToggleStuck(scenarios.PLATFORM, 12.0, 20)),
    "unanswered": one_fault(faults.GuardUnanswered(scenarios.PLATFORM, 12.0, 2)),
    "falls": one_fault(faults.LeavesOperational(scenarios.ENTRY, 12.0)),
    "stops": one_fault(faults.LeavesOperational(scenarios.GUIDE, 12.0, State.STOPPED)),
    "malformed": one_fault(faults.MalformedCommand(12.0)),
    "clock ahead": one_fault(faults.ClockStep(15.0, 700)),
    "clock far ahead": one_fault(faults.ClockStep(15.0, 3_600_000)),
    "stop": one_fault(faults.Command(15.0, 0x02), faults.Command(20.0, 0x01)),
    "reset": one_fault(
        faults.Command(15.0, 0x81, scenarios.PRESS), faults.Command(25.0, 0x01, scenarios.PRESS)
    ),
}


@cache
def analyzed(name: str) -> tuple[Simulated, Run]:
    scenario = FAULTS[name] if name in FAULTS else scenarios.SCENARIOS[name]()
    simulated = Simulated(scenario)
    items = list(simulated.stream())
    description = BusDescription.loads(simulated.description_toml)
    return simulated, run_items(items, simulated.bus_names, description)


def _told(run: Run) -> list[Finding | Link]:
    """Findings, those of several nodes by the links of their chain."""
    return [
        piece
        for finding in run.findings()
        for piece in (finding.chain if finding.node is None and finding.chain else [finding])
    ]


def _matches(run: Run, expected: ExpectedFinding) -> bool:
    return any(
        finding.id in (expected.id, *expected.or_as)
        and finding.node == expected.node
        and finding.start_ns < expected.end_ns
        and finding.end_ns >= expected.start_ns
        for finding in _told(run)
    )


each_scenario = pytest.mark.parametrize("name", [*scenarios.SCENARIOS, *FAULTS])


@each_scenario
def test_every_required_finding_is_there(name: str) -> None:
    simulated, run = analyzed(name)
    missing = [
        expected
        for expected in simulated.truth.required()
        if expected.id.startswith(FAMILIES) and not _matches(run, expected)
    ]
    assert missing == []


@each_scenario
def test_no_finding_is_invented(name: str) -> None:
    simulated, run = analyzed(name)
    expected = {(finding.id, finding.node) for finding in simulated.truth.findings}
    invented = [f for f in _told(run) if (f.id, f.node) not in expected]
    assert invented == []


@each_scenario
def test_sdo_transfers_are_the_master_s(name: str) -> None:
    simulated, run = analyzed(name)
    if name in ("duplicate", "gap", "bad_day"):
        pytest.skip("some of its transfers are answered twice or fall into a gap")
    truth = [(t.node, t.index, t.sub, t.direction, t.result, t.data) for t in simulated.truth.sdo]
    found = [
        (row.node, row.index, row.sub, row.direction, row.result, row.data)
        for row in run.analysis.sdo
    ]
    assert sorted(found) == sorted(truth)


@each_scenario
def test_commands_and_boot_ups(name: str) -> None:
    """A first 7Fh of a LIR at the start of the capture may as well be a heartbeat: not counted."""
    simulated, run = analyzed(name)
    gaps = [(gap.start_ns, gap.end_ns) for gap in run.analysis.capture.gaps]
    begun = run.analysis.capture.first_ns + 500 * MS
    heard = [
        boot
        for boot in simulated.truth.boot_ups
        if not any(start <= boot.t_ns < end for start, end in gaps)
        and not (boot.byte == 0x7F and boot.t_ns < begun)
    ]
    found = [row.node for row in run.tables.nmt.boot_ups]
    assert sorted(found) == sorted(boot.node for boot in heard)
    commands = [c.node for c in simulated.truth.commands]
    assert [row.node for row in run.analysis.nmt_commands] == commands


@pytest.mark.parametrize("name", ["healthy_line", "reset", "stop", "power", "cable"])
def test_states_agree_with_the_devices(name: str) -> None:
    """Wherever a state is told as observed, the device was in it (except in the slack)."""
    simulated, run = analyzed(name)
    told = [row for row in run.analysis.nmt_states if row.certainty == "observed"]
    checked = 0
    for row in told:
        if row.state in ("LOST", "UNKNOWN"):
            continue
        middle = (row.start_ns + row.end_ns) // 2
        if row.end_ns - row.start_ns < SLACK_NS:
            continue
        for truth in simulated.truth.states:
            if truth.node == row.node and truth.start_ns <= middle < truth.end_ns:
                assert truth.state == row.state, row
                checked += 1
    assert checked >= 6


def test_a_gap_in_the_stream_is_a_gap() -> None:
    simulated, run = analyzed("gap")
    assert [gap.reason for gap in run.analysis.capture.gaps] != []
    assert not [item for item in simulated.batches if isinstance(item, Gap)]
