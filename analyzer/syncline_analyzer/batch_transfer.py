"""Batches as they travel between processes: in few bytes, with what is dear to compute.

What follows from the frames within 3 ns each (the columns by identifier) is made again where it
arrives: to send eight bytes costs as much.
"""

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.grouping import Grouping
from syncline_schemas.batch import FrameBatch
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.wire_length import short_wire_bits


class Narrow(NamedTuple):
    """A column in as few bytes as its numbers need: none at all where all are 0."""

    column: NDArray[np.unsignedinteger]
    dtype: np.dtype[Any]
    """What it has to be again."""

    @classmethod
    def of(cls, column: NDArray[np.integer]) -> Self:
        """Of numbers that are not negative."""
        return cls.below(int(column.max(initial=0)) + 1, column)

    @classmethod
    def below(cls, limit: int, column: NDArray[np.integer]) -> Self:
        """Of numbers that are not negative, and all lower than a limit."""
        if limit <= 1:
            return cls(np.zeros(0, np.uint8), column.dtype)
        return cls(np.ascontiguousarray(column, np.min_scalar_type(limit - 1)), column.dtype)

    def wide(self, count: int) -> NDArray[Any]:
        """(count,) the numbers."""
        return self.column.astype(self.dtype) if len(self.column) else np.zeros(count, self.dtype)


class PackedBatch(NamedTuple):
    """An `IndexedBatch` of one bus.

    `seqs` count from `seq0`, and are None where they follow it without a break.
    """

    timed: bool
    seq0: int
    seqs: Narrow | None
    t_ns: NDArray[np.int64]
    bus: int
    can_id: Narrow
    flags: Narrow
    dlc: NDArray[np.uint8]
    data: NDArray[np.uint8]
    rows: Narrow
    keys: NDArray[np.unsignedinteger]
    edges: NDArray[np.intp]
    shortest: NDArray[np.uint8]
    longest: NDArray[np.uint8]
    wire_bits: Narrow
    flags_seen: int
    ascending: bool


def packed(batch: IndexedBatch) -> PackedBatch:
    """A batch of one bus, to be sent."""
    frames, grouping = batch.frames, batch.grouping
    return PackedBatch(
        batch.timed,
        batch.seq0,
        Narrow.of(batch.seqs - batch.seq0) if batch.scattered else None,
        np.ascontiguousarray(frames.t_ns),
        batch.buses[0],
        Narrow.of(frames.can_id),
        Narrow.below(batch.flags_seen + 1, frames.flags),
        np.ascontiguousarray(frames.dlc),
        np.ascontiguousarray(frames.data),
        Narrow.below(len(batch), grouping.rows),
        grouping.keys,
        grouping.edges,
        grouping.shortest,
        grouping.longest,
        Narrow.of(short_wire_bits(frames))._replace(dtype=np.dtype(np.int64)),
        batch.flags_seen,
        batch.ascending,
    )


def unpacked(sent: PackedBatch) -> IndexedBatch:
    """The batch that was sent, indexed."""
    count = len(sent.t_ns)
    frames = FrameBatch(
        sent.t_ns,
        np.full(count, sent.bus, np.uint8),
        sent.can_id.wide(count),
        sent.flags.wide(count),
        sent.dlc,
        sent.data,
    )
    seqs = None if sent.seqs is None else sent.seqs.wide(count) + sent.seq0
    batch = IndexedBatch(frames, sent.seq0, timed=sent.timed, seqs=seqs)
    rows = sent.rows.wide(int(sent.edges[-1]))
    each = sent.keys, sent.edges, sent.shortest, sent.longest
    batch.buses = [sent.bus]
    batch.grouping = Grouping(rows, sent.t_ns.take(rows), *each)
    batch.wire_bits = sent.wire_bits.wide(count)
    batch.flags_seen = sent.flags_seen
    batch.ascending = sent.ascending
    return batch
