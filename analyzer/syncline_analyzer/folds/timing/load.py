"""Bus load and frame rate per second."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.results import BusLoadRow, OverloadRow, Series
from syncline_analyzer.series import Columns, Thinner
from syncline_schemas.batch import FrameFlag

WINDOW_NS = 1_000_000_000
MAX_POINTS = 20_000
"""Windows that are kept for the plot."""
OVERLOAD_PERCENT = 90.0
"""Load from which on frames of low priority wait for long."""
OVERLOAD_WINDOWS = 3
"""So many such windows in a row are an overload."""
_POSSIBLE_PERCENT = 101.0
"""A higher load is no load: the recorder stamped late what it had kept."""
MAX_OVERLOADS = 1000
_STEP_BACK_NS = 100_000_000
"""A larger step back of the clock starts a new stretch of windows."""


@dataclass(slots=True)
class _State:
    """A bus from block to block."""

    frames: int = 0
    bits: int = 0
    listened_ns: int = 0
    switched_rate: bool = False
    origin_ns: int | None = None
    """Start of the stretch that is being counted; None at the start and after a gap."""
    last_ns: int = 0
    window: int = 0
    window_frames: int = 0
    window_bits: int = 0
    peak_bits: int | None = None
    over_time: Thinner = field(default_factory=lambda: Thinner("bits", MAX_POINTS))
    full: list[OverloadRow] = field(default_factory=list)
    """Windows that are nearly full, joined where they follow one another."""


class LoadFold:
    """Counts bits and frames in windows of one second, per bus.

    Windows start with the first frame, again after a gap or a step back of the clock. The peak is
    that of whole windows; error frames are not counted, as their length cannot be told. A frame
    with a switched bit rate (FD, BRS) makes percentages impossible.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._states: dict[int, _State] = {}

    def update(self, block: Block, bus: int) -> None:
        """Take in the frames of one bus."""
        rows = block.by_bus[bus]
        state = self._states.setdefault(bus, _State())
        t_ns, bits = block.frames.t_ns[rows], block.wire_bits[rows]
        state.frames += len(t_ns)
        state.bits += int(bits.sum())
        state.switched_rate |= bool((block.frames.flags[rows] & FrameFlag.BRS).any())
        if not self._context.timed:
            return
        back = np.flatnonzero(np.diff(t_ns) < -_STEP_BACK_NS) + 1
        edges = [0, *back.tolist(), len(t_ns)]
        for first, stop in pairwise(edges):
            self._stretch(bus, state, t_ns[first:stop], bits[first:stop])

    def gap(self, bus: int | None) -> None:
        """Close the windows: what lies in a gap is not load."""
        for state_bus, state in self._states.items():
            if bus in (None, state_bus):
                _close(state)

    def finish(self) -> tuple[list[BusLoadRow], list[Series]]:
        """One row and one series per bus: "bus load" [%], or "frame rate" without a bit rate."""
        rows, series = [], []
        for bus, state in sorted(self._states.items()):
            _close(state)
            rows.append(self._row(bus, state))
            columns = state.over_time.columns()
            if columns:
                series.append(self._series(bus, state, columns["t_ns"], columns))
        return rows, series

    def overloads(self) -> list[OverloadRow]:
        """Stretches of at least `OVERLOAD_WINDOWS` windows that are nearly full."""
        shortest_ns = OVERLOAD_WINDOWS * WINDOW_NS
        return [
            row
            for _, state in sorted(self._states.items())
            for row in state.full
            if row.end_ns - row.start_ns >= shortest_ns and not state.switched_rate
        ]

    def _stretch(
        self, bus: int, state: _State, t_ns: NDArray[np.int64], bits: NDArray[np.int64]
    ) -> None:
        """Frames whose stamps run forward."""
        if state.origin_ns is not None and t_ns[0] < state.last_ns - _STEP_BACK_NS:
            _close(state)
        if state.origin_ns is None:
            state.origin_ns = state.last_ns = int(t_ns[0])
            # The first frame lies before its stamp, outside the time that is listened to.
            state.bits -= int(bits[0])
        forward = np.maximum.accumulate(np.maximum(t_ns, state.last_ns))
        state.listened_ns += int(forward[-1]) - state.last_ns
        state.last_ns = int(forward[-1])
        window = (forward - state.origin_ns) // WINDOW_NS
        starts = np.flatnonzero(np.diff(window, prepend=window[0] - 1))
        numbers = window[starts]
        frames = np.diff(np.append(starts, len(window)))
        sums = np.add.reduceat(bits, starts)
        if numbers[0] == state.window:
            frames[0] += state.window_frames
            sums[0] += state.window_bits
        elif state.window_frames:
            numbers = np.concatenate(([state.window], numbers))
            frames = np.concatenate(([state.window_frames], frames))
            sums = np.concatenate(([state.window_bits], sums))
        _add_windows(state, numbers[:-1], frames[:-1], sums[:-1])
        bitrate = self._bitrate(bus, state)
        if bitrate:
            _add_full(state, self._context.bus_name(bus), numbers[:-1], 100 * sums[:-1] / bitrate)
        state.window = int(numbers[-1])
        state.window_frames, state.window_bits = int(frames[-1]), int(sums[-1])

    def _bitrate(self, bus: int, state: _State) -> int | None:
        return self._context.bitrates.get(self._context.bus_name(bus))

    def _row(self, bus: int, state: _State) -> BusLoadRow:
        bitrate = self._bitrate(bus, state)
        seconds = state.listened_ns / 1e9
        mean = peak = None
        if bitrate and seconds and not state.switched_rate:
            mean = 100 * state.bits / bitrate / seconds
            peak = mean if state.peak_bits is None else 100 * state.peak_bits / bitrate
        rate = state.frames / seconds if seconds else 0.0
        return BusLoadRow(self._context.bus_name(bus), bitrate, mean, peak, rate)

    def _series(
        self,
        bus: int,
        state: _State,
        t_ns: NDArray[np.int64],
        columns: Columns,
    ) -> Series:
        bitrate = self._bitrate(bus, state)
        name = self._context.bus_name(bus)
        if bitrate and not state.switched_rate:
            return Series(name, "bus load", "%", t_ns, 100 * columns["bits"] / bitrate)
        return Series(name, "frame rate", "1/s", t_ns, columns["frames"])


