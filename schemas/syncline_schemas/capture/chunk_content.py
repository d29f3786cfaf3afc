"""What a chunk holds: where its messages are, and its frames as columns."""

from collections.abc import Sequence
from dataclasses import field
from functools import cache

import mcap.records as mcap_records
import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.capture.checksum import crc32
from syncline_schemas.capture.chunk import decompress
from syncline_schemas.capture.frame_record import (
    MAX_DATA,
    PADDING,
    RECORD_HEAD,
    GatheredFrames,
    RecordHeads,
    gather_frames,
)
from syncline_schemas.capture.layout import PROTOBUF, frames_topic
from syncline_schemas.capture.record_file import (
    Definition,
    MessageIndex,
    RawChunk,
    parse_definition,
)
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class ChunkContent:
    """A decompressed chunk and its messages, in the order in which they stand in it.

    Attributes:
        buffer: (size + PADDING,) uint8.
        size: bytes of the chunk.
        offset: (n,) int64, where each message record begins.
        end: (n,) int64, where it ends.
        channel: (n,) uint16.
        log_time_ns: (n,) int64.
        definitions: schemas and channels that stand between the messages.
        damage: what was found wrong, in words; None when all is well.
    """

    buffer: NDArray[np.uint8]
    size: int
    offset: NDArray[np.int64]
    end: NDArray[np.int64]
    channel: NDArray[np.uint16]
    log_time_ns: NDArray[np.int64]
    definitions: list[Definition] = field(default_factory=list)
    damage: str | None = None

    def publish_time_ns(self, row: int) -> int:
        """Publish time of one message."""
        at = int(self.offset[row]) + 23
        return int.from_bytes(self.buffer[at : at + 8].tobytes(), "little", signed=True)

    def payload(self, row: int) -> bytes:
        """Payload of one message."""
        return self.buffer[self.offset[row] + RECORD_HEAD : self.end[row]].tobytes()


def open_chunk(raw: RawChunk) -> ChunkContent | str:
    """The content of a chunk, or in words why none of it can be believed."""
    plain = unpacked(raw)
    if isinstance(plain, str):
        return plain
    joined = None if raw.index is None else _by_index([plain], [raw.index])
    return _content_by_walk(plain) if joined is None else joined.content


@dataclass(frozen=True, slots=True, eq=False)
class JoinedChunks:
    """Chunks that stand one behind the other in a file, as one.

    Attributes:
        content: their messages.
        heads: of the same records.
        first_row: (chunks,) int64, the first message of each chunk.
    """

    content: ChunkContent
    heads: RecordHeads
    first_row: NDArray[np.int64]


def open_joined(raws: Sequence[RawChunk]) -> JoinedChunks | None:
    """The content of several chunks at once: the work on columns costs by the call.

    None unless each chunk is whole and its message index names all that is in it.
    """
    plains, indexes = [], []
    for raw in raws:
        plain = None if raw.index is None else unpacked(raw)
        if raw.index is None or not isinstance(plain, bytes):
            return None
        plains.append(plain)
        indexes.append(raw.index)
    return _by_index(plains, indexes)


def unpacked(raw: RawChunk) -> bytes | str:
    """The plain bytes of a chunk, or in words why they cannot be believed."""
    plain = decompress(raw.data, raw.compression, raw.uncompressed_size)
    if isinstance(plain, bytes) and raw.crc not in (0, crc32(plain)):
        return "its checksum is wrong"
    return plain


def _by_index(plains: Sequence[bytes], indexes: Sequence[MessageIndex]) -> JoinedChunks | None:
    """None unless the records that the indexes name fill the chunks exactly."""
    buffer = np.frombuffer(b"".join((*plains, bytes(PADDING))), np.uint8)
    lengths = np.array([len(plain) for plain in plains], np.int64)
    begins = np.cumsum(lengths) - lengths
    size = int(lengths.sum())
    offset = _ascending(indexes, begins)
    if len(offset) == 0 or offset[0] != 0 or offset[-1] + RECORD_HEAD > size:
        return None
    heads = RecordHeads.at(buffer, offset)
    end = np.append(offset[1:], size)
    length = end - offset - 9
    whole = (
        (length >= RECORD_HEAD - 9)
        & (heads.u8(1).view(np.int64) == length)
        & (heads.u1(0) == Opcode.MESSAGE)
    )
    first_row = np.searchsorted(offset, begins)
    if not whole.all() or first_row[-1] >= len(offset) or np.any(offset[first_row] != begins):
        return None
    channel, log_time_ns = heads.u2(9), heads.u8(15).view(np.int64)
    content = ChunkContent(buffer, size, offset, end, channel, log_time_ns)
    return JoinedChunks(content, heads, first_row)


def _ascending(indexes: Sequence[MessageIndex], begins: NDArray[np.int64]) -> NDArray[np.int64]:
    """Offsets of all messages; each chunk counts from where it begins."""
    found = [
        entries[:, 1] + begin
        for index, begin in zip(indexes, begins.view(np.uint64), strict=True)
        for entries in index.values()
    ]
    offset = np.concatenate([*found, np.zeros(0, np.uint64)]).view(np.int64)
    return np.sort(offset) if np.any(offset[1:] < offset[:-1]) else offset


