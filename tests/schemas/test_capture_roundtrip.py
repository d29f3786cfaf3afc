"""What is written is what the official readers, the doctor and our own reader find."""

import subprocess
import sys
import tempfile
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.capture.layout import (
    Attachment,
    BusInfo,
    CaptureMetadata,
    Compression,
    description_attachment,
    eds_attachment,
)
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.capture.scan import BusStatusSample, CaptureScan, ClockReading
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.errors import UsageError
from syncline_schemas.proto import syncline_pb2
from tests.schemas.capture_builder import (
    T0,
    Row,
    capture_bytes,
    frame_rows,
    official_messages,
    rows,
    scanned,
    signed,
)

COMPRESSIONS: list[Compression] = ["zstd", "lz4", "none"]


def official_rows(data: bytes) -> list[Row]:
    """Frames as the official packages read them."""
    found: list[Row] = []
    for each in official_messages(data):
        values = {field.name: value for field, value in each.message.ListFields()}
        assert list(values) == ["can_id", "flags", "dlc", "data"]
        number = int(each.bus.removeprefix("can"))
        found.append((signed(each.record.publish_time), number, *values.values()))
    return found


@settings(max_examples=120, deadline=None)
@given(
    chunks=st.lists(st.lists(frame_rows(), min_size=1, max_size=30), max_size=4),
    compression=st.sampled_from(COMPRESSIONS),
)
def test_every_frame_comes_back_in_order(chunks: list[list[Row]], compression: Compression) -> None:
    batches = [FrameBatch.from_rows(chunk) for chunk in chunks]
    data = capture_bytes(batches, buses=3, compression=compression)
    written = [row for chunk in chunks for row in chunk]
    assert official_rows(data) == written
    with tempfile.TemporaryDirectory() as folder:
        found, gaps, scan = scanned(Path(folder, "a.mcap"), data)
    assert found == written
    assert (gaps, scan.facts.damage, scan.facts.closed) == ([], [], True)
    assert [bus.name for bus in scan.facts.buses] == ["can0", "can1", "can2"]


@settings(max_examples=50, deadline=None)
@given(chunks=st.lists(st.lists(frame_rows(), min_size=1, max_size=20), min_size=1, max_size=3))
def test_log_time_never_steps_back_and_sequences_count_each_bus(chunks: list[list[Row]]) -> None:
    data = capture_bytes([FrameBatch.from_rows(chunk) for chunk in chunks], buses=3)
    messages = official_messages(data)
    times = [each.record.log_time for each in messages]
    assert all(a <= b for a, b in pairwise(times))
    for bus in {each.bus for each in messages}:
        counted = [each.record.sequence for each in messages if each.bus == bus]
        assert counted == list(range(len(counted)))


