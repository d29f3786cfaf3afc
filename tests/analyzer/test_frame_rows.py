"""Frames that the Rerun recording lists: which ones, and how each is written."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from syncline_analyzer.results import Analysis, GapRow
from syncline_analyzer.session import open_session
from syncline_analyzer.views import frame_rows as module
from syncline_analyzer.views.frame_rows import LeftOut, Shown, frame_rows
from syncline_analyzer.views.frame_words import FrameLines
from syncline_analyzer.views.rerun_view import write_rrd
from syncline_schemas.batch import FrameBatch
from tests.analyzer.analysis_builder import (
    SECOND,
    T0,
    analysis,
    at,
    capture_row,
    emcy_row,
    finding,
    node_row,
)
from tests.analyzer.test_views_rerun import columns

SAMPLES = Path(__file__).parents[2] / "samples"
STEP = SECOND // 100


def frames(count: int) -> FrameBatch:
    """Heartbeats every 10 ms from the start of the capture."""
    rows = [(T0 + STEP * n, 0, 0x705, 0, 1, b"\x05") for n in range(count)]
    return FrameBatch.from_rows(rows)


def a_capture(count: int, files: list[str] | None = None) -> Analysis:
    """A finding, and an EMCY some time after it."""
    row = capture_row(
        frames=count, duration_ns=count * STEP, files=files or ["a.mcap"], buses=["can0"]
    )
    return analysis(
        capture=row,
        nodes=[node_row(5)],
        findings=[finding(second=250.0, start_ns=at(250), end_ns=at(250))],
        emcy=[emcy_row(t_ns=at(400), seq=40_000)],
    )


class Reader:
    """Stands for a session; notes the stretches that it was asked for."""

    def __init__(self, whole: FrameBatch) -> None:
        self.whole = whole
        self.asked: list[tuple[int | None, int | None]] = []

    def __call__(self, start: int | None, end: int | None) -> Iterator[FrameBatch]:
        self.asked.append((start, end))
        low = 0 if start is None else np.searchsorted(self.whole.t_ns, start)
        high = len(self.whole) if end is None else np.searchsorted(self.whole.t_ns, end)
        yield self.whole[int(low) : int(high)]


def listed(items: list[Shown | LeftOut]) -> int:
    return sum(len(item.frames) for item in items if isinstance(item, Shown))


def test_a_short_capture_is_listed_whole() -> None:
    read = Reader(frames(2_000))
    (shown,) = frame_rows(a_capture(2_000), read)
    assert isinstance(shown, Shown)
    assert shown.frames.t_ns.tolist() == read.whole.t_ns.tolist()
    assert shown.seq is not None
    assert shown.seq.tolist() == list(range(2_000))


def test_of_a_longer_one_what_is_left_out_is_counted() -> None:
    count = module.ALL_FRAMES + 10_000
    items = list(frame_rows(a_capture(count), Reader(frames(count))))
    assert [type(item) for item in items] == [Shown, LeftOut, Shown, LeftOut, Shown, LeftOut]
    assert listed(items) == module.AROUND * 5
    left = sum(item.count or 0 for item in items if isinstance(item, LeftOut))
    assert left + listed(items) == count
    for item, event in zip(items[2::2], (at(250), at(400)), strict=True):
        assert isinstance(item, Shown)
        assert item.frames.t_ns[0] < event <= item.frames.t_ns[-1]


def test_of_a_long_one_only_the_stretches_around_events_are_read() -> None:
    count = module.ONE_PASS_FRAMES + 1
    read = Reader(frames(count))
    items = list(frame_rows(a_capture(count), read))
    assert len(read.asked) == 3
    assert all(start is not None and end is not None for start, end in read.asked)
    assert listed(items) == module.AROUND * 5
    ends = [item.end_ns for item in items if isinstance(item, LeftOut)]
    assert ends[-1] > T0 + (count - 1) * STEP
    assert all(item.count is None for item in items if isinstance(item, LeftOut))


def test_a_long_log_that_would_have_to_be_read_again_and_again_is_not_listed() -> None:
    count = module.ONE_PASS_FRAMES + 1
    read = Reader(frames(10))
    assert list(frame_rows(a_capture(count, ["night.log"]), read)) == [
        LeftOut(T0, T0 + count * STEP + 1, count)
    ]
    assert read.asked == []


def test_a_capture_without_frames_lists_none() -> None:
    empty = analysis(capture=capture_row(frames=0))
    (shown,) = frame_rows(empty, lambda start, end: iter([]))
    assert isinstance(shown, Shown)
    assert len(shown.frames) == 0


@pytest.mark.parametrize(
    ("seq", "line"),
    [
        (0, "0:00.000000 701h 1 00               node 1 entry roller: boot-up"),
        (2, "0:00.013998 703h 1 7F               node 3 press drive: PRE-OPERATIONAL"),
    ],
)
def test_frames_of_the_sample_are_written_as_people_read_canopen(seq: int, line: str) -> None:
    session = open_session(SAMPLES / "bad_day.mcap")
    lines, first = FrameLines(session.analysis), next(session.frames())
    assert lines.line(first, seq, seq)[0] == line


@pytest.mark.parametrize(
    ("can_id", "flags", "data", "words"),
    [
        (0x000, 0, b"\x01\x05", "NMT start: node 5 drum"),
        (0x085, 0, bytes.fromhex("3081110000000000"),
         "EMCY of node 5 drum: 8130h life guard or heartbeat error, register 11h generic, communication"),
        (0x605, 0, bytes.fromhex("4017100000000000"),
         "SDO to node 5 drum: read 1017h:00 producer heartbeat time"),
        (0x605, 0, bytes.fromhex("6000000000000000"), "SDO to node 5 drum: segment"),
        (0x585, 0, b"", "SDO from node 5 drum: segment"),
        (0x705, 2, b"", "guard request to node 5 drum"),
        (0x123, 0, b"\x01", ""),
        (0x12345, 1, b"\x01\x02", ""),
    ],
)  # fmt: skip
def test_a_frame_is_named_by_its_service(can_id: int, flags: int, data: bytes, words: str) -> None:
    shown = analysis(capture=capture_row(buses=["can0"]), nodes=[node_row(5, name="drum")])
    batch = FrameBatch.from_rows([(T0, 0, can_id, flags, len(data), data)])
    line, _ = FrameLines(shown).line(batch, 0, None)
    assert line.endswith(words)
    assert line.startswith("0:00.000000 ")


def test_buses_are_named_where_there_are_several() -> None:
    shown = analysis(capture=capture_row(buses=["can0", "vcan10"]), nodes=[])
    batch = FrameBatch.from_rows([(T0, 1, 0x80, 0, 0, b"")])
    assert "vcan10 080h 0" in FrameLines(shown).line(batch, 0, None)[0]


def test_gaps_do_not_disturb_the_listing() -> None:
    session = open_session(SAMPLES / "bad_day.mcap")
    assert isinstance(session.analysis.capture.gaps[0], GapRow)
    (shown,) = frame_rows(session.analysis, session.frames)
    assert isinstance(shown, Shown)
    assert len(shown.frames) == session.analysis.capture.frames


@pytest.mark.parametrize("name", ["bad_day.mcap", "healthy_line.mcap", "jittery_sync.log"])
def test_a_listed_frame_tells_the_values_that_it_carries(name: str) -> None:
    session = open_session(SAMPLES / name)
    lines = FrameLines(session.analysis)
    said = lines.decoded(session.decoding())
    assert len(said) == session.analysis.capture.frames
    if name != "bad_day.mcap":
        return
    whole = FrameBatch.concat([*session.frames()])
    emcy, pdo = (lines.line(whole, seq, seq, said[seq]) for seq in (1224, 3012))
    assert emcy[0] == (
        "0:12.800119 082h EMCY of node 2 guide roller: 6010h reset by the watchdog, register 01h"
        " general, warnings watchdog reset  [8] 1060010000040000"
    )
    assert pdo[0] == (
        "0:29.201483 18Ah TPDO1 10: Slope longitudinal 16 351.8 deg, Slope lateral 16 6.0 deg"
        "  [4] BE0D3C00"
    )
    assert (emcy[1], pdo[1]) == ("error", "info")


def test_a_part_of_a_capture_is_decoded_by_what_was_told_before_it(tmp_path: Path) -> None:
    session = open_session(SAMPLES / "bad_day.mcap", start="29s", end="30s")
    told = FrameLines(session.analysis).decoded(session.decoding())
    count = sum(map(len, session.frames()))
    assert len(told) == count
    values = [text for text, _ in told if text.startswith("TPDO1 10: ")]
    assert values
    assert all("Slope longitudinal 16 " in text for text in values)
    path = write_rrd(session.analysis, tmp_path / "s.rrd", session.frames, decode=session.decoding)
    shown = columns(path, "/log/frames", "TextLog:text")["TextLog:text"]
    assert len(shown) == count
    assert any(f"{values[0]}" in str(text) for text in shown)
