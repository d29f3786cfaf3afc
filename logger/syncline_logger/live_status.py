"""What the live line tells: rates, bus load, nodes and their states; fed with frames, no I/O."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_logger.bus_condition import BusCondition
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.canopen.nmt import RESETS, STATE_OF_BYTE, NmtState
from syncline_schemas.canopen.services import Service, service_of
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.wire_length import wire_ns

SILENT_PERIODS = 3
"""A node that sent heartbeats is shown as LOST after so many of its periods."""
SHORTEST_SILENCE_NS = 500_000_000
"""Shorter silences come from adapters and machines that hand frames over late."""
RESTART_NS = 5_000_000_000
"""So long a node may take to restart when it is told to; a LIR takes 4 s (SKB IS, LIR CANopen 4.7)."""
STAMPS_KEPT = 5
"""Of a node's latest heartbeats, to know its period."""


@dataclass(frozen=True, slots=True)
class BusSnapshot:
    """One bus at one moment; rates are those of the last period.

    `load_percent` is None where the bit rate is not known. `nodes`: state by node id.
    `clock_residual_ns`: largest error of the adapter's clock on UTC, None where it has no clock.
    """

    name: str
    frames: int
    frames_per_s: float
    load_percent: float | None
    state: str
    adapter_present: bool
    error_frames: int
    dropped_frames: int
    nodes: dict[int, str]
    clock_residual_ns: int | None = None


@dataclass(frozen=True, slots=True)
class StatusSnapshot:
    """The recorder at one moment.

    `gaps` counts the stretches in which a bus was not heard. `trouble` says what the disk refuses,
    empty while all is well.
    """

    t_ns: int
    elapsed_ns: int
    path: str
    bytes_written: int
    buses: tuple[BusSnapshot, ...]
    gaps: int = 0
    trouble: str = ""

    @property
    def frames(self) -> int:
        """Frames recorded so far, all buses together."""
        return sum(bus.frames for bus in self.buses)


@dataclass(frozen=True, slots=True)
class NodeChange:
    """Something changed with a node; `bus` is its bus's name."""

    log_ns: int
    bus: str
    text: str


@dataclass(slots=True)
class _Node:
    """`told`: its state as the last change told it; silence before `excused_ns` is none."""

    state: NmtState
    seen_ns: int
    stamps_ns: NDArray[np.int64]
    told: NmtState | None = None
    excused_ns: int = 0

    def state_at(self, heard_ns: int, listening_ns: int) -> NmtState:
        """LOST after too long a silence; only the time in which somebody listened counts."""
        silent = self.is_long(heard_ns - max(self.seen_ns, self.excused_ns, listening_ns))
        return NmtState.LOST if silent else self.state

    def is_long(self, silence_ns: int) -> bool:
        """Whether a silence is too long for its period."""
        period_ns = _longest_period(np.diff(self.stamps_ns).tolist())
        return period_ns > 0 and silence_ns > max(SILENT_PERIODS * period_ns, SHORTEST_SILENCE_NS)

    def tell(self, state: NmtState) -> str:
        """Words where the state is another one than was told last, else none."""
        before, self.told = self.told, state
        if before is None:
            return f"is heard, {state}"
        return "" if before == state else f"goes from {before} to {state}"


def _longest_period(intervals_ns: Sequence[int]) -> int:
    """The longest since the node was last silent for too long; 0 when there is none.

    >>> _longest_period([20, 21, 19, 20]), _longest_period([20, 20, 60_000, 20])
    (21, 20)
    """
    longest_ns = 0
    for interval_ns in intervals_ns:
        was_lost = 0 < SILENT_PERIODS * longest_ns < interval_ns
        longest_ns = 0 if was_lost else max(longest_ns, interval_ns)
    return longest_ns


@dataclass(slots=True)
class _Bus:
    info: BusInfo
    listening_ns: int
    heard_ns: int
    frames: int = 0
    busy_ns: float = 0.0
    nodes: dict[int, _Node] = field(default_factory=dict)


class LiveStatus:
    """Counts of the running period and the last sign of life of each node."""

    def __init__(self, buses: Sequence[BusInfo], start_ns: int) -> None:
        self._buses = {bus.number: _Bus(bus, start_ns, start_ns) for bus in buses}
        self._start_ns = self._period_start_ns = start_ns
        self._changes: list[NodeChange] = []

    def update(self, frames: FrameBatch, log_ns: NDArray[np.int64]) -> None:
        """Take in frames of any bus. log_ns: (n,) int64, never decreasing."""
        for number, bus in self._buses.items():
            rows = np.flatnonzero(frames.bus == number)
            mine = frames[rows]
            bus.frames += len(mine)
            if bus.info.bitrate:
                busy_ns = wire_ns(mine, bus.info.bitrate, bus.info.data_bitrate)
                bus.busy_ns += float(busy_ns.sum())
            self._changes += _take_error_control(bus, mine, log_ns[rows])
            _excuse_restarts(bus, mine, log_ns[rows])

    def take_changes(self) -> list[NodeChange]:
        """What changed with the nodes since the last call."""
        changes, self._changes = self._changes, []
        return changes

    def listened(self, bus: int, begin_ns: int, end_ns: int) -> None:
        """All frames that a bus gave in [begin_ns, end_ns) of log time are taken in.

        Nothing is known of the time before `begin_ns`, the recorder's start or the end of a gap.
        """
        self._buses[bus].listening_ns, self._buses[bus].heard_ns = begin_ns, end_ns

    def snapshot(
        self,
        now_ns: int,
        path: str,
        bytes_written: int,
        conditions: Sequence[BusCondition],
        gaps: int = 0,
        trouble: str = "",
    ) -> StatusSnapshot:
        """The state now; begins the next period. `conditions` are in the order of the buses."""
        period_ns = max(now_ns - self._period_start_ns, 1)
        self._period_start_ns = now_ns
        buses = tuple(
            _snapshot(bus, condition, period_ns)
            for bus, condition in zip(self._buses.values(), conditions, strict=True)
        )
        self._changes += [
            change for bus in self._buses.values() for change in _silences(bus, now_ns)
        ]
        return StatusSnapshot(
            now_ns, now_ns - self._start_ns, path, bytes_written, buses, gaps, trouble
        )


