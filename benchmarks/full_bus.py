"""Four full buses for the recorder's benchmarks: a second of traffic that repeats for ever."""

import socket
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from syncline_logger.batcher import FrameBuffer
from syncline_logger.source import SourceFacts
from syncline_schemas.batch import FrameBatch
from syncline_schemas.wire_length import wire_ns

BITRATE = 1_000_000
BUSES = 4
SECOND_NS = 1_000_000_000
ENCODERS = (1, 2)
INCLINOMETERS = (3, 4, 5, 6, 7)
DESCRIPTION = "".join(
    f'[node.{node}]\ndevice = "{device}"\n'
    for nodes, device in ((ENCODERS, "lir-da158a"), (INCLINOMETERS, "jn2100"))
    for node in nodes
)


def full_second(bus: int) -> FrameBatch:
    """A second of one bus at full load, `t_ns` from 0.

    SYNC every millisecond, two encoders (4 bytes) and five inclinometers (8 bytes) that answer
    each, second PDOs every 2 and 4 ms, heartbeats every 100 ms, 40 SDO reads. Frames follow one
    another back to back, as long as they are on the wire.
    """
    rng = np.random.default_rng(bus)
    slots = []
    for ms in range(1000):
        slots += [(0x080, b"")]
        slots += [(0x180 + n, (ms * 37 * n % 2**17).to_bytes(4, "little")) for n in ENCODERS]
        slots += [(0x280 + n, rng.bytes(8)) for n in INCLINOMETERS]
        if ms % 2:
            slots += [(0x280 + n, (ms * 11 % 2**17).to_bytes(4, "little")) for n in ENCODERS]
        if ms % 4 == 3:
            slots += [(0x180 + n, rng.bytes(4)) for n in INCLINOMETERS]
        if ms % 100 == 50:
            slots += [(0x700 + n, b"\x05") for n in (*ENCODERS, *INCLINOMETERS)]
        if ms % 25 == 10:
            node = 1 + ms // 25 % 7
            slots += [
                (0x600 + node, bytes.fromhex("4004600000000000")),
                (0x580 + node, bytes.fromhex("4304600001020300")),
            ]
    batch = FrameBatch.from_rows([(0, bus, can_id, 0, len(d), d) for can_id, d in slots])
    batch.t_ns[:] = np.cumsum(wire_ns(batch, BITRATE)).astype(np.int64)
    return batch


def load_percent(second: FrameBatch) -> float:
    """Share of the second in which the bus is busy."""
    return float(wire_ns(second, BITRATE).sum()) / SECOND_NS * 100


class FullBus:
    """Gives the frames of a full bus as they would come, in batches as SocketCAN does.

    It counts what it gave in `given`. `speed` is how much faster than real time the bus runs.
    """

    def __init__(
        self,
        number: int,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        speed: float = 1.0,
        end_ns: int | None = None,
    ) -> None:
        self.facts = SourceFacts(
            f"can{number}", "virtual", str(number), bitrate=BITRATE, clock="kernel"
        )
        self.given = 0
        self._second = full_second(number)
        self._clock_ns = clock_ns
        self._speed = speed
        self._end_ns = end_ns
        self._start_ns = self._begin_utc_ns = self._done_ns = 0
        self._ready = socket_that_is_always_ready()

    def fileno(self) -> int:
        """A number that is always readable: frames never stop on a full bus."""
        return self._ready[0].fileno()

    def open(self) -> None:
        """Start the bus."""
        self._start_ns = self._clock_ns()
        self._begin_utc_ns = time.time_ns()

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        """Give what has come since the last read."""
        now_ns = int((self._clock_ns() - self._start_ns) * self._speed)
        if self._end_ns is not None:
            now_ns = min(now_ns, self._end_ns)
        count = 0
        while self._done_ns < now_ns:
            second, from_ns = divmod(self._done_ns, SECOND_NS)
            to_ns = min(now_ns - second * SECOND_NS, SECOND_NS)
            begin, end = np.searchsorted(self._second.t_ns, [from_ns, to_ns])
            batch = shifted(
                self._second[int(begin) : int(end)], self._begin_utc_ns + second * SECOND_NS, bus
            )
            buffer.extend(batch)
            count += len(batch)
            self._done_ns = second * SECOND_NS + to_ns
        self.given += count
        return count

    def close(self) -> None:
        """Nothing is held."""


def shifted(batch: FrameBatch, by_ns: int, bus: int) -> FrameBatch:
    """The same frames later, on another bus."""
    t_ns: NDArray[np.int64] = batch.t_ns + by_ns
    number = np.full(len(batch), bus, np.uint8)
    return FrameBatch(t_ns, number, batch.can_id, batch.flags, batch.dlc, batch.data)


def socket_that_is_always_ready() -> tuple[socket.socket, socket.socket]:
    """A pair whose first end has a byte to read; select on Windows takes sockets alone."""
    pair = socket.socketpair()
    pair[1].send(b"x")
    return pair
