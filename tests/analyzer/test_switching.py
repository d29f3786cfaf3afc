"""Whole buses that fall silent, and machines that are switched off: neither accuses a node."""

import pytest

from syncline_analyzer.results import Analysis, Finding
from tests.analyzer.control_runs import Row, frame
from tests.analyzer.whole_run import beats, every, whole

BUSES = ("can0", "can1")


def told(analysis: Analysis) -> list[tuple[str, str, int | None]]:
    """(severity, id, node) of all findings."""
    return [(f.severity, f.id, f.node) for f in analysis.findings]


def only(analysis: Analysis) -> Finding:
    (finding,) = analysis.findings
    return finding


def machine(stop_ms: float, *, bus: int = 0, first_ms: float = 0) -> list[Row]:
    return [
        row
        for node in (5, 6, 7)
        for row in beats(node, first_ms + 3 * node, stop_ms + 3 * node, bus=bus)
    ]


@pytest.mark.triggers("nmt.bus_silent")
@pytest.mark.near_miss("nmt.node_lost")
def test_a_bus_that_falls_silent_for_good_while_another_is_recorded_accuses_no_node() -> None:
    finding = only(whole(machine(60_000), machine(30_000, bus=1), buses=BUSES))
    assert (finding.id, finding.severity, finding.bus) == ("nmt.bus_silent", "warning", "can1")
    assert finding.node is None
    assert "Another bus was heard meanwhile" in finding.text


@pytest.mark.near_miss("nmt.node_lost")
def test_the_only_node_of_a_silent_bus_is_not_accused() -> None:
    rows = whole(machine(60_000), beats(9, 0, 30_000, bus=1), buses=BUSES)
    assert told(rows) == [("warning", "nmt.bus_silent", None)]


@pytest.mark.triggers("nmt.node_lost")
def test_a_node_that_is_lost_beside_others_of_its_bus_is_lost() -> None:
    rows = whole(machine(60_000), machine(60_000, bus=1), beats(9, 0, 30_000, bus=1), buses=BUSES)
    assert told(rows) == [("error", "nmt.node_lost", 9)]


@pytest.mark.near_miss("nmt.node_lost", "bus.silent")
@pytest.mark.parametrize(
    "stops",
    [(59_000, 59_160, 59_400), (59_100, 59_500, 59_500), (58_000, 58_000, 60_000)],
)
def test_nodes_that_fade_at_the_end_are_switched_off(stops: tuple[int, int, int]) -> None:
    nodes = [beats(node, node, stop) for node, stop in zip((5, 6, 7), stops, strict=True)]
    finding = only(whole(*nodes))
    assert (finding.id, finding.severity) == ("nmt.bus_silent", "info")


@pytest.mark.near_miss("nmt.node_lost", "bus.silent")
def test_a_controller_that_runs_on_after_its_nodes_is_switched_off_with_them() -> None:
    plc = beats(1, 0, 61_400, 500)
    assert told(whole(machine(59_700), plc)) == [("info", "nmt.bus_silent", None)]


@pytest.mark.near_miss("nmt.node_lost")
def test_after_a_stop_of_all_nodes_they_may_fade_more_slowly() -> None:
    stop = [frame(55_000, 0x000, "0200")]
    fading = [beats(5, 0, 55_500), beats(6, 0, 57_000), beats(7, 0, 60_000)]
    assert told(whole(*fading)) == [("error", "nmt.node_lost", 5), ("error", "nmt.node_lost", 6)]
    assert told(whole(*fading, stop)) == [("info", "nmt.bus_silent", None)]


@pytest.mark.triggers("nmt.bus_silent")
def test_a_machine_off_and_on_is_told_once_with_its_true_numbers() -> None:
    plc = [*beats(1, 0, 61_400, 500), frame(90_300, 0x701, "00"), *beats(1, 90_400, 120_000, 500)]
    boots = [frame(90_000 + node, 0x700 + node, "00") for node in (5, 6, 7)]
    finding = only(whole(machine(59_700), boots, machine(120_000, first_ms=90_100), plc))
    assert (finding.id, finding.severity, finding.node) == ("nmt.bus_silent", "warning", None)
    assert "at +61.000 s for 29 s; nodes 1, 5, 6, 7 came back" in finding.text
    assert "the first 1.385 s before the last" in finding.text


@pytest.mark.near_miss("nmt.unexpected_reset", "nmt.node_lost")
def test_a_short_break_of_the_whole_supply_is_told_once() -> None:
    sync = every(0x080, 0, 13_000, 20) + every(0x080, 14_000, 30_000, 20)
    boots = [frame(t, 0x700 + node, "00") for node, t in ((5, 13_300), (6, 13_307), (7, 13_900))]
    on = [
        row for node, t in ((5, 13_400), (6, 13_410), (7, 14_000)) for row in beats(node, t, 30_000)
    ]
    finding = only(whole(machine(12_980), boots, on, sync))
    assert (finding.id, finding.severity, finding.node) == ("nmt.bus_silent", "warning", None)
    assert "nodes 5, 6, 7 came back with a boot-up" in finding.text


@pytest.mark.triggers("nmt.unexpected_reset")
def test_nodes_that_restart_together_beside_one_that_goes_on_are_told() -> None:
    boots = [frame(t, 0x700 + node, "00") for node, t in ((5, 13_300), (6, 13_307), (7, 13_900))]
    on = [
        row for node, t in ((5, 13_400), (6, 13_410), (7, 14_000)) for row in beats(node, t, 30_000)
    ]
    analysis = whole(machine(12_980), boots, on, beats(9, 0, 30_000, 150))
    assert "nmt.bus_silent" not in {finding.id for finding in analysis.findings}
    assert {f.node for f in analysis.findings} == {5, 6, 7}
