"""The records of an MCAP file, read from whatever state the file is in."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import field, replace
from io import BytesIO
from typing import BinaryIO, TypeVar

import mcap.records as mcap_records
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray

from syncline_schemas.capture.chunk import MAX_CHUNK
from syncline_schemas.capture.record_stream import MAGIC
from syncline_schemas.records import dataclass

MessageIndex = dict[int, NDArray[np.uint64]]
"""(n, 2) uint64 of log_time and offset by channel id."""

_HEAD = 9
_CHUNK_FIELDS = struct.Struct("<QQQII")
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_ENTRY = 16
_INDEX_PLACE = struct.Struct("<HQ")
_MESSAGE_INDEX = int(Opcode.MESSAGE_INDEX)
_FOOTER_SIZE = _HEAD + 20
_SEARCH_STEP = 1 << 20
_LOOSE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class RawChunk:
    """A chunk as it stands in the file, still compressed.

    `index` is None where the message index is missing, unreadable, or was not read yet: then `place`
    is where it is. `offset` is that of the record in the file. `chunked` is False for messages that
    stood outside chunks: put together here, without times of its own.
    """

    offset: int
    start_ns: int
    end_ns: int
    uncompressed_size: int
    crc: int
    compression: str
    data: bytes | memoryview
    index: MessageIndex | None = None
    chunked: bool = True
    place: "ChunkPlace | None" = None


@dataclass(frozen=True, slots=True, eq=False)
class Lost:
    """A place in the file where messages were and cannot be read; times where they are known."""

    offset: int
    reason: str
    start_ns: int | None = None
    end_ns: int | None = None


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Where a chunk is, from the summary; `length` holds its message indexes too.

    `index_length` is their part of it; `index_places` is the summary's map of where they are.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    index_length: int = 0
    index_places: bytes = b""

    def messages(self) -> dict[int, int] | None:
        """Messages by channel, known without reading the chunk; None where the summary tells not.

        The message indexes stand one behind the other, 16 bytes for each message after a head.
        """
        if not self.index_places or len(self.index_places) % _INDEX_PLACE.size:
            return None
        places = sorted(
            (at, channel) for channel, at in _INDEX_PLACE.iter_unpack(self.index_places)
        )
        end = self.offset + self.length
        if places[0][0] != end - self.index_length:
            return None
        counts: dict[int, int] = {}
        for (at, channel), until in zip(places, [*(at for at, _ in places[1:]), end], strict=True):
            count, rest = divmod(until - at - _INDEX_HEAD.size, _INDEX_ENTRY)
            if rest or count < 0 or channel in counts:
                return None
            counts[channel] = count
        return counts


@dataclass(slots=True)
class Summary:
    """The summary section of a file that was closed."""

    schemas: list[mcap_records.Schema] = field(default_factory=list)
    channels: list[mcap_records.Channel] = field(default_factory=list)
    chunks: list[ChunkPlace] = field(default_factory=list)
    attachments: list[mcap_records.AttachmentIndex] = field(default_factory=list)
    metadata: list[mcap_records.MetadataIndex] = field(default_factory=list)
    statistics: mcap_records.Statistics | None = None

    @property
    def complete(self) -> bool:
        """Whether everything in the file can be found from here."""
        counts = self.statistics
        return (
            counts is not None
            and counts.chunk_count == len(self.chunks)
            and counts.attachment_count == len(self.attachments)
            and counts.metadata_count == len(self.metadata)
            and counts.channel_count == len(self.channels)
            and (counts.message_count == 0 or bool(self.chunks))
        )


Definition = mcap_records.Schema | mcap_records.Channel
Document = mcap_records.Attachment | mcap_records.Metadata
Record = RawChunk | Lost | Definition | Document
_R = TypeVar("_R", bound=mcap_records.McapRecord)


class RecordFile:
    """An open MCAP file; nothing that it holds makes a method raise.

    Attributes:
        size: bytes of the file when it was opened; what is appended later is not read.
        damage: what was found wrong so far, in words.
        closed: whether footer and closing magic are there.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.size = file.seek(0, 2)
        self.damage: list[str] = []
        tail = self._read(max(self.size - _FOOTER_SIZE - len(MAGIC), 0), _FOOTER_SIZE + len(MAGIC))
        self._footer = _parse_footer(tail)
        self.closed = self._footer is not None

    @property
    def plausible(self) -> bool:
        """Whether this is an MCAP file at all, perhaps cut off or with a byte damaged."""
        start = self._read(0, len(MAGIC))
        wrong = sum(a != b for a, b in zip(start, MAGIC, strict=False))
        return wrong <= 1 or self.closed

    def profile(self) -> str:
        """Profile in the header, "" where there is none."""
        opcode, length = self._head(len(MAGIC))
        if opcode != Opcode.HEADER or length > 1 << 16:
            return ""
        header = parse_record(mcap_records.Header, self._read(len(MAGIC) + _HEAD, length))
        return header.profile if header else ""

    def summary(self) -> Summary | None:
        """The summary; None where there is none or its checksum is wrong."""
        if self._footer is None:
            return None
        start, crc = self._footer.summary_start, self._footer.summary_crc
        end = self.size - len(MAGIC) - _FOOTER_SIZE
        if not 0 < start <= end:
            return None
        # The checksum covers the footer up to the checksum itself.
        data = self._read(start, end - start + _FOOTER_SIZE - 4)
        if crc not in (0, zlib.crc32(data)):
            self.damage.append("the summary is damaged; read from the start instead")
            return None
        return _parse_summary(data[: end - start])

    def chunk_at(self, place: ChunkPlace, *, indexed: bool = True) -> RawChunk | Lost:
        """The chunk at a place that the summary names.

        indexed: with its message indexes. They are more than half of what a capture has on disk,
        and of a chunk in which all is well nobody asks for them.
        """
        if place.length > MAX_CHUNK or place.offset + place.length > self.size:
            return self._lost_at(place, "lies beyond the end of the file")
        data = self._read(place.offset, place.length - (0 if indexed else place.index_length))
        opcode, length = _unpack_head(data)
        chunk = None
        if opcode == Opcode.CHUNK and _HEAD + length <= len(data):
            content = memoryview(data)[_HEAD : _HEAD + length]
            index = parse_indexes(data[_HEAD + length :])
            chunk = parse_chunk(place.offset, content, index, None if indexed else place)
        if chunk is None and not indexed:
            return self.chunk_at(place)
        return chunk or self._lost_at(place, "has a damaged header")

    def indexed(self, raw: RawChunk) -> RawChunk:
        """A chunk with its message indexes, if there are any."""
        whole = None if raw.place is None else self.chunk_at(raw.place)
        return whole if isinstance(whole, RawChunk) else raw

    def _lost_at(self, place: ChunkPlace, what: str) -> Lost:
        return Lost(
            place.offset, f"chunk at byte {place.offset} {what}", place.start_ns, place.end_ns
        )

    def documents(self, summary: Summary) -> Iterator[Document]:
        """Attachments and metadata that a summary names, with a damage note for each unreadable."""
        for offset, length in (
            *((place.offset, place.length) for place in summary.attachments),
            *((place.offset, place.length) for place in summary.metadata),
        ):
            data = self._read(offset, min(length, MAX_CHUNK))
            opcode, content_length = _unpack_head(data)
            whole = content_length == len(data) - _HEAD
            record = _parse_document(opcode, data[_HEAD:]) if whole else None
            if record is None:
                self.damage.append(f"attachment or metadata at byte {offset} is damaged")
            else:
                yield record

    def metadata(self) -> Iterator[mcap_records.Metadata]:
        """Metadata records; of a file without a summary those before the first damage.

        No chunk is read, so that files of any size are walked through quickly.
        """
        summary = self.summary()
        if summary is not None:
            documents = self.documents(replace(summary, attachments=[]))
            yield from (each for each in documents if isinstance(each, mcap_records.Metadata))
            return
        position = len(MAGIC)
        while position < self.size and self._is_record(position):
            opcode, length = self._head(position)
            if opcode == Opcode.METADATA:
                record = _parse_document(opcode, self._read(position + _HEAD, length))
                if isinstance(record, mcap_records.Metadata):
                    yield record
            position += _HEAD + length

    def records(self, position: int = len(MAGIC)) -> Iterator[Record]:
        """Records from a position to the end of the data, for files without a usable summary.

        Damaged records are skipped; where the next record cannot be found by its length, the next
        chunk is searched for.
        """
        if position == len(MAGIC) and self._read(0, len(MAGIC)) != MAGIC:
            self.damage.append("the file does not begin as an MCAP file")
        while position < self.size:
            opcode, length = self._head(position)
            end = position + _HEAD + length
            if not self._is_record(position):
                found = self._find_chunk(position + 1)
                lost = self._unreadable(position, found)
                if lost is not None:
                    yield lost
                position = self.size if found is None else found
            elif opcode == Opcode.MESSAGE:
                chunk, position = self._loose_messages(position)
                yield chunk
            elif _LENGTH_OF_END.get(opcode) == length:
                return
            elif opcode == Opcode.CHUNK:
                chunk_or_lost, position = self._chunk(position, length)
                yield chunk_or_lost
            else:
                record = self._other(position, opcode, length)
                if record is not None:
                    yield record
                position = end if self._is_record(end) else self._after_damage(position, end)

    def last_chunk_end_ns(self) -> int | None:
        """Time of the last message in the last whole chunk, found from the end of the file."""
        reach = _SEARCH_STEP
        while True:
            start = max(self.size - reach, 0)
            found = self._find_chunk(start)
            ends = [
                record.end_ns
                for record in (self.records(found) if found is not None else ())
                if isinstance(record, RawChunk)
            ]
            if ends or start == 0:
                return ends[-1] if ends else None
            reach *= 8

    def _is_record(self, position: int) -> bool:
        """Whether a whole record of a known kind begins here, or the file ends here."""
        if position == self.size:
            return True
        opcode, length = self._head(position)
        known = 0 < opcode <= Opcode.DATA_END or opcode >= 0x80
        return known and position + _HEAD + length <= self.size

    def _after_damage(self, position: int, end: int) -> int:
        """Where to go on after a record whose successor looks wrong."""
        found = self._find_chunk(position + 1)
        return end if found is None or found >= end else found

    def _unreadable(self, position: int, found: int | None) -> Lost | None:
        if found is not None:
            return Lost(position, f"no readable record from byte {position} to byte {found}")
        opcode, length = self._read(position, 1)[0], self._head(position)[1]
        if opcode == Opcode.CHUNK:
            return self._cut_chunk(position, length)
        if 0 < opcode <= Opcode.DATA_END and opcode != Opcode.MESSAGE:
            name = Opcode(opcode).name.lower()
            self.damage.append(f"the file is cut off in the {name} record at byte {position}")
            return None
        return Lost(position, f"no readable record from byte {position} to the end")

    def _cut_chunk(self, position: int, length: int) -> Lost:
        head = self._read(position + _HEAD, _CHUNK_FIELDS.size)
        if len(head) < _CHUNK_FIELDS.size:
            return Lost(position, f"chunk at byte {position} is cut off in its header")
        missing = position + _HEAD + length - self.size
        reason = f"chunk at byte {position} is cut off, {missing} bytes are missing"
        start_ns, end_ns, *_ = _CHUNK_FIELDS.unpack(head)
        return Lost(position, reason, start_ns, end_ns)

    def _chunk(self, position: int, length: int) -> tuple[RawChunk | Lost, int]:
        end = position + _HEAD + length
        if length > MAX_CHUNK:
            return Lost(position, f"chunk at byte {position} claims {length} bytes"), end
        content = self._read(position + _HEAD, length)
        indexes_end = end
        while indexes_end < self.size and self._is_record(indexes_end):
            opcode, index_length = self._head(indexes_end)
            if opcode != Opcode.MESSAGE_INDEX:
                break
            indexes_end += _HEAD + index_length
        index = parse_indexes(self._read(end, indexes_end - end))
        chunk = parse_chunk(position, memoryview(content), index)
        if chunk is not None:
            return chunk, indexes_end if index is not None else end
        lost = Lost(position, f"chunk at byte {position} has a damaged header")
        return lost, self._after_damage(position, end)

    def _loose_messages(self, position: int) -> tuple[RawChunk, int]:
        start = position
        while position < self.size and position - start < _LOOSE_BYTES:
            opcode, length = self._head(position)
            if opcode != Opcode.MESSAGE or not self._is_record(position):
                break
            position += _HEAD + length
        data = self._read(start, position - start)
        return RawChunk(start, 0, 0, len(data), 0, "", data, chunked=False), position

    def _other(
        self, position: int, opcode: int, length: int
    ) -> Definition | Document | RawChunk | None:
        """A record that is not marked as a chunk, though it may be one whose mark is damaged."""
        if length > MAX_CHUNK:
            return None
        content = self._read(position + _HEAD, length)
        record = parse_definition(opcode, content) or _parse_document(opcode, content)
        if record is not None:
            return record
        chunk = parse_chunk(position, memoryview(content), None)
        if opcode in _PARSED and chunk is None:
            name = Opcode(opcode).name.lower()
            self.damage.append(f"the {name} record at byte {position} is damaged")
        return chunk

    def _find_chunk(self, position: int) -> int | None:
        """The next offset at which a chunk's two length fields agree."""
        while position < self.size:
            data = self._read(position, _SEARCH_STEP + 64)
            for candidate in _chunk_candidates(data):
                if self._is_record(position + candidate):
                    return position + candidate
            position += _SEARCH_STEP
        return None

    def _head(self, position: int) -> tuple[int, int]:
        return _unpack_head(self._read(position, _HEAD))

    def _read(self, position: int, length: int) -> bytes:
        if not 0 <= position < self.size or length <= 0:
            return b""
        self._file.seek(position)
        return self._file.read(min(length, self.size - position))


