"""A stretch of a large capture: only the chunks that it needs are read, and nothing else changes."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from syncline_analyzer import open_session
from syncline_analyzer.readers.mcap import McapReader
from syncline_analyzer.reading import Captures
from syncline_analyzer.session import Session
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.gap_message import gap_message
from syncline_schemas.capture.layout import CLOCK_TOPIC, GAP_TOPIC, BusInfo, CaptureMetadata
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.capture.record_file import ChunkPlace, Lost, RawChunk, RecordFile
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.proto import syncline_pb2

SECOND = 1_000_000_000
T0 = 1_760_000_000 * SECOND
CHUNKS = 40
PER_CHUNK = 50
STEP = SECOND // PER_CHUNK


def frames(second: int) -> FrameBatch:
    """A second of two buses; the second one is heard in the first half of the capture only."""
    two = second % CHUNKS < CHUNKS // 2
    return FrameBatch.from_rows(
        [
            (T0 + second * SECOND + i * STEP, i % 2 if two else 0, 0x181 + i % 3, 0, 2, bytes([i, second % 256]))
            for i in range(PER_CHUNK)
        ]
    )  # fmt: skip


def write(
    path: Path, *, segment: int = 0, gap_s: tuple[int, int] | None = None, clocks: bool = False
) -> Path:
    """A chunk for every second; a gap stands in the chunk in which it ends."""
    with path.open("wb") as stream:
        metadata = CaptureMetadata("0.1", "one", segment=segment, clock="kernel")
        writer = CaptureWriter(stream, metadata, [BusInfo("a", 0, 500_000), BusInfo("b", 1)])
        gap_channel = writer.add_channel(GAP_TOPIC, schema_of(syncline_pb2.Gap.DESCRIPTOR))
        clock = writer.add_channel(CLOCK_TOPIC, schema_of(syncline_pb2.ClockSample.DESCRIPTOR))
        for second in range(segment * CHUNKS, (segment + 1) * CHUNKS):
            messages = []
            if gap_s and second == gap_s[1]:
                gap = Gap(T0 + gap_s[0] * SECOND, T0 + gap_s[1] * SECOND, "adapter lost", None, 0)
                messages.append(
                    block(gap_channel, gap.end_ns, gap_message(gap).SerializeToString())
                )
            if clocks:
                sample = syncline_pb2.ClockSample(
                    utc_ns=T0 + second * SECOND, boot_ns=second * SECOND, offset_ns=T0
                )
                messages.append(block(clock, T0 + second * SECOND, sample.SerializeToString()))
            writer.write_chunk(frames(second), messages=messages)
        writer.finish()
    return path


def block(channel: int, t_ns: int, payload: bytes) -> MessageBlock:
    stamp, length = np.array([t_ns], np.int64), np.array([len(payload)], np.int64)
    return MessageBlock(channel, stamp, stamp, length, np.frombuffer(payload, np.uint8))


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Second of each chunk that is read, in order; once of those that need a second look."""
    seconds: list[int] = []
    chunk_at = RecordFile.chunk_at

    def counted(self: RecordFile, place: ChunkPlace, *, indexed: bool = True) -> RawChunk | Lost:
        second = (place.start_ns - T0) // SECOND
        seconds.extend([second] if seconds[-1:] != [second] else [])
        return chunk_at(self, place, indexed=indexed)

    monkeypatch.setattr(RecordFile, "chunk_at", counted)
    return seconds


def numbered(session: Session) -> list[tuple[int, int, int]]:
    """(seq, t_ns, bus) of each frame of a session, as the analyses get them."""
    captures = Captures(session.paths)
    stretch = captures.stretch(session._start, session._end)
    return [
        (seq + i, int(item.t_ns[i]), int(item.bus[i]))
        for seq, item in captures.numbered(stretch)
        if isinstance(item, FrameBatch)
        for i in range(len(item))
    ]


@pytest.mark.parametrize("clocks", [False, True])
def test_only_the_chunks_of_a_stretch_are_read(
    tmp_path: Path, read: list[int], clocks: bool
) -> None:
    session = open_session(write(tmp_path / "a.mcap", clocks=clocks))
    found = FrameBatch.concat(list(session.frames("30s", "32.5s")))
    wanted = FrameBatch.concat([frames(30), frames(31), frames(32)[:25]])
    assert np.array_equal(found.t_ns, wanted.t_ns)
    assert np.array_equal(found.data, wanted.data)
    # The first, where time begins, and the last ones of either bus.
    assert read == [0, 19, 30, 31, 32, 39]


