"""The SocketCAN source with a scripted kernel: what its answers and errors come to."""

import errno
import socket
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from syncline_logger.batcher import FrameBuffer, Loss
from syncline_logger.bus_options import BusOptions, Filter
from syncline_logger.clock import RecorderClock
from syncline_logger.source import SourceAsleep, StampedSource
from syncline_logger.sources import socketcan
from syncline_logger.sources.link_wire import CanLink
from syncline_logger.sources.socketcan import SocketCanSource
from syncline_logger.sources.socketcan_wire import Received
from syncline_schemas.errors import SourceError
from tests.logger.test_socketcan_wire import Message, beside, classic, received

S = 1_000_000_000
LINK = CanLink(7, "can0", True, True, 16, "can", 250_000, state="active", listen_only=True)

Step = OSError | list[Message]


class Kernel:
    """Answers of the kernel, one per question; the last one stands."""

    def __init__(self) -> None:
        self.link: CanLink | None = LINK
        self.steps: list[Step] = []
        self.dropped = 0
        self.by_hardware = False
        self.opened = 0
        self.filters: list[Filter] = []

    def receive(self) -> Received:
        step = self.steps.pop(0) if self.steps else []
        if isinstance(step, OSError):
            raise step
        return received(step, 72)


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Iterator[Kernel]:
    scripted = Kernel()
    ends: list[socket.socket] = []

    class Ring:
        def __init__(self, size: int, width: int) -> None:
            assert (size, width) == (1024, 72)

        def receive(self, file_number: int) -> Received:
            return scripted.receive()

    def can_socket(name: str, filters: list[Filter]) -> socket.socket:
        scripted.opened += 1
        scripted.filters = list(filters)
        ends.extend(socket.socketpair())
        return ends[-1]

    monkeypatch.setattr(socketcan, "MessageRing", Ring)
    monkeypatch.setattr(socketcan, "can_socket", can_socket)
    monkeypatch.setattr(socketcan, "can_link", lambda _: scripted.link)
    monkeypatch.setattr(socketcan, "dropped_frames", lambda _: scripted.dropped)
    monkeypatch.setattr(socketcan, "receive_buffer_bytes", lambda _: 32 << 20)
    monkeypatch.setattr(socketcan, "stamps_by_hardware", lambda *_: scripted.by_hardware)
    yield scripted
    for end in ends:
        end.close()


def opened(**options: int) -> SocketCanSource:
    source = SocketCanSource(BusOptions("press", "socketcan", "can0", **options))  # type: ignore[arg-type]
    source.open()
    return source


def message(can_id: int, kernel_ns: int = S, hardware_ns: int = 0, drops: int = 0) -> Message:
    control = b"".join(beside(8, kernel_ns, hardware_ns, drops, "so").parts)
    return Message(classic(can_id, b"\x05"), control=control)


def read(source: SocketCanSource) -> tuple[list[tuple[int, int]], list[Loss]]:
    """(identifier, stamp) of the frames, and the losses."""
    buffer = FrameBuffer(lambda: 99)
    count = source.read(buffer, 2, 0)
    taken = buffer.take()
    assert len(taken) == count
    assert set(taken.frames.bus.tolist()) <= {2}
    rows = zip(taken.frames.can_id.tolist(), taken.frames.t_ns.tolist(), strict=True)
    return list(rows), taken.losses


def test_frames_with_the_kernels_stamps(kernel: Kernel) -> None:
    source = opened()
    kernel.steps = [[message(0x181, 5 * S), message(0x182, 5 * S + 7)]]
    assert read(source) == ([(0x181, 5 * S), (0x182, 5 * S + 7)], [])
    assert read(source) == ([], [])
    assert (source.facts.bitrate, source.facts.clock, source.facts.listen_only) == (
        250_000,
        "kernel",
        True,
    )


def test_a_frame_without_a_stamp_gets_the_time_of_reading(kernel: Kernel) -> None:
    source = opened()
    begin_ns = time.time_ns()
    kernel.steps = [[message(0x181, 0)]]
    [(_, t_ns)], _ = read(source)
    assert begin_ns <= t_ns <= time.time_ns()


