"""The frame batch: the only shape in which frames travel."""

from collections.abc import Iterable, Sequence
from enum import IntFlag
from typing import Self

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass


class FrameFlag(IntFlag):
    """Bits of the `flags` column; the numbers are part of the capture format and never change."""

    EXTENDED = 1 << 0
    """29-bit identifier."""
    REMOTE = 1 << 1
    """Remote frame: `dlc` is what was asked for, `data` is empty."""
    ERROR = 1 << 2
    """Error frame: `can_id` holds the SocketCAN error class bits, `data` its eight bytes."""
    FD = 1 << 3
    BRS = 1 << 4
    ESI = 1 << 5
    TX = 1 << 6
    """Sent by the machine that recorded it."""
    DLC_INVALID = 1 << 7
    """The log states a length that its data bytes contradict; `dlc` is the number of bytes kept."""


_REMOTE = int(FrameFlag.REMOTE)


@dataclass(frozen=True, slots=True, eq=False)
class FrameBatch:
    """Frames as numpy columns, one row per frame, in arrival order.

    Attributes:
        t_ns: (n,) int64, stamp closest to the wire, ns since the UNIX epoch (or since the start
            of a log that has no date).
        bus: (n,) uint8, number of the bus in the capture's list of buses.
        can_id: (n,) uint32, 11- or 29-bit identifier without flag bits.
        flags: (n,) uint16, `FrameFlag` bits.
        dlc: (n,) uint8, length in bytes (0..64), not the FD code.
        data: (n, 8) uint8, or (n, 64) when a batch holds FD frames; bytes from `dlc` on are 0.
    """

    t_ns: NDArray[np.int64]
    bus: NDArray[np.uint8]
    can_id: NDArray[np.uint32]
    flags: NDArray[np.uint16]
    dlc: NDArray[np.uint8]
    data: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, rows: slice | NDArray[np.intp] | NDArray[np.bool_]) -> "FrameBatch":
        """Rows chosen by slice, index array or mask."""
        return FrameBatch(
            self.t_ns[rows],
            self.bus[rows],
            self.can_id[rows],
            self.flags[rows],
            self.dlc[rows],
            self.data[rows],
        )

    @classmethod
    def empty(cls) -> Self:
        """A batch of no frames."""
        return cls.from_rows([])

    @classmethod
    def from_rows(cls, rows: Iterable[tuple[int, int, int, int, int, bytes]]) -> Self:
        """A batch from (t_ns, bus, can_id, flags, dlc, data) tuples; for rare events and tests."""
        listed = list(rows)
        width = 64 if any(len(row[5]) > 8 for row in listed) else 8
        data = np.zeros((len(listed), width), np.uint8)
        for i, row in enumerate(listed):
            data[i, : len(row[5])] = np.frombuffer(row[5], np.uint8)
        columns = list(zip(*(row[:5] for row in listed), strict=True)) or [[]] * 5
        return cls(
            np.array(columns[0], np.int64),
            np.array(columns[1], np.uint8),
            np.array(columns[2], np.uint32),
            np.array(columns[3], np.uint16),
            np.array(columns[4], np.uint8),
            data,
        )

    @staticmethod
    def concat(batches: Sequence["FrameBatch"]) -> "FrameBatch":
        """One batch from several; the data column is as wide as the widest."""
        if len(batches) == 1:
            return batches[0]
        if not batches:
            return FrameBatch.empty()
        width = max(batch.data.shape[1] for batch in batches)
        return FrameBatch(
            np.concatenate([batch.t_ns for batch in batches]),
            np.concatenate([batch.bus for batch in batches]),
            np.concatenate([batch.can_id for batch in batches]),
            np.concatenate([batch.flags for batch in batches]),
            np.concatenate([batch.dlc for batch in batches]),
            np.concatenate([_widened(batch.data, width) for batch in batches]),
        )

    @property
    def flags_seen(self) -> int:
        """Every `FrameFlag` bit that any of the frames has."""
        return int(np.bitwise_or.reduce(self.flags, initial=0))

    @property
    def buses(self) -> list[int]:
        """Numbers of the buses of the frames, ascending."""
        if not len(self):
            return []
        if (self.bus == self.bus[0]).all():
            return [int(self.bus[0])]
        return np.flatnonzero(np.bincount(self.bus)).tolist()

    def payload(self, row: int) -> bytes:
        """The data bytes of one row."""
        return self.data[row, : self.dlc[row]].tobytes() if not self.is_remote(row) else b""

    def is_remote(self, row: int) -> bool:
        """Whether one row is a remote frame."""
        return bool(int(self.flags[row]) & _REMOTE)


def _widened(data: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    if data.shape[1] == width:
        return data
    wide = np.zeros((len(data), width), np.uint8)
    wide[:, : data.shape[1]] = data
    return wide


@dataclass(frozen=True, slots=True)
class Gap:
    """A stretch in which the recorder could not listen: nothing may be concluded from silence.

    Half-open [start_ns, end_ns). `bus` is None when all buses are concerned; `lost_frames` is
    None when the number is unknown. In a stream of batches a Gap stands between the last batch
    before it and the first batch after it.
    """

    start_ns: int
    end_ns: int
    reason: str
    lost_frames: int | None = None
    bus: int | None = None