def test_log_time_is_what_the_recorder_said() -> None:
    batch = FrameBatch.from_rows(rows(3))
    taken = batch.t_ns + np.array([5, 7, 9])
    messages = official_messages(capture_bytes([batch], log_time_ns=taken))
    assert [m.record.log_time for m in messages] == taken.tolist()
    assert [m.record.publish_time for m in messages] == batch.t_ns.tolist()


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_the_doctor_finds_no_fault(tmp_path: Path, compression: Compression) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(full_capture(compression))
    program = Path(sys.executable).with_name("pymcap-cli")
    if not program.exists():
        pytest.skip("pymcap-cli is not installed")
    arguments = [str(program), "doctor", "--strict-message-order", "--format", "jsonl", str(path)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert '"error"' not in done.stdout
    assert '"warning"' not in done.stdout


def full_capture(compression: Compression = "zstd") -> bytes:
    """Two buses, status, clock, a gap, attachments, several chunks."""
    stream = BytesIO()
    writer = CaptureWriter(
        stream,
        CaptureMetadata("0.0.0", "test", created_ns=T0),
        [BusInfo("can0", 0, 250_000), BusInfo("vcan 1", 1)],
        compression=compression,
        attachments=[description_attachment("[bus]\n"), eds_attachment("a.eds", b"[FileInfo]\xff")],
    )
    status = writer.add_channel(
        "/can/vcan_1/status", schema_of(syncline_pb2.BusStatus.DESCRIPTOR), {"bus": "vcan 1"}
    )
    clock = writer.add_channel("/recorder/clock", schema_of(syncline_pb2.ClockSample.DESCRIPTOR))
    for first in (0, 100, 200):
        batch = FrameBatch.from_rows(rows(100, first=first, buses=2))
        half = [int(batch.t_ns[50])]
        messages = [
            MessageBlock.of_messages(
                status, half, half, [syncline_pb2.BusStatus(state="active", tx_errors=0)]
            ),
            MessageBlock.of_messages(
                clock, half, half, [syncline_pb2.ClockSample(utc_ns=half[0], monotonic_ns=first)]
            ),
        ]
        writer.write_chunk(batch, None, messages)
    writer.attach(Attachment("late.bin", "application/octet-stream", b""))
    writer.finish()
    assert writer.bytes_written == len(stream.getvalue())
    return stream.getvalue()


def test_the_official_reader_finds_the_summary() -> None:
    data = full_capture()
    reader = make_reader(BytesIO(data), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 306
    assert summary.statistics.chunk_count == 3
    assert summary.statistics.message_start_time == T0
    assert summary.statistics.message_end_time == T0 + 299_000_000
    assert {schema.name for schema in summary.schemas.values()} == {
        "syncline.Frame",
        "syncline.BusStatus",
        "syncline.ClockSample",
    }
    assert {a.name: a.data for a in reader.iter_attachments()} == {
        "bus-description.toml": b"[bus]\n",
        "a.eds": b"[FileInfo]\xff",
        "late.bin": b"",
    }
    assert dict(reader.get_header().__dict__)["profile"] == "syncline"
    names = [record.name for record in reader.iter_metadata()]
    assert names[0] == "syncline"
    assert len(names) == len(set(names))
    assert sum(1 for _ in reader.iter_messages(topics=["/can/vcan_1/frames"])) == 150


def test_status_and_clock_are_read_with_their_bus(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(full_capture())
    items = list(CaptureScan(path).items())
    status = [item for item in items if isinstance(item, BusStatusSample)]
    clock = [item for item in items if isinstance(item, ClockReading)]
    assert [(item.t_ns, item.bus, item.status.state) for item in status] == [
        (T0 + first * 1_000_000 + 50_000_000, 1, "active") for first in (0, 100, 200)
    ]
    assert [item.sample.monotonic_ns for item in clock] == [0, 100, 200]
    assert sum(len(item) for item in items if isinstance(item, FrameBatch)) == 300


def test_facts_are_there_before_the_first_frame(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(full_capture())
    facts = CaptureScan(path).facts
    assert facts.metadata is not None
    assert facts.metadata.recording_id == "test"
    assert [attachment.name for attachment in facts.attachments] == [
        "bus-description.toml",
        "a.eds",
        "late.bin",
    ]
    assert [(bus.name, bus.bitrate) for bus in facts.buses] == [("can0", 250_000), ("vcan 1", None)]


def test_a_large_batch_is_written_in_several_chunks(tmp_path: Path) -> None:
    stream = BytesIO()
    writer = CaptureWriter(stream, CaptureMetadata("0", "id"), [BusInfo("can0", 0)])
    written = rows(40_000)
    writer.write_frames(FrameBatch.from_rows(written))
    writer.finish()
    found, _, _ = scanned(tmp_path / "a.mcap", stream.getvalue())
    assert found == written
    summary = make_reader(BytesIO(stream.getvalue())).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 3


@pytest.mark.parametrize(
    "buses",
    [[BusInfo("a", 1)], [BusInfo("a", 0), BusInfo("b", 0)], [BusInfo("a b", 0), BusInfo("a/b", 1)]],
)
def test_buses_that_cannot_be_told_apart_are_refused(buses: list[BusInfo]) -> None:
    with pytest.raises(UsageError):
        CaptureWriter(BytesIO(), CaptureMetadata("0", "id"), buses)


def test_a_bus_that_was_not_announced_is_refused() -> None:
    with pytest.raises(ValueError, match="bus 2"):
        capture_bytes([FrameBatch.from_rows([(T0, 2, 1, 0, 0, b"")])])


def test_nothing_to_write_writes_nothing(tmp_path: Path) -> None:
    found, gaps, scan = scanned(tmp_path / "a.mcap", capture_bytes([FrameBatch.empty()]))
    assert (found, gaps, scan.facts.damage) == ([], [], [])


def test_a_channel_is_registered_once_for_each_schema() -> None:
    writer = CaptureWriter(BytesIO(), CaptureMetadata("0", "id"), [])
    nmt, sync = schema_of(syncline_pb2.Nmt.DESCRIPTOR), schema_of(syncline_pb2.Sync.DESCRIPTOR)
    first = writer.add_channel("/x", nmt)
    assert writer.add_channel("/x", nmt) == first
    assert writer.add_channel("/x", sync) != first


RANGES = [(0, 300), (10, 11), (150, 160), (299, 400), (50, 50)]


@pytest.mark.parametrize(("first", "end"), RANGES)
@pytest.mark.parametrize("lag_ns", [0, 3_000_000, -2_000_000])
def test_a_time_range_takes_frames_by_their_stamp(
    tmp_path: Path, first: int, end: int, lag_ns: int
) -> None:
    stream = BytesIO()
    writer = CaptureWriter(stream, CaptureMetadata("0", "id"), [BusInfo("can0", 0)])
    for start in range(0, 300, 10):
        batch = FrameBatch.from_rows(rows(10, first=start))
        writer.write_chunk(batch, batch.t_ns + lag_ns)
    writer.finish()
    path = tmp_path / "a.mcap"
    path.write_bytes(stream.getvalue())
    bounds = T0 + first * 1_000_000, T0 + end * 1_000_000
    scan = CaptureScan(path, start_ns=bounds[0], end_ns=bounds[1])
    stamps = [int(t) for item in scan.batches() if isinstance(item, FrameBatch) for t in item.t_ns]
    assert stamps == [T0 + i * 1_000_000 for i in range(first, min(end, 300))]


def test_a_time_range_reads_only_the_chunks_it_needs(tmp_path: Path) -> None:
    data = bytearray(capture_bytes(FrameBatch.from_rows(rows(10, first=i)) for i in (0, 10, 20)))
    summary = make_reader(BytesIO(bytes(data))).get_summary()
    assert summary is not None
    first = summary.chunk_indexes[0]
    start = first.chunk_start_offset
    data[start + 60 : start + first.chunk_length] = bytes(first.chunk_length - 60)
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    scan = CaptureScan(path, start_ns=T0 + 10_000_000)
    assert sum(len(item) for item in scan.batches() if isinstance(item, FrameBatch)) == 20
    assert scan.facts.damage == []


def test_error_frames_are_kept_bit_by_bit(tmp_path: Path) -> None:
    written = [(T0, 0, 0x0000_00AC, int(FrameFlag.ERROR), 8, bytes(range(0xF8, 0x100)))]
    found, _, _ = scanned(tmp_path / "a.mcap", capture_bytes([FrameBatch.from_rows(written)]))
    assert found == written
