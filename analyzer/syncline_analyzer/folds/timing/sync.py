"""SYNC: its periods, those that are missing, and its place between the other frames."""

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.distribution import median_of, quantile_of
from syncline_analyzer.folds.timing.backlog import PAUSE, TOO_SHORT, backlog
from syncline_analyzer.folds.timing.block import LONGEST_ERROR, UNKNOWN_BITS, Block
from syncline_analyzer.folds.timing.bundles import bundled, lacking, paced
from syncline_analyzer.folds.timing.catching_up import catching_up
from syncline_analyzer.folds.timing.lateness import ClockSet, clock_set
from syncline_analyzer.folds.timing.sync_counter import lost_in_time
from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_analyzer.folds.timing.sync_settings import told_overflow
from syncline_analyzer.folds.timing.sync_state import SyncHole, SyncState, told_of
from syncline_analyzer.folds.timing.sync_table import SyncTable, sync_table
from syncline_analyzer.folds.timing.unsteady import OFF
from syncline_analyzer.folds.timing.usual import MISSING, cycles_of, even, usual_of
from syncline_analyzer.results import ClockStepRow
from syncline_schemas.batch import FrameFlag
from syncline_schemas.wire_length import longest_bits

MAX_HOLES = 1000
"""Stretches without SYNC that are kept one by one."""
MAX_FILLED = 100_000
"""SYNCs kept one by one after which error frames filled the bus."""
_LEARN = 16
"""Periods from which a block's own median is taken."""
_REGIME = 8
"""This many long periods in a row are a slower SYNC, not missing ones."""


