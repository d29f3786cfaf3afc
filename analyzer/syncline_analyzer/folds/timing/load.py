"""Bus load over time: windows of 1 s and 100 ms, the fullest burst, the longest busy stretch."""

from collections.abc import Iterable, Mapping
from dataclasses import field, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.load_busy import Busy
from syncline_analyzer.folds.timing.load_shares import Shares
from syncline_analyzer.folds.timing.load_windows import Whole, Windows
from syncline_analyzer.pdo_binding import PdoBindings
from syncline_analyzer.results import (
    BusLoadRow,
    BusShareRow,
    NodeShareRow,
    OverloadRow,
    Series,
)
from syncline_analyzer.service_ids import moved_emcy_id
from syncline_schemas.batch import FrameFlag
from syncline_schemas.records import dataclass

WINDOW_NS = 1_000_000_000
SHORT_WINDOW_NS = 100_000_000
OVERLOAD_PERCENT = 90.0
"""Load from which on frames of low priority wait for long."""
OVERLOAD_WINDOWS = 3
"""So many such windows in a row are an overload."""
_POSSIBLE = 1.01
"""A higher load is no load: the recorder stamped late what it had kept."""
_KEPT_NS = 250_000_000
"""A recorder may have kept frames of so long before the first stamp [ns]."""
MAX_OVERLOADS = 1000
_STEP_BACK_NS = 1_000_000
"""Stamps that run back by more are a step of the clock, which starts a new stretch of windows."""
_NONE: Mapping[str, int] = {}

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LoadTables:
    """What is told of the load of all buses."""

    load: list[BusLoadRow] = field(default_factory=list)
    shares: list[BusShareRow] = field(default_factory=list)
    node_shares: list[NodeShareRow] = field(default_factory=list)
    series: list[Series] = field(default_factory=list)
    overloads: list[OverloadRow] = field(default_factory=list)


@dataclass(slots=True)
class _State:
    """A bus from block to block; bits at the data bit rate are counted as nominal ones."""

    frames: int = 0
    bits: float = 0.0
    listened_ns: int = 0
    silent_ns: int = 0
    unknown_rate: bool = False
    """Whether a frame switched to a bit rate that nobody tells."""
    last_ns: int | None = None
    """None at the start and after a gap."""
    seconds: Windows = field(default_factory=lambda: Windows(WINDOW_NS, _POSSIBLE))
    tenths: Windows = field(default_factory=lambda: Windows(SHORT_WINDOW_NS, _POSSIBLE))
    busy: Busy = field(default_factory=Busy)
    shares: Shares = field(default_factory=Shares)
    full: list[OverloadRow] = field(default_factory=list)
    """Windows that are nearly full, joined where they follow one another."""

    def mean_percent(self, bitrate: int) -> float | None:
        """Mean load at a bit rate; None where no time passed."""
        return 1e11 * self.bits / bitrate / self.listened_ns if self.listened_ns else None

    def close(self) -> None:
        """End a stretch of time that is listened to."""
        self.seconds.close()
        self.tenths.close()
        self.busy.close()
        self.last_ns = None


