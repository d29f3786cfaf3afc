"""A simulated machine on a python-can bus that others can talk to, in real time."""

import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Self

from syncline_samples.bus import Frame
from syncline_samples.machine import Machine
from syncline_samples.play import to_message
from syncline_schemas.batch import FrameBatch

if TYPE_CHECKING:
    import can

_STEP_S = 0.002


class LiveMachine:
    """Runs a machine against the wall clock in a thread; frames pass in both directions.

    Use as a context manager. The machine goes on from where its simulation stands.
    """

    def __init__(self, machine: Machine, can_bus: "can.BusABC") -> None:
        self._machine = machine
        self._can_bus = can_bus
        self._stop = threading.Event()
        self._foreign: deque[Frame] = deque()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()

    def _serve(self) -> None:
        simulation = self._machine.simulation
        begin_ns = time.monotonic_ns() - simulation.now_ns
        while not self._stop.is_set():
            self._take(self._can_bus.recv(_STEP_S))
            simulation.run_until(max(simulation.now_ns, time.monotonic_ns() - begin_ns))
            self._deliver()

    def _take(self, message: "can.Message | None") -> None:
        if message is None or message.is_extended_id or message.is_error_frame:
            return
        remote_dlc = message.dlc if message.is_remote_frame else None
        frame = Frame(message.arbitration_id, bytes(message.data), remote_dlc)
        self._foreign.append(frame)
        self._machine.world.bus.send(frame, self)

    def _deliver(self) -> None:
        for item in self._machine.recorder.take():
            if isinstance(item, FrameBatch):
                for row in range(len(item)):
                    self._deliver_row(item, row)

    def _deliver_row(self, batch: FrameBatch, row: int) -> None:
        remote_dlc = int(batch.dlc[row]) if batch.is_remote(row) else None
        frame = Frame(int(batch.can_id[row]), batch.payload(row), remote_dlc)
        if frame in self._foreign:
            self._foreign.remove(frame)
        else:
            self._can_bus.send(to_message(batch, row))