_LENGTH_OF_END: dict[int, int] = {Opcode.DATA_END: 4, Opcode.FOOTER: 20}
_PARSED = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT, Opcode.METADATA)


def parse_record(kind: type[_R], content: bytes) -> _R | None:
    """A record from its content; None when the bytes are not one."""
    stream = ReadDataStream(BytesIO(content))
    try:
        record: _R = kind.read(stream)  # type: ignore[attr-defined]
    except (McapError, struct.error, ValueError, OverflowError, MemoryError):
        return None
    return record if stream.count == len(content) else None


def parse_definition(opcode: int, content: bytes) -> Definition | None:
    """A schema or channel from its content."""
    if opcode == Opcode.SCHEMA:
        return parse_record(mcap_records.Schema, content)
    if opcode == Opcode.CHANNEL:
        return parse_record(mcap_records.Channel, content)
    return None


def _parse_document(opcode: int, content: bytes) -> Document | None:
    if opcode == Opcode.METADATA:
        return parse_record(mcap_records.Metadata, content)
    if opcode != Opcode.ATTACHMENT or len(content) < 4:
        return None
    crc = int.from_bytes(content[-4:], "little")
    if crc not in (0, zlib.crc32(content[:-4])):
        return None
    return parse_record(mcap_records.Attachment, content)


