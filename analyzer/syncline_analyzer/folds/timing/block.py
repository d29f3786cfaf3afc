"""Small batches joined into blocks, so that work per batch does not count."""

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.echo import COPY
from syncline_analyzer.fold import IndexedBatch
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.wire_length import data_phase_bits, longest_bits

BLOCK_FRAMES = 1 << 16
"""Frames that make a block worth its fixed cost, and enough of them to learn a rhythm from."""
UNKNOWN_BITS = 1 << 24
"""What an error frame counts as in a sum of bits: nothing is known of the bus then."""
LONGEST_ERROR = longest_bits(8, extended=True) + 20
"""Bits that an error may take: a frame that breaks at its end, error flags and delimiter."""


class Blocks:
    """Joins batches that follow one another in `seq` until there are enough frames."""

    def __init__(self, frames: int = BLOCK_FRAMES) -> None:
        self._wanted = frames
        self._waiting: list[IndexedBatch] = []
        self._held = 0

    def add(self, batch: IndexedBatch) -> list["Block"]:
        """Blocks that are complete with this batch."""
        done = []
        if self._waiting and self._waiting[-1].last_seq + 1 != batch.seq0:
            done += self.flush()
        if len(batch):
            self._waiting.append(batch)
            self._held += len(batch)
        if self._held >= self._wanted:
            done += self.flush()
        return done

    def flush(self) -> list["Block"]:
        """What is waiting as a block: before a gap, and at the end."""
        waiting, self._waiting, self._held = self._waiting, [], 0
        if not waiting:
            return []
        return [Block(IndexedBatch.joined(waiting))]


class Block:
    """A batch with its wire lengths, computed once for all who need them."""

    def __init__(self, batch: IndexedBatch) -> None:
        self.batch = batch
        self._wire_ns: dict[tuple[int, float, float | None], NDArray[np.float64]] = {}

    @property
    def frames(self) -> FrameBatch:
        """The columns."""
        return self.batch.frames

    def parts(self, cuts: Sequence[int]) -> list["Block"]:
        """The block cut before the rows of these `seq`, ascending; itself where there are none."""
        if not cuts:
            return [self]
        batch = self.batch
        edges = [0, *(batch.row_at(seq) for seq in cuts), len(batch)]
        return [Block(batch.part(slice(a, b))) for a, b in pairwise(edges) if b > a]

    @cached_property
    def wire_bits(self) -> NDArray[np.int64]:
        """(n,) length on the wire with intermission [bit].

        Exact; 0 for errors, and for what the recorder wrote down twice. The part of it in
        `data_phase_bits` passed at the data bit rate, and faster than at the nominal one.
        """
        bits = self.batch.wire_bits
        if self.batch.flags_seen & FrameFlag.FD:
            bits = bits + self.data_phase_bits
        return self._but_copies(bits)

    @cached_property
    def data_phase_bits(self) -> NDArray[np.int64]:
        """(n,) bits at the data bit rate: 0 for all but FD frames with bit rate switch."""
        if not self.batch.flags_seen & FrameFlag.BRS:
            return np.zeros(len(self.batch), np.int64)
        return self._but_copies(data_phase_bits(self.frames))

    def _but_copies(self, bits: NDArray[np.int64]) -> NDArray[np.int64]:
        if self.batch.flags_seen & COPY:
            return np.where((self.frames.flags & COPY) != 0, 0, bits)
        return bits

    def wire_ns(
        self, bus: int, bit_ns: float, data_bit_ns: float | None = None
    ) -> NDArray[np.float64]:
        """(k,) time on the wire of the frames of a bus with intermission, as in `by_bus` [ns].

        NaN for error frames, and for FD frames whose data bit rate is not known.
        """
        key = bus, bit_ns, data_bit_ns
        if key not in self._wire_ns:
            places = self.by_bus[bus]
            found: NDArray[np.float64] = self.wire_bits[places].astype(np.float64) * bit_ns
            if self.batch.flags_seen & FrameFlag.BRS:
                fast = self.data_phase_bits[places]
                each_ns = np.nan if data_bit_ns is None else data_bit_ns
                slow_ns = (self.wire_bits[places] - fast) * bit_ns
                found = np.where(fast > 0, slow_ns + fast * each_ns, found)
            if self.batch.flags_seen & FrameFlag.ERROR:
                found[self.error[places]] = np.nan
            self._wire_ns[key] = found
        return self._wire_ns[key]

    @cached_property
    def by_bus(self) -> dict[int, NDArray[np.intp] | slice]:
        """Rows of each bus but copies; a slice when there is only one."""
        bus, buses = self.frames.bus, self.batch.buses
        if not self.batch.flags_seen & COPY:
            if len(buses) == 1:
                return {buses[0]: slice(None)}
            return {one: np.flatnonzero(bus == one) for one in buses}
        real = (self.frames.flags & COPY) == 0
        rows = {one: np.flatnonzero((bus == one) & real) for one in buses}
        return {one: found for one, found in rows.items() if len(found)}

    @cached_property
    def error(self) -> NDArray[np.bool_]:
        """(n,) True for error frames."""
        if not self.batch.flags_seen & FrameFlag.ERROR:
            return np.zeros(len(self.batch), np.bool_)
        error: NDArray[np.bool_] = (self.frames.flags & FrameFlag.ERROR) != 0
        return error
