"""What the analyses are fed with: a batch indexed once for all of them."""

from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.canopen.services import Service, service_of

_DATA_11_BIT = np.uint16(FrameFlag.EXTENDED | FrameFlag.ERROR | FrameFlag.REMOTE | FrameFlag.FD)


class IndexedBatch:
    """A frame batch with its place in the capture and its rows by identifier and service.

    Attributes:
        frames: the columns.
        seq0: `seq` of the first row; row k has `seq0 + k`.
        timed: whether the stamps mean anything (False for logs without times).
    """

    def __init__(self, frames: FrameBatch, seq0: int = 0, *, timed: bool = True) -> None:
        self.frames = frames
        self.seq0 = seq0
        self.timed = timed

    def __len__(self) -> int:
        return len(self.frames)

    @cached_property
    def service(self) -> NDArray[np.uint8]:
        """(n,) `Service` by the predefined connection set; remote frames included."""
        return service_of(self.frames)

    @cached_property
    def node(self) -> NDArray[np.uint8]:
        """(n,) low seven bits of the identifier."""
        return (self.frames.can_id & 0x7F).astype(np.uint8)

    @cached_property
    def remote(self) -> NDArray[np.bool_]:
        """(n,) True for remote frames."""
        remote: NDArray[np.bool_] = (self.frames.flags & FrameFlag.REMOTE) != 0
        return remote

    @cached_property
    def _by_id(self) -> dict[tuple[int, int], NDArray[np.intp]]:
        frames = self.frames
        rows = np.flatnonzero((frames.flags & _DATA_11_BIT) == 0)
        key = (frames.bus[rows].astype(np.uint32) << 11) | frames.can_id[rows]
        order = np.argsort(
            key.astype(np.uint16) if key.max(initial=0) < 1 << 16 else key, kind="stable"
        )
        ordered = key[order]
        cuts = np.flatnonzero(np.diff(ordered)) + 1
        starts = np.concatenate(([0], cuts)) if len(ordered) else np.zeros(0, np.intp)
        return {
            (int(ordered[start]) >> 11, int(ordered[start]) & 0x7FF): part
            for start, part in zip(starts, np.split(rows[order], cuts), strict=False)
        }

    def ids(self) -> list[tuple[int, int]]:
        """(bus, identifier) of every 11-bit data frame in the batch, ascending."""
        return list(self._by_id)

    def rows(self, bus: int, can_id: int) -> NDArray[np.intp]:
        """Rows of one identifier's 11-bit data frames, in arrival order."""
        return self._by_id.get((bus, can_id), _NO_ROWS)

    def rows_of(self, *services: Service, remote: bool = False) -> NDArray[np.intp]:
        """Rows whose predefined service is one of these; data frames, or remote ones."""
        wanted = np.isin(np.arange(len(Service)), services)
        return np.flatnonzero(wanted[self.service] & (self.remote == remote))

    def seq(self, row: int) -> int:
        """Position of a row in the capture."""
        return self.seq0 + int(row)


_NO_ROWS = np.zeros(0, np.intp)


class Fold(Protocol):
    """One analysis: fed batch by batch in capture order, with bounded memory."""

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        ...

    def gap(self, gap: Gap) -> None:
        """Take in that nothing was heard for a while."""
        ...
