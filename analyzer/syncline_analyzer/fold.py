"""What the analyses are fed with: a batch indexed once for all of them."""

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.grouping import BUS_SHIFT, REMOTE_KEY, Grouping
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service, service_of
from syncline_schemas.wire_length import wire_bits

_NOWHERE = slice(0, 0)


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

    @property
    def scattered(self) -> bool:
        """Whether rows of the capture may lie between those of the batch."""
        return self._given is not None

    @cached_property
    def seqs(self) -> NDArray[np.int64]:
        """(n,) position of each row in the capture."""
        if self._given is not None:
            return self._given
        return np.arange(self.seq0, self.seq0 + len(self), dtype=np.int64)

    @property
    def last_seq(self) -> int:
        """Position of the last row in the capture; of the row before the first, if there is none."""
        return self.seq(-1) if len(self) else self.seq0 - 1

    @cached_property
    def apart_ns(self) -> NDArray[np.int64]:
        """(n - 1,) time from each frame to the next, negative where the clock was set."""
        return self.frames.t_ns[1:] - self.frames.t_ns[:-1]

    @cached_property
    def flags_seen(self) -> int:
        """Every `FrameFlag` bit that any of the frames has."""
        return self.frames.flags_seen

    @cached_property
    def buses(self) -> list[int]:
        """Numbers of the buses of the frames, ascending."""
        return self.frames.buses

    @cached_property
    def ascending(self) -> bool:
        """Whether no stamp is earlier than the one before it."""
        t_ns = self.frames.t_ns
        return bool((t_ns[1:] >= t_ns[:-1]).all())

    def seqs_at(self, rows: NDArray[np.intp]) -> NDArray[np.int64]:
        """(k,) positions of some rows in the capture."""
        return self._given[rows] if self._given is not None else rows + self.seq0

    def row_at(self, seq: int) -> int:
        """How many rows come before a position in the capture."""
        return int(np.searchsorted(self.seqs, seq))

    def part(self, rows: slice | NDArray[np.intp]) -> "IndexedBatch":
        """Some of the rows, in their order."""
        if isinstance(rows, slice):
            begin, stop, step = rows.indices(len(self))
            if (begin, stop, step) == (0, len(self), 1):
                return self
            if self._given is None and step == 1:
                return IndexedBatch(self.frames[rows], self.seq0 + begin, timed=self.timed)
        return IndexedBatch(self.frames[rows], timed=self.timed, seqs=self.seqs[rows])

    def of_bus(self, bus: int) -> "IndexedBatch":
        """The frames of one of its buses."""
        if self.buses == [bus]:
            return self
        return self.part(np.flatnonzero(self.frames.bus == bus))

    def showing(self, frames: FrameBatch) -> "IndexedBatch":
        """The same place in the capture with other content."""
        if frames is self.frames:
            return self
        return IndexedBatch(frames, self.seq0, timed=self.timed, seqs=self._given)

    @classmethod
    def joined(cls, parts: Sequence["IndexedBatch"]) -> "IndexedBatch":
        """One batch of at least one, in their order."""
        if len(parts) == 1:
            return parts[0]
        frames = FrameBatch.concat([part.frames for part in parts])
        timed = parts[0].timed
        if all(a.last_seq + 1 == b.seq0 for a, b in pairwise(parts)) and not any(
            part.scattered for part in parts
        ):
            return cls(frames, parts[0].seq0, timed=timed)
        return cls(frames, timed=timed, seqs=np.concatenate([part.seqs for part in parts]))

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
        """(n,) True for remote frames; the bit in an error frame makes it none."""
        either = np.uint16(FrameFlag.REMOTE | FrameFlag.ERROR)
        remote: NDArray[np.bool_] = (self.frames.flags & either) == FrameFlag.REMOTE
        return remote

    @cached_property
    def grouping(self) -> Grouping:
        """All 11-bit frames by identifier, CAN FD and remote frames included."""
        return Grouping.of(self.frames)

    @cached_property
    def _classic(self) -> Grouping:
        """The same without CAN FD."""
        if self.flags_seen & FrameFlag.FD:
            return Grouping.of(self.frames, FrameFlag.FD)
        return self.grouping

    @cached_property
    def _places(self) -> dict[tuple[int, int], slice]:
        """Where in `_classic` the data frames of each identifier are."""
        grouping = self._classic
        edges = grouping.edges.tolist()
        return {
            (key >> BUS_SHIFT, key & 0x7FF): slice(begin, stop)
            for key, begin, stop in zip(grouping.keys.tolist(), edges[:-1], edges[1:], strict=True)
            if not key & REMOTE_KEY
        }

    @property
    def rows_by_id(self) -> NDArray[np.intp]:
        """(m,) rows of the 11-bit frames by identifier; those of one are at its `place`."""
        return self._classic.rows

    @cached_property
    def seqs_by_id(self) -> NDArray[np.int64]:
        """(m,) positions of `rows_by_id` in the capture."""
        return self.seqs_at(self._classic.rows)

    @property
    def t_ns_by_id(self) -> NDArray[np.int64]:
        """(m,) stamps of `rows_by_id` [ns]."""
        return self._classic.t_ns

    @cached_property
    def words_by_id(self) -> NDArray[np.uint64]:
        """(m,) the eight data bytes of each of `rows_by_id` in one word, to be compared."""
        data = np.ascontiguousarray(self.frames.data[:, :8])
        return data.view(np.uint64)[:, 0].take(self._classic.rows)

    @cached_property
    def lengths(self) -> dict[tuple[int, int], tuple[int, int]]:
        """Shortest and longest length [bytes] of each identifier's 11-bit data frames."""
        of = self._classic
        lengths = zip(of.shortest.tolist(), of.longest.tolist(), strict=True)
        return {
            (key >> BUS_SHIFT, key & 0x7FF): found
            for key, found in zip(of.keys.tolist(), lengths, strict=True)
            if not key & REMOTE_KEY
        }

    @cached_property
    def wire_bits(self) -> NDArray[np.int64]:
        """(n,) `wire_bits` of the frames [bit]; read only."""
        bits = wire_bits(self.frames)
        bits.flags.writeable = False
        return bits

    def place(self, bus: int, can_id: int) -> slice:
        """Where in the columns by identifier the data frames of one are."""
        return self._places.get((bus, can_id), _NOWHERE)

    def ids(self) -> list[tuple[int, int]]:
        """(bus, identifier) of every 11-bit data frame in the batch, ascending."""
        return list(self._places)

    def rows(self, bus: int, can_id: int) -> NDArray[np.intp]:
        """Rows of one identifier's 11-bit data frames, in arrival order."""
        return self._classic.rows[self._places.get((bus, can_id), _NOWHERE)]

    def seqs_of(self, bus: int, can_id: int) -> NDArray[np.int64]:
        """Positions of the same frames in the capture; a view."""
        return self.seqs_by_id[self._places.get((bus, can_id), _NOWHERE)]

    def t_ns_of(self, bus: int, can_id: int) -> NDArray[np.int64]:
        """Stamps of the same frames [ns]; a view."""
        return self.t_ns_by_id[self._places.get((bus, can_id), _NOWHERE)]

    def rows_of(self, *services: Service, remote: bool = False) -> NDArray[np.intp]:
        """Rows whose predefined service is one of these; data frames, or remote ones."""
        grouping = self._classic
        if remote and not self.flags_seen & FrameFlag.REMOTE:
            return grouping.rows[:0]
        keys = grouping.keys
        chosen = np.zeros(len(Service), np.bool_)
        chosen[list(services)] = True
        wanted = chosen[SERVICE_OF_ID[keys & np.uint32(0x7FF)]]
        wanted &= ((keys & np.uint32(REMOTE_KEY)) != 0) == remote
        found = [
            grouping.rows[grouping.edges[group] : grouping.edges[group + 1]]
            for group in np.flatnonzero(wanted).tolist()
        ]
        return np.sort(np.concatenate(found)) if found else grouping.rows[:0]

    def seq(self, row: int) -> int:
        """Position of a row in the capture."""
        if self._given is not None:
            return int(self._given[row])
        return self.seq0 + int(row) + (len(self) if row < 0 else 0)


class Fold(Protocol):
    """One analysis: fed batch by batch in capture order, with bounded memory."""

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        ...

    def gap(self, gap: Gap) -> None:
        """Take in that nothing was heard for a while."""
        ...
