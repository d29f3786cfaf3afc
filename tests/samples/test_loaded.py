"""The loaded buses obey the rules of CAN: checked from their frames alone."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from random import Random

import pytest

from syncline_samples.loaded import random_loaded_bus
from syncline_samples.loaded_run import LoadedRun, run_loaded
from syncline_samples.loaded_truth import SentPdo
from syncline_samples.wire import frame_bits, stuff
from syncline_schemas.batch import FrameBatch, FrameFlag

SEEDS = range(1000, 1012)


@cache
def run_of(seed: int) -> LoadedRun:
    """A bus on which no frame is destroyed: the truth does not hold those."""
    return run_loaded(replace(random_loaded_bus(Random(seed), seed), errors_s=()))


def test_a_seed_is_a_bus() -> None:
    first, second = (run_loaded(random_loaded_bus(Random(5), 5)) for _ in range(2))
    assert first.plan == second.plan
    assert first.truth.frames == second.truth.frames
    assert first.truth.pdos == second.truth.pdos


def test_the_plans_span_what_there_is() -> None:
    plans = [random_loaded_bus(Random(seed), seed) for seed in range(400)]
    assert {len(plan.nodes) for plan in plans} == set(range(2, 21))
    assert {plan.bitrate for plan in plans} == {125_000, 250_000, 500_000, 1_000_000}
    assert min(plan.load for plan in plans) < 0.25
    assert max(plan.load for plan in plans) > 0.9
    kinds = {pdo.kind for plan in plans for pdo in plan.pdos}
    assert {1, 2, 240, 254, 255} <= kinds
    assert {plan.told for plan in plans} == {"sdo", "description", "nothing"}


def test_the_load_is_what_the_plan_aims_at() -> None:
    for run in map(run_of, SEEDS):
        sent = [f for f in run.truth.frames if f.start_ns >= run.truth.started_ns]
        busy = sum(frame.bits for frame in sent) / run.plan.bitrate
        passed = (sent[-1].end_ns - sent[0].start_ns) / 1e9
        assert 0.15 < busy / passed <= 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_no_two_frames_share_the_wire(seed: int) -> None:
    run = run_of(seed)
    intermission_ns = 3 * 1_000_000_000 // run.plan.bitrate
    assert all(
        before.end_ns + intermission_ns <= after.start_ns
        for before, after in pairwise(run.truth.frames)
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_a_frame_takes_its_bits(seed: int) -> None:
    run = run_of(seed)
    bit_ns = 1_000_000_000 // run.plan.bitrate
    frames = FrameBatch.concat([item for item in run.batches if isinstance(item, FrameBatch)])
    data_frames = [f for f in run.truth.frames if f.seq is not None]
    rows = [row for row in range(len(frames)) if not frames.flags[row] & FrameFlag.ERROR]
    assert [frame.seq for frame in data_frames] == rows
    for frame in data_frames[:: len(data_frames) // 300]:
        assert frame.seq is not None
        data = frames.payload(frame.seq)
        bits = len(stuff(frame_bits(frame.can_id, data))) + 10
        assert frame.end_ns - frame.start_ns == bits * bit_ns
        assert frame.bits == bits + 3
        step_ns = run.plan.stamp_resolution_ns
        assert frames.t_ns[frame.seq] == frame.end_ns // step_ns * step_ns


@pytest.mark.parametrize("seed", SEEDS)
def test_the_lowest_identifier_goes_first(seed: int) -> None:
    """While a PDO waited, the bus was never idle, and what went before it had precedence."""
    run = run_of(seed)
    bit_ns = 1_000_000_000 // run.plan.bitrate
    starts = {frame.start_ns: place for place, frame in enumerate(run.truth.frames)}
    for pdo in run.truth.pdos:
        _check_waiting(run, pdo, starts[pdo.start_ns], bit_ns)


def _check_waiting(run: LoadedRun, pdo: SentPdo, place: int, bit_ns: int) -> None:
    assert pdo.ready_ns <= pdo.asked_ns <= pdo.start_ns
    free_ns = pdo.start_ns
    while free_ns > pdo.asked_ns:
        place -= 1
        before = run.truth.frames[place]
        assert before.end_ns + 3 * bit_ns == free_ns, "the bus was idle"
        if before.start_ns >= pdo.asked_ns:
            assert before.can_id <= pdo.can_id
        free_ns = before.start_ns


@pytest.mark.parametrize("seed", SEEDS)
def test_every_due_pdo_is_sent_or_noted_as_unsent(seed: int) -> None:
    run = run_of(seed)
    last_ns = run.truth.frames[-1].end_ns
    for plan in run.plan.pdos:
        if not plan.synchronous:
            continue
        due = run.truth.due.get(plan.can_id, [])
        sent = [pdo.sync_number for pdo in run.truth.pdos if pdo.can_id == plan.can_id]
        unsent = sum(each.can_id == plan.can_id for each in run.truth.unsent)
        assert all(after - before == plan.kind for before, after in pairwise(due))
        assert set(sent) <= set(due)
        assert len(set(sent)) == len(sent)
        longest_ns = plan.delay.base_ns + plan.delay.jitter_ns + plan.slow_ns
        closed = [n for n in due if run.truth.syncs[n].end_ns + longest_ns + 10**8 < last_ns]
        assert len(closed) <= len(sent) + unsent
