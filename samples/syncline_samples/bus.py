"""A CAN bus in virtual time: arbitration by identifier and exact wire times."""

from collections.abc import Callable
from heapq import heapify, heappop, heappush
from typing import NamedTuple, Protocol

from syncline_samples.simulation import Simulation
from syncline_samples.wire import ERROR_BITS, INTERMISSION_BITS, wire_bits


class Frame(NamedTuple):
    """A classic frame with an 11-bit identifier; a remote frame has `remote_dlc` and no data."""

    can_id: int
    data: bytes = b""
    remote_dlc: int | None = None


class Tap(Protocol):
    """What records the bus."""

    def frame(self, t_ns: int, frame: Frame) -> None:
        """Take the end of a frame."""
        ...

    def error(self, t_ns: int, data: bytes) -> None:
        """Take an error frame, with the eight data bytes of a SocketCAN bus error."""
        ...


Listener = Callable[[Frame, int], None]
"""Called with a frame and the time of its end."""
OnSent = Callable[[int], None]
"""Called with the end of a frame that one has sent."""
_Entry = tuple[int, int, Frame, object, OnSent | None]

_STUFF_ERROR = bytes([0, 0, 0x04, 0x0A, 0, 0, 0, 0])
"""SocketCAN error data: protocol violation by bit stuffing, in the data section."""
_BITS_BEFORE_ERROR = 25
"""A broken transmitter is noticed in the first data byte."""


class Bus:
    """One bus; frames are delivered to the listeners of their identifier at the end of the frame.

    The frame with the lowest identifier wins when the bus becomes free; a data frame wins over a
    remote frame of the same identifier. Frames of one identifier keep their order, also when they
    come from two nodes, which on a real bus could end in an error frame.
    """

    def __init__(self, simulation: Simulation, bitrate: int, tap: Tap) -> None:
        self.simulation = simulation
        self.bitrate = bitrate
        self.bit_ns = 1_000_000_000 // bitrate
        self.busy_bits = 0
        self._tap = tap
        self._listeners: dict[int, list[Listener]] = {}
        self._pending: list[_Entry] = []
        self._order = 0
        self._busy = False
        self._free_ns = 0
        self._failing: dict[object, tuple[int, Callable[[], None]]] = {}

    def listen(self, can_id: int, listener: Listener) -> None:
        """Deliver each frame of an identifier, also remote ones and one's own."""
        self._listeners.setdefault(can_id, []).append(listener)

    def unlisten(self, can_id: int, listener: Listener) -> None:
        """Stop what `listen` began."""
        kept = [each for each in self._listeners.get(can_id, ()) if each != listener]
        self._listeners[can_id] = kept

    def send(self, frame: Frame, sender: object, on_sent: OnSent | None = None) -> None:
        """Queue a frame for arbitration."""
        self._order += 1
        key = frame.can_id << 1 | (frame.remote_dlc is not None)
        heappush(self._pending, (key, self._order, frame, sender, on_sent))
        if not self._busy:
            self._busy = True
            self.simulation.late_at(max(self.simulation.now_ns, self._free_ns), self._start)

    def withdraw(self, sender: object) -> None:
        """Drop the queued frames of a sender that lost power or went bus-off."""
        self._pending = [entry for entry in self._pending if entry[3] is not sender]
        heapify(self._pending)

    def break_transmitter(self, sender: object, errors: int, done: Callable[[], None]) -> None:
        """Destroy the next transmissions of a sender, then call `done` (bus-off)."""
        self._failing[sender] = (errors, done)

    def _start(self) -> None:
        if not self._pending:
            self._busy = False
            return
        entry = heappop(self._pending)
        if self._failing and entry[3] in self._failing:
            self._destroy(entry)
            return
        frame = entry[2]
        bits = wire_bits(*frame)
        self.busy_bits += bits
        end_ns = self.simulation.now_ns + (bits - INTERMISSION_BITS) * self.bit_ns
        self.simulation.at(end_ns, self._end, frame, entry[4])

    def _end(self, frame: Frame, on_sent: OnSent | None) -> None:
        t_ns = self.simulation.now_ns
        self._tap.frame(t_ns, frame)
        if on_sent is not None:
            on_sent(t_ns)
        for listener in self._listeners.get(frame.can_id, ()):
            listener(frame, t_ns)
        self._release()

    def _release(self) -> None:
        self._free_ns = self.simulation.now_ns + INTERMISSION_BITS * self.bit_ns
        if self._pending:
            self.simulation.late_at(self._free_ns, self._start)
        else:
            self._busy = False

    def _destroy(self, entry: _Entry) -> None:
        heappush(self._pending, entry)
        bits = _BITS_BEFORE_ERROR + ERROR_BITS
        self.busy_bits += bits + INTERMISSION_BITS
        self.simulation.at(self.simulation.now_ns + bits * self.bit_ns, self._end_error, entry[3])

    def _end_error(self, sender: object) -> None:
        self._tap.error(self.simulation.now_ns, _STUFF_ERROR)
        left, done = self._failing[sender]
        if left > 1:
            self._failing[sender] = (left - 1, done)
        else:
            del self._failing[sender]
            done()
        self._release()
