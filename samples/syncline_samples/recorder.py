"""The simulated recorder: stamps what passes on the bus and hands it on in batches."""

from array import array
from random import Random

import numpy as np

from syncline_samples.bus import Frame
from syncline_samples.truth import Truth
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap

_BUS_ERROR = 0x88
"""SocketCAN error class: protocol violation (08h) and bus error (80h)."""
_CONTROLLER, _RX_OVERFLOW = 0x04, 0x01
_BUS_OFF = 0x40
_RESTARTED = 0x100
"""SocketCAN error classes of the recorder's own controller, and a bit of the first one."""


class Recorder:
    """Takes the frames of one bus; `take` returns what came since the last call.

    Args:
        epoch_ns: UTC of virtual time 0.
        resolution_ns: step of the stamps.
        jitter_ns: a stamp is late by up to this much; stamps keep their order.
        remote_as_data: remote frames are stored as empty data frames, as some loggers do.
    """

    def __init__(
        self,
        truth: Truth,
        rng: Random,
        epoch_ns: int,
        resolution_ns: int = 1,
        jitter_ns: int = 0,
        remote_as_data: bool = False,
    ) -> None:
        self._truth = truth
        self._rng = rng
        self._epoch_ns = self._offset_ns = epoch_ns
        self._resolution_ns = resolution_ns
        self._jitter_ns = jitter_ns
        self._remote_as_data = remote_as_data
        self._last_ns = 0
        self._blind_since_ns: int | None = None
        self._lost = 0
        self._done: list[FrameBatch | Gap] = []
        self._clear()

    def _clear(self) -> None:
        self._t_ns = array("q")
        self._can_id = array("I")
        self._flags = array("H")
        self._dlc = array("B")
        self._data = bytearray()

    def frame(self, t_ns: int, frame: Frame) -> None:
        """Take a data or remote frame at its end."""
        can_id, data, remote_dlc = frame
        if remote_dlc is None:
            self._row(t_ns, can_id, 0, len(data), data)
        elif self._remote_as_data:
            self._row(t_ns, can_id, 0, 0, b"")
        else:
            self._truth.remote_frames += self._blind_since_ns is None
            self._row(t_ns, can_id, FrameFlag.REMOTE.value, remote_dlc, b"")

    def error(self, t_ns: int, data: bytes) -> None:
        """Take an error frame of the bus."""
        self._error(t_ns, _BUS_ERROR, data)

    def _error(self, t_ns: int, kind: int, data: bytes) -> None:
        self._truth.error_frames += self._blind_since_ns is None
        self._row(t_ns, kind, FrameFlag.ERROR.value, 8, data)

    def controller(self, t_ns: int, classes: int, data: bytes) -> None:
        """The recorder's own controller says something: SocketCAN error classes and data."""
        self._error(t_ns, classes, data)

    def controller_off(self, t_ns: int) -> None:
        """The recorder's own controller goes bus-off: an error frame, then it hears nothing."""
        self._error(t_ns, _BUS_OFF, bytes(8))
        self.go_blind(t_ns)

    def controller_restarted(self, t_ns: int) -> None:
        """The controller is back; nobody tells of a gap but its two error frames."""
        self.hear_again(t_ns)
        self._error(t_ns, _RESTARTED, bytes(8))

    def overflowed(self, t_ns: int) -> None:
        """Frames were lost unnoticed until now; one error frame tells of it."""
        self.hear_again(t_ns)
        self._error(t_ns, _CONTROLLER, bytes([0, _RX_OVERFLOW, 0, 0, 0, 0, 0, 0]))

    def not_yet(self) -> None:
        """Hear nothing until `begin`: the recording has not begun."""
        self.go_blind(0)

    def begin(self, t_ns: int) -> None:
        """The recording begins; what passed before is not lost, it was never wanted."""
        self._lost = 0
        self.hear_again(t_ns)

    def hear_again(self, t_ns: int) -> None:
        """Take frames again without a word about the time between."""
        if self._blind_since_ns is None:
            return
        self._truth.lost_frames += self._lost
        self._truth.recording = True
        start_ns, end_ns = self._blind_since_ns + self._epoch_ns, t_ns + self._epoch_ns
        self._truth.deaf.append((start_ns, end_ns))
        self._blind_since_ns, self._lost = None, 0

    def _row(self, t_ns: int, can_id: int, flags: int, dlc: int, data: bytes) -> None:
        if self._blind_since_ns is not None:
            self._lost += 1
            return
        self._truth.frames += 1
        self._t_ns.append(self._stamp(t_ns))
        self._can_id.append(can_id)
        self._flags.append(flags)
        self._dlc.append(dlc)
        self._data += data.ljust(8, b"\0")

    def _stamp(self, t_ns: int) -> int:
        if self._jitter_ns:
            t_ns = max(self._last_ns, t_ns + int(self._jitter_ns * self._rng.random()))
            self._last_ns = t_ns
        return (t_ns + self._offset_ns) // self._resolution_ns * self._resolution_ns

    def step_clock(self, step_ns: int) -> None:
        """Set the recorder's clock forward or back."""
        self._offset_ns += step_ns

    def go_blind(self, t_ns: int) -> None:
        """Lose every frame from now on."""
        self._blind_since_ns = t_ns
        self._truth.recording = False

    def see_again(self, t_ns: int) -> None:
        """Take frames again; the time between becomes a gap in the capture."""
        if self._blind_since_ns is None:
            return
        self._flush()
        start_ns = self._blind_since_ns + self._offset_ns
        self._done.append(Gap(start_ns, t_ns + self._offset_ns, "adapter lost", self._lost, 0))
        self.hear_again(t_ns)

    def _flush(self) -> None:
        n = len(self._t_ns)
        if not n:
            return
        self._done.append(
            FrameBatch(
                np.array(self._t_ns, np.int64),
                np.zeros(n, np.uint8),
                np.array(self._can_id, np.uint32),
                np.array(self._flags, np.uint16),
                np.array(self._dlc, np.uint8),
                np.frombuffer(bytes(self._data), np.uint8).reshape(n, 8).copy(),
            )
        )
        self._clear()

    def take(self) -> list[FrameBatch | Gap]:
        """Batches and gaps since the last call, in order."""
        self._flush()
        done, self._done = self._done, []
        return done
