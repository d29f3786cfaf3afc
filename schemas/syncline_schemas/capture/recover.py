"""Make a regular file of a damaged capture."""

import os
from collections.abc import Callable
from dataclasses import field
from pathlib import Path
from typing import BinaryIO

import mcap.records as mcap_records
import numpy as np

from syncline_schemas.batch import Gap
from syncline_schemas.capture.channels import ChannelTable, Kind
from syncline_schemas.capture.chunk import Chunk, RecordRun, build_chunk, message_index
from syncline_schemas.capture.chunk_content import (
    ChunkContent,
    frame_channels_by_content,
    open_chunk,
    read_frames,
)
from syncline_schemas.capture.frame_record import pack_messages
from syncline_schemas.capture.gap_message import gap_message
from syncline_schemas.capture.lag import LagBounds
from syncline_schemas.capture.layout import (
    END_METADATA_NAME,
    GAP_TOPIC,
    PROFILE,
    PROTOBUF,
    RECOVER_METADATA_NAME,
)
from syncline_schemas.capture.loss import LossTracker
from syncline_schemas.capture.message import schema_of
from syncline_schemas.capture.record_file import Definition, Document, Lost, RawChunk, RecordFile
from syncline_schemas.capture.record_stream import RecordStream
from syncline_schemas.errors import CaptureError, UsageError
from syncline_schemas.proto import syncline_pb2
from syncline_schemas.records import dataclass

_GAP_ID = 0xFFFF
"""Channel and schema id of the gaps that recovery adds, far from those that writers count up."""


@dataclass(slots=True)
class RecoverResult:
    """What was saved and what was not.

    Attributes:
        whole: the source needed no repair.
        frames: frames that the target holds.
        messages: messages of all channels that the target holds.
        lost_chunks: chunks that could not be read.
        lost_frames: frames known to be lost with them; others may be uncounted.
        damage: what was wrong, each in words.
    """

    whole: bool = True
    frames: int = 0
    messages: int = 0
    lost_chunks: int = 0
    lost_frames: int = 0
    damage: list[str] = field(default_factory=list)


def is_whole(path: Path) -> bool:
    """Whether a capture has a footer and an undamaged summary; a quick look, no chunk is read.

    Raises:
        CaptureError: the path cannot be opened.
    """
    with _open(path) as file:
        summary = RecordFile(file).summary()
        return summary is not None and summary.complete


def recover(
    source: Path, target: Path, progress: Callable[[int], None] | None = None
) -> RecoverResult:
    """Write all that can be read of `source` to `target`, a file with summary and footer.

    Attachments, metadata and every message of every channel are kept as they are, byte for byte.
    Where a chunk was lost, a gap is written. `target` appears only when it is complete, on disk.
    `progress` is called after each chunk with the frames saved so far.

    Raises:
        CaptureError: `source` cannot be opened or is no MCAP file.
        UsageError: `target` is `source`.
    """
    if target.exists() and target.samefile(source):
        raise UsageError(f"{target} cannot be recovered onto itself; name another file")
    partial = target.with_name(f"{target.name}.partial")
    with _open(source) as file:
        records = RecordFile(file)
        if not records.plausible:
            raise CaptureError(f"{source} is no MCAP file")
        try:
            with partial.open("wb") as out:
                result = _Recovery(records, out).run(source.name, progress)
                out.flush()
                os.fsync(out.fileno())
            partial.replace(target)
        finally:
            partial.unlink(missing_ok=True)
    return result


