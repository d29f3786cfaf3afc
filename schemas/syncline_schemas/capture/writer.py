"""Writing a capture: records in order onto a stream, and the summary at the end."""

import hashlib
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version

import mcap.records as mcap_records
import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.chunk import ZSTD_LEVEL, RecordRun, build_chunk, merge
from syncline_schemas.capture.clock_history import ClockHistory
from syncline_schemas.capture.frame_record import pack_frames, pack_messages
from syncline_schemas.capture.lag import LagBounds
from syncline_schemas.capture.layout import (
    ATTACHMENT_METADATA_NAME,
    CLOCK_TOPIC,
    END_METADATA_NAME,
    GAP_TOPIC,
    METADATA_NAME,
    PROFILE,
    Attachment,
    BusInfo,
    CaptureMetadata,
    Compression,
    frames_topic,
)
from syncline_schemas.capture.message import MessageBlock, MessageSchema, schema_of
from syncline_schemas.capture.record_stream import ByteSink, RecordStream
from syncline_schemas.errors import UsageError
from syncline_schemas.proto import syncline_pb2

FRAMES_PER_CHUNK = 16_384
"""Of frames that are not recorded live: about 0.9 MB before compression."""


class CaptureWriter:
    """Writes a capture onto a binary stream, which stays the caller's to flush, sync and close.

    Whole records only: after each call everything given so far stands on the stream, and a file cut
    there or later can be read up to the cut. Header, metadata, attachments and the frame channels
    are written by the constructor, so that a killed recording explains itself.

    Attributes:
        frames_written: frames of all buses.
        bytes_written: bytes given to the stream.
        bus_count: buses so far.

    Raises:
        UsageError: the buses are not numbered 0, 1, 2 ... or two have one topic.
    """

    def __init__(
        self,
        stream: ByteSink,
        metadata: CaptureMetadata,
        buses: Sequence[BusInfo],
        *,
        compression: Compression = "zstd",
        zstd_level: int = ZSTD_LEVEL,
        attachments: Sequence[Attachment] = (),
    ) -> None:
        _check_buses(buses)
        self._records = RecordStream(stream, PROFILE, _library())
        self._created_ns = max(metadata.created_ns, 0)
        self._compression = compression
        self._zstd_level = zstd_level
        self._schema_ids: dict[MessageSchema, int] = {}
        self._channel_ids: dict[tuple[str, MessageSchema], int] = {}
        self._gap_channels: set[int] = set()
        self._clock_channels: set[int] = set()
        self._sequence: dict[int, int] = {}
        self._last_log_ns = 0
        self._lag: LagBounds | None = None
        self._clocks = ClockHistory()
        self._channel_of_bus = np.zeros(256, np.uint16)
        self.bus_count = len(buses)
        self.frames_written = 0
        self.add_metadata(METADATA_NAME, metadata.to_record())
        for attachment in attachments:
            self.attach(attachment)
        for bus in buses:
            self._add_frames_channel(bus)

    @property
    def bytes_written(self) -> int:
        """Bytes given to the stream so far."""
        return self._records.position

    @property
    def index_bytes(self) -> int:
        """Size of the index, which is kept in memory until the file is finished."""
        return self._records.summary_bytes

    def add_channel(
        self, topic: str, schema: MessageSchema, metadata: Mapping[str, str] | None = None
    ) -> int:
        """Register a channel; one of this topic and schema that is there already keeps its id."""
        if (topic, schema) in self._channel_ids:
            return self._channel_ids[topic, schema]
        channel_id = self._channel_ids[topic, schema] = len(self._channel_ids) + 1
        if topic == GAP_TOPIC:
            self._gap_channels.add(channel_id)
        if topic == CLOCK_TOPIC:
            self._clock_channels.add(channel_id)
        self._records.channel(
            mcap_records.Channel(
                id=channel_id,
                topic=topic,
                message_encoding=schema.encoding,
                metadata=dict(metadata or {}),
                schema_id=self._schema_id(schema),
            )
        )
        return channel_id

    def add_bus(self, bus: BusInfo) -> None:
        """Register a bus that became known later, under the next number.

        Raises:
            UsageError: the number is another one, or its name makes the topic of another bus.
        """
        if bus.number != self.bus_count or bus.number > 255:
            raise UsageError(f"the next bus has number {self.bus_count}, not {bus.number}")
        if (frames_topic(bus.name), _FRAME_SCHEMA) in self._channel_ids:
            raise UsageError(f"bus {bus.name!r} gets the topic of another bus; rename one of them")
        self._add_frames_channel(bus)
        self.bus_count += 1

    def _add_frames_channel(self, bus: BusInfo) -> None:
        self._channel_of_bus[bus.number] = self.add_channel(
            frames_topic(bus.name), _FRAME_SCHEMA, bus.to_channel()
        )

    def write_chunk(
        self,
        batch: FrameBatch,
        log_time_ns: NDArray[np.int64] | None = None,
        messages: Sequence[MessageBlock] = (),
    ) -> int:
        """Write frames and other messages as one chunk, merged by `log_time`; the bytes written.

        Of equal times a gap comes first, then the frames, then what is derived from them.

        log_time_ns: (n,) int64; None takes `t_ns`. A time before the last one written, in this
        batch or before it, is written as that one: `log_time` never steps back.
        """
        gaps = [block for block in messages if block.channel in self._gap_channels]
        others = [block for block in messages if block.channel not in self._gap_channels]
        runs = [self._message_run(block) for block in gaps]
        runs.append(self._frame_run(batch, batch.t_ns if log_time_ns is None else log_time_ns))
        runs += [self._message_run(block) for block in others]
        filled = [run for run in runs if len(run.length)]
        if not filled:
            return 0
        merged = merge(filled)
        self._last_log_ns = int(merged.log_time_ns[-1])
        self.frames_written += len(batch)
        return self._records.chunk(build_chunk(merged, self._compression, self._zstd_level))

    def write_frames(self, batch: FrameBatch) -> None:
        """Write a batch of any length that was not recorded just now, in chunks of usual size."""
        for start in range(0, len(batch), FRAMES_PER_CHUNK):
            self.write_chunk(batch[start : start + FRAMES_PER_CHUNK])

    def attach(self, attachment: Attachment) -> None:
        """Write an attachment and a metadata record with its SHA-256."""
        self._records.attachment(
            mcap_records.Attachment(
                create_time=0,
                log_time=max(self._last_log_ns, self._created_ns),
                name=attachment.name,
                media_type=attachment.media_type,
                data=attachment.data,
            )
        )
        digest = hashlib.sha256(attachment.data).hexdigest()
        name = f"{ATTACHMENT_METADATA_NAME}/{attachment.name}"
        self.add_metadata(name, {"name": attachment.name, "sha256": digest})

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self._records.metadata(mcap_records.Metadata(name, dict(values)))

    def finish(self) -> None:
        """Write summary and footer; nothing can be written after it."""
        lag = self._lag.to_record() if self._lag else {}
        told = {"frames": str(self.frames_written), **lag, **self._clocks.to_record()}
        self.add_metadata(END_METADATA_NAME, told)
        self._records.finish()

    def _schema_id(self, schema: MessageSchema) -> int:
        if schema not in self._schema_ids:
            schema_id = self._schema_ids[schema] = len(self._schema_ids) + 1
            record = mcap_records.Schema(
                id=schema_id, name=schema.name, encoding=schema.encoding, data=schema.data
            )
            self._records.schema(record)
        return self._schema_ids[schema]

    def _frame_run(self, batch: FrameBatch, log_time_ns: NDArray[np.int64]) -> RecordRun:
        if len(batch) and int(batch.bus.max()) >= self.bus_count:
            raise ValueError(f"bus {batch.bus.max()} is not one of the {self.bus_count} buses")
        log_time = self._forward_only(log_time_ns)
        self._lag = LagBounds.widened(self._lag, log_time, batch.t_ns)
        channel = self._channel_of_bus[batch.bus]
        sequence = np.empty(len(batch), np.uint32)
        for channel_id in np.unique(channel).tolist():
            rows = channel == channel_id
            sequence[rows] = self._next_sequence(channel_id, int(np.count_nonzero(rows)))
        data, length = pack_frames(batch, self._channel_of_bus, sequence, log_time)
        return RecordRun(data, length, channel, log_time)

    def _message_run(self, block: MessageBlock) -> RecordRun:
        log_time = self._forward_only(block.log_time_ns)
        if block.channel in self._clock_channels:
            self._note_clocks(block, log_time)
        data, length = pack_messages(
            block.channel,
            self._next_sequence(block.channel, len(block)),
            log_time,
            block.publish_time_ns,
            block.length,
            block.payload,
        )
        return RecordRun(data, length, np.full(len(block), block.channel, np.uint16), log_time)

    def _note_clocks(self, block: MessageBlock, log_time_ns: NDArray[np.int64]) -> None:
        ends = np.cumsum(block.length).tolist()
        for log_ns, end, length in zip(log_time_ns.tolist(), ends, block.length, strict=True):
            payload = block.payload[end - length : end].tobytes()
            self._clocks.add(log_ns, syncline_pb2.ClockSample.FromString(payload))

    def _forward_only(self, log_time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.maximum.accumulate(np.maximum(log_time_ns, self._last_log_ns))

    def _next_sequence(self, channel: int, count: int) -> NDArray[np.uint32]:
        first = self._sequence.get(channel, 0)
        self._sequence[channel] = first + count
        return (np.arange(first, first + count) & 0xFFFF_FFFF).astype(np.uint32)


_FRAME_SCHEMA = schema_of(syncline_pb2.Frame.DESCRIPTOR)


def _check_buses(buses: Sequence[BusInfo]) -> None:
    if [bus.number for bus in buses] != list(range(len(buses))) or len(buses) > 256:
        numbers = [bus.number for bus in buses]
        raise UsageError(f"buses are numbered {numbers}; number them 0, 1, 2 ... in order")
    topics: dict[str, str] = {}
    for bus in buses:
        other = topics.setdefault(frames_topic(bus.name), bus.name)
        if len(topics) <= bus.number:
            raise UsageError(f"buses {other!r} and {bus.name!r} get one topic; rename one of them")


def _library() -> str:
    try:
        return f"syncline {version('syncline')}"
    except PackageNotFoundError:
        return "syncline"
