"""What a raw SocketCAN socket hands over, as columns: frames, stamps and the drop counter.

The layouts are those of linux/can.h (struct can_frame, struct canfd_frame), of socket control
messages (cmsg(3)) and of Documentation/networking/{can,timestamping}.rst of the Linux kernel.
"""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag

CLASSIC_BYTES = 16
"""Size of struct can_frame (CAN_MTU)."""
FD_BYTES = 72
"""Size of struct canfd_frame (CANFD_MTU)."""
POINTER_BYTES = struct.calcsize("P")
"""Sizes and alignment of control messages follow the machine's word."""

EXTENDED_BIT, REMOTE_BIT, ERROR_BIT = 1 << 31, 1 << 30, 1 << 29
FD_BRS, FD_ESI = 0x01, 0x02
SENT_HERE = 0x04
"""MSG_DONTROUTE: this machine sent the frame. Frames of the very socket carry MSG_CONFIRM too."""

SOL_SOCKET = 1
RXQ_OVFL = 40
TIMESTAMPING = frozenset({37, 65})
"""SO_TIMESTAMPING_OLD and _NEW; with _OLD the words of 32-bit machines hold 32-bit times."""

_STANDARD_MASK = 0x7FF
_EXTENDED_MASK = 0x1FFF_FFFF
_CLASSIC_DATA, _FD_DATA = 8, 64
_HEADER_BYTES = 8
_SECOND_NS = 1_000_000_000
_HARDWARE = 2
"""Position of the adapter's own stamp among the three of SCM_TIMESTAMPING; the kernel's is first."""


def _frame_type(data_bytes: int) -> np.dtype[np.void]:
    return np.dtype(
        [
            ("can_id", "=u4"),
            ("length", "u1"),
            ("flags", "u1"),
            ("reserved", "u1"),
            ("raw_dlc", "u1"),
            ("data", "u1", (data_bytes,)),
        ]
    )


_FRAME_TYPES = {CLASSIC_BYTES: _frame_type(_CLASSIC_DATA), FD_BYTES: _frame_type(_FD_DATA)}

_KIND_FLAGS = np.array(
    [
        (FrameFlag.EXTENDED if kind & 4 else 0)
        | (FrameFlag.REMOTE if kind & 2 else 0)
        | (FrameFlag.ERROR if kind & 1 else 0)
        for kind in range(8)
    ],
    np.uint16,
)
"""Flags by the upper three bits of the identifier's word."""

_KEPT_BYTES = np.array([(1 << 8 * length) - 1 for length in range(9)], "<u8")
"""Mask of the data bytes by length; the others are 0 whatever the sender left in them."""


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """Messages as recvmmsg left them.

    Attributes:
        frames: (n, 16) uint8, or (n, 72) where the socket takes CAN FD frames.
        lengths: (n,) bytes of each message.
        flags: (n,) message flags.
        control: (n, c) uint8, control messages.
        control_lengths: (n,) bytes of them.
    """

    frames: NDArray[np.uint8]
    lengths: NDArray[np.unsignedinteger]
    flags: NDArray[np.signedinteger]
    control: NDArray[np.uint8]
    control_lengths: NDArray[np.unsignedinteger]


@dataclass(frozen=True, slots=True, eq=False)
class Control:
    """What came beside the frames.

    Attributes:
        kernel_ns: (n,) int64, the kernel's stamps, UTC; 0 where there is none.
        hardware_ns: (n,) int64, the adapter's own stamps, by its own clock; 0 where none.
        drops: (n,) uint32, frames that had found the socket's buffer full when this one was
            queued; counted since the socket was made, modulo 2**32.
    """

    kernel_ns: NDArray[np.int64]
    hardware_ns: NDArray[np.int64]
    drops: NDArray[np.uint32]


