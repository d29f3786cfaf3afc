"""What the analyses are fed with: a batch indexed once for all of them."""

from collections.abc import Sequence
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
        seq0: `seq` of the first row.
        timed: whether the stamps mean anything (False for logs without times).

    Args:
        seqs: (n,) `seq` of each row, ascending; by default they follow `seq0` without a break.
    """

    def __init__(
        self,
        frames: FrameBatch,
        seq0: int = 0,
        *,
        timed: bool = True,
        seqs: NDArray[np.int64] | None = None,
    ) -> None:
        self.frames = frames
        self.seq0 = seq0 if seqs is None or not len(seqs) else int(seqs[0])
        self.timed = timed
        self._given = seqs

    def __len__(self) -> int:
        return len(self.frames)

    @cached_property
    def seqs(self) -> NDArray[np.int64]:
        """(n,) position of each row in the capture."""
        if self._given is not None:
            return self._given
        return np.arange(self.seq0, self.seq0 + len(self), dtype=np.int64)

    @property
    def last_seq(self) -> int:
        """Position of the last row in the capture; of the row before the first, if there is none."""
        return int(self.seqs[-1]) if len(self) else self.seq0 - 1

    def row_at(self, seq: int) -> int:
        """How many rows come before a position in the capture."""
        return int(np.searchsorted(self.seqs, seq))

    def part(self, rows: slice | NDArray[np.intp]) -> "IndexedBatch":
        """Some of the rows, in their order."""
        return IndexedBatch(self.frames[rows], timed=self.timed, seqs=self.seqs[rows])

    @classmethod
    def joined(cls, parts: Sequence["IndexedBatch"]) -> "IndexedBatch":
        """One batch of at least one, in their order."""
        if len(parts) == 1:
            return parts[0]
        frames = FrameBatch.concat([part.frames for part in parts])
        seqs = np.concatenate([part.seqs for part in parts])
        return cls(frames, timed=parts[0].timed, seqs=seqs)

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
        return int(self.seqs[row])


_NO_ROWS = np.zeros(0, np.intp)


class Fold(Protocol):
    """One analysis: fed batch by batch in capture order, with bounded memory."""

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        ...

    def gap(self, gap: Gap) -> None:
        """Take in that nothing was heard for a while."""
        ...