def test_what_the_kernel_dropped_between_frames_and_behind_them(kernel: Kernel) -> None:
    source = opened()
    kernel.steps = [[message(1, S), message(2, 2 * S, drops=5)]]
    kernel.dropped = 9
    begin_ns = time.time_ns()
    _, [loss] = read(source)
    assert (loss.bus, loss.where, loss.frames, loss.first_ns) == (2, "kernel", 9, S)
    assert begin_ns - 1 <= loss.last_ns <= time.time_ns()
    kernel.steps = [[message(3, 3 * S, drops=11), message(4, 4 * S, drops=11)]]
    kernel.dropped = 11
    assert read(source)[1] == [Loss(2, "kernel", 2, 2 * S, 3 * S - 1, 99)]
    assert read(source) == ([], [])


def test_the_adapters_own_stamps_are_mapped_and_go_before_the_kernels(kernel: Kernel) -> None:
    kernel.by_hardware = True
    source = SocketCanSource(BusOptions("press", "socketcan", "can0"))
    assert isinstance(source, StampedSource)
    clock = RecorderClock()
    source.use_clock(clock)
    source.open()
    now_ns = time.time_ns()
    # The adapter counts from its start; its frames are 1 ms apart, the kernel saw them at once.
    frames = [message(n, now_ns, 5000 + n * 1_000_000) for n in range(10)]
    kernel.steps = [[*frames, message(0x20, now_ns)]]
    rows, _ = read(source)
    stamps = np.array([t_ns for _, t_ns in rows])
    assert np.diff(stamps[:10]).tolist() == [1_000_000] * 9
    assert abs(int(stamps[9]) - now_ns) < S
    assert stamps[10] == now_ns
    assert source.facts.clock == "hardware"
    assert source.clock_knots()


def test_the_interface_goes_down_and_comes_up(kernel: Kernel) -> None:
    source = opened()
    down = OSError(errno.ENETDOWN, "Network is down")
    kernel.steps = [down, [message(0x181)]]
    kernel.link = replace(LINK, up=False)
    buffer = FrameBuffer(lambda: 99)
    with pytest.raises(SourceAsleep, match=r"bus 'press' \(socketcan can0\): .* went down"):
        source.read(buffer, 0, 0)
    # What had come before was read all the same.
    assert buffer.take().frames.can_id.tolist() == [0x181]
    with pytest.raises(SourceAsleep, match="ip link set can0 up type can bitrate 250000"):
        source.read(buffer, 0, 0)
    kernel.link = replace(LINK, bitrate=125_000)
    kernel.steps = [[message(0x182)]]
    assert [can_id for can_id, _ in read(source)[0]] == [0x182]
    assert kernel.opened == 1
    assert source.facts.notes == ("can0 was set from 250000 to 125000 bit/s",)


@pytest.mark.parametrize(
    "link", [None, replace(LINK, index=8)], ids=["gone", "replaced by another one"]
)
def test_the_adapter_is_unplugged(kernel: Kernel, link: CanLink | None) -> None:
    source = opened()
    kernel.steps = [OSError(errno.ENETDOWN, "Network is down"), OSError(errno.ENODEV, "No device")]
    kernel.link = link
    with pytest.raises(SourceError, match="lost: No device") as raised:
        read(source)
    assert not isinstance(raised.value, SourceAsleep)
    source.close()
    assert source.fileno() == -1
    kernel.link = None
    with pytest.raises(SourceAsleep, match="no interface 'can0'"):
        source.open()
    kernel.link = replace(LINK, index=9)
    source.open()
    assert kernel.opened == 2
    assert source.fileno() >= 0


def test_a_deaf_socket_is_noticed_without_an_error(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = opened()
    monkeypatch.setattr(socketcan, "LOOK_AFTER_NS", 0)
    assert read(source) == ([], [])
    kernel.link = replace(LINK, index=8)
    with pytest.raises(SourceError, match="the interface is gone"):
        read(source)


def test_a_bus_without_end_does_not_hold_up_the_others(kernel: Kernel) -> None:
    source = opened()
    full = [message(1)] * 1024
    kernel.steps = [full] * 20
    rows, _ = read(source)
    assert len(rows) == 8 * 1024


def test_filters_are_handed_over(kernel: Kernel) -> None:
    wanted = ({"can_id": 0x181, "can_mask": 0x7FF},)
    source = SocketCanSource(BusOptions("press", "socketcan", "can0", filters=wanted))
    source.open()
    assert kernel.filters == list(wanted)
    assert source.facts.filters == "181:7FF"


def test_it_has_no_way_to_send() -> None:
    assert not [name for name in dir(SocketCanSource) if "send" in name]
