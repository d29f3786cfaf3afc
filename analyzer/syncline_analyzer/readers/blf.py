"""Vector BLF binary logs.

Layout of the objects as in Tobias Lorenz' description (Vector BLF) and python-can's `blf.py`; a log
is a row of containers, whose unpacked bytes joined are a row of objects.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.possible import possible
from syncline_analyzer.readers.source import CaptureSource
from syncline_analyzer.readers.times import utc_ns
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.byte_columns import ByteColumns, Column
from syncline_schemas.errors import CaptureError
from syncline_schemas.memory import keep_freed_memory

_HEADER_SIZE: Final = 144
_CONTAINER: Final = 10
_CAN_MESSAGES: Final = (1, 86)
_CAN_ERROR: Final = 2
_CAN_ERROR_EXT: Final = 73
_CAN_FD: Final = 100
_CAN_FD_64: Final = 101
_CAN_FD_ERROR_64: Final = 104
_FRAME_TYPES: Final = (
    *_CAN_MESSAGES,
    _CAN_ERROR,
    _CAN_ERROR_EXT,
    _CAN_FD,
    _CAN_FD_64,
    _CAN_FD_ERROR_64,
)
_OBJECT: Final = struct.Struct("<4sHHLL")
_SIGNATURE: Final = int.from_bytes(b"LOBJ", "little")
_BATCH_BYTES: Final = 4 * 1024 * 1024
_MAX_OBJECT: Final = 64 * 1024 * 1024
_FD_LENGTHS: Final = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64], np.uint8)


class BlfReader:
    """Reads a BLF as batches of some megabytes of objects."""

    def __init__(self, path: Path) -> None:
        self.facts = CaptureFacts(path, "blf", time_base="relative")
        source = CaptureSource(path)
        header = source.read(_HEADER_SIZE)
        source.close()
        if len(header) < 72 or header[:4] != b"LOGG":
            raise CaptureError(f"{path}: the BLF file header is cut off")
        self._header_size = max(72, min(int.from_bytes(header[4:8], "little"), 4096))
        self._start_ns = _system_time(header[40:56])
        if self._start_ns is not None:
            self.facts.time_base = "utc"
            self.facts.notes.append("the log's date names no time zone; it is taken as UTC")
        self._expected = int.from_bytes(header[32:36], "little")
        self._bus_of: dict[int, int] = {}
        self._steps: set[int] = set()

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in file order."""
        keep_freed_memory()
        source = CaptureSource(self.facts.path)
        try:
            source.read(self._header_size)
            yield from self._read(source)
        finally:
            source.close()
        if source.damage:
            self._harm(source.damage)
        self.facts.resolution_ns = min(self._steps, default=1)

    def _read(self, source: CaptureSource) -> Iterator[FrameBatch]:
        rest = b""
        joined: list[bytes] = []
        size = 0
        for data in self._containers(source):
            joined.append(data)
            size += len(data)
            if size >= _BATCH_BYTES:
                batch, rest = self._objects(rest + b"".join(joined))
                joined, size = [], 0
                if len(batch):
                    yield batch
        batch, rest = self._objects(rest + b"".join(joined))
        if len(batch):
            yield batch
        if len(rest) >= _OBJECT.size:
            self._harm("the last object is cut off")
        elif not joined and self._expected and not self._steps:
            self._harm(f"none of the {self._expected} objects that the header tells of is there")

    def _harm(self, what: str) -> None:
        self.facts.damage = self.facts.damage or what

    def _containers(self, source: CaptureSource) -> Iterator[bytes]:
        """Unpacked bytes of the containers; objects that stand outside of one are given as well."""
        while head := source.read(_OBJECT.size):
            if len(head) < _OBJECT.size:
                self._harm("the file ends within an object")
                return
            signature, _, _, size, kind = _OBJECT.unpack(head)
            if signature != b"LOBJ" or not _OBJECT.size <= size <= _MAX_OBJECT:
                self._harm("an object does not start where the one before it ends")
                return
            body = source.read(size - _OBJECT.size)
            whole = len(body) == size - _OBJECT.size
            padding = source.read(size % 4)
            if kind != _CONTAINER:
                yield head + body + padding
            else:
                yield from self._unpacked(body)
            if not whole:
                self._harm("the file ends within an object")
                return

    def _unpacked(self, body: bytes) -> Iterator[bytes]:
        method = int.from_bytes(body[:2], "little")
        packed = body[16:]
        if len(body) < 16 or method == 0:
            yield packed
        elif method == 2:
            inflate = zlib.decompressobj()
            try:
                yield inflate.decompress(packed, _MAX_OBJECT)
            except zlib.error as error:
                self._harm(f"a container cannot be unpacked: {error}")
        else:
            self._harm(f"a container is packed in the unknown way {method}")

    def _objects(self, data: bytes) -> tuple[FrameBatch, bytes]:
        """Frames of all whole objects in the data, and the bytes left."""
        plain = _plain_messages(data)
        frames = self._plain_frames(plain)
        rest, left = self._other_objects(data[plain.nbytes :])
        return FrameBatch.concat([each for each in (frames, rest) if len(each)]), left

    def _plain_frames(self, objects: NDArray[np.void]) -> FrameBatch:
        """Frames of CAN messages that stand in a row, as a matrix."""
        columns = _Columns(len(objects), 8)
        columns.channel[:] = objects["channel"]
        columns.can_id[:] = objects["id"] & 0x1FFFFFFF
        columns.flags[:] = _FLAGS_OF_BYTE[objects["flags"]]
        columns.flags |= ((objects["id"] >> 31) * int(FrameFlag.EXTENDED)).astype(np.uint16)
        np.minimum(objects["length"], 8, out=columns.dlc)
        columns.data_count[:] = columns.dlc
        columns.data_count[(columns.flags & FrameFlag.REMOTE) != 0] = 0
        columns.data[:] = objects["data"]
        columns.t_ns[:] = self._stamps(objects["stamp"], objects["unit"] == 1)
        return self._batch(columns)

    def _other_objects(self, data: bytes) -> tuple[FrameBatch, bytes]:
        at, used = _object_places(data)
        if used < 0:
            self._harm("an object does not start where the one before it ends")
            used = len(data)
        view = ByteColumns(data)
        wanted = at[np.isin(view.u32(at, 12), _FRAME_TYPES)]
        return self._frames(view, wanted), data[used:]

    def _frames(self, view: ByteColumns, at: NDArray[np.intp]) -> FrameBatch:
        kind = view.u32(at, 12)
        body = at + view.u16(at, 4).astype(np.intp)
        size = view.u32(at, 8).astype(np.intp)
        whole = (body + _least_body(kind) <= at + size) & (view.u16(at, 4) >= 32)
        if not whole.all():
            self.facts.unparsed_count += int(np.count_nonzero(~whole))
            at, kind, body, size = at[whole], kind[whole], body[whole], size[whole]
        fd = bool(np.isin(kind, (_CAN_FD, _CAN_FD_64)).any())
        columns = _Columns(len(at), 64 if fd else 8)
        columns.t_ns[:] = self._times(view, at)
        for kinds, read in _READERS:
            rows = np.flatnonzero(np.isin(kind, kinds))
            if len(rows):
                read(view, body[rows], at[rows] + size[rows], columns, rows)
        return self._batch(columns)

    def _times(self, view: ByteColumns, at: NDArray[np.intp]) -> NDArray[np.int64]:
        return self._stamps(view.u64(at, 24).view(np.int64), view.u32(at, 16) == 1)

    def _stamps(self, stamps: NDArray[np.int64], ten_us: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Times of objects, whose stamps count ns or 10 us."""
        self._steps.update({10_000} if ten_us.any() else set(), {1} if not ten_us.all() else set())
        if ten_us.any():
            stamps = stamps * np.where(ten_us, 10_000, 1)
        return stamps + (self._start_ns or 0)

    def _batch(self, columns: "_Columns") -> FrameBatch:
        if len(columns.channel) and not np.any(columns.channel != columns.channel[0]):
            channels, first = columns.channel[:1], np.zeros(1, np.intp)
        else:
            channels, first = np.unique(columns.channel, return_index=True)
        for channel in channels[np.argsort(first)].tolist():
            if channel not in self._bus_of:
                full = len(self.facts.buses) >= 256
                self._bus_of[channel] = 255 if full else self.facts.bus_number(str(channel))
        numbers = np.array([self._bus_of[int(channel)] for channel in channels], np.uint8)
        bus = numbers[np.searchsorted(channels, columns.channel)] if len(channels) else columns.dlc
        frames = FrameBatch(
            columns.t_ns,
            bus,
            columns.can_id,
            columns.flags,
            columns.dlc,
            columns.data * _KEPT[columns.data_count, : columns.data.shape[1]],
        )
        return possible(frames, self.facts)


_KEPT: Final = (np.arange(64) < np.arange(65)[:, None]).astype(np.uint8)
"""(65, 64) 1 for each of the first n bytes."""
_FLAGS_OF_BYTE: Final = np.array(
    [(byte & 1) * int(FrameFlag.TX) | (byte >> 7) * int(FrameFlag.REMOTE) for byte in range(256)],
    np.uint16,
)
_PLAIN: Final = np.dtype(
    [
        ("signature", "<u4"),
        ("header", "<u2"),
        ("version", "<u2"),
        ("size", "<u4"),
        ("kind", "<u4"),
        ("unit", "<u4"),
        ("client", "<u2"),
        ("object_version", "<u2"),
        ("stamp", "<i8"),
        ("channel", "<u2"),
        ("flags", "u1"),
        ("length", "u1"),
        ("id", "<u4"),
        ("data", "u1", (8,)),
    ]
)
"""A CAN message, classic, of which most logs consist: an object of 48 bytes."""


def _plain_messages(data: bytes) -> NDArray[np.void]:
    """The CAN messages with which the data begin, as far as nothing else comes between."""
    objects = np.frombuffer(data, _PLAIN, len(data) // _PLAIN.itemsize)
    other = (
        (objects["signature"] != _SIGNATURE)
        | (objects["size"] != _PLAIN.itemsize)
        | (objects["header"] != 32)
        | ((objects["kind"] != _CAN_MESSAGES[0]) & (objects["kind"] != _CAN_MESSAGES[1]))
    )
    return objects[: int(np.argmax(other)) if other.any() else len(objects)]


class _Columns:
    """Columns that the readers of the object types fill, row by row of their type."""

    def __init__(self, n: int, width: int) -> None:
        self.t_ns = np.zeros(n, np.int64)
        self.channel = np.zeros(n, np.uint16)
        self.can_id = np.zeros(n, np.uint32)
        self.flags = np.zeros(n, np.uint16)
        self.dlc = np.zeros(n, np.uint8)
        self.data_count = np.zeros(n, np.uint8)
        self.data = np.zeros((n, width), np.uint8)

    def put_id(self, rows: NDArray[np.intp], raw: Column) -> None:
        self.can_id[rows] = raw & 0x1FFFFFFF
        self.flags[rows] |= np.where(raw & 0x80000000, FrameFlag.EXTENDED, 0).astype(np.uint16)

    def put_flag(self, rows: NDArray[np.intp], flag: FrameFlag, given: Column) -> None:
        self.flags[rows] |= np.where(given != 0, flag, 0).astype(np.uint16)

    def put_length(self, rows: NDArray[np.intp], stated: Column, there: Column) -> None:
        """Length in bytes; a frame with fewer bytes than stated is marked."""
        remote = (self.flags[rows] & FrameFlag.REMOTE) != 0
        count = np.where(remote, 0, np.minimum(stated, there))
        self.data_count[rows] = count
        self.dlc[rows] = np.where(remote, np.minimum(stated, 8), count)
        self.put_flag(rows, FrameFlag.DLC_INVALID, (~remote & (there < stated)).astype(np.uint64))


_Reader = Callable[
    [ByteColumns, NDArray[np.intp], NDArray[np.intp], _Columns, NDArray[np.intp]], None
]


def _can_message(
    view: ByteColumns,
    at: NDArray[np.intp],
    end: NDArray[np.intp],
    out: _Columns,
    rows: NDArray[np.intp],
) -> None:
    out.channel[rows] = view.u16(at, 0)
    flags = view.u8(at, 2)
    out.put_id(rows, view.u32(at, 4))
    out.put_flag(rows, FrameFlag.TX, flags & 1)
    out.put_flag(rows, FrameFlag.REMOTE, flags & 0x80)
    length = np.minimum(view.u8(at, 3), 8)
    out.put_length(rows, length, length)
    out.data[rows, :8] = view.block(at, 8, 8)


def _can_error(
    view: ByteColumns,
    at: NDArray[np.intp],
    end: NDArray[np.intp],
    out: _Columns,
    rows: NDArray[np.intp],
) -> None:
    out.channel[rows] = view.u16(at, 0)
    out.flags[rows] = FrameFlag.ERROR
    out.dlc[rows] = 8


def _can_error_ext(
    view: ByteColumns,
    at: NDArray[np.intp],
    end: NDArray[np.intp],
    out: _Columns,
    rows: NDArray[np.intp],
) -> None:
    out.channel[rows] = view.u16(at, 0)
    out.flags[rows] = FrameFlag.ERROR
    length = np.minimum(view.u8(at, 10), 8)
    out.put_length(rows, length, length)
    # Vector's tools fill in what the controller told, and the identifier is the disturbed frame's;
    # python-can leaves all that empty and stores SocketCAN's error frame.
    told = (view.u16(at, 2) != 0) | (view.u32(at, 4) != 0) | (view.u16(at, 8) != 0)
    told |= view.u32(at, 12) != 0
    out.can_id[rows] = np.where(told, np.uint32(0), view.u32(at, 16) & 0x1FFFFFFF)
    out.data[rows, :8] = np.where(told[:, np.newaxis], np.uint8(0), view.block(at, 24, 8))


def _can_fd(
    view: ByteColumns,
    at: NDArray[np.intp],
    end: NDArray[np.intp],
    out: _Columns,
    rows: NDArray[np.intp],
) -> None:
    out.channel[rows] = view.u16(at, 0)
    flags, fd_flags = view.u8(at, 2), view.u8(at, 13)
    out.put_id(rows, view.u32(at, 4))
    out.put_flag(rows, FrameFlag.TX, flags & 1)
    out.put_flag(rows, FrameFlag.REMOTE, flags & 0x80)
    _put_fd_flags(out, rows, fd_flags & 1, fd_flags & 2, fd_flags & 4)
    stated = _FD_LENGTHS[np.minimum(view.u8(at, 3), 15).astype(np.intp)].astype(np.uint64)
    out.put_length(rows, stated, np.minimum(view.u8(at, 14), 64))
    out.data[rows, :64] = view.block(at, 20, 64)


def _can_fd_64(
    view: ByteColumns,
    at: NDArray[np.intp],
    end: NDArray[np.intp],
    out: _Columns,
    rows: NDArray[np.intp],
) -> None:
    out.channel[rows] = view.u8(at, 0)
    flags = view.u32(at, 12)
    out.put_id(rows, view.u32(at, 4))
    out.put_flag(rows, FrameFlag.TX, view.u8(at, 34))
    out.put_flag(rows, FrameFlag.REMOTE, flags & 0x0010)
    _put_fd_flags(out, rows, flags & 0x1000, flags & 0x2000, flags & 0x4000)
    stated = _FD_LENGTHS[np.minimum(view.u8(at, 1), 15).astype(np.intp)].astype(np.uint64)
    # Valid bytes beyond the object's end are zeros, as in Vector's own library.
    valid = np.minimum(view.u8(at, 2), 64)
    out.put_length(rows, stated, valid)
    there = np.clip(end - at - 40, 0, 64)
    data = view.block(at, 40, 64)
    out.data[rows, :64] = np.where(np.arange(64) < there[:, None], data, 0)


def _can_fd_error_64(
    view: ByteColumns,
    at: NDArray[np.intp],
    end: NDArray[np.intp],
    out: _Columns,
    rows: NDArray[np.intp],
) -> None:
    out.channel[rows] = view.u8(at, 0)
    out.flags[rows] = FrameFlag.ERROR
    out.dlc[rows] = 8


def _put_fd_flags(
    out: _Columns, rows: NDArray[np.intp], fd: Column, brs: Column, esi: Column
) -> None:
    out.put_flag(rows, FrameFlag.FD, fd)
    out.put_flag(rows, FrameFlag.BRS, np.where(fd != 0, brs, 0))
    out.put_flag(rows, FrameFlag.ESI, np.where(fd != 0, esi, 0))


_READERS: Final[tuple[tuple[tuple[int, ...], _Reader], ...]] = (
    (_CAN_MESSAGES, _can_message),
    ((_CAN_ERROR,), _can_error),
    ((_CAN_ERROR_EXT,), _can_error_ext),
    ((_CAN_FD,), _can_fd),
    ((_CAN_FD_64,), _can_fd_64),
    ((_CAN_FD_ERROR_64,), _can_fd_error_64),
)


def _least_body(kind: Column) -> NDArray[np.intp]:
    sizes = {1: 16, 86: 16, 2: 4, 73: 32, 100: 20, 101: 40, 104: 44}
    out = np.zeros(len(kind), np.intp)
    for number, size in sizes.items():
        out[kind == number] = size
    return out


def _object_places(data: bytes) -> tuple[NDArray[np.intp], int]:
    """Where whole objects start, and how many bytes they take; -1 where no object starts in time."""
    words = np.frombuffer(data, "<u4", len(data) // 4)
    at = np.flatnonzero(words == _SIGNATURE) * 4
    sizes = words[np.minimum(at // 4 + 2, len(words) - 1)].astype(np.intp) if len(at) else at
    ends = at + sizes
    # An object of odd size is padded by as many bytes as it has too many.
    chained = len(at) > 0 and at[0] == 0 and bool(np.all(ends[:-1] + sizes[:-1] % 4 == at[1:]))
    if not chained:
        return _walked_places(data)
    if ends[-1] > len(data) or at[-1] + _OBJECT.size > len(data):
        return at[:-1], int(at[-1])
    return at, int(min(ends[-1] + sizes[-1] % 4, len(data)))


def _walked_places(data: bytes) -> tuple[NDArray[np.intp], int]:
    places: list[int] = []
    at = 0
    while len(data) - at >= _OBJECT.size:
        found = data.find(b"LOBJ", at, at + 8)
        if found < 0:
            return np.array(places, np.intp), -1
        at = found
        size = int.from_bytes(data[at + 8 : at + 12], "little")
        if len(data) - at < _OBJECT.size or at + size > len(data):
            break
        if size < _OBJECT.size:
            return np.array(places, np.intp), -1
        places.append(at)
        at += size
    return np.array(places, np.intp), at


def _system_time(raw: bytes) -> int | None:
    year, month, _, day, hour, minute, second, milliseconds = struct.unpack("<8H", raw)
    whole = utc_ns(year, month, day, hour, minute, second) if year else None
    return None if whole is None else whole + min(milliseconds, 999) * 10**6
