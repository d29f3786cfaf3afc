"""The CAN frames of ROS 2 recordings in MCAP: `can_msgs/msg/Frame`, and what ros2_socketcan sends.

The messages are in CDR (OMG DDS-XTypes 7.4.1, as ROS 2 writes it): a header of four bytes that tells
the order of the bytes of numbers, then the fields in order, each aligned to its size. Only the length
of `frame_id` varies, so that all messages are read as columns. No ROS is needed.
"""

from collections.abc import Iterator
from dataclasses import field
from pathlib import Path
from typing import Final

import mcap.records as mcap_records
import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.byte_columns import ByteColumns, ByteOrder, Places
from syncline_schemas.capture.chunk_content import ChunkContent, open_chunk
from syncline_schemas.capture.layout import PROFILE
from syncline_schemas.capture.record_file import Definition, Lost, RawChunk, RecordFile
from syncline_schemas.records import dataclass

CLASSIC_SCHEMAS: Final = ("can_msgs/msg/Frame", "ros2_socketcan_msgs/msg/Frame")
FD_SCHEMAS: Final = ("ros2_socketcan_msgs/msg/FdFrame",)
SCHEMAS: Final = (*CLASSIC_SCHEMAS, *FD_SCHEMAS)
_SECOND_NS: Final = 1_000_000_000
_RECORD_HEAD: Final = 31
_CDR_HEAD: Final = 4
_ORDERS: Final[dict[int, ByteOrder]] = {0x0100: "<", 0x0000: ">"}
"""By what a header begins with, read as a little-endian number: the order of the bytes of numbers."""
_MAX_NAME: Final = 4096
_MAX_BUSES: Final = 256
_CLASSIC, _FD = 1, 2


def bag_schemas(path: Path) -> list[str]:
    """Names of the CAN schemas in an MCAP file; empty where it is no ROS 2 bag with CAN frames."""
    with path.open("rb") as file:
        records = RecordFile(file)
        if records.profile() == PROFILE:
            return []
        summary = records.summary()
        if summary is not None and summary.schemas:
            return sorted({s.name for s in summary.schemas} & set(SCHEMAS))
        for record in records.records():
            if isinstance(record, mcap_records.Schema) and record.name in SCHEMAS:
                return [record.name]
            if isinstance(record, RawChunk):
                content = open_chunk(record)
                definitions = [] if isinstance(content, str) else content.definitions
                names = {each.name for each in definitions if isinstance(each, mcap_records.Schema)}
                return sorted(names & set(SCHEMAS))
    return []


@dataclass(slots=True)
class BagFacts:
    """What is known of a bag besides its frames; complete when the last batch was read.

    Attributes:
        topics: by bus number; each topic with CAN frames is a bus of its own.
        damage: what could not be read, each in words.
        unstamped: messages whose stamp is not set; the time of recording stands for it.
        unreadable: messages that are no CAN frames.
    """

    topics: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    unstamped: int = 0
    unreadable: int = 0


@dataclass(slots=True)
class _Channel:
    kind: int
    bus: int


