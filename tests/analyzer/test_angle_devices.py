"""Traces of all six devices on the simulated machine, against the scripted motion by numpy."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from math import degrees, log, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.engine import analyze
from syncline_analyzer.results import Analysis, Trace, TraceRow
from syncline_samples import scenarios
from syncline_samples.devices import Haomiao38, Lir
from syncline_samples.machine import DeviceSpec, Machine, Run, Scenario
from syncline_samples.motion import Shaft
from syncline_samples.sdo_client import read, write
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.description import BusDescription

ENCODERS = {
    scenarios.ENTRY: (1 << 17, 1, 500),
    scenarios.GUIDE: (1 << 17, 1, 250),
    scenarios.PRESS: (1 << 17, 4096, 500),
    scenarios.WINDER: (1 << 13, 4096, 400),
    scenarios.LIFT: (8192, 4096, 1000),
}
"""Node: counts per turn, turns, heartbeat; by the device sheets."""


@dataclass(frozen=True)
class Do:
    """Something that a test does to the machine."""

    at_s: float
    what: Callable[[Machine], None]

    def arm(self, machine: Machine) -> None:
        machine.at(self.at_s, self.what, machine)


def analysis_of(run: Run, more: str = "", *, described: bool = True) -> Analysis:
    def stream() -> Iterator[tuple[int, FrameBatch | Gap]]:
        seq = 0
        for item in run.stream():
            yield seq, item
            seq += 0 if isinstance(item, Gap) else len(item)

    names = run.bus_names
    text = (run.description_toml if described else "") + more
    facts = CaptureFacts(Path("simulated.log"), "test", names)
    description = BusDescription.loads(text)
    return analyze(stream(), [facts], names, description=description, devices={})


@cache
def line() -> tuple[Run, Analysis]:
    """The six devices at work, known by what they tell; the weak name of a Haomiao needs a word."""
    run = Run(scenarios.healthy_line(60.0, 20_000))
    named = f'[node.{scenarios.LIFT}]\ndevice = "haomiao-38"\n'
    return run, analysis_of(run, named, described=False)


def row(analysis: Analysis, node: int, index: int = 0x6004) -> TraceRow:
    return next(t for t in analysis.traces if (t.node, t.object >> 8) == (node, index))


def trace(analysis: Analysis, node: int, index: int = 0x6004) -> Trace:
    return next(t for t in analysis.trace_data if (t.node, t.object >> 8) == (node, index))


def sent(run: Run, node: int, *can_ids: int) -> Any:
    """Values of the PDOs that a node really sent, in order of the wire."""
    found = [p for p in run.truth.pdos if p.node == node and (not can_ids or p.cob_id in can_ids)]
    return np.array([p.values for p in sorted(found, key=lambda p: p.end_ns)])


def circular(angle_deg: Any) -> tuple[float, float]:
    """Mean and standard deviation on the circle by complex numbers."""
    total = np.exp(1j * np.radians(angle_deg)).mean()
    return float(np.angle(total, deg=True)), degrees(sqrt(-2 * log(abs(total))))


@pytest.mark.parametrize("node", ENCODERS)
def test_statistics_of_the_encoders(node: int) -> None:
    run, analysis = line()
    per_turn, _, _ = ENCODERS[node]
    counts = sent(run, node)[:, 0]
    told = row(analysis, node)
    mean, std = circular(counts % per_turn * 360 / per_turn)
    assert told.samples == len(counts)
    assert told.mean_deg is not None
    assert (told.mean_deg - mean + 180) % 360 - 180 == pytest.approx(0, abs=1e-5)
    assert told.std_deg == pytest.approx(std, abs=1e-5)
    assert sum(told.sources.values()) == told.samples
    assert len(told.sources) == 2


@pytest.mark.parametrize("node", ENCODERS)
def test_directions_and_ways_of_the_encoders_are_those_of_the_script(node: int) -> None:
    run, analysis = line()
    shaft = next(s.motion for s in run.scenario.devices if s.node_id == node)
    assert isinstance(shaft, Shaft)
    found = trace(analysis, node)
    t_ns = found.t_ns - run.scenario.epoch_ns
    turns = np.array([shaft.nanoturns(int(t)) for t in t_ns]) / 1e9
    way = found.columns["unwrapped_deg"] - found.columns["unwrapped_deg"][0]
    # A value is up to 15 ms old when it is on the wire, at 5 turns per second.
    np.testing.assert_allclose(way, (turns - turns[0]) * 360, atol=30)
    speed = np.sign(np.round(np.gradient(turns, t_ns / 1e9), 1))
    moving = speed[speed != 0]
    assert row(analysis, node).direction_changes == np.count_nonzero(np.diff(moving))


@pytest.mark.parametrize(("index", "axis"), [(0x6010, 0), (0x6020, 1), (0x6110, 0), (0x6120, 1)])
def test_statistics_of_the_inclinometer(index: int, axis: int) -> None:
    run, analysis = line()
    values = sent(run, scenarios.PLATFORM, 0x18A if index < 0x6100 else 0x28A)[:, axis]
    told = row(analysis, scenarios.PLATFORM, index)
    mean, std = circular(values // 100 / 10)
    assert told.mean_deg is not None
    assert (told.mean_deg - mean + 180) % 360 - 180 == pytest.approx(0, abs=1e-5)
    assert told.std_deg == pytest.approx(std, abs=1e-5)
    assert (told.max or 0) > 359
    assert told.noise_deg == pytest.approx(0, abs=0.05)


def test_a_healthy_line_is_left_in_peace() -> None:
    _, analysis = line()
    assert [f.text for f in analysis.findings if f.severity != "info"] == []
    kinds = {e.kind for e in analysis.trace_events}
    assert kinds <= {"ambiguous"}
    assert all(t.cuts == 0 and t.flags["silence"] == 0 for t in analysis.traces)


STOP_AND_GO = Shaft(
    (0, 0), (8, 0), (9, 30), (13, 30), (14, 0), (22, 0), (23, -30), (26, -30), (27, 0), (30, 0)
)


def one(spec: DeviceSpec, *what: Do, seconds: float = 30.0, sync_us: int = 20_000) -> Run:
    return Run(Scenario("one", seconds, (spec,), what, sync_us=sync_us, seed=3))


@pytest.mark.parametrize("device", ["lir-da158", "lir-da158a", "lir-ma158k", "lir-918"])
@pytest.mark.parametrize("counter", [1, 3])
def test_a_repeat_counter_makes_no_trace_lose_its_line(device: str, counter: int) -> None:
    """TPDOs only for `counter` frames after a change: 8 s of silence at standstill."""
    spec = scenarios.lir_heartbeat(5, device, "stop and go", STOP_AND_GO, 500)
    counters = (write(0x2800, 0, counter, 1), write(0x2801, 0, counter, 1))
    analysis = analysis_of(one(replace(spec, jobs=(*spec.jobs, *counters))))
    assert [f.text for f in analysis.findings if f.severity != "info"] == []
    told = row(analysis, 5)
    assert (told.cuts, told.flags["silence"], told.direction_changes) == (0, 0, 1)
    found = trace(analysis, 5)
    pause = np.diff(found.t_ns).max()
    assert pause > 5_000_000_000
    np.testing.assert_allclose(found.columns["unwrapped_deg"][-1], (5 - 4) * 0.5 * 360, atol=2)


@pytest.mark.parametrize(
    "device", ["lir-da158", "lir-da158a", "lir-ma158k", "lir-918", "haomiao-38"]
)
def test_an_encoder_that_is_only_polled_has_a_sample_for_each_read(device: str) -> None:
    def poll(machine: Machine) -> None:
        machine.tool(5).run(read(0x6004))
        machine.after(0.25, poll, machine)

    if device == "haomiao-38":
        spec = scenarios.haomiao(5, "polled", STOP_AND_GO, 500)
    else:
        spec = scenarios.lir_heartbeat(5, device, "polled", STOP_AND_GO, 500)
    off = tuple(write(0x1800 + k, 1, 0x8000_0185 + 0x100 * k, 4) for k in (0, 1))
    run = one(replace(spec, jobs=(*spec.jobs, *off)), Do(6.0, poll))
    analysis = analysis_of(run)
    told = row(analysis, 5)
    assert told.sources["SDO"] == pytest.approx(96, abs=1)
    found = trace(analysis, 5)
    polled = found.flags[np.flatnonzero(found.t_ns > found.t_ns[-1] - 20_000_000_000)]
    assert len(polled) == pytest.approx(80, abs=2)
    assert told.cuts <= 1
    assert [f.text for f in analysis.findings if f.severity != "info"] == []


@pytest.mark.parametrize("at_s", [10.0, 24.0], ids=["turning", "at rest"])
def test_the_set_input_is_known_at_rest_and_in_motion(at_s: float) -> None:
    def press(machine: Machine) -> None:
        node = machine.nodes[5]
        assert isinstance(node, Haomiao38)
        node.press_set_input()

    shaft = Shaft((0, 0), (8, 0), (9, 30), (13, 30), (14, 0), (30, 0), start_turns=2)
    run = one(scenarios.haomiao(5, "lift", shaft, 500), Do(at_s, press))
    analysis = analysis_of(run)
    (finding,) = [f for f in analysis.findings if f.severity != "info"]
    assert finding.id == "angle.preset_by_wire"
    assert abs(finding.start_ns - run.scenario.epoch_ns - at_s * 1e9) < 60e6


@pytest.mark.parametrize("device", ["lir-da158", "lir-da158a", "lir-ma158k"])
def test_a_position_that_is_lost_at_rest_is_told_of_every_lir(device: str) -> None:
    def lose(machine: Machine) -> None:
        node = machine.nodes[5]
        assert isinstance(node, Lir)
        node.jumped_counts += node.model.counts_per_turn // 3

    spec = scenarios.lir_heartbeat(5, device, "lost", STOP_AND_GO, 500)
    analysis = analysis_of(one(spec, Do(18.0, lose)))
    (finding,) = [f for f in analysis.findings if f.severity != "info"]
    assert finding.id == "angle.step"


def test_two_encoders_of_different_makers_on_one_shaft() -> None:
    shaft = Shaft((0, 0), (8, 0), (12, 60), (20, 60), (24, -60), (30, -60), (34, 0), (60, 0))
    devices = (
        scenarios.lir_heartbeat(5, "lir-da158", "motor side", shaft, 500),
        scenarios.haomiao(6, "drum side", shaft, 500),
    )

    def slip(machine: Machine) -> None:
        node = machine.nodes[5]
        assert isinstance(node, Lir)
        node.jumped_counts += node.model.counts_per_turn * 8 // 360

    for what in ((), (Do(26.0, slip),)):
        run = Run(Scenario("two", 60.0, devices, what, sync_us=20_000, seed=3))
        text = run.description_toml + "same_shaft_as = 5\n"
        names = run.bus_names
        analysis = analyze(
            ((0, item) for item in _whole(run)),
            [CaptureFacts(Path("x"), "test", names)],
            names,
            description=BusDescription.loads(text),
            devices={},
        )
        (told,) = analysis.shafts
        found = [f.id for f in analysis.findings if f.severity != "info"]
        assert told.parted == len(what)
        assert found == ["angle.shafts_parted"] * len(what)
        if what:
            assert told.parted_deg == pytest.approx(-8, abs=1)


def _whole(run: Run) -> list[FrameBatch]:
    return [FrameBatch.concat([item for item in run.stream() if isinstance(item, FrameBatch)])]
