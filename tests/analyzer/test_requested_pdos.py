"""Synchronous PDOs that somebody also asks for by remote frames: no answer to a SYNC is invented."""

import pytest

from syncline_analyzer.results import PdoRow
from syncline_schemas.batch import FrameFlag
from tests.analyzer.timing_builder import (
    MS,
    T0,
    US,
    Row,
    context,
    frame,
    learn,
    ordered,
    regular,
    syncs,
    timing,
)

PERIOD = 10 * MS
COUNT = 40
DATA = b"\1\2\3\4"


def request(t_ns: int) -> Row:
    """A remote frame that asks for the PDO (CiA 301 7.2.2.5.2)."""
    return T0 + t_ns, 0, 0x181, int(FrameFlag.REMOTE), 4, b""


def answered(*, asked: list[Row], block_frames: int = 1 << 16, kind: int = 1) -> PdoRow:
    """A PDO 1 ms after each SYNC, and what else passes."""
    ctx = context()
    learn(ctx, 1, 0x1800, 1, 0x181)
    learn(ctx, 1, 0x1800, 2, kind)
    pdos = [frame(k * PERIOD + MS, 0x181, DATA) for k in range(COUNT)]
    frames = ordered(syncs(regular(COUNT + 1, PERIOD)), pdos, asked)
    tables = timing(ctx, frames, block_frames=block_frames)
    (row,) = (row for row in tables.pdos if row.cob_id == 0x181)
    return row


@pytest.mark.parametrize("block_frames", [1 << 16, 7, 2, 1])
@pytest.mark.parametrize(
    ("before_ns", "after_ns"),
    [(100 * US, 300 * US), (-200 * US, 300 * US), (-2 * MS, 2500 * US), (-5 * MS, 6 * MS)],
    ids=["over the SYNC", "before the answer", "behind the answer", "far behind"],
)
def test_the_answer_to_a_request_is_neither_response_nor_extra(
    before_ns: int, after_ns: int, block_frames: int
) -> None:
    rows = []
    for k in (5, 12, 20, 31):
        rows += [request(k * PERIOD - before_ns), frame(k * PERIOD + after_ns, 0x181, DATA)]
    row = answered(asked=rows, block_frames=block_frames)
    assert row.response_us is not None
    assert (row.response_us.min, row.response_us.max) == (1000.0, 1000.0)
    assert (row.extra, row.extra_alone, row.missed) == (0, 0, 0)


def test_a_second_frame_that_nobody_asked_for_is_extra() -> None:
    row = answered(asked=[frame(k * PERIOD + 3 * MS, 0x181, DATA) for k in (5, 12, 20, 31)])
    assert row.extra == 4


def test_a_request_that_nobody_answers_hides_one_answer_and_no_more() -> None:
    """The next PDO may be the answer to it; the one after that answers its SYNC."""
    row = answered(asked=[request(k * PERIOD - MS) for k in (5, 12)])
    assert row.response_us is not None
    assert (row.response_us.min, row.response_us.max) == (1000.0, 1000.0)
    assert (row.extra, row.missed) == (0, 0)


def test_a_request_written_down_as_an_empty_frame_is_no_answer() -> None:
    rows = [frame(k * PERIOD + 300 * US, 0x181) for k in (5, 12)]
    row = answered(asked=[*rows, *(frame(k * PERIOD + 600 * US, 0x181, DATA) for k in (5, 12))])
    assert row.response_us is not None
    assert (row.response_us.min, row.response_us.max) == (1000.0, 1000.0)
    assert row.extra == 0
