"""State of a bus as its controller reports it, and counts of what was received and lost."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.proto import syncline_pb2

ERR_CONTROLLER = 0x004
ERR_BUS_OFF = 0x040
ERR_RESTARTED = 0x100
ERR_COUNTERS = 0x200
"""Error classes of SocketCAN: bits of an error frame's identifier (linux/can/error.h)."""

CONTROLLER_OVERRUN = 0x01
CONTROLLER_STATES = ((0x30, "passive"), (0x0C, "warning"), (0x40, "active"))
"""Bits of data byte 1 under ERR_CONTROLLER; the worst is named first."""

SOCKETCAN_ERROR_FRAMES = frozenset({"socketcan", "socketcand"})
"""Interfaces whose error frames carry SocketCAN's classes; others only say that there was one."""


@dataclass(frozen=True, slots=True)
class Change:
    """Something about a bus changed, at a log time [ns]."""

    log_ns: int
    text: str


class BusCondition:
    """What `/can/<bus>/status` tells of one bus, fed with the bus's frames."""

    def __init__(self, interface: str) -> None:
        self._reads_error_frames = interface in SOCKETCAN_ERROR_FRAMES
        self.state = "unknown"
        self.tx_errors: int | None = None
        self.rx_errors: int | None = None
        self.frames = 0
        self.error_frames = 0
        self.dropped_controller = 0
        self.dropped_queue = 0
        self.adapter_present = True

    def update(self, frames: FrameBatch, log_ns: NDArray[np.int64]) -> list[Change]:
        """Take in frames of this bus; what changed."""
        self.frames += len(frames)
        rows = np.flatnonzero(frames.flags & FrameFlag.ERROR)
        self.error_frames += len(rows)
        if not self._reads_error_frames:
            return []
        changes = []
        for row in rows:
            text = self._take_error(int(frames.can_id[row]), frames.data[row])
            if text:
                changes.append(Change(int(log_ns[row]), text))
        return changes

    def _take_error(self, classes: int, data: NDArray[np.uint8]) -> str:
        before = self.state
        if classes & ERR_COUNTERS:
            self.tx_errors, self.rx_errors = int(data[6]), int(data[7])
        if classes & ERR_CONTROLLER:
            self.state = next(
                (name for bits, name in CONTROLLER_STATES if data[1] & bits), self.state
            )
            if data[1] & CONTROLLER_OVERRUN:
                self.dropped_controller += 1
                return "the controller's receive buffer overran; frames are missing"
        if classes & ERR_BUS_OFF:
            self.state = "off"
        elif classes & ERR_RESTARTED:
            self.state = "active"
        return f"{before} -> {self.state}" if self.state != before else ""

    def message(self, text: str = "") -> syncline_pb2.BusStatus:
        """The status message; `text` says what changed."""
        return syncline_pb2.BusStatus(
            state=self.state,
            tx_errors=self.tx_errors,
            rx_errors=self.rx_errors,
            frames_received=self.frames,
            error_frames=self.error_frames,
            dropped_controller=self.dropped_controller,
            dropped_queue=self.dropped_queue,
            adapter_present=self.adapter_present,
            text=text,
        )