def _content_by_walk(plain: bytes) -> ChunkContent:
    """Record by record: chunks with other records in them, or without a good message index."""
    offsets: list[int] = []
    definitions: list[Definition] = []
    damage, position = None, 0
    while position < len(plain):
        opcode = plain[position]
        end = position + 9 + int.from_bytes(plain[position + 1 : position + 9], "little")
        if position + 9 > len(plain) or end > len(plain):
            damage = f"a record runs past its end, {len(plain) - position} bytes are lost"
            break
        if opcode == Opcode.MESSAGE and end - position >= RECORD_HEAD:
            offsets.append(position)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definition = parse_definition(opcode, plain[position + 9 : end])
            definitions += [definition] if definition else []
        position = end
    offset = np.array(offsets, np.int64)
    buffer = np.frombuffer(plain + bytes(PADDING), np.uint8)
    heads = RecordHeads.at(buffer, offset)
    return ChunkContent(
        buffer,
        len(plain),
        offset,
        offset + 9 + heads.u8(1).view(np.int64),
        heads.u2(9),
        heads.u8(15).view(np.int64),
        definitions,
        damage,
    )


def read_frames(
    content: ChunkContent, rows: NDArray[np.intp], bus_of_channel: NDArray[np.int16]
) -> tuple[FrameBatch, NDArray[np.intp]]:
    """Frames of the messages in these rows, and the rows that are no frames and were left out.

    Records as `pack_frames` writes them are gathered by column; any other encoding of
    `syncline.Frame` is parsed one by one.
    """
    gathered = _gathered(content, rows, bus_of_channel)
    if gathered.regular.all():
        return gathered.frames, np.zeros(0, np.intp)
    regular = np.flatnonzero(gathered.regular)
    parsed, parsed_at, unreadable = [], [], []
    for at in np.flatnonzero(~gathered.regular).tolist():
        row = int(rows[at])
        fields = parse_frame(content.payload(row))
        if fields is None:
            unreadable.append(row)
        else:
            bus = int(bus_of_channel[content.channel[row]])
            parsed.append((content.publish_time_ns(row), bus, *fields))
            parsed_at.append(at)
    frames = FrameBatch.concat([gathered.frames[regular], FrameBatch.from_rows(parsed)])
    order = np.argsort(np.concatenate([regular, np.array(parsed_at, np.intp)]), kind="stable")
    return frames[order], np.array(unreadable, np.intp)


def _gathered(
    content: ChunkContent, rows: NDArray[np.intp], bus_of_channel: NDArray[np.int16]
) -> GatheredFrames:
    offset = content.offset[rows]
    heads = RecordHeads.at(content.buffer, offset)
    bus = bus_of_channel[content.channel[rows]].astype(np.uint8)
    return gather_frames(content.buffer, offset, heads, bus)


def parse_frame(payload: bytes) -> tuple[int, int, int, bytes] | None:
    """(can_id, flags, dlc, data) of a `syncline.Frame`; None when it is none.

    A length that the data contradict becomes the number of data bytes, marked DLC_INVALID.
    """
    from google.protobuf.message import DecodeError

    from syncline_schemas.proto import syncline_pb2

    try:
        frame = syncline_pb2.Frame.FromString(payload)
    except DecodeError:
        return None
    flags, dlc, data = frame.flags & 0xFFFF, frame.dlc, frame.data
    if len(data) > MAX_DATA or frame.can_id > 0x1FFF_FFFF:
        return None
    if flags & FrameFlag.REMOTE:
        return frame.can_id, flags, min(dlc, MAX_DATA), b""
    if dlc != len(data):
        flags |= FrameFlag.DLC_INVALID
    return frame.can_id, flags, len(data), data


def frame_channels_by_content(
    content: ChunkContent, undescribed: NDArray[np.intp]
) -> list[Definition]:
    """Schema and channel for messages whose channel record is lost, if they are plainly frames.

    undescribed: rows of messages of channels that nothing describes. A channel is taken for frames
    when each of its messages has every tag and length of `pack_frames`.
    """
    schema = _lost_frame_schema()
    definitions: list[Definition] = []
    for channel in np.unique(content.channel[undescribed]).tolist():
        rows = undescribed[content.channel[undescribed] == channel]
        if _gathered(content, rows, np.zeros(1 << 16, np.int16)).regular.all():
            topic = frames_topic(f"channel{channel}")
            definitions.append(mcap_records.Channel(channel, topic, PROTOBUF, {}, schema.id))
    return [schema, *definitions] if definitions else []


@cache
def _lost_frame_schema() -> mcap_records.Schema:
    """Of channels whose own record is lost; its id is far from those that writers count up."""
    from syncline_schemas.capture.message import schema_of
    from syncline_schemas.proto import syncline_pb2

    frame = schema_of(syncline_pb2.Frame.DESCRIPTOR)
    return mcap_records.Schema(0xFFFE, frame.data, frame.encoding, frame.name)
