"""SYNC: its periods, those that are missing, and its place between the other frames."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.distribution import Distribution
from syncline_analyzer.folds.block import Block
from syncline_analyzer.folds.unsteady import OFF, Unsteady
from syncline_analyzer.results import Series, SyncJitterRow, SyncRow
from syncline_analyzer.series import Thinner
from syncline_schemas.wire_length import longest_bits

MAX_HOLES = 10_000
"""Stretches without SYNC that are kept one by one."""
MAX_POINTS = 20_000
"""Points of the SYNC period over time."""
_MISSING = 1.5
_PAUSE = 10.0
"""A period longer than this many medians is a pause of the producer or of the whole bus."""
_LEARN = 16
"""Periods from which a block's own median is taken."""
_REGIME = 8
"""This many long periods in a row are a slower SYNC, not missing ones."""


@dataclass(frozen=True, slots=True)
class SyncHole:
    """A stretch between two SYNCs in which `missing` are missing; `seq` are those of the two."""

    start_ns: int
    end_ns: int
    missing: int
    seq: tuple[int, int]


@dataclass(frozen=True, slots=True)
class SyncTable:
    """A SYNC identifier: its row, the holes in it, and what the findings measure by."""

    bus: int
    row: SyncRow
    holes: list[SyncHole]
    period: Distribution
    series: Series | None
    jitter: list[SyncJitterRow]


@dataclass(frozen=True, slots=True, eq=False)
class SyncIndex:
    """SYNCs of a block; position 0 stands for the last one before it.

    Attributes:
        rows: (m,) rows in the block.
        first_ordinal: number of the SYNC at position 0, counted over the capture.
        known: whether there is a SYNC at position 0 (not at the start, nor after a gap).
        t_ns, seq, bits: (m + 1,) stamp, `seq`, and the bits sent on the bus up to its end.
        before: (n,) position of the last SYNC at or before each row of the block.
        usable: (m + 1,) False where SYNC stayed away for so long that nothing follows from silence.
    """

    rows: NDArray[np.intp]
    first_ordinal: int
    known: bool
    t_ns: NDArray[np.int64]
    seq: NDArray[np.int64]
    bits: NDArray[np.int64]
    before: NDArray[np.int64]
    usable: NDArray[np.bool_]

    @property
    def last_closed(self) -> int:
        """Number of the last SYNC that another one follows."""
        return self.first_ordinal + len(self.rows) - 1


@dataclass(slots=True)
class _State:
    """A SYNC identifier from block to block."""

    count: int = 0
    last_ns: int | None = None
    last_seq: int = 0
    last_bits: int = 0
    counter: int | None = None
    overflow: int = 0
    missing: int = 0
    jumps: int = 0
    period: Distribution = field(default_factory=Distribution)
    holes: list[SyncHole] = field(default_factory=list)
    unsteady: Unsteady = field(default_factory=Unsteady)
    over_time: Thinner = field(default_factory=lambda: Thinner("value", MAX_POINTS))


