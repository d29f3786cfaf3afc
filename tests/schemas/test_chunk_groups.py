"""Small chunks are read as one: the same items as chunk by chunk, whatever is in them."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture import chunk_group, read_ahead
from syncline_schemas.capture.gap_message import gap_message
from syncline_schemas.capture.layout import GAP_TOPIC, BusInfo, CaptureMetadata, status_topic
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.capture.record_file import RecordFile
from syncline_schemas.capture.scan import BusStatusSample, CaptureScan
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.proto import syncline_pb2

pytestmark = pytest.mark.usefixtures("both_ways")

T0 = 1_760_000_000_000_000_000
MS = 1_000_000

frame = st.tuples(
    st.integers(0, 1),
    st.integers(0, 0x7FF),
    st.sampled_from([0, 1, 4]),
    st.binary(max_size=8) | st.binary(min_size=64, max_size=64),
)
chunk = st.tuples(
    st.lists(frame, max_size=6), st.sampled_from(["", "", "", "gap", "status", "damaged"])
)


def write(path: Path, chunks: list[tuple[list[tuple[int, int, int, bytes]], str]]) -> None:
    with path.open("wb") as stream:
        writer = CaptureWriter(
            stream, CaptureMetadata("0", "id"), [BusInfo("a", 0), BusInfo("b", 1)]
        )
        t_ns = T0
        for frames, other in chunks:
            rows = []
            for bus, can_id, flags, data in frames:
                t_ns += MS
                remote = bool(flags & 4)
                rows.append(
                    (
                        t_ns,
                        bus,
                        can_id,
                        flags,
                        min(len(data), 8) if remote else len(data),
                        b"" if remote else data,
                    )
                )
            batch = FrameBatch.from_rows(rows)
            messages = []
            if other == "gap":
                gap = Gap(t_ns - 3 * MS, t_ns, "adapter lost")
                channel = writer.add_channel(GAP_TOPIC, schema_of(syncline_pb2.Gap.DESCRIPTOR))
                messages = [block(channel, t_ns, gap_message(gap).SerializeToString())]
            if other == "status":
                schema = schema_of(syncline_pb2.BusStatus.DESCRIPTOR)
                channel = writer.add_channel(status_topic("b"), schema)
                status = syncline_pb2.BusStatus(state="active")
                messages = [block(channel, t_ns, status.SerializeToString())]
            writer.write_chunk(batch, messages=messages)
        writer.finish()
    damage(path, [number for number, (_, other) in enumerate(chunks) if other == "damaged"])


def block(channel: int, t_ns: int, payload: bytes) -> MessageBlock:
    stamp, length = np.array([t_ns], np.int64), np.array([len(payload)], np.int64)
    return MessageBlock(channel, stamp, stamp, length, np.frombuffer(payload, np.uint8))


def damage(path: Path, numbers: list[int]) -> None:
    """Change a byte of the data of some chunks."""
    data = bytearray(path.read_bytes())
    with path.open("rb") as stream:
        summary = RecordFile(stream).summary()
    assert summary is not None
    for number in numbers:
        if number < len(summary.chunks):
            place = summary.chunks[number]
            data[place.offset + place.length - place.index_length - 3] ^= 0xFF
    path.write_bytes(data)


def items(path: Path) -> tuple[list[object], list[str], int]:
    """Frames one by one and everything else, in order, with what was damaged."""
    scan = CaptureScan(path)
    found: list[object] = []
    for item in scan.items():
        if isinstance(item, FrameBatch):
            found += [
                (int(item.t_ns[i]), int(item.bus[i]), int(item.can_id[i]), int(item.flags[i]), int(item.dlc[i]), item.payload(i))
                for i in range(len(item))
            ]  # fmt: skip
        elif isinstance(item, BusStatusSample):
            found.append((item.t_ns, item.bus, item.status.state))
        else:
            found.append(item)
    return sorted(found, key=str), scan.facts.damage, scan.facts.lost_frames


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(chunks=st.lists(chunk, min_size=1, max_size=9))
def test_groups_tell_what_their_chunks_tell(
    tmp_path: Path, chunks: list[tuple[list[tuple[int, int, int, bytes]], str]]
) -> None:
    path = tmp_path / "a.mcap"
    write(path, chunks)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(read_ahead, "default_workers", lambda: 1)
        patch.setattr(chunk_group._Run, "add", lambda run, raw: False)
        patch.setattr(chunk_group, "_plain_by_index", lambda group, channels: None)
        one_by_one = items(path)
    assert items(path) == one_by_one
