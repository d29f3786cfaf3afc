"""Collecting frames one by one into columns, at the least cost per frame."""

import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch

CLASSIC_BYTES = 8
FD_BYTES = 64


def _row_type(width: int) -> np.dtype[np.void]:
    return np.dtype(
        [
            ("t_ns", "<i8"),
            ("log_ns", "<i8"),
            ("can_id", "<u4"),
            ("flags", "<u2"),
            ("bus", "u1"),
            ("dlc", "u1"),
            ("data", "u1", (width,)),
        ]
    )


_ROW_TYPE = {width: _row_type(width) for width in (CLASSIC_BYTES, FD_BYTES)}
_PACK_INTO = {
    width: struct.Struct(f"<qqIHBB{width}s").pack_into for width in (CLASSIC_BYTES, FD_BYTES)
}


@dataclass(slots=True)
class QueueLoss:
    """Frames of one bus that found the buffer full, and when [ns, log time]."""

    frames: int
    first_ns: int
    last_ns: int


@dataclass(frozen=True, slots=True)
class Collected:
    """What came in since the last time: frames in the order taken, and what had no room.

    Attributes:
        frames: the columns; all arrays are the caller's own.
        log_ns: (n,) int64, when each frame was taken; never decreasing.
        losses: by bus number.
    """

    frames: FrameBatch
    log_ns: NDArray[np.int64]
    losses: dict[int, QueueLoss] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.frames)


class FrameBuffer:
    """The bounded queue between the threads that read buses and the one that writes.

    Preallocated rows, filled by any number of threads. A frame for which there is no room is
    counted with its bus and time instead of being kept.
    """

    def __init__(
        self, clock_ns: Callable[[], int], capacity: int = 1 << 17, notify_rows: int = 1 << 14
    ) -> None:
        self._clock_ns = clock_ns
        self._capacity = capacity
        self._notify_rows = notify_rows
        self._lock = threading.Lock()
        self.filled = threading.Event()
        """Set when `notify_rows` frames wait to be taken."""
        self._losses: dict[int, QueueLoss] = {}
        self._allocate(CLASSIC_BYTES)

    def _allocate(self, width: int) -> None:
        self._width = width
        self._row_bytes = _ROW_TYPE[width].itemsize
        self._pack_into = _PACK_INTO[width]
        self._memory = bytearray(self._row_bytes * self._capacity)
        self._count = 0

    def append(
        self, t_ns: int, bus: int, can_id: int, flags: int, dlc: int, data: bytes | bytearray
    ) -> None:
        """Add one frame, stamped with the recorder's clock; `t_ns` 0 takes that stamp too."""
        with self._lock:
            log_ns = self._clock_ns()
            count = self._count
            if count == self._capacity:
                self._lose(bus, log_ns, 1)
                return
            if len(data) > self._width:
                self._widen()
            self._pack_into(
                self._memory,
                count * self._row_bytes,
                t_ns or log_ns,
                log_ns,
                can_id,
                flags,
                bus,
                dlc,
                data,
            )
            self._count = count = count + 1
        if count == self._notify_rows:
            self.filled.set()

    def extend(self, batch: FrameBatch) -> None:
        """Add the frames of a batch, all taken now."""
        with self._lock:
            log_ns = self._clock_ns()
            room = self._capacity - self._count
            if len(batch) > room:
                for bus, lost in zip(*np.unique(batch.bus[room:], return_counts=True), strict=True):
                    self._lose(int(bus), log_ns, int(lost))
                batch = batch[:room]
            if len(batch) == 0:
                return
            if batch.data.shape[1] > self._width:
                self._widen()
            rows = self._rows()[self._count : self._count + len(batch)]
            for name in ("t_ns", "can_id", "flags", "bus", "dlc"):
                rows[name] = getattr(batch, name)
            rows["log_ns"] = log_ns
            rows["data"][:, : batch.data.shape[1]] = batch.data
            self._count += len(batch)
            if self._count >= self._notify_rows:
                self.filled.set()

    def take(self) -> Collected:
        """Everything that waits; the buffer is empty afterwards."""
        with self._lock:
            rows = self._rows()[: self._count].copy()
            losses, self._losses = self._losses, {}
            self._count = 0
            self.filled.clear()
        frames = FrameBatch(
            *(
                np.ascontiguousarray(rows[name])
                for name in ("t_ns", "bus", "can_id", "flags", "dlc", "data")
            )
        )
        if frames.data.shape[1] == FD_BYTES and not len(frames.dlc[frames.dlc > CLASSIC_BYTES]):
            frames = FrameBatch(
                frames.t_ns,
                frames.bus,
                frames.can_id,
                frames.flags,
                frames.dlc,
                np.ascontiguousarray(frames.data[:, :CLASSIC_BYTES]),
            )
        return Collected(frames, np.ascontiguousarray(rows["log_ns"]), losses)

    def _rows(self) -> NDArray[np.void]:
        return np.frombuffer(self._memory, _ROW_TYPE[self._width])

    def _lose(self, bus: int, log_ns: int, frames: int) -> None:
        loss = self._losses.setdefault(bus, QueueLoss(0, log_ns, log_ns))
        loss.frames += frames
        loss.last_ns = log_ns

    def _widen(self) -> None:
        narrow, count = self._rows(), self._count
        self._allocate(FD_BYTES)
        rows = self._rows()
        for name in ("t_ns", "log_ns", "can_id", "flags", "bus", "dlc"):
            rows[name][:count] = narrow[name][:count]
        rows["data"][:count, :CLASSIC_BYTES] = narrow["data"][:count]
        self._count = count
