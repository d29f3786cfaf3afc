"""Our messages in files that other tools wrote or wrote anew."""

import subprocess
import sys
from io import BytesIO
from pathlib import Path

import mcap.records as mcap_records
import pytest
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.capture.chunk_content import parse_frame
from syncline_schemas.capture.gap_message import gap_message
from syncline_schemas.capture.layout import BusInfo, CaptureMetadata
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.capture.recover import recover
from syncline_schemas.capture.scan import CaptureScan
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.proto import syncline_pb2
from tests.schemas.capture_builder import T0, Row, capture_bytes, rows, scanned

FRAME = schema_of(syncline_pb2.Frame.DESCRIPTOR)
LAYOUTS: dict[str, dict[str, object]] = {
    "as usual": {},
    "small chunks": {"chunk_size": 300},
    "no compression": {"compression": CompressionType.NONE},
    "lz4": {"compression": CompressionType.LZ4},
    "no chunks": {"use_chunking": False},
    "no message index": {"index_types": IndexType.CHUNK},
    "no index at all": {"index_types": IndexType.NONE},
    "no statistics": {"use_statistics": False},
    "no channels in the summary": {"repeat_channels": False, "repeat_schemas": False},
    "no checksums": {"enable_crcs": False},
}


def official_file(
    frames: list[Row], payloads: list[bytes], *, finish: bool = True, **options: object
) -> bytes:
    """A file by the official writer: one channel for each bus, and one that is none of ours."""
    stream = BytesIO()
    writer = Writer(stream, **options)  # type: ignore[arg-type]
    writer.start("syncline", "test")
    schema = writer.register_schema(FRAME.name, FRAME.encoding, FRAME.data)
    other = writer.register_channel("/other", "json", 0)
    channels: dict[int, int] = {}
    for sequence, (row, payload) in enumerate(zip(frames, payloads, strict=True)):
        if row[1] not in channels:
            channels[row[1]] = writer.register_channel(
                f"/can/can{row[1]}/frames", "protobuf", schema
            )
        writer.add_message(channels[row[1]], row[0], payload, row[0], sequence)
        writer.add_message(other, row[0], b"{}", row[0])
    if finish:
        writer.finish()
    return stream.getvalue()


def serialized(row: Row) -> bytes:
    """A frame as any protobuf program writes it."""
    _, _, can_id, flags, dlc, data = row
    return syncline_pb2.Frame(can_id=can_id, flags=flags, dlc=dlc, data=data).SerializeToString()


@pytest.mark.parametrize("finish", [True, False])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_files_of_the_official_writer_are_read(tmp_path: Path, layout: str, finish: bool) -> None:
    frames = rows(60, buses=2)
    payloads = [serialized(row) for row in frames]
    data = official_file(frames, payloads, finish=finish, **LAYOUTS[layout])
    found, gaps, scan = scanned(tmp_path / "a.mcap", data)
    # An unfinished file of the official writer ends with the last chunk that was full.
    assert found == (frames if finish or layout == "no chunks" else frames[: len(found)])
    assert gaps == []
    assert [bus.name for bus in scan.facts.buses] == (["can0", "can1"] if found else [])
    assert bool(scan.facts.damage) is not finish


def reordered(row: Row) -> bytes:
    """A frame with its fields in another order, which protobuf allows."""
    _, _, can_id, flags, dlc, data = row
    return (
        b"\x22" + bytes([len(data)]) + data
        + b"\x15" + flags.to_bytes(4, "little")
        + b"\x18" + bytes([dlc])
        + b"\x0d" + can_id.to_bytes(4, "little")
    )  # fmt: skip


def swapped(row: Row) -> bytes:
    """A frame whose first two fields, of equal length, stand in the other order."""
    usual = serialized(row)
    return usual[5:10] + usual[:5] + usual[10:]


def without_zeros(row: Row) -> bytes:
    """A frame with zero fields left out, as a writer without explicit presence makes it."""
    _, _, can_id, flags, dlc, data = row
    frame = syncline_pb2.Frame()
    for name, value in (("can_id", can_id), ("flags", flags), ("dlc", dlc), ("data", data)):
        if value:
            setattr(frame, name, value)
    return frame.SerializeToString()


def with_more(row: Row) -> bytes:
    """A frame with a field that a later version may add."""
    return serialized(row) + b"\x2a\x03new"


