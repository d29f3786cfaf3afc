"""PDO timing and bus load on random loaded buses against the truth of who asked for what when."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from random import Random

import numpy as np
import pytest
from numpy.typing import NDArray

from syncline_analyzer import open_session
from syncline_analyzer.results import Responses
from syncline_samples.loaded import random_loaded_bus
from syncline_schemas.batch import FrameBatch
from tests.analyzer.load_truth import wrong_peaks, wrong_rate, wrong_shares
from tests.analyzer.timing_builder import context, timing
from tests.analyzer.timing_truth import (
    Measured,
    analyzed,
    carried,
    kind,
    measured,
    widths_us,
    wrong_bounds,
    wrong_counts,
    wrong_load,
    wrong_syncs,
    wrong_waiting,
)
from tests.analyzer.waiting_truth import wrong_causes, wrong_delays

SEEDS = range(24)


@cache
def case_of(seed: int) -> Measured:
    return measured(random_loaded_bus(Random(seed), seed))


def outcome(lines: Iterator[str]) -> list[str]:
    """The first few of what is wrong."""
    return [line for line, _ in zip(lines, range(5), strict=False)]


@pytest.mark.parametrize("seed", SEEDS)
def test_every_device_time_lies_within_its_bounds(seed: int) -> None:
    case = case_of(seed)
    assert (
        outcome(line for each in case.analysis.responses for line in wrong_bounds(case, each)) == []
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_what_a_pdo_waited_lies_within_the_bounds_of_arbitration(seed: int) -> None:
    case = case_of(seed)
    lines = (line for each in case.analysis.responses for line in wrong_waiting(case, each))
    assert outcome(lines) == []
    assert outcome(wrong_delays(case)) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_nobody_is_blamed_for_what_another_did(seed: int) -> None:
    case = case_of(seed)
    lines = (line for row in case.analysis.lateness for line in wrong_causes(case, row))
    assert outcome(lines) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_the_load_is_the_sum_of_what_was_sent(seed: int) -> None:
    case = case_of(seed)
    assert outcome(wrong_load(case)) == []
    assert outcome(wrong_shares(case)) == []
    if not case.plan.gap_s and not case.plan.errors_s:
        assert outcome(wrong_peaks(case)) == []


def test_a_bit_rate_that_nobody_tells_is_never_told_wrongly() -> None:
    told = []
    for seed in SEEDS[::3]:
        plan = case_of(seed).plan
        case = measured(plan, bitrate_known=False)
        assert outcome(wrong_rate(case)) == []
        if plan.stamp_resolution_ns < 100_000:
            told.append(case.analysis.bus_load[0].bitrate is not None)
    assert sum(told) > 0.9 * len(told)


@pytest.mark.parametrize("seed", SEEDS)
def test_missed_extra_and_late_are_those_of_the_definitions(seed: int) -> None:
    case = case_of(seed)
    assert outcome(wrong_syncs(case)) == []
    assert outcome(line for can_id in case.plan_of for line in wrong_counts(case, can_id)) == []


def test_the_bounds_are_narrow_where_the_bus_has_room() -> None:
    """Shares of the SYNC period; at a load of 40 % the frames since the SYNC are few."""
    low: list[NDArray[np.float64]] = []
    high: list[NDArray[np.float64]] = []
    for case in map(case_of, SEEDS):
        if case.plan.stamp_resolution_ns < 100_000:
            widths = widths_us(case).get("least", np.zeros(0)) * 1000 / case.usual_period_ns
            (low if case.load < 0.4 else high).append(widths[np.isfinite(widths)])
    assert np.median(np.concatenate(low)) < 0.02
    assert np.median(np.concatenate(high)) < 0.15


def test_an_answer_after_the_next_sync_counts_as_ready_at_once() -> None:
    """What the bus held back beyond the next SYNC was ready before it: nothing else is claimed."""
    compared = 0
    for case in map(case_of, SEEDS):
        if not carried(case):
            continue
        syncs = case.last_sync
        for each in case.analysis.responses:
            for seq, low in zip(each.seq.tolist(), each.device_low_us.tolist(), strict=True):
                pdo = case.pdo_of[seq]
                if pdo.sync_ns is not None and pdo.ready_ns < syncs[seq].end_ns:
                    compared += 1
                    assert low == 0
    assert compared > 20


@pytest.mark.parametrize("seed", [3, 13, 24])
def test_coarser_stamps_widen_the_bounds_and_keep_them_true(seed: int) -> None:
    exact = float(np.mean(widths_us(case_of(seed))["low"]))
    assert case_of(seed).plan.stamp_resolution_ns == 1
    for step_ns in (1000, 10_000, 1_000_000):
        plan = replace(case_of(seed).plan, stamp_resolution_ns=step_ns)
        case = measured(plan)
        lines = (line for each in case.analysis.responses for line in wrong_bounds(case, each))
        assert outcome(lines) == []
        width = float(np.mean(widths_us(case)["low"]))
        assert exact <= width <= exact + 2 * step_ns / 1000


@pytest.mark.parametrize("step_ns", [1000, 100_000, 1_000_000])
def test_the_step_of_the_stamps_in_a_text_log_widens_the_bounds(
    tmp_path: Path, step_ns: int
) -> None:
    """Nobody tells the reader of a log how coarse the clock of its logger was."""
    plan = replace(case_of(24).plan, stamp_resolution_ns=step_ns)
    case = measured(plan)
    log, described = tmp_path / "run.log", tmp_path / "bus.toml"
    log.write_text(candump(frames_of(case)), encoding="ascii")
    described.write_text(plan.description_toml, encoding="utf-8")
    analysis = open_session(log, description=described, bitrate=plan.bitrate).analyze()
    read = replace(case, analysis=analysis)
    assert sum(len(each.seq) for each in analysis.responses) > 1000
    assert outcome(line for each in analysis.responses for line in wrong_bounds(read, each)) == []
    assert outcome(line for each in analysis.responses for line in wrong_waiting(read, each)) == []


def candump(frames: FrameBatch) -> str:
    """The frames as `candump -L` writes them."""
    lines = (
        f"({t_ns // 10**9}.{t_ns % 10**9 // 1000:06d}) can0 {frames.can_id[row]:03X}"
        f"#{frames.payload(row).hex()}\n"
        for row, t_ns in enumerate(frames.t_ns.tolist())
    )
    return "".join(lines)


def test_two_buses_in_one_log_are_those_of_two_logs() -> None:
    cases = [case_of(seed) for seed in (3, 4)]
    parts = []
    for bus, case in enumerate(cases):
        frames = frames_of(case)
        frames.bus[:] = bus
        parts.append(frames)
    both = FrameBatch.concat(parts)
    both = both[np.argsort(both.t_ns, kind="stable")]
    together = analyzed(
        [both],
        ["can0", "can1"],
        "".join(
            case.plan.description_toml.replace("can0", f"can{bus}")
            for bus, case in enumerate(cases)
        ),
        1000,
        {f"can{bus}": case.plan.bitrate for bus, case in enumerate(cases)},
    )
    for bus, case in enumerate(cases):
        alone = analyzed(
            case.batches, ["can0"], case.plan.description_toml, 1000, {"can0": case.plan.bitrate}
        )
        of_bus = [each for each in together.responses if each.bus == f"can{bus}"]
        assert_same(of_bus, alone.responses)


@pytest.mark.parametrize("block_frames", [300, 1000])
def test_the_size_of_the_blocks_changes_no_bound(block_frames: int) -> None:
    case = case_of(5)
    frames = frames_of(case)
    ctx = [context(bitrate=case.plan.bitrate, buses=["can0"]) for _ in range(2)]
    small = timing(ctx[0], frames, size=100, block_frames=block_frames)
    assert_same(small.responses, timing(ctx[1], frames).responses)


def frames_of(case: Measured) -> FrameBatch:
    """All frames in one batch of its own."""
    frames = FrameBatch.concat([item for item in case.batches if isinstance(item, FrameBatch)])
    return replace(frames, bus=frames.bus.copy())


def assert_same(some: list[Responses], others: list[Responses]) -> None:
    assert [each.cob_id for each in some] == [each.cob_id for each in others]
    for one, other in zip(some, others, strict=True):
        for column in ("t_ns", "response_us", "device_low_us", "device_high_us"):
            np.testing.assert_array_equal(getattr(one, column), getattr(other, column))


def test_a_problem_is_seen() -> None:
    """The checks themselves: bounds that are a few ns too narrow are told."""
    case = case_of(3)
    (each, *_) = case.analysis.responses
    narrow = replace(each, device_high_us=each.device_high_us - 0.004)
    assert {kind(line) for line in wrong_bounds(case, narrow)}
