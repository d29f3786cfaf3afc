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
_LENGTH_AT, _BITS_AT, _DATA_AT = 4, 5, 8
"""Offsets in both structures, behind the identifier; the bits are those of CAN FD."""
_HEADER_BYTES = 8
_SECOND_NS = 1_000_000_000
_HARDWARE = 4
"""Word of the adapter's own stamp in SCM_TIMESTAMPING: three times seconds and nanoseconds."""


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

_KIND_MASKS = np.array(
    [_EXTENDED_MASK if kind & 5 else _STANDARD_MASK for kind in range(8)], np.uint32
)
"""Bits of the identifier by the same three bits: error classes have 29, too."""

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
    rows = received.frames
    word = np.ascontiguousarray(rows.view("=u4")[:, 0])
    kind = word >> np.uint32(29)
    flags = _KIND_FLAGS[kind]
    sent = received.flags & SENT_HERE
    if sent.any():
        flags[sent != 0] |= np.uint16(FrameFlag.TX)
    fd = received.lengths == FD_BYTES
    wide = bool(fd.any())
    if wide:
        flags |= _fd_flags(rows[:, _BITS_AT], fd)
    dlc = _lengths(rows[:, _LENGTH_AT], fd, flags, wide=wide)
    held = np.where(flags & np.uint16(FrameFlag.REMOTE), np.uint8(0), dlc) if kind.any() else dlc
    return FrameBatch(
        t_ns,
        np.full(len(rows), bus, np.uint8),
        word & _KIND_MASKS[kind],
        flags,
        dlc,
        _fd_data(rows, held) if wide else _classic_data(rows, held),
    )


def _fd_flags(bits: NDArray[np.uint8], fd: NDArray[np.bool_]) -> NDArray[np.uint16]:
    flags = np.full(len(bits), int(FrameFlag.FD), np.uint16)
    flags[(bits & FD_BRS) != 0] |= np.uint16(FrameFlag.BRS)
    flags[(bits & FD_ESI) != 0] |= np.uint16(FrameFlag.ESI)
    return np.where(fd, flags, np.uint16(0))


def _lengths(
    told: NDArray[np.uint8], fd: NDArray[np.bool_], flags: NDArray[np.uint16], *, wide: bool
) -> NDArray[np.uint8]:
    """Lengths that the frames can have; what was told beyond that is marked in `flags`."""
    if told.max(initial=0) <= _CLASSIC_DATA:
        return told.copy()
    classic = np.uint8(_CLASSIC_DATA)
    most = np.where(fd, np.uint8(_FD_DATA), classic) if wide else np.full(len(told), classic)
    flags[told > most] |= np.uint16(FrameFlag.DLC_INVALID)
    return np.minimum(told, most)


def _classic_data(rows: NDArray[np.uint8], held: NDArray[np.uint8]) -> NDArray[np.uint8]:
    kept: NDArray[np.uint64] = rows.view("<u8")[:, _DATA_AT // 8] & _KEPT_BYTES[held]
    return kept.view(np.uint8).reshape(-1, _CLASSIC_DATA)


def _fd_data(rows: NDArray[np.uint8], held: NDArray[np.uint8]) -> NDArray[np.uint8]:
    data = rows[:, _DATA_AT : _DATA_AT + _FD_DATA]
    return np.where(np.arange(_FD_DATA) < held[:, None], data, np.uint8(0))


def control_of(received: Received, pointer_bytes: int = POINTER_BYTES) -> Control:
    """The stamps and drop counters of the control messages.

    Messages that came alike are taken together; most often all of them did.
    """
    count = len(received.control)
    found = Control(
        np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros(count, np.uint32)
    )
    left: NDArray[np.intp] | slice = slice(0, count)
    while count:
        lengths, words = received.control_lengths[left], received.control.view("=u4")[left]
        first = received.control[left][0, : int(lengths[0])].tobytes()
        places = _places(first, pointer_bytes)
        alike = lengths == lengths[0]
        for place in places:
            for word in range(place.header // 4, place.data // 4):
                alike &= words[:, word] == words[0, word]
        if alike.all():
            _take(found, received.control, left, places)
            break
        rows = np.arange(len(received.control))[left]
        _take(found, received.control, rows[alike], places)
        left = rows[~alike]
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
    found: Control,
    control: NDArray[np.uint8],
    rows: NDArray[np.intp] | slice,
    places: list[_Place],
) -> None:
    for place in places:
        if place.level != SOL_SOCKET:
            continue
        size = place.end - place.data
        if place.kind == RXQ_OVFL and size >= 4:
            found.drops[rows] = control.view("=u4")[rows, place.data // 4]
        elif place.kind in TIMESTAMPING and size in (24, 48):
            data = np.ascontiguousarray(control[rows, place.data : place.end])
            times = data.view("=i8" if size == 48 else "=i4").astype(np.int64, copy=False)
            found.kernel_ns[rows] = times[:, 0] * _SECOND_NS + times[:, 1]
            if times[:, _HARDWARE : _HARDWARE + 2].any():
                hardware_ns = times[:, _HARDWARE] * _SECOND_NS + times[:, _HARDWARE + 1]
                found.hardware_ns[rows] = hardware_ns