@pytest.mark.parametrize("encode", [reordered, swapped, without_zeros, with_more])
def test_frames_in_other_encodings_mix_with_ours(tmp_path: Path, encode: object) -> None:
    assert callable(encode)
    frames = rows(50, buses=2)
    frames[7] = (frames[7][0], 1, 0x701, int(FrameFlag.REMOTE), 1, b"")
    frames[8] = (frames[8][0], 0, 0x123, int(FrameFlag.FD), 64, bytes(range(64)))
    payloads = [serialized(row) if i % 3 else encode(row) for i, row in enumerate(frames)]
    found, _, scan = scanned(tmp_path / "a.mcap", official_file(frames, payloads))
    assert found == frames
    assert scan.facts.damage == []


def test_messages_that_are_no_frames_are_counted(tmp_path: Path) -> None:
    frames = rows(10)
    payloads = [serialized(row) for row in frames]
    payloads[3] = b"\xff\xff\xff"
    payloads[5] = serialized((T0, 0, 1, 0, 65, bytes(65)))
    found, _, scan = scanned(tmp_path / "a.mcap", official_file(frames, payloads))
    assert found == [row for i, row in enumerate(frames) if i not in (3, 5)]
    assert scan.facts.lost_frames == 2
    assert scan.facts.damage == ["2 messages are no frames"]


@pytest.mark.parametrize(
    ("frame", "read"),
    [
        ({"can_id": 1, "dlc": 3, "data": b"ab"}, (1, FrameFlag.DLC_INVALID, 2, b"ab")),
        ({"can_id": 1, "data": b"ab"}, (1, FrameFlag.DLC_INVALID, 2, b"ab")),
        ({"can_id": 1, "flags": FrameFlag.REMOTE, "dlc": 5}, (1, FrameFlag.REMOTE, 5, b"")),
        ({"can_id": 1 << 29, "dlc": 0}, None),
        ({}, (0, 0, 0, b"")),
    ],
)
def test_lengths_that_contradict_the_data_are_marked(
    frame: dict[str, int | bytes], read: tuple[int, int, int, bytes] | None
) -> None:
    payload = syncline_pb2.Frame(**frame).SerializeToString()  # type: ignore[arg-type]
    assert parse_frame(payload) == read


def test_a_length_that_contradicts_the_data_is_marked_in_our_layout_too(tmp_path: Path) -> None:
    frames = rows(5)
    payloads = [serialized(row) for row in frames]
    payloads[2] = serialized((T0, 0, 1, 0, 3, b"ab"))
    found, _, _ = scanned(tmp_path / "a.mcap", official_file(frames, payloads))
    assert found[2][2:] == (1, FrameFlag.DLC_INVALID, 2, b"ab")


def test_an_unfinished_file_of_another_writer_is_recovered_with_its_channels(
    tmp_path: Path,
) -> None:
    frames = rows(60, buses=2)
    payloads = [serialized(row) for row in frames]
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    source.write_bytes(official_file(frames, payloads, finish=False, chunk_size=300))
    recover(source, target)
    found, _, _ = scanned(target)
    assert found == frames[: len(found)]
    assert found
    topics = {
        channel.topic for _, channel, _ in make_reader(BytesIO(target.read_bytes())).iter_messages()
    }
    assert topics == {"/can/can0/frames", "/can/can1/frames", "/other"}


def remuxed(data: bytes) -> bytes:
    """Every message read and written by the official library, metadata left behind."""
    reader, stream = make_reader(BytesIO(data)), BytesIO()
    writer = Writer(stream, compression=CompressionType.LZ4, chunk_size=1000)
    writer.start()
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for schema, channel, message in reader.iter_messages():
        assert schema is not None
        if schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
            )
        times = message.log_time, message.data, message.publish_time
        writer.add_message(channels[channel.id], *times, message.sequence)
    writer.finish()
    return stream.getvalue()


def test_a_remuxed_capture_reads_the_same(tmp_path: Path) -> None:
    written = rows(200, buses=3)
    data = capture_bytes(
        [FrameBatch.from_rows(written[:100]), FrameBatch.from_rows(written[100:])], buses=3
    )
    found, gaps, scan = scanned(tmp_path / "a.mcap", remuxed(data))
    assert (found, gaps, scan.facts.damage) == (written, [], [])
    assert [(bus.name, bus.bitrate) for bus in scan.facts.buses] == [
        (f"can{i}", 500_000) for i in range(3)
    ]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_capture_compressed_anew_by_pymcap_reads_the_same(
    tmp_path: Path, compression: str
) -> None:
    program = Path(sys.executable).with_name("pymcap-cli")
    if not program.exists():
        pytest.skip("pymcap-cli is not installed")
    written = rows(200, buses=2)
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    source.write_bytes(capture_bytes([FrameBatch.from_rows(written)], buses=2))
    arguments = [str(program), "compress", str(source), "-o", str(target)]
    subprocess.run([*arguments, "--compression", compression], check=True, capture_output=True)
    found, _, scan = scanned(target)
    assert (found, scan.facts.damage) == (written, [])
    assert scan.facts.metadata is not None