def parse_chunk(
    offset: int,
    content: memoryview,
    index: MessageIndex | None,
    place: ChunkPlace | None = None,
) -> RawChunk | None:
    """A chunk from its record's content; None when its lengths contradict each other."""
    fixed = _CHUNK_FIELDS.size
    if len(content) < fixed + 8:
        return None
    start_ns, end_ns, size, crc, name_length = _CHUNK_FIELDS.unpack_from(content)
    data_start = fixed + name_length + 8
    if data_start > len(content):
        return None
    (data_length,) = struct.unpack_from("<Q", content, data_start - 8)
    if data_start + data_length != len(content):
        return None
    name = bytes(content[fixed : fixed + name_length]).decode("ascii", "replace")
    data = content[data_start:]
    return RawChunk(offset, start_ns, end_ns, size, crc, name, data, index, place=place)


def parse_indexes(data: bytes) -> MessageIndex | None:
    """Message index records back to back; None when there are none or they are damaged."""
    index: MessageIndex = {}
    position = 0
    while position < len(data):
        start = position + _INDEX_HEAD.size
        if start > len(data):
            return None
        opcode, length, channel, entries_length = _INDEX_HEAD.unpack_from(data, position)
        position = start + entries_length
        wrong = opcode != _MESSAGE_INDEX or entries_length + 6 != length or entries_length % 16
        if wrong or position > len(data) or channel in index:
            return None
        index[channel] = np.frombuffer(data, "<u8", entries_length // 8, start).reshape(-1, 2)
    return index or None


def _unpack_head(head: bytes) -> tuple[int, int]:
    if len(head) < _HEAD:
        return 0, 0
    opcode, length = struct.unpack_from("<BQ", head)
    return opcode, length


def _parse_footer(tail: bytes) -> mcap_records.Footer | None:
    if len(tail) < _FOOTER_SIZE + len(MAGIC) or not tail.endswith(MAGIC):
        return None
    if _unpack_head(tail) != (Opcode.FOOTER, 20):
        return None
    return parse_record(mcap_records.Footer, tail[_HEAD:_FOOTER_SIZE])


def _parse_summary(data: bytes) -> Summary:
    summary = Summary()
    position = 0
    while position + _HEAD <= len(data):
        opcode, length = _unpack_head(data[position : position + _HEAD])
        _add_to_summary(summary, opcode, data[position + _HEAD : position + _HEAD + length])
        position += _HEAD + length
    return summary


def _add_to_summary(summary: Summary, opcode: int, content: bytes) -> None:
    if opcode == Opcode.CHUNK_INDEX:
        place = _parse_chunk_index(content)
        summary.chunks += [place] if place else []
    elif opcode == Opcode.STATISTICS:
        summary.statistics = parse_record(mcap_records.Statistics, content)
    elif opcode == Opcode.SCHEMA and (schema := parse_record(mcap_records.Schema, content)):
        summary.schemas.append(schema)
    elif opcode == Opcode.CHANNEL and (channel := parse_record(mcap_records.Channel, content)):
        summary.channels.append(channel)
    elif opcode == Opcode.ATTACHMENT_INDEX:
        attachment = parse_record(mcap_records.AttachmentIndex, content)
        summary.attachments += [attachment] if attachment else []
    elif opcode == Opcode.METADATA_INDEX:
        metadata = parse_record(mcap_records.MetadataIndex, content)
        summary.metadata += [metadata] if metadata else []


def _parse_chunk_index(content: bytes) -> ChunkPlace | None:
    if len(content) < 44:
        return None
    start_ns, end_ns, offset, length, offsets_length = struct.unpack_from("<QQQQI", content)
    if 36 + offsets_length + 8 > len(content):
        return None
    (index_length,) = struct.unpack_from("<Q", content, 36 + offsets_length)
    index_places = content[36 : 36 + offsets_length]
    return ChunkPlace(offset, length + index_length, start_ns, end_ns, index_length, index_places)


def _chunk_candidates(data: bytes) -> list[int]:
    """Offsets in `data` where a chunk record may begin: its two length fields agree."""
    count = len(data) - 64
    if count <= 0:
        return []
    raw = np.frombuffer(data, np.uint8)
    place = np.flatnonzero(raw[:count] == Opcode.CHUNK)
    u4 = np.ndarray((len(data) - 3,), "<u4", raw, 0, (1,))
    u8 = np.ndarray((len(data) - 7,), "<u8", raw, 0, (1,))
    name_length = u4[place + 37]
    place, name_length = place[name_length <= 4], name_length[name_length <= 4].astype(np.int64)
    agree = u8[place + 1] - (40 + name_length).view(np.uint64) == u8[place + 41 + name_length]
    return [int(candidate) for candidate in place[agree]]
