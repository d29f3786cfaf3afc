"""The analyzer's reader of our own captures: facts, ranges, damage, and files that are not ours."""

from io import BytesIO
from pathlib import Path

import pytest
from mcap.writer import Writer

from syncline_analyzer.readers import open_capture
from syncline_analyzer.readers.mcap import McapReader
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.capture.layout import (
    BusInfo,
    CaptureMetadata,
    description_attachment,
    eds_attachment,
)
from syncline_schemas.capture.recover import recover
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.errors import CaptureError

T0 = 1_760_000_000_000_000_000


def frames(count: int = 100) -> FrameBatch:
    return FrameBatch.from_rows(
        [(T0 + i * 1_000_000, i % 2, 0x181, 0, 2, bytes([i, 0])) for i in range(count)]
    )


def capture(*, finish: bool = True, clock: str = "kernel", time_base: str = "utc") -> bytes:
    """Two buses, two attachments, one chunk of a hundred frames."""
    stream = BytesIO()
    writer = CaptureWriter(
        stream,
        CaptureMetadata("0.1", "id", clock=clock, resolution_ns=1000, time_base=time_base),
        [BusInfo("line", 0, 500_000, 2_000_000), BusInfo("spare", 1)],
        attachments=[description_attachment("[bus]\n"), eds_attachment("x.eds", b"[FileInfo]")],
    )
    writer.write_chunk(frames())
    if finish:
        writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize("finish", [True, False])
def test_facts_are_known_before_the_first_frame(tmp_path: Path, finish: bool) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(capture(finish=finish))
    facts = McapReader(path).facts
    assert facts.buses == ["line", "spare"]
    assert facts.bitrates == {"line": 500_000}
    assert facts.data_bitrates == {"line": 2_000_000}
    assert (facts.clock, facts.resolution_ns, facts.time_base) == ("kernel", 1000, "utc")
    assert facts.description_toml == "[bus]\n"
    assert facts.eds_files == {"x.eds": b"[FileInfo]"}
    assert facts.metadata["recording_id"] == "id"


def test_the_content_decides_which_reader_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "renamed.log"
    path.write_bytes(capture())
    (batch,) = open_capture(path).batches()
    assert isinstance(batch, FrameBatch)
    assert batch.t_ns.tolist() == frames().t_ns.tolist()
    assert batch.bus.tolist() == frames().bus.tolist()


def test_a_range_is_half_open(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(capture())
    (batch,) = McapReader(path, T0 + 10_000_000, T0 + 12_000_000).batches()
    assert isinstance(batch, FrameBatch)
    assert batch.data[:, 0].tolist() == [10, 11]


def test_a_cut_file_says_what_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    whole = capture(finish=False)
    path.write_bytes(whole)
    reader = McapReader(path)
    assert [len(item) for item in reader.batches() if isinstance(item, FrameBatch)] == [100]
    assert reader.facts.damage == "no footer: the recording was cut off or still runs"
    path.write_bytes(whole[:-1700])
    reader = McapReader(path)
    (gap,) = reader.batches()
    assert isinstance(gap, Gap)
    assert gap.start_ns == T0
    assert "cut off" in (reader.facts.damage or "")


def test_a_time_base_that_nobody_knows_is_taken_as_utc(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(capture(time_base="martian"))
    assert McapReader(path).facts.time_base == "utc"


@pytest.mark.parametrize("finish", [True, False])
def test_an_mcap_file_without_our_frames_is_refused_with_its_schemas(
    tmp_path: Path, finish: bool
) -> None:
    path = tmp_path / "a.mcap"
    stream = BytesIO()
    writer = Writer(stream, chunk_size=1)
    writer.start("ros2")
    schema = writer.register_schema("can_msgs/msg/Frame", "ros2msg", b"uint32 id")
    channel = writer.register_channel("/can", "cdr", schema)
    writer.add_message(channel, 1, b"x", 1)
    writer.finish()
    data = stream.getvalue()
    path.write_bytes(data if finish else data[:-8])
    if finish:
        with pytest.raises(CaptureError, match="can_msgs/msg/Frame"):
            McapReader(path)
    else:
        with pytest.raises(CaptureError, match="can_msgs/msg/Frame"):
            list(McapReader(path).batches())


def test_an_empty_recording_is_a_capture(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    stream = BytesIO()
    CaptureWriter(stream, CaptureMetadata("0", "id"), []).finish()
    path.write_bytes(stream.getvalue())
    reader = McapReader(path)
    assert list(reader.batches()) == []
    assert reader.facts.damage is None


def test_a_recovered_capture_says_so(tmp_path: Path) -> None:
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    source.write_bytes(capture(finish=False)[:-1700])
    recover(source, target)
    reader = McapReader(target)
    (gap,) = reader.batches()
    assert isinstance(gap, Gap)
    assert reader.facts.damage is None
    (note,) = reader.facts.notes
    assert note.startswith("recovered from a.mcap: chunk at byte")


@pytest.mark.parametrize("beside", [0, 64])
def test_a_remote_frame_of_a_length_that_there_is_not_is_none_whatever_stands_beside_it(
    tmp_path: Path, beside: int
) -> None:
    """Frames of 64 bytes make the columns of all frames that are read with them wider."""
    path, remote = tmp_path / "a.mcap", int(FrameFlag.REMOTE)
    rows = [(T0, 0, 0x701, remote, 8, b""), (T0 + 1, 0, 0x702, remote, 9, b"")]
    rows += [(T0 + 2, 0, 0x300, int(FrameFlag.FD), beside, bytes(beside))]
    stream = BytesIO()
    writer = CaptureWriter(stream, CaptureMetadata("0.1", "id"), [BusInfo("line", 0)])
    writer.write_chunk(FrameBatch.from_rows(rows))
    writer.finish()
    path.write_bytes(stream.getvalue())
    reader = McapReader(path)
    (batch,) = reader.batches()
    assert isinstance(batch, FrameBatch)
    assert batch.can_id.tolist() == [0x701, 0x300]
    assert reader.facts.unparsed_count == 1
