"""Frames from Linux SocketCAN, many at once, with the kernel's stamps and drop counter."""

import errno
import select
import socket
import struct
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from syncline_logger.adapter_clock import AdapterClock, Knot
from syncline_logger.batcher import FrameBuffer
from syncline_logger.bus_options import BusOptions, Filter, filter_words
from syncline_logger.clock import RecorderClock
from syncline_logger.source import SourceAsleep, SourceFacts
from syncline_logger.sources.kernel_drops import Dropped, KernelDrops
from syncline_logger.sources.link_wire import CanLink
from syncline_logger.sources.linux_socket import (
    SOL_SOCKET,
    MessageRing,
    can_link,
    dropped_frames,
    library_call,
    raise_receive_buffer,
    receive_buffer_bytes,
    stamps_by_hardware,
)
from syncline_logger.sources.socketcan_notes import (
    interface_notes,
    what_is_down,
    what_is_missing,
)
from syncline_logger.sources.socketcan_wire import (
    EXTENDED_BIT,
    FD_BYTES,
    TIMESTAMPING,
    Control,
    Received,
    control_of,
    frames_of,
)
from syncline_schemas.errors import SourceError

BATCH = 1024
"""Frames received by one call."""
BATCHES_PER_READ = 8
"""A read returns after so many, so that a saturated bus cannot hold up the others."""
RECEIVE_BUFFER_BYTES = 32 << 20
"""About 44,000 frames: 5 s of a full bus of 1 Mbit/s."""
LOOK_AFTER_NS = 1_000_000_000
"""How often the interface is looked for when its socket is quiet."""

AF_CAN, CAN_RAW, SOL_CAN_RAW = 29, 1, 101
CAN_RAW_FILTER, CAN_RAW_ERR_FILTER, CAN_RAW_FD_FRAMES = 1, 2, 5
SO_RXQ_OVFL = 40
STAMPS = 1 << 2 | 1 << 3 | 1 << 4 | 1 << 6
"""SO_TIMESTAMPING: stamps of received frames, by hardware and by software, and both of them reported."""
_ALL_ERRORS = 0x1FFF_FFFF


def why_unavailable() -> str:
    """Why this machine cannot use this source; empty where it can."""
    if not hasattr(socket, "AF_CAN"):
        return "this Python knows no SocketCAN"
    if library_call("recvmmsg") is None:
        return "the C library has no recvmmsg"
    return ""