def _add_windows(
    state: _State, numbers: NDArray[np.int64], frames: NDArray[np.int64], bits: NDArray[np.int64]
) -> None:
    """Whole windows; a silent stretch is drawn as two windows of nothing."""
    if not len(numbers):
        return
    assert state.origin_ns is not None
    state.peak_bits = max(state.peak_bits or 0, int(bits.max()))
    silent = np.flatnonzero(np.diff(numbers) > 1)
    edges = np.concatenate([numbers[silent] + 1, numbers[silent + 1] - 1])
    order = np.argsort(np.concatenate([numbers, edges]), kind="stable")
    number = np.concatenate([numbers, edges])[order]
    none = np.zeros(len(edges), np.int64)
    state.over_time.add(
        {
            "t_ns": state.origin_ns + number * WINDOW_NS,
            "frames": np.concatenate([frames, none])[order].astype(np.float64),
            "bits": np.concatenate([bits, none])[order].astype(np.float64),
        }
    )


def _add_full(
    state: _State, bus: str, numbers: NDArray[np.int64], percent: NDArray[np.float64]
) -> None:
    """Join whole windows that are nearly full to stretches."""
    assert state.origin_ns is not None
    full = np.flatnonzero((percent >= OVERLOAD_PERCENT) & (percent <= _POSSIBLE_PERCENT))
    for at in full.tolist():
        start_ns = state.origin_ns + int(numbers[at]) * WINDOW_NS
        last = state.full[-1] if state.full else None
        if last is not None and last.end_ns == start_ns:
            seconds = (last.end_ns - last.start_ns) / WINDOW_NS
            mean = (last.percent * seconds + float(percent[at])) / (seconds + 1)
            state.full[-1] = OverloadRow(bus, last.start_ns, start_ns + WINDOW_NS, mean)
        else:
            _drop_short(state.full)
            if len(state.full) < MAX_OVERLOADS:
                state.full.append(
                    OverloadRow(bus, start_ns, start_ns + WINDOW_NS, float(percent[at]))
                )


def _drop_short(full: list[OverloadRow]) -> None:
    """Leave out the last stretch if it ended too soon to count."""
    if full and full[-1].end_ns - full[-1].start_ns < OVERLOAD_WINDOWS * WINDOW_NS:
        full.pop()


def _close(state: _State) -> None:
    """End a stretch; its last window is not whole and only counts when it is the only one."""
    if state.origin_ns is not None and not state.over_time.columns() and state.window_frames:
        start = np.array([state.origin_ns + state.window * WINDOW_NS])
        state.over_time.add(
            {
                "t_ns": start,
                "frames": np.array([float(state.window_frames)]),
                "bits": np.array([float(state.window_bits)]),
            }
        )
    state.origin_ns = None
    state.window = state.window_frames = state.window_bits = 0
