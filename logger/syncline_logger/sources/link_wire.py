"""A network interface as rtnetlink tells it: whether it is up, and how its CAN controller is set.

Messages are those of linux/rtnetlink.h, attributes those of linux/if_link.h and
linux/can/netlink.h; all numbers are in the machine's byte order.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

GET_LINK, NEW_LINK = 18, 16
_REQUEST = 1
_HEADER = struct.Struct("=IHHII")
"""nlmsghdr: length, type, flags, sequence number, port."""
_LINK = struct.Struct("=BxHiII")
"""ifinfomsg: family, type, index, flags, change mask."""
_ATTRIBUTE = struct.Struct("=HH")
_NUMBER = struct.Struct("=I")
_ATTRIBUTE_MASK = 0x3FFF
"""The upper two bits of an attribute's type are flags."""

_UP = 1
CAN_TYPE = 280
"""ARPHRD_CAN."""
_NAME, _MTU, _LINK_INFO = 3, 4, 18
_KIND, _DATA = 1, 2
_BIT_TIMING, _STATE, _CONTROL_MODE, _RESTART_MS, _DATA_BIT_TIMING = 1, 4, 5, 6, 9
_CONTROL_MODE_EXTENDED, _SUPPORTED = 17, 1
_LISTEN_ONLY = 0x02

FD_MTU = 72
STATES = ("active", "warning", "passive", "off", "stopped", "stopped")
"""By enum can_state; the last is a sleeping controller."""


@dataclass(frozen=True, slots=True)
class CanLink:
    """One interface.

    Attributes:
        is_can: whether it carries CAN frames.
        kind: "can" for a controller, "vcan" for a virtual bus.
        mtu: bytes of the largest frame; 72 or more takes CAN FD.
        bitrate, data_bitrate: [bit/s], None where it has none.
        state: of the controller, as in BusStatus; empty where it has none.
        listen_only: whether the controller never drives the bus; None where there is none.
        can_listen_only: whether it has that mode; None where the kernel does not tell.
        restart_ms: after so long the controller leaves bus-off by itself, 0 for never.
    """

    index: int
    name: str
    up: bool
    is_can: bool
    mtu: int = 0
    kind: str = ""
    bitrate: int | None = None
    data_bitrate: int | None = None
    state: str = ""
    listen_only: bool | None = None
    can_listen_only: bool | None = None
    restart_ms: int | None = None

    @property
    def takes_fd(self) -> bool:
        """Whether CAN FD frames can come."""
        return self.mtu >= FD_MTU


def link_request(index: int, sequence: int) -> bytes:
    """The request for one interface."""
    body = _LINK.pack(0, 0, index, 0, 0)
    return _HEADER.pack(_HEADER.size + len(body), GET_LINK, _REQUEST, sequence, 0) + body


def link_of(reply: bytes) -> CanLink | None:
    """The interface in an answer; None when it is another message or cut."""
    if len(reply) < _HEADER.size + _LINK.size:
        return None
    length, kind, *_ = _HEADER.unpack_from(reply)
    if kind != NEW_LINK:
        return None
    _, device, index, flags, _ = _LINK.unpack_from(reply, _HEADER.size)
    found = dict(_attributes(reply[_HEADER.size + _LINK.size : length]))
    info = dict(_attributes(found.get(_LINK_INFO, b"")))
    can = dict(_attributes(info.get(_DATA, b""))) if device == CAN_TYPE else {}
    mode = can.get(_CONTROL_MODE, b"")
    supported = dict(_attributes(can.get(_CONTROL_MODE_EXTENDED, b""))).get(_SUPPORTED, b"")
    return CanLink(
        index=index,
        name=_text(found.get(_NAME, b"")),
        up=bool(flags & _UP),
        is_can=device == CAN_TYPE,
        mtu=_number(found.get(_MTU, b"")) or 0,
        kind=_text(info.get(_KIND, b"")),
        bitrate=_number(can.get(_BIT_TIMING, b"")) or None,
        data_bitrate=_number(can.get(_DATA_BIT_TIMING, b"")) or None,
        state=_state(can.get(_STATE, b"")),
        listen_only=_has(mode[_NUMBER.size :], _LISTEN_ONLY),
        can_listen_only=_has(supported, _LISTEN_ONLY),
        restart_ms=_number(can.get(_RESTART_MS, b"")),
    )


def _attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Type and content of each attribute; what is cut is left out."""
    begin = 0
    while begin + _ATTRIBUTE.size <= len(data):
        length, kind = _ATTRIBUTE.unpack_from(data, begin)
        if not _ATTRIBUTE.size <= length <= len(data) - begin:
            return
        yield kind & _ATTRIBUTE_MASK, data[begin + _ATTRIBUTE.size : begin + length]
        begin += (length + 3) & ~3


def _number(data: bytes) -> int | None:
    """The number that the content begins with."""
    if len(data) < _NUMBER.size:
        return None
    (number,) = _NUMBER.unpack_from(data)
    return int(number)


def _has(data: bytes, bit: int) -> bool | None:
    flags = _number(data)
    return None if flags is None else bool(flags & bit)


def _text(data: bytes) -> str:
    return data.split(b"\0")[0].decode(errors="replace")


def _state(data: bytes) -> str:
    number = _number(data)
    return STATES[number] if number is not None and number < len(STATES) else ""