class SocketCanSource:
    """One interface of Linux SocketCAN; it is only ever read."""

    def __init__(self, options: BusOptions) -> None:
        self._options = options
        self._channel = str(options.channel or "")
        self._socket: socket.socket | None = None
        self._index = 0
        self._asleep = False
        self._opened_bitrate: int | None = None
        self._looked_ns = 0
        self._clock: RecorderClock | None = None
        self._adapter_clock: AdapterClock | None = None
        self._drops = KernelDrops(0)
        self.facts = SourceFacts(
            name=options.name,
            interface="socketcan",
            channel=self._channel,
            bitrate=options.bitrate,
            data_bitrate=options.data_bitrate,
            clock="kernel",
            filters=filter_words(options.filters),
            loss_counters=("kernel", "controller"),
        )

    def use_clock(self, clock: RecorderClock) -> None:
        """Map the adapter's own stamps onto this clock; without one the kernel's are taken."""
        self._clock = clock

    def clock_knots(self) -> list[Knot]:
        """How stamps were mapped since the last call."""
        mapped_by = self._adapter_clock
        return mapped_by.take_knots() if mapped_by else []

    def open(self) -> None:
        """Listen to the interface.

        Raises SourceAsleep where it is missing or down, SourceError where it cannot be listened to.
        """
        if self._socket is not None:
            return
        link = self._link()
        if not link.up:
            raise SourceAsleep(self._said(what_is_down(link, self._options.bitrate)))
        try:
            self._open_socket(link)
        except OSError as error:
            self.close()
            raise SourceError(self._said(f"cannot open: {error.strerror or error}")) from error

    def _link(self) -> CanLink:
        """The interface. Raises SourceAsleep where there is none, SourceError if it is no bus."""
        link = can_link(self._channel)
        if link is None:
            raise SourceAsleep(self._said(what_is_missing(self._channel, self._options.bitrate)))
        if not link.is_can:
            raise SourceError(self._said("is no CAN interface; 'ip link' lists what there is"))
        return link

    def _open_socket(self, link: CanLink) -> None:
        self._socket = opened = can_socket(link.name, self._options.filters)
        self._ring = MessageRing(BATCH, FD_BYTES)
        self._drops = KernelDrops(time.time_ns())
        self._index, self._asleep = link.index, False
        if self._clock and stamps_by_hardware(opened, link.name):
            self._adapter_clock = AdapterClock(self._clock)
        self._know(link, receive_buffer_bytes(opened))

    def _know(self, link: CanLink, buffer_bytes: int) -> None:
        """Facts of the opened interface; what it is set to goes before what was told."""
        before, self._opened_bitrate = self._opened_bitrate, link.bitrate
        self.facts = replace(
            self.facts,
            bitrate=link.bitrate or self._options.bitrate,
            data_bitrate=link.data_bitrate or self._options.data_bitrate,
            fd=link.takes_fd,
            clock="hardware" if self._adapter_clock else "kernel",
            listen_only=bool(link.listen_only),
            state=link.state,
            receive_buffer_bytes=buffer_bytes,
            restart_ms=link.restart_ms,
            notes=interface_notes(link, self._options, buffer_bytes, RECEIVE_BUFFER_BYTES, before),
        )

    def fileno(self) -> int:
        """File number of the socket, -1 while there is none."""
        return -1 if self._socket is None else self._socket.fileno()

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        """Put what waits into the buffer, and what the kernel dropped.

        Raises SourceAsleep while the interface is down, SourceError when it is gone.
        """
        opened = self._socket
        if opened is None:
            raise SourceError(self._said("is not open"))
        if timeout_s:
            select.select([opened], [], [], timeout_s)
        count, failure = 0, None
        for _ in range(BATCHES_PER_READ):
            try:
                received = self._ring.receive(opened.fileno())
            except OSError as error:
                # What came before the failure still waits behind it.
                failure = error
                continue
            self._take(received, buffer, bus)
            count += len(received.frames)
            if len(received.frames) < BATCH:
                self._settle(opened, buffer, bus)
                break
        if failure:
            self._fail(failure)
        if self._asleep or count == 0:
            self._look_after(opened)
        return count

    def _take(self, received: Received, buffer: FrameBuffer, bus: int) -> None:
        if len(received.frames) == 0:
            return
        control = control_of(received)
        t_ns = self._stamps(control)
        for dropped in self._drops.take(control.drops, t_ns):
            _lose(buffer, bus, dropped)
        buffer.extend(frames_of(received, t_ns, bus))

    def _stamps(self, control: Control) -> NDArray[np.int64]:
        """The stamp closest to the wire of each frame, in UTC."""
        now_ns = time.time_ns()
        t_ns = np.where(control.kernel_ns == 0, now_ns, control.kernel_ns)
        rows = np.flatnonzero(control.hardware_ns)
        if self._adapter_clock and self._clock and len(rows):
            waited_ns = max(now_ns - int(t_ns[rows[-1]]), 0)
            arrival_ns = self._clock.elapsed_ns() - waited_ns
            t_ns[rows] = self._adapter_clock.t_ns(control.hardware_ns[rows], arrival_ns)
        return t_ns

    def _settle(self, opened: socket.socket, buffer: FrameBuffer, bus: int) -> None:
        """Count what was dropped behind the last frame, which no frame has told of yet."""
        counter = dropped_frames(opened)
        dropped = None if counter is None else self._drops.settle(counter, time.time_ns())
        if dropped:
            _lose(buffer, bus, dropped)

    def _fail(self, error: OSError) -> None:
        """Raise what an error of the socket means."""
        if error.errno != errno.ENETDOWN or self._current_link() is None:
            raise SourceError(self._said(f"lost: {error.strerror or error}"))
        self._asleep = True
        raise SourceAsleep(self._said("the interface went down"))

    def _look_after(self, opened: socket.socket) -> None:
        """Raise where the interface is not the one any more that the socket listens to.

        A socket whose interface was unplugged tells so once; from then on it is only silent.
        """
        now_ns = time.monotonic_ns()
        if not self._asleep and now_ns - self._looked_ns < LOOK_AFTER_NS:
            return
        self._looked_ns = now_ns
        link = self._current_link()
        if link is None:
            raise SourceError(self._said("lost: the interface is gone"))
        if not link.up:
            self._asleep = True
            raise SourceAsleep(self._said(what_is_down(link, self._options.bitrate)))
        if self._asleep:
            self._asleep = False
            self._know(link, receive_buffer_bytes(opened))

    def _current_link(self) -> CanLink | None:
        """The interface that the socket listens to; None when it is gone or another one."""
        link = can_link(self._channel)
        return link if link and link.index == self._index else None

    def close(self) -> None:
        """Stop listening."""
        opened, self._socket = self._socket, None
        self._adapter_clock = None
        if opened is not None:
            opened.close()

    def _said(self, text: str) -> str:
        return f"bus '{self.facts.name}' (socketcan {self._channel}): {text}"


def can_socket(name: str, filters: Sequence[Filter]) -> socket.socket:
    """A socket that hears all of an interface that the filters let through, and every error frame.

    Raises OSError.
    """
    opened = socket.socket(AF_CAN, socket.SOCK_RAW, CAN_RAW)
    try:
        opened.setblocking(False)
        raise_receive_buffer(opened, RECEIVE_BUFFER_BYTES)
        opened.setsockopt(SOL_SOCKET, SO_RXQ_OVFL, 1)
        _ask_for_stamps(opened)
        opened.setsockopt(SOL_CAN_RAW, CAN_RAW_ERR_FILTER, struct.pack("=I", _ALL_ERRORS))
        # The interface may be set up anew for CAN FD while it is listened to.
        opened.setsockopt(SOL_CAN_RAW, CAN_RAW_FD_FRAMES, 1)
        if filters:
            opened.setsockopt(SOL_CAN_RAW, CAN_RAW_FILTER, _filters(filters))
        opened.bind((name,))
    except BaseException:
        opened.close()
        raise
    return opened


def _lose(buffer: FrameBuffer, bus: int, dropped: Dropped) -> None:
    last_ns = max(dropped.last_ns - 1, dropped.first_ns)
    buffer.lose(bus, dropped.frames, "kernel", dropped.first_ns, last_ns)


def _ask_for_stamps(opened: socket.socket) -> None:
    """Ask for 64-bit times first: kernels before 5.1 know only the machine's own word."""
    for option in sorted(TIMESTAMPING, reverse=True):
        try:
            opened.setsockopt(SOL_SOCKET, option, STAMPS)
        except OSError:
            continue
        return


def _filters(filters: Sequence[Filter]) -> bytes:
    """struct can_filter of each; without "extended" the length of the identifier is no matter."""
    packed = b""
    for each in filters:
        can_id, mask = each["can_id"], each["can_mask"]
        if "extended" in each:
            can_id |= EXTENDED_BIT if each["extended"] else 0
            mask |= EXTENDED_BIT
        packed += struct.pack("=II", can_id & 0xFFFF_FFFF, mask & 0xFFFF_FFFF)
    return packed
