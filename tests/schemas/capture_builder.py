"""Captures for tests, and what the official MCAP and protobuf packages read in them."""

from collections.abc import Iterable, Sequence
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import mcap.records as mcap_records
import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass
from hypothesis import strategies as st
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.capture.layout import Attachment, BusInfo, CaptureMetadata, Compression
from syncline_schemas.capture.message import MessageBlock
from syncline_schemas.capture.scan import CaptureScan
from syncline_schemas.capture.writer import CaptureWriter

T0 = 1_760_000_000_000_000_000
Row = tuple[int, int, int, int, int, bytes]


def rows(count: int, *, first: int = 0, buses: int = 1) -> list[Row]:
    """Frames a millisecond apart, of different identifiers, lengths and data."""
    return [
        (T0 + i * 1_000_000, i % buses, 0x180 + i % 5, 0, i % 9, bytes([i % 256]) * (i % 9))
        for i in range(first, first + count)
    ]


def batch_rows(batch: FrameBatch) -> list[Row]:
    """A batch as comparable tuples."""
    return [
        (
            int(batch.t_ns[i]),
            int(batch.bus[i]),
            int(batch.can_id[i]),
            int(batch.flags[i]),
            int(batch.dlc[i]),
            batch.payload(i),
        )
        for i in range(len(batch))
    ]


def capture_bytes(
    batches: Iterable[FrameBatch | Sequence[MessageBlock]],
    *,
    buses: int = 1,
    compression: Compression = "zstd",
    attachments: Sequence[Attachment] = (),
    log_time_ns: NDArray[np.int64] | None = None,
    finish: bool = True,
) -> bytes:
    """A capture with one chunk for each batch or list of message blocks."""
    stream = BytesIO()
    writer = CaptureWriter(
        stream,
        CaptureMetadata("0.0.0", "test"),
        [BusInfo(f"can{number}", number, bitrate=500_000) for number in range(buses)],
        compression=compression,
        attachments=attachments,
    )
    for each in batches:
        if isinstance(each, FrameBatch):
            writer.write_chunk(each, log_time_ns)
        else:
            writer.write_chunk(FrameBatch.empty(), None, each)
    if finish:
        writer.finish()
    return stream.getvalue()


def scanned(path: Path, data: bytes | None = None) -> tuple[list[Row], list[Gap], CaptureScan]:
    """All frames and gaps that our reader finds in a file (written first, if bytes are given)."""
    if data is not None:
        path.write_bytes(data)
    scan = CaptureScan(path)
    found: list[Row] = []
    gaps: list[Gap] = []
    for item in scan.batches():
        if isinstance(item, Gap):
            gaps.append(item)
        else:
            found += batch_rows(item)
    return found, gaps, scan


class Official(NamedTuple):
    """A message as the official packages read it, with the schema that the file carries."""

    topic: str
    bus: str
    record: mcap_records.Message
    message: Message


def official_messages(data: bytes) -> list[Official]:
    """Every message in file order, by `mcap` with all checksums and by `protobuf` alone."""
    schemas: dict[int, mcap_records.Schema] = {}
    channels: dict[int, mcap_records.Channel] = {}
    found: list[Official] = []
    for record in StreamReader(BytesIO(data), validate_crcs=True).records:
        if isinstance(record, mcap_records.Schema):
            schemas[record.id] = record
        elif isinstance(record, mcap_records.Channel):
            channels[record.id] = record
        elif isinstance(record, mcap_records.Message):
            channel = channels[record.channel_id]
            message = _message_class(schemas[channel.schema_id]).FromString(record.data)
            found.append(Official(channel.topic, channel.metadata.get("bus", ""), record, message))
    return found


def _message_class(schema: mcap_records.Schema) -> type[Message]:
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(schema.name))


def signed(value: int) -> int:
    """A uint64 of the file as the int64 that was written."""
    return value - (1 << 64) if value >= 1 << 63 else value


_T_NS = st.integers(-(2**61), 2**61) | st.integers(T0, T0 + 10**9)


@st.composite
def frame_rows(draw: st.DrawFn, buses: int = 3) -> Row:
    """Any frame that a bus can carry, at any time."""
    kind = draw(st.sampled_from(["standard", "extended", "remote", "error", "fd"]))
    longest = 64 if kind == "fd" else 8
    data = draw(st.binary(max_size=longest))
    flags = draw(st.sampled_from([0, FrameFlag.TX]))
    can_id = draw(st.integers(0, 0x7FF))
    dlc = len(data)
    if kind == "extended":
        flags, can_id = flags | FrameFlag.EXTENDED, draw(st.integers(0, 0x1FFF_FFFF))
    elif kind == "remote":
        flags, dlc, data = flags | FrameFlag.REMOTE, draw(st.integers(0, 8)), b""
    elif kind == "error":
        flags, can_id = flags | FrameFlag.ERROR, draw(st.integers(0, 0x1FFF_FFFF))
        data = draw(st.binary(min_size=8, max_size=8))
        dlc = 8
    elif kind == "fd":
        flags |= FrameFlag.FD | draw(st.sampled_from([0, FrameFlag.BRS, FrameFlag.ESI]))
    return draw(_T_NS), draw(st.integers(0, buses - 1)), can_id, int(flags), dlc, data
