"""How fast SocketCAN is received, in a virtual machine: our source, a bare loop, python-can.

    ../shared/tools/socketcan-vm --cpus 1 -- .venv/bin/python -m benchmarks.socketcan_vm [FRAMES]

Each receiver drains a queue that was filled while it stood still, so that only the receiver is
measured. The bare loop is the least that can be done with `recvmmsg`: copy frames, stamps and the
drop counter from where they lie, without looking for them.
"""

import os
import socket
import struct
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

from syncline_logger.batcher import FrameBuffer
from syncline_logger.bus_options import BusOptions
from syncline_logger.sources.linux_socket import MessageRing, raise_receive_buffer
from syncline_logger.sources.socketcan import SocketCanSource

INTERFACE = "vcan0"
AF_CAN, CAN_RAW, SOL_SOCKET = 29, 1, 1
SO_TIMESTAMPNS, SO_RXQ_OVFL = 35, 40
BUFFER_BYTES = 64 << 20
ROUNDS = 8

Drain = Callable[[], int]


@dataclass(frozen=True, slots=True)
class Timing:
    """The best of the rounds of one receiver."""

    name: str
    frames: int
    wall_s: float
    cpu_s: float

    @property
    def frames_per_s(self) -> float:
        """By CPU time: the machine may have other things to do."""
        return self.frames / self.cpu_s


def fill(count: int) -> None:
    """Put frames with running numbers into the queues of all sockets on the bus."""
    with socket.socket(AF_CAN, socket.SOCK_RAW, CAN_RAW) as sender:
        sender.bind((INTERFACE,))
        for number in range(count):
            sender.send(struct.pack("=IB3xQ", 0x180 + number % 128, 8, number))


def timed(name: str, drain: Drain, count: int) -> Timing:
    """Fill and drain once."""
    fill(count)
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    received = drain()
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    if received != count:
        raise SystemExit(f"{name}: {received} of {count} frames")
    return Timing(name, count, wall_s, cpu_s)


def best(rounds: list[Timing]) -> Timing:
    """The round that was disturbed least."""
    return min(rounds, key=lambda timing: timing.cpu_s)


def bare_loop(count: int) -> Timing:
    """recvmmsg into numpy, everything at fixed places."""
    with socket.socket(AF_CAN, socket.SOCK_RAW, CAN_RAW) as receiver:
        raise_receive_buffer(receiver, BUFFER_BYTES)
        receiver.setsockopt(SOL_SOCKET, SO_TIMESTAMPNS, 1)
        receiver.setsockopt(SOL_SOCKET, SO_RXQ_OVFL, 1)
        receiver.bind((INTERFACE,))
        ring = MessageRing(1024, 16)

        def drain() -> int:
            kept = []
            while len((received := ring.receive(receiver.fileno())).frames):
                times = received.control[:, 16:32].view("<i8")
                kept.append((received.frames.copy(), times[:, 0] * 1_000_000_000 + times[:, 1]))
            return sum(len(frames) for frames, _ in kept)

        return timed("recvmmsg, fixed places", drain, count)


def our_source(count: int) -> Timing:
    """SocketCanSource into the recorder's buffer, and out of it."""
    source = SocketCanSource(BusOptions("bench", "socketcan", INTERFACE))
    source.open()
    buffer = FrameBuffer(time.time_ns)

    def drain() -> int:
        received = 0
        while source.read(buffer, 0, 0):
            received += len(buffer.take())
        return received

    try:
        return timed("syncline's SocketCAN source", drain, count)
    finally:
        source.close()


def python_can_loop(count: int) -> Timing:
    """python-can's own receiving; asammdf is kept out, which it would import."""
    sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]
    import can

    with can.Bus(INTERFACE, interface="socketcan") as bus:
        raise_receive_buffer(bus.socket, BUFFER_BYTES)  # type: ignore[attr-defined]

        def drain() -> int:
            received = 0
            while bus.recv(0) is not None:
                received += 1
            return received

        return timed("python-can, bus.recv(0)", drain, count)


def main() -> None:
    """Print one line per receiver, by CPU time, and how they compare."""
    if "SOCKETCAN_VM" not in os.environ:
        raise SystemExit("run this in socketcan-vm: it floods the bus 'vcan0'")
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    # In turn, so that what else the machine does slows all of them alike.
    pairs = [(bare_loop(count), our_source(count)) for _ in range(ROUNDS)]
    bare = best([pair[0] for pair in pairs])
    ours = best([pair[1] for pair in pairs])
    for timing in (bare, ours, python_can_loop(count // 10)):
        print(
            f"{timing.name:30s} {timing.frames_per_s:10,.0f} frames/s by CPU,"
            f" {timing.frames / timing.wall_s:10,.0f} by the clock,"
            f" {bare.frames_per_s / timing.frames_per_s:6.2f} x the bare loop",
            flush=True,
        )


if __name__ == "__main__":
    main()
