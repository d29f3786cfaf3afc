"""Collecting frames one by one into columns, at the least cost per frame."""

import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

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


LossPlace = Literal["kernel", "controller", "adapter", "line", "closed", "queue"]
"""Where frames were lost: "line" is the way from the adapter, "closed" an adapter whose channel was
closed, "queue" the buffer of this module."""

JOIN_NS = 100_000_000
"""Losses of one bus and place that follow each other closer than this are told as one."""
WHOLE_FRAMES = 128
"""Batches of so many frames are kept as they are; smaller ones are copied into rows."""
MAX_LOSSES = 1000
"""Kept of one bus and place until they are taken."""


@dataclass(frozen=True, slots=True)
class Loss:
    """Frames of one bus that were lost in one place.

    Attributes:
        frames: how many; None when unknown.
        first_ns, last_ns: none was lost before or after these times [ns].
        log_ns: when it became known [ns, log time].
    """

    bus: int
    where: LossPlace
    frames: int | None
    first_ns: int
    last_ns: int
    log_ns: int


def _joined(earlier: Loss, later: Loss) -> Loss:
    frames = (
        None if earlier.frames is None or later.frames is None else earlier.frames + later.frames
    )
    return Loss(
        later.bus,
        later.where,
        frames,
        min(earlier.first_ns, later.first_ns),
        max(earlier.last_ns, later.last_ns),
        later.log_ns,
    )


def _known_at(loss: Loss) -> int:
    return loss.log_ns


@dataclass(frozen=True, slots=True)
class Collected:
    """What came in since the last time: frames in the order taken, and what had no room.

    Attributes:
        frames: the columns; all arrays are the caller's own.
        log_ns: (n,) int64, when each frame was taken; never decreasing.
        losses: in the order in which they became known.
    """

    frames: FrameBatch
    log_ns: NDArray[np.int64]
    losses: list[Loss] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.frames)


def _batch_of(rows: NDArray[np.void]) -> FrameBatch:
    """Rows as columns, no wider than they must be."""
    columns = {
        name: np.ascontiguousarray(rows[name])
        for name in ("t_ns", "bus", "can_id", "flags", "dlc", "data")
    }
    if columns["data"].shape[1] == FD_BYTES and not (columns["dlc"] > CLASSIC_BYTES).any():
        columns["data"] = np.ascontiguousarray(columns["data"][:, :CLASSIC_BYTES])
    return FrameBatch(**columns)


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
        self._losses: dict[tuple[int, LossPlace, bool], list[Loss]] = {}
        self._whole: list[tuple[int, FrameBatch, int]] = []
        """Batches as they came, each with the number of rows before it and its log time."""
        self._kept_whole = 0
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
            if count + self._kept_whole >= self._capacity:
                self._keep(Loss(bus, "queue", 1, log_ns, log_ns, log_ns))
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
            self._count = count + 1
            if self._count + self._kept_whole == self._notify_rows:
                self.filled.set()

    def extend(self, batch: FrameBatch) -> None:
        """Add the frames of a batch, all taken now; its arrays must not change afterwards."""
        with self._lock:
            log_ns = self._clock_ns()
            room = self._capacity - self._count - self._kept_whole
            if len(batch) > room:
                for bus, lost in zip(*np.unique(batch.bus[room:], return_counts=True), strict=True):
                    self._keep(Loss(int(bus), "queue", int(lost), log_ns, log_ns, log_ns))
                batch = batch[:room]
            if len(batch) >= WHOLE_FRAMES:
                self._whole.append((self._count, batch, log_ns))
                self._kept_whole += len(batch)
            elif len(batch):
                self._copy(batch, log_ns)
            if self._count + self._kept_whole >= self._notify_rows:
                self.filled.set()

    def _copy(self, batch: FrameBatch, log_ns: int) -> None:
        if batch.data.shape[1] > self._width:
            self._widen()
        rows = self._rows()[self._count : self._count + len(batch)]
        for name in ("t_ns", "can_id", "flags", "bus", "dlc"):
            rows[name] = getattr(batch, name)
        rows["log_ns"] = log_ns
        rows["data"][:, : batch.data.shape[1]] = batch.data
        self._count += len(batch)

    def lose(
        self, bus: int, frames: int | None, where: LossPlace, first_ns: int, last_ns: int
    ) -> None:
        """Note frames that were lost before they came here, between these times of the bus.

        frames: how many; None when unknown.
        """
        with self._lock:
            self._keep(Loss(bus, where, frames, first_ns, last_ns, self._clock_ns()))

    def take(self) -> Collected:
        """Everything that waits; the buffer is empty afterwards."""
        with self._lock:
            rows = self._rows()[: self._count].copy()
            whole, self._whole = self._whole, []
            losses, self._losses = self._losses, {}
            self._count = self._kept_whole = 0
            self.filled.clear()
        batches: list[FrameBatch] = []
        log_ns: list[NDArray[np.int64]] = []
        begin = 0
        for end, batch, taken_ns in whole:
            if end > begin:
                batches.append(_batch_of(rows[begin:end]))
                log_ns.append(rows["log_ns"][begin:end])
                begin = end
            batches.append(batch)
            log_ns.append(np.full(len(batch), taken_ns, np.int64))
        batches.append(_batch_of(rows[begin:]))
        log_ns.append(rows["log_ns"][begin:])
        known = sorted((loss for alike in losses.values() for loss in alike), key=_known_at)
        return Collected(FrameBatch.concat(batches), np.concatenate(log_ns), known)

    def _rows(self) -> NDArray[np.void]:
        return np.frombuffer(self._memory, _ROW_TYPE[self._width])

    def _keep(self, loss: Loss) -> None:
        """Keep a loss, joined with the one before it where they are near or too many."""
        alike = self._losses.setdefault((loss.bus, loss.where, loss.frames is None), [])
        if alike and (loss.first_ns - alike[-1].last_ns < JOIN_NS or len(alike) == MAX_LOSSES):
            loss = _joined(alike.pop(), loss)
        alike.append(loss)

    def _widen(self) -> None:
        narrow, count = self._rows(), self._count
        self._allocate(FD_BYTES)
        rows = self._rows()
        for name in ("t_ns", "log_ns", "can_id", "flags", "bus", "dlc"):
            rows[name][:count] = narrow[name][:count]
        rows["data"][:count, :CLASSIC_BYTES] = narrow["data"][:count]
        self._count = count