def frames_of(received: Received, t_ns: NDArray[np.int64], bus: int) -> FrameBatch:
    """The frames with these stamps, as bus number `bus`; all arrays are new.

    An error frame keeps its class bits as identifier. The length of a classic frame is at most
    eight bytes whatever its raw DLC (`len8_dlc`) says.
    """
    count, row_bytes = received.frames.shape
    raw = received.frames.view(_FRAME_TYPES[row_bytes])[:, 0]
    fd = received.lengths == FD_BYTES
    wide = bool(fd.any())
    word = raw["can_id"]
    kind = word >> np.uint32(29)
    flags = _KIND_FLAGS[kind]
    flags |= ((received.flags & SENT_HERE) * (int(FrameFlag.TX) // SENT_HERE)).astype(np.uint16)
    if wide:
        flags |= _fd_flags(raw["flags"], fd)
    dlc = _lengths(raw["length"], fd, flags)
    long_id = (flags & np.uint16(FrameFlag.EXTENDED | FrameFlag.ERROR)) != 0
    mask = np.where(long_id, np.uint32(_EXTENDED_MASK), np.uint32(_STANDARD_MASK))
    held = np.where(flags & np.uint16(FrameFlag.REMOTE), np.uint8(0), dlc)
    return FrameBatch(
        t_ns,
        np.full(count, bus, np.uint8),
        (word & mask).astype(np.uint32, copy=False),
        flags,
        dlc,
        _data(raw["data"], held, wide=wide),
    )


def _fd_flags(bits: NDArray[np.uint8], fd: NDArray[np.bool_]) -> NDArray[np.uint16]:
    flags = np.full(len(bits), int(FrameFlag.FD), np.uint16)
    flags[(bits & FD_BRS) != 0] |= np.uint16(FrameFlag.BRS)
    flags[(bits & FD_ESI) != 0] |= np.uint16(FrameFlag.ESI)
    return np.where(fd, flags, np.uint16(0))


def _lengths(
    told: NDArray[np.uint8], fd: NDArray[np.bool_], flags: NDArray[np.uint16]
) -> NDArray[np.uint8]:
    """Lengths that the frames can have; what was told beyond that is marked in `flags`."""
    most = np.where(fd, np.uint8(_FD_DATA), np.uint8(_CLASSIC_DATA))
    flags[told > most] |= np.uint16(FrameFlag.DLC_INVALID)
    return np.minimum(told, most)


def _data(data: NDArray[np.uint8], held: NDArray[np.uint8], *, wide: bool) -> NDArray[np.uint8]:
    if wide:
        kept: NDArray[np.uint8] = np.where(np.arange(_FD_DATA) < held[:, None], data, np.uint8(0))
        return kept
    words = np.ascontiguousarray(data[:, :_CLASSIC_DATA]).view("<u8")[:, 0]
    kept_words: NDArray[np.uint64] = words & _KEPT_BYTES[held]
    return kept_words.view(np.uint8).reshape(-1, _CLASSIC_DATA)


def control_of(received: Received, pointer_bytes: int = POINTER_BYTES) -> Control:
    """The stamps and drop counters of the control messages.

    Messages that came alike are taken together; most often all of them did.
    """
    count = len(received.control)
    found = Control(
        np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros(count, np.uint32)
    )
    words = received.control.view("=u4")
    left = np.arange(count)
    while len(left):
        first = int(left[0])
        length = int(received.control_lengths[first])
        places = _places(received.control[first, :length].tobytes(), pointer_bytes)
        alike = received.control_lengths[left] == length
        for place in places:
            for word in range(place.header // 4, place.data // 4):
                alike &= words[left, word] == words[first, word]
        _take(found, received.control, left[alike], places)
        left = left[~alike]
    return found


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a control message lies: its header, and its data in [data, end)."""

    level: int
    kind: int
    header: int
    data: int
    end: int


def _places(control: bytes, pointer_bytes: int) -> list[_Place]:
    """The control messages beside one frame, as far as they are whole."""
    size = struct.Struct("=Q" if pointer_bytes == 8 else "=I")
    head = pointer_bytes + _HEADER_BYTES
    places = []
    begin = 0
    while begin + head <= len(control):
        (length,) = size.unpack_from(control, begin)
        level, kind = struct.unpack_from("=ii", control, begin + pointer_bytes)
        if not head <= length <= len(control) - begin:
            break
        places.append(_Place(level, kind, begin, begin + head, begin + length))
        begin += -(-length // pointer_bytes) * pointer_bytes
    return places


def _take(
    found: Control, control: NDArray[np.uint8], rows: NDArray[np.intp], places: list[_Place]
) -> None:
    for place in places:
        if place.level != SOL_SOCKET:
            continue
        data = control[rows, place.data : place.end]
        if place.kind == RXQ_OVFL and data.shape[1] >= 4:
            found.drops[rows] = np.ascontiguousarray(data[:, :4]).view("=u4")[:, 0]
        elif place.kind in TIMESTAMPING and data.shape[1] in (24, 48):
            times = np.ascontiguousarray(data).view("=i8" if data.shape[1] == 48 else "=i4")
            stamps = times.astype(np.int64, copy=False).reshape(len(rows), 3, 2)
            in_ns = stamps[:, :, 0] * _SECOND_NS + stamps[:, :, 1]
            found.kernel_ns[rows] = in_ns[:, 0]
            found.hardware_ns[rows] = in_ns[:, _HARDWARE]
