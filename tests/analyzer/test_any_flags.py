"""Frames with every mix of flags that a log can tell, at any identifier, go through an analysis."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.engine import analyze
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.description import BusDescription

_FLAGS = st.lists(
    st.sampled_from([FrameFlag.EXTENDED, FrameFlag.REMOTE, FrameFlag.ERROR, FrameFlag.FD])
).map(lambda chosen: int(np.bitwise_or.reduce(chosen, initial=0, dtype=np.int64)))
_SHORT = st.sampled_from([0x000, 0x080, 0x085, 0x185, 0x205, 0x585, 0x605, 0x705, 0x7E5, 0x7FF])
_ROWS = st.lists(
    st.tuples(_FLAGS, _SHORT, st.integers(0x800, 0x1FFFFFFF), st.integers(0, 8)), max_size=40
)


@pytest.mark.parametrize("bitrate", [None, 125_000])
@settings(max_examples=60, deadline=None)
@given(_ROWS)
def test_any_mix_of_flags_is_analyzed(
    bitrate: int | None, rows: list[tuple[int, int, int, int]]
) -> None:
    wide = FrameFlag.EXTENDED | FrameFlag.ERROR
    count = len(rows)
    batch = FrameBatch(
        np.arange(count, dtype=np.int64) * 1_000_000,
        np.zeros(count, np.uint8),
        np.array([long if flags & wide else short for flags, short, long, _ in rows], np.uint32),
        np.array([flags for flags, *_ in rows], np.uint16),
        np.array([dlc for *_, dlc in rows], np.uint8),
        np.zeros((count, 8), np.uint8),
    )
    facts = CaptureFacts(Path("any.log"), "test", ["can0"])
    analysis = analyze(
        [(0, batch)] if count else [],
        [facts],
        ["can0"],
        description=BusDescription.loads(""),
        devices={},
        bitrate=bitrate,
    )
    told = analysis.capture
    assert told.frames == count
    assert told.error_frames == sum(bool(flags & FrameFlag.ERROR) for flags, *_ in rows)
