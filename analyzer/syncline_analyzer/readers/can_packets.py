"""CAN frames in the packets of network captures.

Source: the link types LINKTYPE_CAN_SOCKETCAN, LINKTYPE_LINUX_SLL and LINKTYPE_LINUX_SLL2 as the
tcpdump group describes them, and Linux' `can.h`.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameFlag
from syncline_schemas.byte_columns import ByteColumns, ByteOrder, Column, Places
from syncline_schemas.records import dataclass

CAN_SOCKETCAN: Final = 227
LINUX_SLL: Final = 113
LINUX_SLL2: Final = 276
LINK_TYPES: Final = (CAN_SOCKETCAN, LINUX_SLL, LINUX_SLL2)
_ARPHRD_CAN: Final = 280
_PROTOCOL_CAN, _PROTOCOL_CANFD = 0x000C, 0x000D
_OUTGOING: Final = 4
_HEADER: Final = 8
_FD_MTU: Final = 72
_XL: Final = 0x80
"""Bit of the length byte that only CAN XL frames have."""
_FDF, _BRS, _ESI = 0x04, 0x01, 0x02


@dataclass(slots=True)
class CanPackets:
    """Columns of CAN frames, one row per packet.

    Attributes:
        can: whether the packet is of a CAN bus at all.
        whole: whether a classic or FD frame could be taken from it.
        interface: number of the network interface, where the link type tells it, else -1.
    """

    can: NDArray[np.bool_]
    whole: NDArray[np.bool_]
    interface: NDArray[np.int64]
    can_id: NDArray[np.uint32]
    flags: NDArray[np.uint16]
    dlc: NDArray[np.uint8]
    data: NDArray[np.uint8]


def can_packets(
    view: ByteColumns, at: Places, size: NDArray[np.int64], link_type: int, order: ByteOrder
) -> CanPackets:
    """The frames in packets of one link type.

    Args:
        view: the bytes, of any order.
        at: where each packet begins.
        size: how many bytes of it are there.
        link_type: one of `LINK_TYPES`; no other holds CAN frames.
        order: of the machine that captured; cooked packets have their identifiers in it.
    """
    big = view.ordered(">")
    can = np.ones(len(at), np.bool_)
    fd = tx = np.zeros(len(at), np.bool_)
    interface = np.full(len(at), -1, np.int64)
    cooked = 0
    if link_type == LINUX_SLL:
        cooked = 16
        protocol = big.u16(at, 14)
        can = big.u16(at, 2) == _ARPHRD_CAN
        tx = big.u16(at, 0) == _OUTGOING
    elif link_type == LINUX_SLL2:
        cooked = 20
        protocol = big.u16(at, 0)
        can = big.u16(at, 8) == _ARPHRD_CAN
        tx = big.u8(at, 10) == _OUTGOING
        interface = big.u32(at, 4).astype(np.int64)
    elif link_type != CAN_SOCKETCAN:
        can = np.zeros(len(at), np.bool_)
    if cooked:
        can &= (protocol == _PROTOCOL_CAN) | (protocol == _PROTOCOL_CANFD)
        fd = protocol == _PROTOCOL_CANFD
    ids = view.ordered(order if cooked else ">").u32(at, cooked)
    return _frames(view, at + cooked, size - cooked, ids, can, fd, tx, interface)


def _frames(
    view: ByteColumns,
    at: Places,
    size: NDArray[np.int64],
    ids: Column,
    can: NDArray[np.bool_],
    fd: NDArray[np.bool_],
    tx: NDArray[np.bool_],
    interface: NDArray[np.int64],
) -> CanPackets:
    stated, bits = view.u8(at, 4).astype(np.int64), view.u8(at, 5)
    fd = fd | (size == _FD_MTU) | ((bits & _FDF) != 0) | (stated > 8)
    error = (ids & 0x20000000) != 0
    remote = ((ids & 0x40000000) != 0) & ~fd & ~error
    extended = ((ids & 0x80000000) != 0) & ~error
    there = np.where(remote, 0, np.clip(size - _HEADER, 0, stated))
    short = ~remote & (there < stated)
    flags = np.zeros(len(at), np.uint16)
    for flag, given in (
        (FrameFlag.EXTENDED, extended),
        (FrameFlag.REMOTE, remote),
        (FrameFlag.ERROR, error),
        (FrameFlag.FD, fd & ~error),
        (FrameFlag.BRS, fd & ~error & ((bits & _BRS) != 0)),
        (FrameFlag.ESI, fd & ~error & ((bits & _ESI) != 0)),
        (FrameFlag.TX, tx),
        (FrameFlag.DLC_INVALID, short),
    ):
        flags |= np.where(given, flag, 0).astype(np.uint16)
    whole = can & (size >= _HEADER) & (stated <= 64) & ((stated & _XL) == 0)
    width = 64 if bool((whole & (there > 8)).any()) else 8
    data = np.where(np.arange(width) < there[:, np.newaxis], view.block(at, _HEADER, width), 0)
    return CanPackets(
        can,
        whole,
        interface,
        np.where(extended | error, ids & 0x1FFFFFFF, ids & 0x7FF).astype(np.uint32),
        flags,
        np.where(remote, np.minimum(stated, 8), there).astype(np.uint8),
        data.astype(np.uint8),
    )