class _Recovery:
    def __init__(self, source: RecordFile, out: BinaryIO) -> None:
        self._source = source
        self._out = RecordStream(out, source.profile() or PROFILE, "syncline recover")
        self._channels = ChannelTable([], ours=source.profile() == PROFILE)
        self._losses = LossTracker()
        self._lag: LagBounds | None = None
        self._result = RecoverResult()

    def run(self, source_name: str, progress: Callable[[int], None] | None = None) -> RecoverResult:
        summary = self._source.summary()
        if summary is not None:
            self._define(*summary.schemas, *summary.channels)
        for record in self._source.records():
            if isinstance(record, RawChunk):
                self._chunk(record)
                if progress:
                    progress(self._result.frames)
            elif isinstance(record, Lost):
                self._lost(record.reason, record.start_ns, record.end_ns, None)
            elif isinstance(record, mcap_records.Schema | mcap_records.Channel):
                self._define(record)
            else:
                self._document(record)
        self._write_gap(self._losses.finish())
        return self._finish(source_name, summary is not None and summary.complete)

    def _finish(self, source_name: str, had_summary: bool) -> RecoverResult:
        result = self._result
        if not had_summary:
            result.damage.append("no usable summary")
        result.damage[:0] = self._source.damage
        result.whole = not result.damage
        result.messages = self._out.message_count
        self._metadata(
            RECOVER_METADATA_NAME,
            {
                "source": source_name,
                "lost_chunks": str(result.lost_chunks),
                "lost_frames": str(result.lost_frames),
                "damage": "; ".join(result.damage),
            },
        )
        lag = self._lag.to_record() if self._lag else {}
        self._metadata(END_METADATA_NAME, {"frames": str(result.frames)} | lag)
        self._out.finish()
        return result

    def _define(self, *records: Definition) -> None:
        for record in records:
            self._channels.register(record)
            if isinstance(record, mcap_records.Schema):
                self._out.schema(record)
            else:
                self._out.channel(record)

    def _document(self, record: Document) -> None:
        if isinstance(record, mcap_records.Attachment):
            self._out.attachment(record)
        elif record.name not in (END_METADATA_NAME, RECOVER_METADATA_NAME):
            self._out.metadata(record)

    def _metadata(self, name: str, values: dict[str, str]) -> None:
        self._out.metadata(mcap_records.Metadata(name, values))

    def _chunk(self, raw: RawChunk) -> None:
        content = open_chunk(raw)
        if isinstance(content, str):
            frames = self._channels.frames_in(raw.index)
            self._lost(f"chunk at byte {raw.offset}: {content}", raw.start_ns, raw.end_ns, frames)
            return
        self._define(*content.definitions)
        if content.damage:
            self._result.damage.append(f"chunk at byte {raw.offset}: {content.damage}")
        if len(content.offset) == 0:
            return
        undescribed = np.flatnonzero(self._channels.kind[content.channel] == Kind.UNKNOWN)
        if len(undescribed):
            self._define(*frame_channels_by_content(content, undescribed))
        self._write_gap(
            self._losses.read(int(content.log_time_ns[0]), int(content.log_time_ns[-1]))
        )
        self._count(content)
        copied = raw.chunked and not content.damage
        self._out.chunk(_same_chunk(raw, content) if copied else _new_chunk(content))

    def _count(self, content: ChunkContent) -> None:
        rows = np.flatnonzero(self._channels.kind[content.channel] == Kind.FRAME)
        frames, unreadable = read_frames(content, rows, self._channels.bus)
        self._result.frames += len(frames)
        if len(unreadable) == 0:
            self._lag = LagBounds.widened(self._lag, content.log_time_ns[rows], frames.t_ns)

    def _lost(
        self, reason: str, start_ns: int | None, end_ns: int | None, frames: int | None
    ) -> None:
        self._result.damage.append(reason)
        self._result.lost_chunks += 1
        self._result.lost_frames += frames or 0
        self._write_gap(self._losses.lost(start_ns, end_ns, frames))

    def _write_gap(self, gap: Gap | None) -> None:
        if gap is None:
            return
        schema = schema_of(syncline_pb2.Gap.DESCRIPTOR)
        self._define(
            mcap_records.Schema(_GAP_ID, schema.data, schema.encoding, schema.name),
            mcap_records.Channel(_GAP_ID, GAP_TOPIC, PROTOBUF, {}, _GAP_ID),
        )
        time = np.array([gap.start_ns], np.int64)
        payload = np.frombuffer(gap_message(gap).SerializeToString(), np.uint8)
        length = np.array([len(payload)], np.int64)
        sequence = np.zeros(1, np.uint32)
        data, record_length = pack_messages(_GAP_ID, sequence, time, time, length, payload)
        run = RecordRun(data, record_length, np.array([_GAP_ID], np.uint16), time)
        self._out.chunk(build_chunk(run, "zstd"))


def _same_chunk(raw: RawChunk, content: ChunkContent) -> Chunk:
    """The chunk as it was, with a message index made anew."""
    return Chunk(
        start_ns=int(content.log_time_ns.min()),
        end_ns=int(content.log_time_ns.max()),
        uncompressed_size=raw.uncompressed_size,
        crc=raw.crc,
        compression=raw.compression,
        data=raw.data,
        index=message_index(content.channel, content.log_time_ns, content.offset),
    )


def _new_chunk(content: ChunkContent) -> Chunk:
    """A chunk of messages that stood outside chunks or in a broken one."""
    place = np.arange(content.size)
    record = np.searchsorted(content.offset, place, side="right") - 1
    in_message = (record >= 0) & (place < content.end[record])
    run = RecordRun(
        content.buffer[: content.size][in_message],
        content.end - content.offset,
        content.channel,
        content.log_time_ns,
    )
    return build_chunk(run, "zstd")


def _open(path: Path) -> BinaryIO:
    try:
        return path.open("rb")
    except OSError as error:
        raise CaptureError(f"{path} cannot be opened: {error.strerror}") from error
