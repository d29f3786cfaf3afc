"""State of a bus as its controller reports it, and counts of what was received and lost."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from syncline_logger.batcher import Loss
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.can_errors import RECORDER_OFF, RECORDER_OVERFLOW
from syncline_schemas.proto import syncline_pb2

ERR_CONTROLLER = 0x004
ERR_BUS_OFF = 0x040
ERR_RESTARTED = 0x100
ERR_COUNTERS = 0x200
"""Error classes of SocketCAN: bits of an error frame's identifier (linux/can/error.h)."""

CONTROLLER_OVERRUN = 0x01
CONTROLLER_STATES = ((0x30, "passive"), (0x0C, "warning"), (0x40, "active"))
"""Bits of data byte 1 under ERR_CONTROLLER; the worst is named first."""

SOCKETCAN_ERROR_FRAMES = frozenset({"slcan", "socketcan", "socketcand"})
"""Interfaces whose error frames carry SocketCAN's classes; others only say that there was one."""

OVERRUNS_APART_NS = 100_000_000
"""Overruns of the controller that follow each other sooner are told as one [ns]."""
OFF_BEFORE = "the controller was bus-off before the recorder listened to it"
OVERRUN_TEXT = "the controller's receive buffer overran; frames are missing"


@dataclass(frozen=True, slots=True)
class Change:
    """Something about a bus changed, at a log time [ns]; `gap` is what was missed by it.

    `state` is the controller's new state where that is what changed.
    """

    log_ns: int
    text: str
    gap: Gap | None = None
    state: str = ""


