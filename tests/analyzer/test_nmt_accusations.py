"""Faults and healthy habits of error control that look alike: who is accused, and who is not."""

import math
import random

import pytest

from tests.analyzer.control_runs import Row, frame, remote, run
from tests.analyzer.test_nmt_findings import boot, one, others
from tests.analyzer.test_nmt_fold import ordered

PHASES = (0.001, 0.05, 0.2, 0.3, 0.33, 0.4, 0.43, 0.45, 0.48, 0.6, 0.75, 0.99)


def beating(
    start_ms: float, end_ms: float, every_ms: float, jitter_ms: float = 0.5, seed: int = 1
) -> list[Row]:
    """Heartbeats of node 5, each a little late."""
    late = random.Random(seed)
    number = math.ceil((end_ms - start_ms) / every_ms)
    times = (start_ms + n * every_ms + late.uniform(0, jitter_ms) for n in range(number))
    return [frame(t, 0x705, "05") for t in times]


# -- two devices of one period ---------------------------------------------------------------------


@pytest.mark.triggers("nmt.duplicate_node_id")
@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("every_ms", [100, 1000])
def test_two_devices_that_start_together_are_found_at_any_phase(
    phase: float, every_ms: int
) -> None:
    end_ms = 60 * every_ms
    first = beating(1500, end_ms, every_ms)
    second = beating(1500 + phase * every_ms, end_ms, every_ms, seed=2)
    rows = ordered([boot(500), boot(610)], first, second, others(end_ms))
    assert run(*rows).ids() == ["nmt.duplicate_node_id"]


@pytest.mark.near_miss("nmt.duplicate_node_id")
def test_a_pair_of_boot_ups_and_an_even_heartbeat_are_one_device() -> None:
    rows = ordered([boot(500), boot(585)], beating(1500, 60_000, 500), others(60_000))
    assert run(*rows).ids() == []


@pytest.mark.triggers("nmt.duplicate_node_id")
def test_a_third_of_a_second_is_no_task() -> None:
    """Intervals of 330 and 670 ms would be one and two steps of a task, were it not so slow."""
    rows = ordered(beating(200, 60_000, 1000), beating(530, 60_000, 1000, seed=2), others(60_000))
    assert run(*rows).ids() == ["nmt.duplicate_node_id"]


@pytest.mark.near_miss("nmt.duplicate_node_id")
@pytest.mark.near_miss("nmt.node_lost")
@pytest.mark.parametrize("end_ms", [60_000, 60_200])
def test_a_producer_that_alternates_is_neither_two_nor_lost(end_ms: int) -> None:
    rows = ordered(beating(1000, 60_000, 1000), beating(1400, 60_000, 1000), others(end_ms))
    assert run(*rows).ids() == []


@pytest.mark.triggers("nmt.duplicate_node_id")
@pytest.mark.near_miss("nmt.node_lost")
@pytest.mark.parametrize("first_ms", [10_400, 30_400])
def test_a_second_device_that_comes_or_goes_on_the_grid_of_a_task(first_ms: int) -> None:
    second = beating(first_ms, first_ms + 30_000, 1000, seed=2)
    rows = ordered(beating(1000, 60_000, 1000), second, others(60_000))
    assert run(*rows).ids() == ["nmt.duplicate_node_id"]


# -- late, but not lost ----------------------------------------------------------------------------


def uneven(late_ms: float, end_ms: float = 20_000) -> list[Row]:
    """Heartbeats of node 5 every 100 ms, each twentieth one after a longer time."""
    t_ms, rows = 1000.0, list[Row]()
    while t_ms < end_ms:
        rows.append(frame(t_ms, 0x705, "05"))
        t_ms += late_ms if len(rows) % 20 == 0 else 100
    return rows


def allowed(ms: int) -> list[Row]:
    """Node 9 is told how long node 5 may be silent."""
    value = (5 << 16 | ms).to_bytes(4, "little").hex()
    return [frame(900, 0x609, f"23161001{value}"), frame(901, 0x589, "6016100100000000")]


@pytest.mark.triggers("nmt.consumer_time")
@pytest.mark.near_miss("nmt.node_lost")
@pytest.mark.parametrize(("ms", "late_ms"), [(150, 160), (120, 130)])
def test_a_consumer_time_within_the_spread_of_the_heartbeat_is_the_root(
    ms: int, late_ms: int
) -> None:
    found = run(*ordered(allowed(ms), uneven(late_ms), others(20_000)))
    assert "nmt.node_lost" not in found.ids()
    assert f"times took up to {late_ms} ms" in one(found, "nmt.consumer_time").text


@pytest.mark.triggers("nmt.heartbeat_irregular")
@pytest.mark.near_miss("nmt.node_lost")
def test_a_heartbeat_that_is_late_again_and_again_is_irregular() -> None:
    assert run(*ordered(uneven(160), others(20_000))).ids() == ["nmt.heartbeat_irregular"]


@pytest.mark.triggers("nmt.node_lost")
def test_heartbeats_that_are_missing_are_a_loss() -> None:
    assert "nmt.node_lost" in run(*ordered(allowed(150), uneven(260), others(20_000))).ids()


# -- guarding --------------------------------------------------------------------------------------


def empty_requests(end_ms: float, answers_ms: float) -> list[Row]:
    """Guard requests that the log holds as empty data frames, and their answers up to a moment."""
    rows = []
    for n in range(int(end_ms // 200)):
        rows.append(frame(n * 200, 0x705))
        if n * 200 < answers_ms:
            rows.append(frame(n * 200 + 1, 0x705, "85" if n % 2 else "05"))
    return rows


@pytest.mark.triggers("nmt.node_lost")
def test_the_last_of_many_empty_requests_is_no_sign_of_life() -> None:
    finding = one(run(*ordered(empty_requests(20_000, 10_000), others(20_000))), "nmt.node_lost")
    assert "up to the end" in finding.text
    assert len(finding.evidence) == 1


@pytest.mark.near_miss("nmt.node_lost")
def test_single_guard_answers_that_were_not_recorded_are_no_loss() -> None:
    """The toggle bit goes on as if they had been sent."""
    rows = [remote(n * 100, 0x705) for n in range(300)]
    answers = [frame(n * 100 + 1, 0x705, "85" if n % 2 else "05") for n in range(300) if n % 50]
    found = run(*ordered(rows, answers, others(30_000))).ids()
    assert "nmt.node_lost" not in found