class SyncFold:
    """Follows every SYNC identifier: 080h, and those that 1005h names.

    `update` returns where the SYNCs of the block are, for the PDOs that answer them.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._states: dict[tuple[int, int], SyncState] = {}

    def update(
        self,
        block: Block,
        bus: int,
        cob_id: int,
        sent_bits: NDArray[np.int64],
        version: int | None = None,
    ) -> SyncIndex | None:
        """Take in a block.

        Args:
            block, bus, cob_id: the frames, and which of them.
            sent_bits: (n,) bits on the bus up to each row's end.
            version: of the shadow at the end of the block, see `settled`.
        """
        rows = block.batch.rows(bus, cob_id)
        key = (bus, cob_id)
        if not len(rows) and key not in self._states:
            return None
        state = self._states.get(key) or self._states.setdefault(key, SyncState())
        index = self._index(block, bus, cob_id, state, rows, sent_bits)
        in_bundles = bundled(block, bus)
        seq = block.batch.last_seq
        if version is None or state.told.version != version:
            state.told = told_of(self._context.shadow, bus, cob_id, seq, version)
        told = state.told
        state.pace.expect(told.period_us)
        self._measure(state, bus, index, in_bundles)
        state.counter.expect(told.overflow_by_now)
        lost = _lost_by_counter(state, index, told.overflow)
        unsent = self._missing_by_time(state, bus, index, in_bundles)
        if lost.any():
            unsent = self._missing_by_counter(state, index, lost, unsent, told.overflow, in_bundles)
        _add_holes(state, index, unsent)
        state.count += len(rows)
        if len(rows):
            state.last_ns = int(index.t_ns[-1])
            state.last_seq, state.last_bits = int(index.seq[-1]), int(index.bits[-1])
            state.last_counter = int(index.counter[-1])
        return index

    def gap(self, bus: int | None) -> None:
        """No period and no count goes over a gap."""
        for (state_bus, _), state in self._states.items():
            if bus in (None, state_bus):
                state.last_ns = None
                state.counter.cut()
                state.pace.cut()

    def median_ns(self, bus: int, cob_id: int) -> float:
        """Median SYNC period so far, 0 without one."""
        state = self._states.get((bus, cob_id))
        return state.period.quantile(0.5) if state and state.period.count else 0.0

    def filled(self, bus: int, cob_id: int) -> list[int]:
        """`seq` of the SYNCs after which error frames may have kept the bus up to the next one."""
        state = self._states.get((bus, cob_id))
        return state.filled if state else []

    def counter_end(self, bus: int, cob_id: int) -> int | None:
        """Number after which the counter of a SYNC begins again, as far as it is known."""
        state = self._states.get((bus, cob_id))
        told = told_overflow(self._context.shadow, bus, cob_id)
        return state.counter.overflow(told[0] if told else None) if state else None

    def finish(self) -> list[SyncTable]:
        """One table per SYNC identifier that was sent."""
        return [
            sync_table(self._context, bus, cob_id, state)
            for (bus, cob_id), state in sorted(self._states.items())
            if state.count
        ]

    def _index(
        self,
        block: Block,
        bus: int,
        cob_id: int,
        state: SyncState,
        rows: NDArray[np.intp],
        sent_bits: NDArray[np.int64],
    ) -> SyncIndex:
        own_ns, seqs = block.batch.t_ns_of(bus, cob_id), block.batch.seqs_of(bus, cob_id)
        t_ns = np.concatenate(([state.last_ns or 0], own_ns))
        bits = np.concatenate(([state.last_bits], sent_bits[rows]))
        apart = t_ns[1:] - t_ns[:-1]
        first = 0 if state.last_ns is not None else 1
        median = _median(state, apart[first:])
        bundled = np.zeros(len(t_ns), np.bool_)
        bundled[first:-1] = self._bundled(bus, apart[first:], np.diff(bits)[first:], median, first)
        state.bundled += int(bundled.sum())
        for each in clock_set(block, bus, rows):
            bundled[1 + each.sync] = True
            if len(state.steps) < MAX_HOLES:
                state.steps.append(_step(block, self._context.bus_name(bus), each))
        if block.batch.flags_seen & FrameFlag.ERROR:
            self._note_errors(state, bus, apart, bits, seqs)
        usable = ~bundled
        if median > 0:
            usable[:-1] &= (apart >= TOO_SHORT * median) & (apart <= PAUSE * median)
        return SyncIndex(
            rows,
            state.count - 1,
            state.last_ns is not None,
            t_ns,
            np.concatenate(([state.last_seq], seqs)),
            bits,
            usable,
            bundled,
            median,
            _counters(block, state, rows, block.batch.lengths.get((bus, cob_id), (0, 0))[1]),
            len(block.batch),
        )

    def _bundled(
        self,
        bus: int,
        periods: NDArray[np.int64],
        bits: NDArray[np.int64],
        median: float,
        first: int,
    ) -> NDArray[np.bool_]:
        """Which periods have the stamps of a backlog; `first` is 1 where listening began."""
        if not self._context.timed:
            return np.zeros(len(periods), np.bool_)
        bitrate = self._context.bitrates.get(self._context.bus_name(bus))
        return backlog(
            periods,
            bits,
            median,
            begins=first == 1,
            bit_ns=1e9 / bitrate if bitrate else None,
            resolution_ns=self._context.resolution_ns,
        )

    def _note_errors(
        self,
        state: SyncState,
        bus: int,
        periods: NDArray[np.int64],
        bits: NDArray[np.int64],
        seq: NDArray[np.int64],
    ) -> None:
        """Keep the SYNCs after which errors, as long as they can be, leave no time until the next."""
        errors, sent = np.divmod(np.diff(bits), UNKNOWN_BITS)
        filled = errors > 0
        bitrate = self._context.bitrates.get(self._context.bus_name(bus))
        if bitrate:
            filled &= (sent + errors * LONGEST_ERROR) * (1e9 / bitrate) >= periods
        begun = np.concatenate(([state.last_seq], seq))[:-1][filled]
        state.filled.extend(begun[: MAX_FILLED - len(state.filled)].tolist())

    def _measure(self, state: SyncState, bus: int, index: SyncIndex, in_bundles: bool) -> None:
        """Periods, and their jitter where the stamps are not those of bundles."""
        if not self._context.timed:
            return
        t_ns, seq, periods = (
            index.t_ns[index.first + 1 :],
            index.seq[index.first + 1 :],
            index.periods,
        )
        if index.any_bundled:
            true = ~index.bundled[index.first : -1]
            t_ns, seq, periods = t_ns[true], seq[true], periods[true]
        if not len(periods) or int(periods.max()) < 0:
            return
        median = _median_of(state, index, periods)
        steady = index.steady and len(periods) >= _LEARN
        usual = median if steady else usual_of(periods, median)
        if int(periods.min()) >= 0:
            ahead, ahead_seq, ahead_ns = periods, seq, t_ns
        else:
            forward = periods >= 0
            ahead, ahead_seq, ahead_ns = periods[forward], seq[forward], t_ns[forward]
        state.periods.add(ahead, ahead_seq, ahead_ns)
        state.over_time.add({"t_ns": ahead_ns, "value": ahead.astype(np.float64) / 1000})
        state.pace.add(periods, usual)
        if in_bundles:
            return
        state.double.add(t_ns, seq, periods, median)
        if not isinstance(usual, float):
            # Of steady periods no two together are as short as one.
            state.doubled.add(seq, periods, usual)
        if steady and even(index.limits, median):
            state.unsteady.go_on(len(periods))
        else:
            self._find_jitter(state, bus, index, t_ns, seq, periods)

    def _find_jitter(
        self,
        state: SyncState,
        bus: int,
        index: SyncIndex,
        t_ns: NDArray[np.int64],
        seq: NDArray[np.int64],
        periods: NDArray[np.int64],
    ) -> None:
        """Periods off by more than a tenth, a frame in the way, and what the stamps can tell."""
        median = _median_of(state, index, periods)
        bitrate = self._context.bitrates.get(self._context.bus_name(bus))
        in_the_way = longest_bits(8, extended=True) * 1e9 / bitrate if bitrate else 0.0
        whole = (periods >= 0) & (periods < MISSING * median)
        if not whole.any():
            return
        if whole.all():
            cycles = cycles_of(periods, median if len(periods) >= _LEARN else None)
        else:
            cycles = np.full(len(periods), median)
            cycles[whole] = cycles_of(periods[whole])
        limits = np.maximum(OFF * cycles, max(in_the_way, 3.0 * self._context.resolution_ns))
        off = whole & (np.abs(periods - cycles) > limits)
        if off.any():
            off &= ~state.double.within(t_ns)
        state.unsteady.add(t_ns, seq, periods, off, cycles)

    def _missing_by_time(
        self, state: SyncState, bus: int, index: SyncIndex, in_bundles: bool
    ) -> NDArray[np.int64]:
        """SYNCs that are missing in each period: one per whole median (analysis.md section 5).

        Those that come late and are made up for at once are not; where a recorder hands over frames
        in bundles, only those count that the time of many periods has no room for.
        """
        periods = index.periods
        if index.steady and not in_bundles:
            return np.zeros(len(periods), np.int64)
        median = _median(state, periods) if self._context.timed else 0.0
        if not len(periods) or not median > 0:
            return np.zeros(len(periods), np.int64)
        # A clock that was set back makes up for nothing that is missing before it.
        periods = np.where(periods < 0, round(median), periods)
        bitrate = self._context.bitrates.get(self._context.bus_name(bus))
        bits = np.diff(index.bits[index.first :])
        waits = catching_up(periods, bits, median, 1e9 / bitrate if bitrate else 0.0)
        usual = usual_of(np.where(waits, round(median), periods), median)
        usual[usual <= 0] = median
        if in_bundles:
            usual = np.full(len(periods), max(median, paced(periods)))
        cycles = periods / usual
        blur = quantile_of(cycles, 0.95) if in_bundles else 1.0
        long = (cycles > MISSING) & ~index.bundled[index.first : -1]
        missing = np.maximum(np.rint(cycles - blur), 0).astype(np.int64)
        missing = np.where(long & ~_sustained(long) & ~waits, missing, 0)
        if not missing.any():
            return missing
        if in_bundles:
            return np.minimum(missing, lacking(cycles, blur))
        whole = (cycles >= TOO_SHORT) & (cycles <= MISSING)
        return np.minimum(missing, lacking(np.where(whole, 1.0, cycles)))

    def _missing_by_counter(
        self,
        state: SyncState,
        index: SyncIndex,
        lost: NDArray[np.int64],
        unsent: NDArray[np.int64],
        told: int | None,
        in_bundles: bool,
    ) -> NDArray[np.int64]:
        """SYNCs that are missing in each period; the counter alone tells where the time does not."""
        by_counter = np.where(lost > 0, lost, unsent)
        median = _median(state, index.periods) if state.period.count >= _LEARN else 0.0
        if in_bundles or not median > 0:
            return by_counter
        usual = usual_of(index.periods, median)
        cycles = index.periods / np.where(usual > 0, usual, median)
        counter = index.counter[index.first + 1 :]
        in_time = lost_in_time(lost, unsent, cycles, counter, state.counter.end(told))
        return np.where(index.bundled[index.first : -1], by_counter, in_time)


def _step(block: Block, bus: str, found: ClockSet) -> ClockStepRow:
    t_ns, seq = block.frames.t_ns, block.batch.seq(found.end)
    around = int(t_ns[found.start]), int(t_ns[found.end])
    return ClockStepRow(bus, *around, found.by_ns, found.witnesses, [seq])


def _counters(
    block: Block, state: SyncState, rows: NDArray[np.intp], longest: int
) -> NDArray[np.int64]:
    """(m + 1,) counters of the SYNCs, 0 for those without one; `longest` has so many bytes."""
    if not state.last_counter and not longest:
        return np.zeros(len(rows) + 1, np.int64)
    counter = np.where(block.frames.dlc[rows] > 0, block.frames.data[rows, 0], 0)
    return np.concatenate(([state.last_counter], counter)).astype(np.int64)


def _lost_by_counter(state: SyncState, index: SyncIndex, told: int | None) -> NDArray[np.int64]:
    """SYNCs lost in each period by their counter."""
    nothing = np.zeros(len(index.periods), np.int64)
    if not len(index.rows):
        return nothing
    lost = state.counter.follow(index.counter[1:], told)
    return lost if index.known else lost[1:]


def _median(state: SyncState, periods: NDArray[np.int64]) -> float:
    """Median of a block's own periods where there are enough of them, so that it may change."""
    return median_of(periods) if len(periods) >= _LEARN else state.period.quantile(0.5)


def _median_of(state: SyncState, index: SyncIndex, periods: NDArray[np.int64]) -> float:
    """The same of the true periods of a block, where all are true known from its index."""
    if len(periods) >= _LEARN and len(periods) == len(index.periods):
        return index.cycle_ns
    if not state.period.count:
        return median_of(periods)
    return _median(state, periods)


def _add_holes(state: SyncState, index: SyncIndex, missing: NDArray[np.int64]) -> None:
    """Count what is missing in each period, and keep the first holes."""
    if not missing.any():
        return
    state.missing += int(missing.sum())
    t_ns, seq = index.t_ns[index.first :], index.seq[index.first :]
    for at in np.flatnonzero(missing)[: MAX_HOLES - len(state.holes)].tolist():
        pair = int(seq[at]), int(seq[at + 1])
        state.holes.append(SyncHole(int(t_ns[at]), int(t_ns[at + 1]), int(missing[at]), pair))


def _sustained(long: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where long periods follow one another for so long that they are the rhythm."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], long.astype(np.int8), [0]))))
    sustained = np.zeros(len(long), np.bool_)
    for start, stop in edges.reshape(-1, 2).tolist():
        if stop - start >= _REGIME:
            sustained[start:stop] = True
    return sustained
