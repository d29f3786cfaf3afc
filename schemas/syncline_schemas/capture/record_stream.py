"""MCAP records onto a stream, remembering what the summary needs."""

import struct
import zlib
from collections import Counter
from typing import Protocol

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from syncline_schemas.capture.chunk import Chunk

MAGIC = b"\x89MCAP0\r\n"


class ByteSink(Protocol):
    """Anything that takes bytes, all of them at once."""

    def write(self, data: bytes | bytearray, /) -> object:
        """Take the bytes. Raises OSError when it cannot."""
        ...


class RecordStream:
    """Writes whole records, one `write` of the stream for each call.

    The summary's records are kept as bytes: about 150 for each chunk.
    """

    def __init__(self, stream: ByteSink, profile: str, library: str) -> None:
        self._stream = stream
        self._data_crc = 0
        self._groups = {opcode: bytearray() for opcode in _SUMMARY_GROUPS}
        self._schemas: set[int] = set()
        self._channels: set[int] = set()
        self._message_counts: Counter[int] = Counter()
        self._record_counts: Counter[Opcode] = Counter()
        self._start_ns: int | None = None
        self._end_ns = 0
        self.position = 0
        self._write(MAGIC + _bytes_of(Header(profile, library)))

    def schema(self, record: Schema) -> None:
        """Write a schema; one that was written already is left out."""
        if record.id not in self._schemas:
            self._schemas.add(record.id)
            self._write(self._remember(Opcode.SCHEMA, record))

    def channel(self, record: Channel) -> None:
        """Write a channel; one that was written already is left out."""
        if record.id not in self._channels:
            self._channels.add(record.id)
            self._write(self._remember(Opcode.CHANNEL, record))

    def attachment(self, record: Attachment) -> None:
        """Write an attachment and note where it is."""
        data = _bytes_of(record)
        index = AttachmentIndex(
            self.position,
            len(data),
            record.log_time,
            record.create_time,
            len(record.data),
            record.name,
            record.media_type,
        )
        self._remember(Opcode.ATTACHMENT_INDEX, index)
        self._write(data)

    def metadata(self, record: Metadata) -> None:
        """Write a metadata record and note where it is."""
        data = _bytes_of(record)
        self._remember(Opcode.METADATA_INDEX, MetadataIndex(self.position, len(data), record.name))
        self._write(data)

    def chunk(self, chunk: Chunk) -> int:
        """Write a chunk with its message indexes; the number of bytes."""
        start = self.position
        record = _chunk_record(chunk)
        parts, offsets, position = [record], {}, start + len(record)
        for channel, entries in chunk.index:
            offsets[channel] = position
            parts.append(_message_index_record(channel, entries.tobytes()))
            position += len(parts[-1])
            self._message_counts[channel] += len(entries)
        index = ChunkIndex(
            message_start_time=chunk.start_ns,
            message_end_time=chunk.end_ns,
            chunk_start_offset=start,
            chunk_length=len(record),
            message_index_offsets=offsets,
            message_index_length=position - start - len(record),
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            uncompressed_size=chunk.uncompressed_size,
        )
        self._remember(Opcode.CHUNK_INDEX, index)
        first = chunk.start_ns if self._start_ns is None else self._start_ns
        self._start_ns = min(first, chunk.start_ns)
        self._end_ns = max(self._end_ns, chunk.end_ns)
        self._write(b"".join(parts))
        return position - start

    @property
    def summary_bytes(self) -> int:
        """Size of what is kept in memory for the summary."""
        return sum(len(group) for group in self._groups.values())

    @property
    def message_count(self) -> int:
        """Messages of all channels written so far."""
        return self._message_counts.total()

    def finish(self) -> None:
        """Write the end of the data, the summary, the footer and the closing magic."""
        self._write(_bytes_of(DataEnd(self._data_crc)))
        self._groups[Opcode.STATISTICS] += _bytes_of(self._statistics())
        summary_start = self.position
        summary, offsets = bytearray(), bytearray()
        for opcode, group in self._groups.items():
            if group:
                place = SummaryOffset(opcode, summary_start + len(summary), len(group))
                offsets += _bytes_of(place)
                summary += group
        offset_start = summary_start + len(summary)
        summary += offsets
        crc = zlib.crc32(
            struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offset_start),
            zlib.crc32(summary),
        )
        self._write(summary + _bytes_of(Footer(summary_start, offset_start, crc)) + MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=self._record_counts[Opcode.ATTACHMENT_INDEX],
            channel_count=len(self._channels),
            channel_message_counts=dict(sorted(self._message_counts.items())),
            chunk_count=self._record_counts[Opcode.CHUNK_INDEX],
            message_count=self.message_count,
            message_end_time=self._end_ns,
            message_start_time=self._start_ns or 0,
            metadata_count=self._record_counts[Opcode.METADATA_INDEX],
            schema_count=len(self._schemas),
        )

    def _remember(self, opcode: Opcode, record: McapRecord) -> bytes:
        data = _bytes_of(record)
        self._groups[opcode] += data
        self._record_counts[opcode] += 1
        return data

    def _write(self, data: bytes | bytearray) -> None:
        self._stream.write(data)
        self._data_crc = zlib.crc32(data, self._data_crc)
        self.position += len(data)


_SUMMARY_GROUPS = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _chunk_record(chunk: Chunk) -> bytes:
    compression = chunk.compression.encode()
    length = 40 + len(compression) + len(chunk.data)
    head = struct.pack(
        "<BQQQQII",
        Opcode.CHUNK,
        length,
        chunk.start_ns,
        chunk.end_ns,
        chunk.uncompressed_size,
        chunk.crc,
        len(compression),
    )
    return b"".join([head, compression, struct.pack("<Q", len(chunk.data)), chunk.data])


def _message_index_record(channel: int, entries: bytes) -> bytes:
    head = struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries))
    return head + entries