def test_a_gap_stands_between_the_frames_before_and_after_it(tmp_path: Path) -> None:
    stream = BytesIO()
    writer = _writer(stream)
    channel = writer.add_channel("/recorder/gap", schema_of(syncline_pb2.Gap.DESCRIPTOR))
    batch = FrameBatch.from_rows(rows(10))
    told = [
        Gap(T0 + 3_100_000, T0 + 3_900_000, "adapter lost", 5, 0),
        Gap(T0 + 7_200_000, T0 + 7_300_000, "x"),
    ]
    times = [T0 + 3_900_000, T0 + 7_300_000]
    block = MessageBlock.of_messages(channel, times, times, [gap_message(gap) for gap in told])
    writer.write_chunk(batch, None, [block])
    writer.finish()
    path = tmp_path / "a.mcap"
    path.write_bytes(stream.getvalue())
    items = list(CaptureScan(path).batches())
    assert [len(item) if isinstance(item, FrameBatch) else item for item in items] == [
        4,
        told[0],
        4,
        told[1],
        2,
    ]
    narrow = list(CaptureScan(path, start_ns=T0 + 3_500_000, end_ns=T0 + 5_000_000).batches())
    assert narrow[0] == Gap(T0 + 3_500_000, T0 + 3_900_000, "adapter lost", 5, 0)
    assert [len(item) for item in narrow[1:] if isinstance(item, FrameBatch)] == [1]


def _writer(stream: BytesIO) -> CaptureWriter:
    return CaptureWriter(stream, CaptureMetadata("0", "id"), [BusInfo("can0", 0)])


def test_a_gap_that_ends_with_a_frame_stands_before_that_frame(tmp_path: Path) -> None:
    stream = BytesIO()
    writer = _writer(stream)
    channel = writer.add_channel("/recorder/gap", schema_of(syncline_pb2.Gap.DESCRIPTOR))
    gap = Gap(T0 + 1, T0 + 5_000_000, "adapter lost")
    block = MessageBlock.of_messages(channel, [gap.end_ns], [gap.end_ns], [gap_message(gap)])
    writer.write_chunk(FrameBatch.from_rows(rows(10)), None, [block])
    path = tmp_path / "a.mcap"
    path.write_bytes(stream.getvalue())
    items = list(CaptureScan(path).batches())
    assert [len(item) if isinstance(item, FrameBatch) else item for item in items] == [5, gap, 5]


def test_two_channels_of_one_bus_stay_one_bus(tmp_path: Path) -> None:
    stream = BytesIO()
    writer = Writer(stream)
    writer.start("syncline")
    schema = writer.register_schema(FRAME.name, FRAME.encoding, FRAME.data)
    metadata = [{"bus": "can0", "number": "0"}, {"bus": "can1", "number": "0"}, {"bus": "can0"}]
    for i, each in enumerate(metadata):
        channel = writer.register_channel(f"/{i}", "protobuf", schema, each)
        writer.add_message(channel, T0 + i, serialized((T0, 0, i, 0, 0, b"")), T0 + i)
    writer.finish()
    found, _, scan = scanned(tmp_path / "a.mcap", stream.getvalue())
    assert [row[1] for row in found] == [0, 1, 0]
    assert [(bus.name, bus.number) for bus in scan.facts.buses] == [("can0", 0), ("can1", 1)]


def test_messages_of_undescribed_channels_are_reported(tmp_path: Path) -> None:
    data = official_file(rows(1), [serialized(rows(1)[0])], use_chunking=False, finish=False)
    record = mcap_records.Message(99, 1, b"x", 1, 0)
    builder = RecordBuilder()
    record.write(builder)
    found, _, scan = scanned(tmp_path / "a.mcap", data + builder.end())
    assert len(found) == 1
    assert "1 messages of channels that are not described" in scan.facts.damage
