"""What the live line tells: rates, bus load, nodes and their states; fed with frames, no I/O."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from syncline_logger.bus_condition import BusCondition
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.canopen.nmt import STATE_OF_BYTE, NmtState
from syncline_schemas.canopen.services import Service, service_of
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.wire_length import wire_bits

SILENT_PERIODS = 3
"""A node that sent heartbeats is shown as LOST after so many of its periods."""


@dataclass(frozen=True, slots=True)
class BusSnapshot:
    """One bus at one moment; rates are those of the last period.

    `load_percent` is None where the bit rate is not known. `nodes`: state by node id.
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


@dataclass(frozen=True, slots=True)
class StatusSnapshot:
    """The recorder at one moment."""

    t_ns: int
    elapsed_ns: int
    path: str
    bytes_written: int
    buses: tuple[BusSnapshot, ...]

    @property
    def frames(self) -> int:
        """Frames recorded so far, all buses together."""
        return sum(bus.frames for bus in self.buses)


@dataclass(slots=True)
class _Node:
    state: NmtState
    seen_ns: int
    period_ns: int | None = None

    def state_at(self, now_ns: int) -> NmtState:
        if self.period_ns and now_ns - self.seen_ns > SILENT_PERIODS * self.period_ns:
            return NmtState.LOST
        return self.state


@dataclass(slots=True)
class _Bus:
    info: BusInfo
    frames: int = 0
    bits: int = 0
    nodes: dict[int, _Node] = field(default_factory=dict)


class LiveStatus:
    """Counts of the running period and the last sign of life of each node."""

    def __init__(self, buses: Sequence[BusInfo], start_ns: int) -> None:
        self._buses = {bus.number: _Bus(bus) for bus in buses}
        self._start_ns = self._period_start_ns = start_ns

    def update(self, frames: FrameBatch) -> None:
        """Take in frames of any bus."""
        for number, bus in self._buses.items():
            mine = frames if len(self._buses) == 1 else frames[frames.bus == number]
            bus.frames += len(mine)
            if bus.info.bitrate:
                bus.bits += int(wire_bits(mine).sum())
            _take_error_control(bus.nodes, mine)

    def snapshot(
        self, now_ns: int, path: str, bytes_written: int, conditions: Sequence[BusCondition]
    ) -> StatusSnapshot:
        """The state now; begins the next period. `conditions` are in the order of the buses."""
        period_ns = max(now_ns - self._period_start_ns, 1)
        self._period_start_ns = now_ns
        buses = tuple(
            _snapshot(bus, condition, period_ns, now_ns)
            for bus, condition in zip(self._buses.values(), conditions, strict=True)
        )
        return StatusSnapshot(now_ns, now_ns - self._start_ns, path, bytes_written, buses)


def _take_error_control(nodes: dict[int, _Node], frames: FrameBatch) -> None:
    heard = (service_of(frames) == Service.ERROR_CONTROL) & (frames.dlc == 1)
    heard &= (frames.flags & FrameFlag.REMOTE) == 0
    for row in np.flatnonzero(heard):
        number, t_ns = int(frames.can_id[row]) & 0x7F, int(frames.t_ns[row])
        byte = int(frames.data[row, 0]) & 0x7F
        state = NmtState.PRE_OPERATIONAL if byte == 0 else STATE_OF_BYTE.get(byte)
        node = nodes.get(number)
        if node is None:
            nodes[number] = _Node(state or NmtState.UNKNOWN, t_ns)
            continue
        node.period_ns = t_ns - node.seen_ns if byte else None
        node.seen_ns, node.state = t_ns, state or NmtState.UNKNOWN


def _snapshot(bus: _Bus, condition: BusCondition, period_ns: int, now_ns: int) -> BusSnapshot:
    load = None
    if bus.info.bitrate:
        load = 100 * bus.bits * 1e9 / (bus.info.bitrate * period_ns)
    rate = bus.frames * 1e9 / period_ns
    bus.frames = bus.bits = 0
    return BusSnapshot(
        name=bus.info.name,
        frames=condition.frames,
        frames_per_s=rate,
        load_percent=load,
        state=condition.state,
        adapter_present=condition.adapter_present,
        error_frames=condition.error_frames,
        dropped_frames=condition.dropped_queue + condition.dropped_controller,
        nodes={number: node.state_at(now_ns) for number, node in sorted(bus.nodes.items())},
    )