class BusCondition:
    """What `/can/<bus>/status` tells of one bus, fed with the bus's frames.

    `clock_residual_ns`: largest error of the adapter's clock on UTC; None where it has no clock.
    """

    def __init__(self, interface: str, bus: int = 0) -> None:
        self._bus = bus
        self._reads_error_frames = interface in SOCKETCAN_ERROR_FRAMES
        self._off_ns: int | None = None
        self._off_reason = RECORDER_OFF
        self._last_ns: int | None = None
        self._told = (0, "")
        self.state = "unknown"
        self.tx_errors: int | None = None
        self.rx_errors: int | None = None
        self.frames = 0
        self.error_frames = 0
        self.dropped_kernel = 0
        self.dropped_controller = 0
        self.dropped_queue = 0
        self.dropped_disk = 0
        self.adapter_present = True
        self.clock_residual_ns: int | None = None

    @property
    def dropped_frames(self) -> int:
        """All that was lost, wherever."""
        received = self.dropped_queue + self.dropped_disk
        return self.dropped_kernel + self.dropped_controller + received

    def count_loss(self, loss: Loss) -> None:
        """Count a loss; one whose number is unknown counts as one."""
        frames = 1 if loss.frames is None else loss.frames
        if loss.where == "kernel":
            self.dropped_kernel += frames
        elif loss.where == "queue":
            self.dropped_queue += frames
        else:
            self.dropped_controller += frames

    def tell(self, state: str, log_ns: int) -> list[Change]:
        """The interface tells the controller's state when it is opened, or up again."""
        self._told = (log_ns, state)
        if state == "off":
            return self._switched_off(log_ns, log_ns, OFF_BEFORE)
        if self._off_ns is not None:
            return [self._switched_on(state, log_ns, log_ns)]
        self.state = state
        return []

    def deaf_until(self, end_ns: int) -> Gap | None:
        """The gap of a controller that is bus-off still when the recording ends."""
        if self._off_ns is None or end_ns <= self._off_ns:
            return None
        return Gap(self._off_ns, end_ns, self._off_reason, None, self._bus)

    def update(self, frames: FrameBatch, log_ns: NDArray[np.int64]) -> list[Change]:
        """Take in frames of this bus; what changed."""
        self.frames += len(frames)
        rows = np.flatnonzero(frames.flags & FrameFlag.ERROR)
        self.error_frames += len(rows)
        changes = []
        if self._reads_error_frames:
            changes += self._overruns(frames, rows, log_ns)
            for row in _news(frames, rows):
                changes += self._heard_before(frames, row, log_ns)
                changes += self._take_error(frames[row : row + 1], int(log_ns[row]))
            changes += self._heard_before(frames, len(frames), log_ns)
        if len(frames):
            self._last_ns = int(frames.t_ns[-1])
        return changes

    def _take_error(self, frame: FrameBatch, log_ns: int) -> list[Change]:
        classes, bits = int(frame.can_id[0]), int(frame.data[0, 1])
        before = self.state
        if classes & ERR_COUNTERS:
            self.tx_errors, self.rx_errors = int(frame.data[0, 6]), int(frame.data[0, 7])
        if classes & ERR_BUS_OFF:
            return self._switched_off(int(frame.t_ns[0]), log_ns)
        if self._off_ns is not None:
            return (
                [self._switched_on("active", int(frame.t_ns[0]), log_ns)]
                if classes & ERR_RESTARTED
                else []
            )
        if classes & ERR_CONTROLLER:
            self.state = next((name for mask, name in CONTROLLER_STATES if bits & mask), before)
        elif classes & ERR_RESTARTED:
            self.state = "active"
        if self.state == before:
            return []
        return [Change(log_ns, f"{before} -> {self.state}", state=self.state)]

    def _switched_off(self, t_ns: int, log_ns: int, reason: str = RECORDER_OFF) -> list[Change]:
        """Bus-off at `t_ns`; what the interface told later than that is known already."""
        if self._off_ns is not None:
            return []
        told_ns, told = self._told
        if told not in ("", "off") and log_ns < told_ns:
            gap = Gap(t_ns, max(told_ns, t_ns), RECORDER_OFF, None, self._bus)
            return [Change(log_ns, f"off -> {told}", gap, "off")]
        before, self.state = self.state, "off"
        self._off_ns, self._off_reason = t_ns, reason
        return [Change(log_ns, f"{before} -> off", state="off")]

    def _switched_on(self, state: str, t_ns: int, log_ns: int) -> Change:
        gap = self.deaf_until(t_ns)
        self.state, self._off_ns = state, None
        return Change(log_ns, f"off -> {state}", gap, state)

    def _heard_before(
        self, frames: FrameBatch, end: int, log_ns: NDArray[np.int64]
    ) -> list[Change]:
        """A controller that hears frames is on the bus, though nothing told of its restart."""
        if self._off_ns is None:
            return []
        not_heard = FrameFlag.ERROR | FrameFlag.TX
        heard = np.flatnonzero((frames.flags[:end] & not_heard) == 0)
        heard = heard[frames.t_ns[heard] > self._off_ns]
        if len(heard) == 0:
            return []
        first = int(heard[0])
        return [self._switched_on("active", int(frames.t_ns[first]), int(log_ns[first]))]

    def _overruns(
        self, frames: FrameBatch, rows: NDArray[np.intp], log_ns: NDArray[np.int64]
    ) -> list[Change]:
        """Losses in the controller: somewhere between the frame before and the error frame.

        Those that follow each other closely are one change.
        """
        overrun = (frames.can_id[rows] & ERR_CONTROLLER) != 0
        overrun &= (frames.data[rows, 1] & CONTROLLER_OVERRUN) != 0
        rows = rows[overrun]
        self.dropped_controller += len(rows)
        runs = np.split(rows, np.flatnonzero(np.diff(frames.t_ns[rows]) >= OVERRUNS_APART_NS) + 1)
        return [self._overrun(frames, run, log_ns) for run in runs if len(run)]

    def _overrun(
        self, frames: FrameBatch, run: NDArray[np.intp], log_ns: NDArray[np.int64]
    ) -> Change:
        first, last = int(run[0]), int(run[-1])
        end_ns = int(frames.t_ns[last]) + 1
        start_ns = int(frames.t_ns[first - 1]) if first else self._last_ns
        if start_ns is None or start_ns >= end_ns:
            start_ns = int(frames.t_ns[first])
        gap = Gap(min(start_ns, end_ns), end_ns, RECORDER_OVERFLOW, None, self._bus)
        return Change(int(log_ns[last]), OVERRUN_TEXT, gap)

    def message(self, text: str = "") -> syncline_pb2.BusStatus:
        """The status message; `text` says what changed."""
        return syncline_pb2.BusStatus(
            state=self.state,
            tx_errors=self.tx_errors,
            rx_errors=self.rx_errors,
            frames_received=self.frames,
            error_frames=self.error_frames,
            dropped_kernel=self.dropped_kernel,
            dropped_controller=self.dropped_controller,
            dropped_queue=self.dropped_queue,
            dropped_disk=self.dropped_disk,
            adapter_present=self.adapter_present,
            text=text,
        )


def _news(frames: FrameBatch, rows: NDArray[np.intp]) -> list[int]:
    """Error frames that tell of the controller, without those that repeat the one before."""
    telling = np.uint32(ERR_CONTROLLER | ERR_BUS_OFF | ERR_RESTARTED | ERR_COUNTERS)
    rows = rows[(frames.can_id[rows] & telling) != 0]
    if len(rows) == 0:
        return []
    said = frames.data[rows][:, [1, 6, 7]].astype(np.int64) @ np.array([1, 1 << 8, 1 << 16])
    said += (frames.can_id[rows] & telling).astype(np.int64) << 24
    found: list[int] = rows[np.diff(said, prepend=-1) != 0].tolist()
    return found
