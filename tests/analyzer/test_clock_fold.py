"""Steps back and the longest silences of a bus, against a plain loop over its stamps."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.bus import clock
from syncline_analyzer.folds.bus.clock import BusSilence, ClockFold, ClockStep
from syncline_analyzer.shadow import Shadow
from syncline_schemas.batch import FrameBatch

KEPT = 4


def batch(t_ns: list[int], seqs: list[int]) -> IndexedBatch:
    nothing = np.zeros(len(t_ns), np.uint8)
    frames = FrameBatch(
        np.array(t_ns, np.int64),
        nothing,
        nothing.astype(np.uint32),
        nothing.astype(np.uint16),
        nothing,
        np.zeros((len(t_ns), 8), np.uint8),
    )
    return IndexedBatch(frames, seqs=np.array(seqs, np.int64))


@given(
    steps=st.lists(st.integers(-3, 9), min_size=1, max_size=60),
    cuts=st.sets(st.integers(1, 59)),
    data=st.data(),
)
@settings(deadline=None)
def test_however_the_frames_are_cut(steps: list[int], cuts: set[int], data: st.DataObject) -> None:
    t_ns = np.cumsum([1_000, *steps]).tolist()
    seqs = np.cumsum([5, *(data.draw(st.integers(1, 3)) for _ in steps)]).tolist()
    fold = ClockFold(Context(["can0"], Shadow(lambda _: "can0")))
    edges = [0, *sorted(cut for cut in cuts if cut < len(t_ns)), len(t_ns)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(clock, "MAX_SILENCES", KEPT)
        for begin, stop in pairwise(edges):
            fold.update(batch(t_ns[begin:stop], seqs[begin:stop]))
        table = fold.finish(t_ns[-1])

    frames = list(zip(seqs, t_ns, strict=True))
    passed = [(end - start, start, end, seq) for (_, start), (seq, end) in pairwise(frames)]
    longest = sorted((each for each in passed if each[0] > 0), key=lambda each: -each[0])[:KEPT]
    assert table.silences.get(0, []) == [
        BusSilence(start, end, seq) for _, start, end, seq in sorted(longest, key=lambda e: e[3])
    ]
    assert table.steps == [ClockStep("can0", s, end, -by) for by, _, end, s in passed if by < 0]
