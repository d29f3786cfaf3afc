"""Silence of a whole bus against silence of the SYNC producer, on time lines made for it."""

import pytest

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.tables import TimingTables
from tests.analyzer.timing_builder import (
    MS,
    SECOND,
    Row,
    context,
    frame,
    learn,
    ordered,
    state,
    syncs,
    timing,
)

PERIOD = 10 * MS
END = 10 * SECOND
PAUSE = (4990 * MS, 7000 * MS)


def told() -> Context:
    """Node 5 answers SYNC, node 6 sends every 20 ms by its event timer."""
    ctx = context()
    for node, kind in ((5, 1), (6, 0xFE)):
        learn(ctx, node, 0x1800, 1, 0x180 + node)
        learn(ctx, node, 0x1800, 2, kind)
    learn(ctx, 6, 0x1800, 5, 20)
    return ctx


def spared(times: range, pause: tuple[int, int]) -> list[int]:
    return [t for t in times if not pause[0] < t < pause[1]]


def run(
    *,
    producer: tuple[int, int],
    cyclic: tuple[int, int] = (0, 0),
    beats: tuple[int, int] = (0, 0),
    beat_ns: int = 500 * MS,
    block_frames: int = 1 << 16,
) -> TimingTables:
    """SYNC and its answers, a cyclic PDO and heartbeats, each with its own pause."""
    cycle = spared(range(0, END, PERIOD), producer)
    answers = [frame(t + MS, 0x185, bytes(4)) for t in cycle]
    events = [frame(t, 0x186, bytes(4)) for t in spared(range(2 * MS, END, 2 * PERIOD), cyclic)]
    alive: list[Row] = [
        frame(t + node * 100_000, 0x700 + node, b"\x05")
        for t in spared(range(3 * MS, END, beat_ns), beats)
        for node in (5, 6)
    ]
    states = [state(node, "OPERATIONAL", 0, END) for node in (5, 6)]
    frames = ordered(syncs(cycle), answers, events, alive)
    return timing(told(), frames, states=states, block_frames=block_frames)


@pytest.mark.parametrize("block_frames", [1 << 16, 300])
def test_where_nothing_at_all_was_heard_nobody_is_accused(block_frames: int) -> None:
    tables = run(producer=PAUSE, cyclic=PAUSE, beats=PAUSE, block_frames=block_frames)
    assert [row.missing for row in tables.sync] == [0]
    assert [(row.cob_id, row.missed) for row in tables.pdos] == [(0x185, 0), (0x186, 0)]
    assert tables.holes == []


def test_a_producer_that_pauses_while_others_go_on_is_found() -> None:
    assert run(producer=PAUSE).sync[0].missing == 200


def test_a_producer_that_pauses_between_two_heartbeats_is_found() -> None:
    pause = (4100 * MS, 4400 * MS)
    tables = run(producer=pause, cyclic=(0, END))
    assert tables.sync[0].missing == 29


def test_a_producer_and_those_that_answer_it_go_silent_between_heartbeats() -> None:
    assert run(producer=PAUSE, cyclic=(0, END)).sync[0].missing == 200


def test_without_heartbeats_a_pause_of_the_producer_is_told() -> None:
    assert run(producer=PAUSE, cyclic=(0, END), beat_ns=END).sync[0].missing == 200