def test_frames_keep_their_place_in_the_whole_capture(tmp_path: Path, read: list[int]) -> None:
    path = write(tmp_path / "a.mcap", gap_s=(3, 9))
    found = numbered(open_session(path, start="25s", end="27s"))
    assert [seq for seq, _, _ in found] == list(range(25 * PER_CHUNK, 27 * PER_CHUNK))
    assert [t_ns for _, t_ns, _ in found] == [
        T0 + 25 * SECOND + i * STEP for i in range(2 * PER_CHUNK)
    ]
    assert read == [0, 9, 19, 25, 26, 39]


def test_a_gap_that_ends_after_the_stretch_is_not_missed(tmp_path: Path, read: list[int]) -> None:
    session = open_session(write(tmp_path / "a.mcap", gap_s=(10, 30)), start="12s", end="14s")
    assert [row.reason for row in session.analysis.capture.gaps] == ["adapter lost"]
    assert 30 in read
    assert 20 not in read


@pytest.mark.parametrize("bounds", [("70s", "81s"), ("5s", "6s"), ("119s", None), (None, "1s")])
@pytest.mark.parametrize("segments", [(0, 1, 2), (0, 2)])
def test_a_stretch_of_segments_is_analyzed_as_if_all_were_read(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    read: list[int],
    bounds: tuple[str | None, str | None],
    segments: tuple[int, ...],
) -> None:
    paths = [
        write(tmp_path / f"{n}.mcap", segment=n, gap_s=(n * CHUNKS + 2, n * CHUNKS + 4))
        for n in segments
    ]
    start, end = bounds
    limited = open_session(paths, start=start, end=end)
    found = limited.analysis
    few = len(read)
    read.clear()
    monkeypatch.setattr(McapReader, "limit", lambda *args: None)
    whole = open_session(paths, start=start, end=end).analysis
    assert few < len(read) // 2
    assert found.capture == whole.capture
    assert found.nodes == whole.nodes
    assert found.bus_load == whole.bus_load
    assert [f.text for f in found.findings] == [f.text for f in whole.findings]
    assert [f.evidence for f in found.findings] == [f.evidence for f in whole.findings]


def test_a_capture_of_a_gap_alone_is_no_mistake(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = CaptureWriter(stream, CaptureMetadata("0.1", "one"), [BusInfo("a", 0)])
        channel = writer.add_channel(GAP_TOPIC, schema_of(syncline_pb2.Gap.DESCRIPTOR))
        gap = Gap(T0, T0 + 5 * SECOND, "adapter lost", 12, 0)
        content = gap_message(gap).SerializeToString()
        writer.write_chunk(FrameBatch.empty(), messages=[block(channel, gap.end_ns, content)])
        writer.finish()
    (told,) = open_session(path).analysis.findings
    assert told.id == "capture.gap"


def test_a_recording_that_was_killed_is_read_from_its_start(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap")
    path.write_bytes(path.read_bytes()[:-2000])
    whole = FrameBatch.concat(list(open_session(path).frames()))
    part = FrameBatch.concat(list(open_session(path).frames("5s", "7s")))
    inside = (whole.t_ns >= T0 + 5 * SECOND) & (whole.t_ns < T0 + 7 * SECOND)
    assert np.array_equal(part.t_ns, whole.t_ns[inside])


def places(path: Path) -> Iterator[tuple[ChunkPlace, RawChunk | Lost]]:
    with path.open("rb") as file:
        records = RecordFile(file)
        summary = records.summary()
        assert summary is not None
        for place in summary.chunks:
            bare = records.chunk_at(place, indexed=False)
            assert isinstance(bare, RawChunk)
            assert bare.index is None
            yield place, records.indexed(bare)


def test_the_summary_tells_how_many_messages_a_chunk_holds(tmp_path: Path) -> None:
    for place, raw in places(write(tmp_path / "a.mcap", gap_s=(3, 9), clocks=True)):
        assert isinstance(raw, RawChunk)
        assert raw.index is not None
        assert place.messages() == {channel: len(rows) for channel, rows in raw.index.items()}