def _silences(bus: _Bus, now_ns: int) -> Iterator[NodeChange]:
    """Nodes that have become silent; what they send next is told when it comes."""
    for number, node in sorted(bus.nodes.items()):
        if node.state_at(bus.heard_ns, bus.listening_ns) == NmtState.LOST:
            text = node.tell(NmtState.LOST)
            if text:
                yield NodeChange(now_ns, bus.info.name, f"node {number} {text}")


def _take_error_control(
    bus: _Bus, frames: FrameBatch, log_ns: NDArray[np.int64]
) -> Iterator[NodeChange]:
    nodes = bus.nodes
    heard = (service_of(frames) == Service.ERROR_CONTROL) & (frames.dlc == 1)
    heard &= (frames.flags & FrameFlag.REMOTE) == 0
    rows = np.flatnonzero(heard)
    numbers = frames.can_id[rows] & 0x7F
    for number in np.unique(numbers).tolist():
        mine = rows[numbers == number]
        boot_ups = np.flatnonzero(frames.data[mine, 0] & 0x7F == 0)
        before = nodes.get(number)
        if len(boot_ups):
            stamps_ns = frames.t_ns[mine[boot_ups[-1] :]]
        elif before is None:
            stamps_ns = frames.t_ns[mine]
        else:
            stamps_ns = np.concatenate([before.stamps_ns, frames.t_ns[mine]])
        state = _state_of(int(frames.data[mine[-1], 0]))
        node = _Node(state, int(log_ns[mine[-1]]), stamps_ns[-STAMPS_KEPT:])
        words = ["boots"] if len(boot_ups) else []
        if before is not None:
            node.told, node.excused_ns = before.told, before.excused_ns
            silence_ns = _silence_ns(before, bus, int(frames.t_ns[mine[0]]), int(log_ns[mine[0]]))
            if before.is_long(silence_ns):
                words.append(f"was silent for {silence_ns / 1e9:.1f} s")
        words += filter(None, [node.tell(state)])
        nodes[number] = node
        if words:
            text = f"node {number} {', '.join(words)}"
            yield NodeChange(node.seen_ns, bus.info.name, text)


def _excuse_restarts(bus: _Bus, frames: FrameBatch, log_ns: NDArray[np.int64]) -> None:
    """Nodes that are told to restart may be silent for a while."""
    told = (service_of(frames) == Service.NMT) & (frames.dlc == 2)
    told &= np.isin(frames.data[:, 0], RESETS)
    for row in np.flatnonzero(told).tolist():
        target = int(frames.data[row, 1])
        for number, node in bus.nodes.items():
            if target in (0, number):
                node.excused_ns = int(log_ns[row]) + RESTART_NS


def _silence_ns(before: _Node, bus: _Bus, t_ns: int, log_ns: int) -> int:
    """How long a node was silent until this frame: frames that are only handed over late were not."""
    listened_ns = log_ns - max(before.seen_ns, before.excused_ns, bus.listening_ns)
    return min(listened_ns, t_ns - int(before.stamps_ns[-1]))


def _state_of(byte: int) -> NmtState:
    """The state that a heartbeat's byte tells; a node that boots is on its way there."""
    if byte & 0x7F == 0:
        return NmtState.PRE_OPERATIONAL
    return STATE_OF_BYTE.get(byte & 0x7F, NmtState.UNKNOWN)


def _snapshot(bus: _Bus, condition: BusCondition, period_ns: int) -> BusSnapshot:
    load = None
    if bus.info.bitrate:
        load = 100 * bus.busy_ns / period_ns
    rate = bus.frames * 1e9 / period_ns
    bus.frames, bus.busy_ns = 0, 0.0
    return BusSnapshot(
        name=bus.info.name,
        frames=condition.frames,
        frames_per_s=rate,
        load_percent=load,
        state=condition.state,
        adapter_present=condition.adapter_present,
        error_frames=condition.error_frames,
        dropped_frames=condition.dropped_frames,
        clock_residual_ns=condition.clock_residual_ns,
        nodes={
            number: node.state_at(bus.heard_ns, bus.listening_ns)
            for number, node in sorted(bus.nodes.items())
        },
    )
