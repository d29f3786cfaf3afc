"""Vector BLF: objects in compressed containers, stamps in ns from the first stamp's millisecond."""

import struct
import zlib
from datetime import UTC, datetime
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.writers.compose import Chars, has, interleave, kinds_of, payload_length
from syncline_analyzer.writers.log import LogWriter, Survey
from syncline_schemas.batch import FrameBatch, FrameFlag

_HEADER: Final = struct.Struct("<4sLBBBBBBBBQQLL8H8H")
_HEADER_SIZE: Final = 144
_CONTAINER_BYTES: Final = 128 * 1024
_OBJECT_FIELDS: Final = [
    ("signature", "S4"),
    ("header_size", "<u2"),
    ("header_version", "<u2"),
    ("size", "<u4"),
    ("type", "<u4"),
    ("time_unit", "<u4"),
    ("client", "<u2"),
    ("version", "<u2"),
    ("t", "<u8"),
    ("channel", "<u2"),
]
_CAN: Final = np.dtype(
    [*_OBJECT_FIELDS, ("flags", "u1"), ("dlc", "u1"), ("id", "<u4"), ("data", "u1", (8,))]
)
_ERROR: Final = np.dtype(
    [
        *_OBJECT_FIELDS,
        ("before", "V8"),
        ("dlc", "u1"),
        ("spare", "V5"),
        ("id", "<u4"),
        ("more", "V4"),
        ("data", "u1", (8,)),
    ]
)
_FD: Final = np.dtype(
    [
        *_OBJECT_FIELDS,
        ("flags", "u1"),
        ("dlc", "u1"),
        ("id", "<u4"),
        ("length", "<u4"),
        ("bits", "u1"),
        ("fd_flags", "u1"),
        ("valid", "u1"),
        ("spare", "V5"),
        ("data", "u1", (64,)),
    ]
)
_FD_LENGTHS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_FD_CODES: Final = np.searchsorted(_FD_LENGTHS, range(65))


class BlfWriter(LogWriter):
    """Writes the classic objects that every reader of BLF knows."""

    def __init__(self, stream: BinaryIO, survey: Survey) -> None:
        super().__init__(stream, survey)
        self._count_bus_names()
        self._start_ns = survey.origin_ns - survey.origin_ns % 10**6
        self._stop_ns = survey.first_ns
        self._objects = 0
        self._unpacked_size = _HEADER_SIZE
        self._buffer = b""
        stream.write(self._header(0))

    def write(self, batch: FrameBatch) -> None:
        """Write frames."""
        self._count_marks(batch)
        if not len(batch):
            return
        kinds = kinds_of(batch)
        self._buffer += interleave([(rows, self._records(batch[rows])) for rows in kinds])
        self._objects += len(batch)
        self._stop_ns = max(self._stop_ns, int(batch.t_ns.max()))
        whole = len(self._buffer) - len(self._buffer) % _CONTAINER_BYTES
        for start in range(0, whole, _CONTAINER_BYTES):
            self._container(self._buffer[start : start + _CONTAINER_BYTES])
        self._buffer = self._buffer[whole:]

    def close(self) -> None:
        """Write the last container, and the header again, now with the sizes."""
        if self._buffer:
            self._container(self._buffer)
        size = self._stream.tell()
        self._stream.seek(0)
        self._stream.write(self._header(size))
        self._stream.seek(size)

    def _records(self, batch: FrameBatch) -> Chars:
        """(n, width) objects of frames of one kind."""
        if has(batch, FrameFlag.ERROR):
            records = self._objects_of(batch, _ERROR, 73)
        elif has(batch, FrameFlag.FD):
            records = self._objects_of(batch, _FD, 100)
            records["dlc"] = _FD_CODES[payload_length(batch)]
            records["valid"] = payload_length(batch)
            brs, esi = has(batch, FrameFlag.BRS), has(batch, FrameFlag.ESI)
            records["fd_flags"] = 1 | brs << 1 | esi << 2
            records["flags"] = has(batch, FrameFlag.TX)
        else:
            records = self._objects_of(batch, _CAN, 1)
            remote = has(batch, FrameFlag.REMOTE)
            records["flags"] = has(batch, FrameFlag.TX) | remote << 7
        return records.view(np.uint8).reshape(len(batch), -1)

    def _objects_of(
        self, batch: FrameBatch, dtype: np.dtype[np.void], kind: int
    ) -> NDArray[np.void]:
        records = np.zeros(len(batch), dtype)
        records["signature"], records["header_size"], records["header_version"] = b"LOBJ", 32, 1
        records["size"], records["type"], records["time_unit"] = dtype.itemsize, kind, 2
        records["t"] = batch.t_ns - self._start_ns
        records["channel"] = int(batch.bus[0]) + 1
        extended = np.uint32(0x80000000 if has(batch, FrameFlag.EXTENDED) else 0)
        records["id"] = batch.can_id | extended
        records["dlc"] = batch.dlc
        width = min(records["data"].shape[1], batch.data.shape[1])
        records["data"][:, :width] = batch.data[:, :width]
        return records

    def _container(self, data: bytes) -> None:
        packed = zlib.compress(data)
        size = 32 + len(packed)
        head = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, size, 10, 2, len(data))
        self._stream.write(head + packed + bytes(size % 4))
        self._unpacked_size += 32 + len(data)

    def _header(self, size: int) -> bytes:
        dated = self._survey.time_base == "utc"
        start, stop = (
            _system_time(t_ns if dated else 0) for t_ns in (self._start_ns, self._stop_ns)
        )
        counts = (size, self._unpacked_size, self._objects, 0)
        packed = _HEADER.pack(b"LOGG", _HEADER_SIZE, 5, 0, 0, 0, 2, 6, 8, 1, *counts, *start, *stop)
        return packed.ljust(_HEADER_SIZE, b"\0")


def _system_time(t_ns: int) -> tuple[int, ...]:
    if t_ns <= 0:
        return (0,) * 8
    t = datetime.fromtimestamp(t_ns // 10**9, UTC)
    milliseconds = t_ns // 10**6 % 1000
    return t.year, t.month, t.isoweekday() % 7, t.day, t.hour, t.minute, t.second, milliseconds