class SyncFold:
    """Follows every SYNC identifier: 080h, and those that 1005h names.

    `update` returns where the SYNCs of the block are, for the PDOs that answer them.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._states: dict[tuple[int, int], _State] = {}

    def update(
        self, block: Block, bus: int, cob_id: int, sent_bits: NDArray[np.int64]
    ) -> SyncIndex | None:
        """Take in a block; `sent_bits` (n,) counts the bits on the bus up to each row's end."""
        rows = block.batch.rows(bus, cob_id)
        key = (bus, cob_id)
        if not len(rows) and key not in self._states:
            return None
        state = self._states.setdefault(key, _State())
        index = self._index(block, state, rows, sent_bits)
        self._count_periods(block, bus, state, index)
        self._count_jumps(block, bus, state, rows)
        state.count += len(rows)
        if len(rows):
            state.last_ns = int(index.t_ns[-1])
            state.last_seq, state.last_bits = int(index.seq[-1]), int(index.bits[-1])
        return index

    def gap(self, bus: int | None) -> None:
        """No period and no count goes over a gap."""
        for (state_bus, _), state in self._states.items():
            if bus in (None, state_bus):
                state.last_ns = state.counter = None

    def median_ns(self, bus: int, cob_id: int) -> float:
        """Median SYNC period so far, 0 without one."""
        state = self._states.get((bus, cob_id))
        return state.period.quantile(0.5) if state and state.period.count else 0.0

    def finish(self) -> list[SyncTable]:
        """One table per SYNC identifier that was sent."""
        return [
            self._table(bus, cob_id, state)
            for (bus, cob_id), state in sorted(self._states.items())
            if state.count
        ]

    def _index(
        self, block: Block, state: _State, rows: NDArray[np.intp], sent_bits: NDArray[np.int64]
    ) -> SyncIndex:
        is_sync = np.zeros(len(block.batch), np.int64)
        is_sync[rows] = 1
        t_ns = np.concatenate(([state.last_ns or 0], block.frames.t_ns[rows]))
        pause_ns = _PAUSE * (state.period.quantile(0.5) if state.period.count else np.inf)
        return SyncIndex(
            rows,
            state.count - 1,
            state.last_ns is not None,
            t_ns,
            np.concatenate(([state.last_seq], block.batch.seq0 + rows)),
            np.concatenate(([state.last_bits], sent_bits[rows])),
            np.cumsum(is_sync),
            np.append(np.diff(t_ns) <= pause_ns, True),
        )

    def _count_periods(self, block: Block, bus: int, state: _State, index: SyncIndex) -> None:
        first = 0 if index.known else 1
        t_ns, seq = index.t_ns[first:], index.seq[first:]
        periods = np.diff(t_ns)
        forward = periods >= 0
        if not self._context.timed or not forward.any():
            return
        state.period.add(periods[forward])
        state.over_time.add(
            {"t_ns": t_ns[1:][forward], "value": periods[forward].astype(np.float64) / 1000}
        )
        if not _counted(block, index.rows):
            self._find_holes(state, t_ns, seq, periods)
        self._find_jitter(state, bus, t_ns[1:], seq[1:], periods)

    def _find_jitter(
        self,
        state: _State,
        bus: int,
        t_ns: NDArray[np.int64],
        seq: NDArray[np.int64],
        periods: NDArray[np.int64],
    ) -> None:
        """Periods off by more than a tenth, a frame in the way, and what the stamps can tell."""
        median = _median(state, periods)
        bitrate = self._context.bitrates.get(self._context.bus_name(bus))
        in_the_way = longest_bits(8, extended=True) * 1e9 / bitrate if bitrate else 0.0
        limit = max(OFF * median, in_the_way, 3.0 * self._context.resolution_ns)
        off = (np.abs(periods - median) > limit) & (periods < _MISSING * median) & (periods >= 0)
        state.unsteady.add(t_ns, seq, periods, off, median)

    def _find_holes(
        self,
        state: _State,
        t_ns: NDArray[np.int64],
        seq: NDArray[np.int64],
        periods: NDArray[np.int64],
    ) -> None:
        median = _median(state, periods)
        if median <= 0:
            return
        long = periods > _MISSING * median
        for at in np.flatnonzero(long & ~_sustained(long)).tolist():
            missing = round(float(periods[at]) / median) - 1
            self._add_hole(state, int(t_ns[at]), int(t_ns[at + 1]), missing, seq[at : at + 2])

    def _count_jumps(self, block: Block, bus: int, state: _State, rows: NDArray[np.intp]) -> None:
        """Lost SYNCs by the counter of CiA 301 7.2.5.3, which runs from 1 to 1019h."""
        if not len(rows):
            return
        if not _counted(block, rows):
            state.counter = None
            return
        counter = block.frames.data[rows, 0].astype(np.int64)
        state.overflow = self._overflow(bus) or max(state.overflow, int(counter.max()))
        known = state.counter is not None
        before = np.concatenate(([state.counter or 0], counter[:-1]))
        state.counter = int(counter[-1])
        lost = (counter - before - 1) % max(state.overflow, 1)
        lost[0] *= known
        t_ns, seq = block.frames.t_ns[rows], block.batch.seq0 + rows
        for at in np.flatnonzero(lost).tolist():
            state.jumps += 1
            previous_ns, previous_seq = (
                (int(t_ns[at - 1]), int(seq[at - 1]))
                if at
                else (state.last_ns or int(t_ns[0]), state.last_seq)
            )
            pair = np.array([previous_seq, seq[at]])
            self._add_hole(state, previous_ns, int(t_ns[at]), int(lost[at]), pair)

    def _overflow(self, bus: int) -> int:
        """1019h of the SYNC producer, as far as any node of the bus told it."""
        shadow = self._context.shadow
        for node_bus, node in shadow.nodes():
            value = shadow.number(bus, node, 0x1019) if node_bus == bus else None
            if value and value <= 240:
                return value
        return 0

    @staticmethod
    def _add_hole(
        state: _State, start_ns: int, end_ns: int, missing: int, seq: NDArray[np.int64]
    ) -> None:
        state.missing += missing
        if len(state.holes) < MAX_HOLES:
            state.holes.append(SyncHole(start_ns, end_ns, missing, (int(seq[0]), int(seq[1]))))

    def _table(self, bus: int, cob_id: int, state: _State) -> SyncTable:
        name = self._context.bus_name(bus)
        row = SyncRow(
            name, cob_id, state.count, state.period.quantiles(1000), state.missing, state.jumps
        )
        columns = state.over_time.columns()
        series = (
            Series(name, f"SYNC {cob_id:03X}h period", "us", columns["t_ns"], columns["value"])
            if columns
            else None
        )
        jitter = state.unsteady.rows(name, cob_id)
        return SyncTable(bus, row, state.holes, state.period, series, jitter)


def _median(state: _State, periods: NDArray[np.int64]) -> float:
    """Median of a block's own periods where there are enough of them, so that it may change."""
    return float(np.median(periods)) if len(periods) >= _LEARN else state.period.quantile(0.5)


def _counted(block: Block, rows: NDArray[np.intp]) -> bool:
    """Whether the SYNCs carry a counter."""
    return len(rows) > 0 and int(block.frames.dlc[rows].min()) > 0


def _sustained(long: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where long periods follow one another for so long that they are the rhythm."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], long.astype(np.int8), [0]))))
    sustained = np.zeros(len(long), np.bool_)
    for start, stop in edges.reshape(-1, 2).tolist():
        if stop - start >= _REGIME:
            sustained[start:stop] = True
    return sustained