class LoadFold:
    """Counts bits and frames per bus.

    Windows start with the first frame, again after a gap or a step back of the clock. Peaks are
    those of whole windows; error frames are not counted, as their length cannot be told. Frames
    with a switched bit rate (FD, BRS) make percentages impossible where the data bit rate is not
    known.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._states: dict[int, _State] = {}

    def update(self, block: Block, bus: int) -> None:
        """Take in the frames of one bus."""
        rows = block.by_bus[bus]
        state = self._states.get(bus) or self._states.setdefault(bus, _State())
        bits: Ints | Floats = block.wire_bits[rows]
        if block.batch.flags_seen & FrameFlag.BRS and (fast := block.data_phase_bits[rows]).any():
            ratio = self._nominal_per_data_bit(bus)
            state.unknown_rate |= ratio is None
            bits = bits - fast * (1 - (ratio or 1.0))
        frames = block.frames if isinstance(rows, slice) else block.frames[rows]
        state.frames += len(frames)
        state.bits += float(bits.sum())
        state.shares.add(frames, bits, block.batch.flags_seen)
        if not self._context.timed:
            return
        t_ns, error = frames.t_ns, block.error[rows]
        back: list[int] = []
        if not block.batch.ascending:
            back = (np.flatnonzero(t_ns[1:] - t_ns[:-1] < -_STEP_BACK_NS) + 1).tolist()
        for first, stop in pairwise([0, *back, len(t_ns)]):
            part = slice(first, stop)
            self._stretch(bus, state, t_ns[part], bits[part], error[part], block.batch.ascending)

    def gap(self, bus: int | None) -> None:
        """Close the windows: what lies in a gap is not load."""
        for state_bus, state in self._states.items():
            if bus in (None, state_bus):
                state.close()

    def finish(
        self,
        bindings: PdoBindings,
        syncs: Iterable[tuple[str, int]] = (),
        stepped_ns: Mapping[str, int] = _NONE,
        silent_ns: Mapping[str, int] = _NONE,
    ) -> LoadTables:
        """Rows of every bus, and its series: "bus load" [%], or "frame rate" without a bit rate.

        Args:
            bindings: whose PDO an identifier is.
            syncs: (bus, identifier) of every SYNC.
            stepped_ns: by how much the clock was set forward on each bus: time that never passed.
            silent_ns: how long nothing was heard on each bus though heartbeats were due.
        """
        tables = LoadTables()
        known = list(syncs)
        for bus, state in sorted(self._states.items()):
            state.close()
            name = self._context.bus_name(bus)
            state.listened_ns = max(0, state.listened_ns - stepped_ns.get(name, 0))
            state.silent_ns = min(silent_ns.get(name, 0), state.listened_ns)
            bitrate = self._percentages(bus, state)
            tables.load.append(self._row(bus, state))
            tables.series.extend(_series(name, state, bitrate))
            bindings.refresh(bus)
            shares, nodes = state.shares.rows(
                name,
                state.listened_ns / 1e9,
                bitrate,
                lambda cob_id, bus=bus: bindings.owner(bus, cob_id),  # type: ignore[misc]
                self._moved_emcys(bus).get,
                [cob_id for bus_name, cob_id in known if bus_name == name],
            )
            tables.shares.extend(shares)
            tables.node_shares.extend(nodes)
            if bitrate:
                tables.overloads.extend(_long_enough(state.full))
        return tables

    def _moved_emcys(self, bus: int) -> dict[int, int]:
        """Nodes by the identifier to which 1014h moved their EMCYs."""
        shadow = self._context.shadow
        moved = {moved_emcy_id(shadow, bus, node): node for node in shadow.nodes_of(bus)}
        return {cob_id: node for cob_id, node in moved.items() if cob_id is not None}

    def _stretch(
        self,
        bus: int,
        state: _State,
        t_ns: Ints,
        bits: Ints | Floats,
        error: NDArray[np.bool_],
        ascending: bool,
    ) -> None:
        """Frames whose stamps run forward, but for small steps back where they are not ascending."""
        if state.last_ns is not None and t_ns[0] < state.last_ns - _STEP_BACK_NS:
            state.close()
        bit_ns = self._bit_ns(bus)
        first = state.last_ns is None
        if first:
            # The first frame lies before its stamp, outside the time that is listened to.
            state.last_ns = int(t_ns[0])
            state.bits -= float(bits[0])
        assert state.last_ns is not None
        forward = t_ns
        if not ascending or t_ns[0] < state.last_ns:
            forward = np.maximum.accumulate(np.maximum(t_ns, state.last_ns))
        state.listened_ns += int(forward[-1]) - state.last_ns
        state.last_ns = int(forward[-1])
        wire_ns: Floats | None = np.asarray(bits * bit_ns, np.float64) if bit_ns else None
        for windows in (state.seconds, state.tenths):
            windows.begin(int(forward[0]))
            whole = windows.add(forward, bits, wire_ns, bit_ns)
            if windows is state.seconds and bit_ns:
                _add_full(state.full, self._context.bus_name(bus), whole, bit_ns)
        if wire_ns is not None and not error.all():
            sent = ~error if error.any() else slice(None)
            state.busy.add(forward[sent], wire_ns[sent], bit_ns, self._context.resolution_ns)

    def _bit_ns(self, bus: int) -> float:
        """Length of a bit, 0 where it is not known."""
        bitrate = self._context.bitrates.get(self._context.bus_name(bus))
        return 1e9 / bitrate if bitrate else 0.0

    def _nominal_per_data_bit(self, bus: int) -> float | None:
        """How long a bit of the data phase is in nominal bits, None where that is not known."""
        name = self._context.bus_name(bus)
        bitrate, data = self._context.bitrates.get(name), self._context.data_bitrates.get(name)
        return bitrate / data if bitrate and data else None

    def _percentages(self, bus: int, state: _State) -> int | None:
        """The bit rate, where it makes percentages: none above what a bus can carry."""
        name = self._context.bus_name(bus)
        known = self._context.bitrates.get(name)
        if state.unknown_rate or known is None:
            return None
        mean = state.mean_percent(known)
        if mean is None or mean <= 100 * _POSSIBLE:
            return known
        if state.bits * 1e9 / known > state.listened_ns + _KEPT_NS:
            self._context.impossible_loads[name] = mean
        return None

    def _row(self, bus: int, state: _State) -> BusLoadRow:
        name = self._context.bus_name(bus)
        seconds = state.listened_ns / 1e9
        estimate = self._context.estimates.get(name)
        source = self._context.bitrate_sources.get(name)
        confidence: Literal["told", "high", "low"] | None = None
        if source is not None:
            confidence = "high" if source == "estimated" else "told"
        elif estimate is not None:
            confidence = "low"
        row = BusLoadRow(
            name,
            self._context.bitrates.get(name),
            None,
            None,
            state.frames / seconds if seconds else None,
            bitrate_source=source,
            bitrate_confidence=confidence,
            bitrate_estimate=estimate.bitrate if estimate else None,
            data_bitrate=self._context.data_bitrates.get(name),
            silent_ns=state.silent_ns,
        )
        bitrate = self._percentages(bus, state)
        return _with_percent(row, state, bitrate, self._context.resolution_ns) if bitrate else row


def _with_percent(row: BusLoadRow, state: _State, bitrate: int, resolution_ns: int) -> BusLoadRow:
    """The row with what the bit rate makes of the bits."""
    mean = state.mean_percent(bitrate)
    if mean is None:
        return row
    heard_ns = state.listened_ns - state.silent_ns
    peak, tenth = state.seconds.peak, state.tenths.peak
    burst = state.busy.peak(resolution_ns)
    stretch = state.busy.stretch(resolution_ns, 1e9 / bitrate)
    return replace(
        row,
        mean_percent=mean,
        heard_percent=mean * state.listened_ns / heard_ns if heard_ns else None,
        peak_percent=100 * peak[0] / bitrate if peak else mean,
        peak_ns=peak and peak[1],
        peak_100ms_percent=tenth and 1000 * tenth[0] / bitrate,
        peak_100ms_ns=tenth and tenth[1],
        burst_percent=burst and 100 * burst[0],
        burst_ns=burst and burst[1],
        longest_busy_us=stretch.lasts_ns / 1000 if stretch else None,
        longest_busy_frames=stretch.frames if stretch else None,
        longest_busy_ns=stretch.start_ns if stretch else None,
    )


def _series(name: str, state: _State, bitrate: int | None) -> list[Series]:
    found = []
    for windows, word in ((state.seconds, ""), (state.tenths, " in 100 ms")):
        columns = windows.over_time.columns()
        if not columns:
            continue
        a_second = 1e9 / windows.width_ns
        if bitrate:
            percent = 100 * columns["bits"] * a_second / bitrate
            found.append(Series(name, f"bus load{word}", "%", columns["t_ns"], percent))
        else:
            rate = columns["frames"] * a_second
            found.append(Series(name, f"frame rate{word}", "1/s", columns["t_ns"], rate))
    return found


def _add_full(full: list[OverloadRow], bus: str, windows: Whole, bit_ns: float) -> None:
    """Join whole windows that are nearly full to stretches."""
    percent = 100 * windows.bits * bit_ns / WINDOW_NS
    for at in np.flatnonzero((percent >= OVERLOAD_PERCENT) & (percent <= 100 * _POSSIBLE)):
        start_ns = int(windows.start_ns[at])
        last = full[-1] if full else None
        if last is not None and last.end_ns == start_ns:
            seconds = (last.end_ns - last.start_ns) / WINDOW_NS
            mean = (last.percent * seconds + float(percent[at])) / (seconds + 1)
            full[-1] = OverloadRow(bus, last.start_ns, start_ns + WINDOW_NS, mean)
        else:
            if full and not _long_enough(full[-1:]):
                full.pop()
            if len(full) < MAX_OVERLOADS:
                full.append(OverloadRow(bus, start_ns, start_ns + WINDOW_NS, float(percent[at])))


def _long_enough(full: list[OverloadRow]) -> list[OverloadRow]:
    """Stretches of at least `OVERLOAD_WINDOWS` windows."""
    return [row for row in full if row.end_ns - row.start_ns >= OVERLOAD_WINDOWS * WINDOW_NS]
