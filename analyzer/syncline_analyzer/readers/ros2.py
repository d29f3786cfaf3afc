"""ROS 2 recordings in MCAP: `can_msgs/msg/Frame` and the messages of ros2_socketcan, CAN FD too.

The messages are in CDR (OMG DDS-XTypes 7.4.1, as ROS 2 writes it): a header of four bytes, then the
fields in order, each aligned to its size. Only the length of `frame_id` varies, so that messages
of equal length are read as columns. No ROS is needed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import mcap.records as mcap_records
import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.byte_columns import ByteColumns, Places
from syncline_analyzer.readers.resolution import Resolution
from syncline_analyzer.readers.times import FIRST_UTC_NS, SECOND_NS
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.capture.chunk_content import ChunkContent, open_chunk
from syncline_schemas.capture.record_file import Definition, Lost, RawChunk, RecordFile

CLASSIC_SCHEMAS: Final = ("can_msgs/msg/Frame", "ros2_socketcan_msgs/msg/Frame")
FD_SCHEMAS: Final = ("ros2_socketcan_msgs/msg/FdFrame",)
SCHEMAS: Final = (*CLASSIC_SCHEMAS, *FD_SCHEMAS)
_RECORD_HEAD: Final = 31
_CDR_HEAD: Final = 4
_MAX_NAME: Final = 4096
_MAX_BUSES: Final = 256
_CLASSIC, _FD = 1, 2


def ros2_schemas(path: Path) -> list[str]:
    """Names of the CAN schemas in an MCAP file that is none of ours."""
    with path.open("rb") as file:
        records = RecordFile(file)
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
class _Channel:
    kind: int
    bus: int


class Ros2Reader:
    """The CAN frames of a ROS 2 bag; each topic is a bus of its own."""

    def __init__(self, path: Path, start_ns: int | None = None, end_ns: int | None = None) -> None:
        self._path = path
        self.facts = CaptureFacts(path, "ros2")
        self._range = (start_ns, end_ns)
        self._schemas: dict[int, mcap_records.Schema] = {}
        self._channels: dict[int, _Channel] = {}
        self._resolution = Resolution()
        self._damage: list[str] = []
        self._bag_times = 0

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in file order."""
        with self._path.open("rb") as file:
            records = RecordFile(file)
            summary = records.summary()
            if summary is not None:
                self._register(*summary.schemas, *summary.channels)
            for record in records.records():
                if isinstance(record, mcap_records.Schema | mcap_records.Channel):
                    self._register(record)
                elif isinstance(record, Lost):
                    self._damage.append(record.reason)
                elif isinstance(record, RawChunk):
                    yield from self._chunk(record)
            self._finish(records)

    def _finish(self, records: RecordFile) -> None:
        self.facts.resolution_ns = self._resolution.step_ns
        self._damage += records.damage
        if not records.closed:
            self._damage.append("no footer: the recording was cut off or still runs")
        self.facts.damage = "; ".join(self._damage[:20]) or None
        if self._bag_times:
            self.facts.notes.append(
                f"{self._bag_times} message(s) have no stamp; the time of recording is used"
            )
        if len(self.facts.buses) > 1:
            self.facts.notes.append(
                "each topic is taken for a bus; ros2_socketcan's to_can_bus and from_can_bus are one"
            )

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
            self._damage.append(f"messages of {record.topic} are in {record.message_encoding}")
        elif len(self.facts.buses) < _MAX_BUSES:
            kind = _FD if schema.name in FD_SCHEMAS else _CLASSIC
            self._channels[record.id] = _Channel(kind, self.facts.bus_number(record.topic))

    def _chunk(self, raw: RawChunk) -> Iterator[FrameBatch]:
        content = open_chunk(raw)
        if isinstance(content, str):
            self._damage.append(f"chunk at byte {raw.offset} is damaged: {content}")
            return
        self._register(*content.definitions)
        if content.damage:
            self._damage.append(f"chunk at byte {raw.offset}: {content.damage}")
        batches: list[FrameBatch] = []
        rows: list[NDArray[np.intp]] = []
        view = ByteColumns(content.buffer.tobytes())
        for number, channel in self._channels.items():
            chosen = np.flatnonzero(content.channel == number)
            if len(chosen):
                batch, kept = self._frames(view, content, chosen, channel)
                batches.append(batch)
                rows.append(kept)
        if not batches:
            return
        order = np.argsort(np.concatenate(rows), kind="stable")
        frames = self._wanted(FrameBatch.concat(batches)[order])
        if len(frames):
            self._resolution.sample(frames.t_ns, frames.bus, frames.can_id)
            if int(frames.t_ns[0]) < FIRST_UTC_NS:
                self.facts.time_base = "relative"
            yield frames

    def _wanted(self, frames: FrameBatch) -> FrameBatch:
        start_ns, end_ns = self._range
        if start_ns is not None:
            frames = frames[frames.t_ns >= start_ns]
        return frames if end_ns is None else frames[frames.t_ns < end_ns]

    def _frames(
        self, view: ByteColumns, content: ChunkContent, rows: Places, channel: _Channel
    ) -> tuple[FrameBatch, Places]:
        """Frames of one channel, and their rows in the chunk; what is none is counted."""
        record = content.offset[rows].astype(np.intp)
        at = record + _RECORD_HEAD + _CDR_HEAD
        end = content.end[rows].astype(np.intp)
        name = view.u32(at, 8).astype(np.int64)
        named = (view.u8(at, -3) == 1) & (name <= _MAX_NAME) & (end - at >= 12)
        body = np.where(named, 12 + name + -name % 4, 0)
        good = named & (at + body + (12 if channel.kind == _FD else 16) <= end)
        self._count(int(np.count_nonzero(~good)))
        at, end, body, record, rows = at[good], end[good], body[good], record[good], rows[good]
        t_ns = view.u32(at, 0).astype(np.int64) * SECOND_NS + view.u32(at, 4).astype(np.int64)
        unset = t_ns == 0
        self._bag_times += int(np.count_nonzero(unset))
        t_ns = np.where(unset, content.log_time_ns[rows], t_ns)
        read = _fd_columns if channel.kind == _FD else _classic_columns
        can_id, flags, dlc, data = read(view, at + body, end)
        bus = np.full(len(rows), channel.bus, np.uint8)
        return FrameBatch(t_ns, bus, can_id, flags, dlc, data), rows

    def _count(self, unreadable: int) -> None:
        for _ in range(min(unreadable, 100)):
            self.facts.add_unparsed(0, "a message that is no CAN frame")
        self.facts.unparsed_count += max(0, unreadable - 100)


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
