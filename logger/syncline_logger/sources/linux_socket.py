"""Calls of Linux that Python has no name for: many messages at once, facts of an interface.

Numbers are those of the kernel's headers, since Python names them on Linux alone.
"""

import ctypes
import os
import socket
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_logger.sources.link_wire import CAN_TYPE, CanLink, link_of, link_request
from syncline_logger.sources.socketcan_wire import Received

SOL_SOCKET = 1
SO_RCVBUF, SO_RCVBUFFORCE = 8, 33
SO_MEMINFO = 55
_DROPS_WORD = 8
"""SK_MEMINFO_DROPS: position among the 32-bit words of SO_MEMINFO."""
_AF_NETLINK, _NETLINK_ROUTE, _SOCK_RAW = 16, 0, 3
_REPLY_BYTES = 1 << 16
_ANSWER_S = 1.0

_MSG_DONTWAIT = 0x40
_EAGAIN = 11
_CONTROL_BYTES = 96
"""Room for the stamps (64 bytes) and the drop counter (24 bytes) with their headers."""

_SIOCETHTOOL = 0x8946
_GET_TS_INFO = 0x41
_RX_HARDWARE_STAMPS = 1 << 2 | 1 << 6
"""SOF_TIMESTAMPING_RX_HARDWARE and SOF_TIMESTAMPING_RAW_HARDWARE."""

_HEADER = np.dtype(
    [
        ("name", np.uintp),
        ("name_length", np.uint32),
        ("places", np.uintp),
        ("place_count", np.uintp),
        ("control", np.uintp),
        ("control_length", np.uintp),
        ("flags", np.int32),
    ],
    align=True,
)
"""struct msghdr; musl's has the same layout."""
_MESSAGE = np.dtype([("header", _HEADER), ("length", np.uint32)], align=True)
"""struct mmsghdr."""
_PLACE = np.dtype([("base", np.uintp), ("length", np.uintp)])
"""struct iovec."""


@cache
def library_call(name: str) -> Callable[..., int] | None:
    """A function of the C library, None where it has none of that name."""
    try:
        function: Any = getattr(ctypes.CDLL(None, use_errno=True), name)
    except (AttributeError, OSError, TypeError):
        return None
    function.restype = ctypes.c_int
    call: Callable[..., int] = function
    return call


class MessageRing:
    """Memory for many messages of a socket, received by one call; used by one thread.

    Args:
        size: messages received at once.
        width: most bytes of a message.
    """

    def __init__(self, size: int, width: int) -> None:
        receive = library_call("recvmmsg")
        if receive is None:
            raise OSError("the C library has no recvmmsg")
        self._receive = receive
        self.size = size
        self._frames = np.zeros((size, width), np.uint8)
        self._control = np.zeros((size, _CONTROL_BYTES), np.uint8)
        self._places = np.zeros(size, _PLACE)
        self._places["base"] = _addresses(self._frames)
        self._places["length"] = width
        self._messages = np.zeros(size, _MESSAGE)
        header = self._messages["header"]
        header["places"] = _addresses(self._places)
        header["place_count"] = 1
        header["control"] = _addresses(self._control)
        header["control_length"] = _CONTROL_BYTES
        self._pointer = ctypes.c_void_p(self._messages.ctypes.data)
        self._used = 0

    def receive(self, file_number: int) -> Received:
        """What waits, up to `size` messages; valid until the next call.

        Raises OSError when the socket tells an error.
        """
        header = self._messages["header"]
        header["control_length"][: self._used] = _CONTROL_BYTES
        self._used = 0
        count = self._receive(file_number, self._pointer, self.size, _MSG_DONTWAIT, None)
        if count < 0:
            number = ctypes.get_errno()
            if number != _EAGAIN:
                raise OSError(number, os.strerror(number))
            count = 0
        self._used = count
        return Received(
            self._frames[:count],
            self._messages["length"][:count],
            header["flags"][:count],
            self._control[:count],
            header["control_length"][:count],
        )


def _addresses(rows: NDArray[Any]) -> NDArray[np.uintp]:
    """Where each row lies in memory."""
    steps = np.arange(len(rows), dtype=np.uintp) * np.uintp(rows.strides[0])
    return np.uintp(rows.ctypes.data) + steps


def raise_receive_buffer(sock: socket.socket, size: int) -> None:
    """Ask for a receive buffer of `size` bytes: beyond the system's limit, else up to it."""
    for option in (SO_RCVBUFFORCE, SO_RCVBUF):
        if receive_buffer_bytes(sock) < size:
            with suppress(OSError):
                sock.setsockopt(SOL_SOCKET, option, size // 2)


def receive_buffer_bytes(sock: socket.socket) -> int:
    """Size of the receive buffer, twice what was asked for: the kernel's own bookkeeping counts."""
    return sock.getsockopt(SOL_SOCKET, SO_RCVBUF)


def dropped_frames(sock: socket.socket) -> int | None:
    """Frames that found the buffer full since the socket was made, modulo 2**32.

    None where the kernel does not tell (before 4.12).
    """
    try:
        words = np.frombuffer(sock.getsockopt(SOL_SOCKET, SO_MEMINFO, 256), np.uint32)
    except OSError:
        return None
    return int(words[_DROPS_WORD]) if len(words) > _DROPS_WORD else None


def can_link(name: str) -> CanLink | None:
    """The interface of this name, as the kernel tells it; None when there is none."""
    try:
        index = socket.if_nametoindex(name)
    except OSError:
        return None
    try:
        with socket.socket(_AF_NETLINK, _SOCK_RAW, _NETLINK_ROUTE) as asking:
            asking.settimeout(_ANSWER_S)
            asking.sendto(link_request(index, 1), (0, 0))
            return link_of(asking.recv(_REPLY_BYTES))
    except OSError:
        return _link_of_files(name, index)


def _link_of_files(name: str, index: int) -> CanLink:
    """What sysfs tells where rtnetlink may not be asked; it knows nothing of the controller."""
    told = {"flags": 1, "type": CAN_TYPE, "mtu": 0}
    for key in told:
        with suppress(OSError, ValueError):
            text = Path("/sys/class/net", name, key).read_text(encoding="ascii")
            told[key] = int(text, 0)
    return CanLink(index, name, bool(told["flags"] & 1), told["type"] == CAN_TYPE, told["mtu"])


class _InterfaceRequest(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_char * 16),
        ("data", ctypes.c_void_p),
        ("rest", ctypes.c_char * 16),
    )


def stamps_by_hardware(sock: socket.socket, name: str) -> bool:
    """Whether the interface stamps received frames itself."""
    control = library_call("ioctl")
    if control is None:
        return False
    answer = (ctypes.c_uint32 * 11)(_GET_TS_INFO)
    request = _InterfaceRequest(name.encode()[:15], ctypes.addressof(answer))
    if control(sock.fileno(), ctypes.c_ulong(_SIOCETHTOOL), ctypes.byref(request)) != 0:
        return False
    return answer[1] & _RX_HARDWARE_STAMPS == _RX_HARDWARE_STAMPS
