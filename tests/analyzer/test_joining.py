"""Batches of a stream are joined, gaps and breaks in `seq` keep their place."""

import gc
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from syncline_analyzer.deafness import Numbered
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.joining import joined
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.collecting import rare_collections


def _batch(first: int, count: int) -> FrameBatch:
    numbers = np.arange(first, first + count)
    return FrameBatch(
        numbers.astype(np.int64),
        np.zeros(count, np.uint8),
        numbers.astype(np.uint32),
        np.zeros(count, np.uint16),
        np.zeros(count, np.uint8),
        np.zeros((count, 8), np.uint8),
    )


def _shape(stream: Iterator[IndexedBatch | Gap]) -> list[tuple[int, list[int]] | str]:
    return [
        item.reason if isinstance(item, Gap) else (item.seq0, item.frames.can_id.tolist())
        for item in stream
    ]


def test_batches_that_follow_one_another_become_one() -> None:
    parts = [(0, _batch(0, 2)), (2, _batch(2, 0)), (2, _batch(2, 3)), (5, _batch(5, 1))]
    assert _shape(joined(parts)) == [(0, [0, 1, 2, 3, 4, 5])]


@pytest.mark.parametrize("size", [1, 4, 6, 7, 12, 20])
def test_all_batches_are_equally_long_however_the_frames_came(size: int) -> None:
    whole = _batch(0, 20)
    parts = [(seq, whole[seq : seq + size]) for seq in range(0, 20, size)]
    expected = [(0, [*range(6)]), (6, [*range(6, 12)]), (12, [*range(12, 18)]), (18, [18, 19])]
    assert _shape(joined(parts, frames=6)) == expected


def test_gaps_and_breaks_end_what_waits() -> None:
    gap = Gap(1, 2, "test", None, None)
    parts: list[Numbered] = [(0, _batch(0, 2)), (2, gap), (2, _batch(2, 1)), (7, _batch(7, 1))]
    assert _shape(joined(parts)) == [(0, [0, 1]), "test", (2, [2]), (7, [7])]
    assert _shape(joined([(0, gap)])) == ["test"]


def test_a_wide_batch_widens_those_it_is_joined_with() -> None:
    wide = FrameBatch.concat([_batch(2, 1)])
    wide = FrameBatch(
        wide.t_ns, wide.bus, wide.can_id, wide.flags, wide.dlc, np.zeros((1, 64), np.uint8)
    )
    (whole,) = joined([(0, _batch(0, 2)), (2, wide)])
    assert isinstance(whole, IndexedBatch)
    assert whole.frames.data.shape == (3, 64)
    assert all(a < b for a, b in pairwise(whole.frames.t_ns.tolist()))
    assert whole.seqs.tolist() == [0, 1, 2]


def test_collections_are_as_often_as_before_once_the_analysis_is_over() -> None:
    before = gc.get_threshold()
    with rare_collections():
        assert gc.get_threshold()[0] > before[0]
    assert gc.get_threshold() == before