class BagScan:
    """The CAN frames of a ROS 2 bag, whole, cut off or damaged, in the order of recording."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.facts = BagFacts()
        self._schemas: dict[int, mcap_records.Schema] = {}
        self._channels: dict[int, _Channel] = {}

    def batches(self) -> Iterator[FrameBatch]:
        """Batches in file order. Damage never raises."""
        with self.path.open("rb") as file:
            records = RecordFile(file)
            summary = records.summary()
            if summary is not None:
                self._register(*summary.schemas, *summary.channels)
            for record in records.records():
                if isinstance(record, mcap_records.Schema | mcap_records.Channel):
                    self._register(record)
                elif isinstance(record, Lost):
                    self.facts.damage.append(record.reason)
                elif isinstance(record, RawChunk):
                    yield from self._chunk(record)
            self.facts.damage += records.damage
            if not records.closed:
                self.facts.damage.append("no footer: the recording was cut off or still runs")

    def _register(self, *records: Definition) -> None:
        for record in records:
            if isinstance(record, mcap_records.Schema):
                self._schemas.setdefault(record.id, record)
            else:
                self._add_channel(record)

    def _add_channel(self, record: mcap_records.Channel) -> None:
        schema = self._schemas.get(record.schema_id)
        if record.id in self._channels or schema is None or schema.name not in SCHEMAS:
            return
        if record.message_encoding not in ("cdr", ""):
            told = f"messages of {record.topic} are in {record.message_encoding}"
            self.facts.damage.append(told)
            return
        topics = self.facts.topics
        if record.topic not in topics:
            if len(topics) >= _MAX_BUSES:
                return
            topics.append(record.topic)
        kind = _FD if schema.name in FD_SCHEMAS else _CLASSIC
        self._channels[record.id] = _Channel(kind, topics.index(record.topic))

    def _chunk(self, raw: RawChunk) -> Iterator[FrameBatch]:
        content = open_chunk(raw)
        if isinstance(content, str):
            self.facts.damage.append(f"chunk at byte {raw.offset} is damaged: {content}")
            return
        self._register(*content.definitions)
        if content.damage:
            self.facts.damage.append(f"chunk at byte {raw.offset}: {content.damage}")
        batches: list[FrameBatch] = []
        rows: list[NDArray[np.intp]] = []
        view = ByteColumns(content.buffer.tobytes())
        for number, channel in self._channels.items():
            chosen = np.flatnonzero(content.channel == number)
            if not len(chosen):
                continue
            form = view.u16(content.offset[chosen].astype(np.intp), _RECORD_HEAD)
            self.facts.unreadable += int(np.count_nonzero(~np.isin(form, list(_ORDERS))))
            for told, numbers in _ORDERS.items():
                if len(some := chosen[form == told]):
                    batch, kept = self._frames(view.ordered(numbers), content, some, channel)
                    batches.append(batch)
                    rows.append(kept)
        if any(len(batch) for batch in batches):
            order = np.argsort(np.concatenate(rows), kind="stable")
            yield FrameBatch.concat(batches)[order]

    def _frames(
        self, view: ByteColumns, content: ChunkContent, rows: Places, channel: _Channel
    ) -> tuple[FrameBatch, Places]:
        """Frames of one channel, and their rows in the chunk; what is none is counted."""
        record = content.offset[rows].astype(np.intp)
        at = record + _RECORD_HEAD + _CDR_HEAD
        end = content.end[rows].astype(np.intp)
        name = view.u32(at, 8).astype(np.int64)
        named = (name <= _MAX_NAME) & (end - at >= 12)
        # A message of nothing but zeros says that it is big-endian, and has a name without its end.
        named &= (name > 0) | (view.u16(record, _RECORD_HEAD) != 0)
        body = np.where(named, 12 + name + -name % 4, 0)
        good = named & (at + body + (12 if channel.kind == _FD else 16) <= end)
        self.facts.unreadable += int(np.count_nonzero(~good))
        at, end, body, record, rows = at[good], end[good], body[good], record[good], rows[good]
        t_ns = view.u32(at, 0).astype(np.int64) * _SECOND_NS + view.u32(at, 4).astype(np.int64)
        unset = t_ns == 0
        self.facts.unstamped += int(np.count_nonzero(unset))
        t_ns = np.where(unset, content.log_time_ns[rows], t_ns)
        read = _fd_columns if channel.kind == _FD else _classic_columns
        can_id, flags, dlc, data = read(view, at + body, end)
        bus = np.full(len(rows), channel.bus, np.uint8)
        return FrameBatch(t_ns, bus, can_id, flags, dlc, data), rows


_Columns = tuple[NDArray[np.uint32], NDArray[np.uint16], NDArray[np.uint8], NDArray[np.uint8]]


def _classic_columns(view: ByteColumns, at: Places, end: Places) -> _Columns:
    """uint32 id, bool is_rtr, is_extended, is_error, uint8 dlc, uint8[8] data."""
    remote, extended, error = (view.u8(at, place) != 0 for place in (4, 5, 6))
    stated = view.u8(at, 7).astype(np.int64)
    remote &= ~error
    there = np.where(remote, 0, np.minimum(stated, 8))
    flags = _flags(extended, error)
    flags |= np.where(remote, FrameFlag.REMOTE, 0).astype(np.uint16)
    flags |= np.where(~remote & (stated > 8), FrameFlag.DLC_INVALID, 0).astype(np.uint16)
    data = np.where(np.arange(8) < there[:, np.newaxis], view.block(at, 8, 8), 0)
    dlc = np.minimum(stated, 8).astype(np.uint8)
    return _can_id(view, at, extended | error), flags, dlc, data.astype(np.uint8)


def _fd_columns(view: ByteColumns, at: Places, end: Places) -> _Columns:
    """uint32 id, bool is_extended, is_error, uint8 len, uint8[<=64] data with its count before."""
    extended, error = (view.u8(at, place) != 0 for place in (4, 5))
    stated = view.u8(at, 6).astype(np.int64)
    count = np.minimum(view.u32(at, 8).astype(np.int64), np.clip(end - at - 12, 0, 64))
    there = np.minimum(stated, count)
    flags = _flags(extended, error)
    flags |= np.where(error, 0, FrameFlag.FD).astype(np.uint16)
    flags |= np.where(there < stated, FrameFlag.DLC_INVALID, 0).astype(np.uint16)
    data = np.where(np.arange(64) < there[:, np.newaxis], view.block(at, 12, 64), 0)
    return _can_id(view, at, extended | error), flags, there.astype(np.uint8), data.astype(np.uint8)


def _flags(extended: NDArray[np.bool_], error: NDArray[np.bool_]) -> NDArray[np.uint16]:
    flags = np.where(extended & ~error, FrameFlag.EXTENDED, 0)
    return (flags | np.where(error, FrameFlag.ERROR, 0)).astype(np.uint16)


def _can_id(view: ByteColumns, at: Places, wide: NDArray[np.bool_]) -> NDArray[np.uint32]:
    ids = view.u32(at, 0)
    return np.where(wide, ids & 0x1FFFFFFF, ids & 0x7FF).astype(np.uint32)
