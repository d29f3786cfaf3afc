"""The LAWICEL ASCII protocol of serial adapters (slcan): received bytes to columns.

A line ends with CR; an adapter that refuses a command sends BEL instead. Frames are
`t` + 3 digits or `T` + 8 digits of identifier, one digit of DLC, two of each data byte, and where
the adapter stamps frames 4 digits (milliseconds) or 8 digits (microseconds or milliseconds) more;
`r` and `R` are remote frames (LAWICEL CANUSB manual 1.0). `d D b B` are CAN FD frames without and
with bit rate switch, DLC in hexadecimal, as CANable 2 and WeAct adapters send them; an odd digit at
the end of these is the error state indicator. `x` is CANDapter's `T`. `s` and `e` tell the
controller's state and errors (Linux, drivers/net/can/slcan).
"""

import re
from dataclasses import dataclass, field, replace
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.can_errors import Controller, ErrorClass

CR, BEL, LF = 0x0D, 0x07, 0x0A
MAX_LINE = 160
"""The longest line is an FD frame of 64 bytes with stamp: 147 characters."""
MAX_ANSWERS = 64
"""Lines that are no frames, kept from one call of `feed`."""
NO_STAMP = -1


class Status(IntFlag):
    """Bits of the answer to `F` (LAWICEL CANUSB manual 1.0)."""

    RX_FULL = 1 << 0
    TX_FULL = 1 << 1
    WARNING = 1 << 2
    OVERRUN = 1 << 3
    PASSIVE = 1 << 5
    ARBITRATION_LOST = 1 << 6
    BUS_ERROR = 1 << 7


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """What the bytes held.

    Attributes:
        frames: in the order of the lines; `t_ns` and `bus` are 0.
        at: (n,) int64, position of each frame's last byte in the bytes fed, the rest of the call
            before counted as negative positions.
        stamp: (n,) int64, the adapter's stamp as it stands there; NO_STAMP where there is none.
        stamp_digits: (n,) uint8, hexadecimal digits of the stamp: 0, 4 or 8.
        answers: lines that have the whole shape of an answer, with their position.
        acknowledged: empty lines: commands that the adapter took.
        refused: BELs: commands that it did not take.
        garbage: lines that are nothing known, and frames whose digits are damaged.
        garbage_bytes: bytes in them.
        garbage_frames: frames that were in them, by the letters at which frames begin, at least one
            in each line.
    """

    frames: FrameBatch
    at: NDArray[np.int64]
    stamp: NDArray[np.int64]
    stamp_digits: NDArray[np.uint8]
    answers: list[tuple[int, bytes]] = field(default_factory=list)
    acknowledged: int = 0
    refused: int = 0
    garbage: int = 0
    garbage_bytes: int = 0
    garbage_frames: int = 0


class LineReader:
    """Takes bytes as they come; the rest of a line waits for its end."""

    def __init__(self) -> None:
        self._rest = b""
        self._skipping = False

    def feed(self, data: bytes) -> Lines:
        """Everything in the lines that end in these bytes; never raises."""
        before = len(self._rest)
        text = self._rest + data
        plain = np.zeros(len(text) + _PADDING, np.uint8)
        plain[: len(text)] = np.frombuffer(text, np.uint8)
        ends = np.flatnonzero((plain == CR) | (plain == BEL))
        used = int(ends[-1]) + 1 if len(ends) else 0
        self._rest = text[used:]
        begins = np.concatenate([np.zeros(min(len(ends), 1), np.int64), ends[:-1] + 1])
        skipped_frames = 0
        if self._skipping and len(ends):
            skipped_frames = _starts(text[: int(ends[0])])
            begins, ends = begins[1:], ends[1:]
            self._skipping = False
        lines = _read(plain, begins, ends, before)
        lines = replace(lines, garbage_frames=lines.garbage_frames + skipped_frames)
        if len(self._rest) > MAX_LINE:
            lost, self._rest = self._rest, b""
            first = 0 if self._skipping else 1
            self._skipping = True
            return replace(
                lines,
                garbage=lines.garbage + first,
                garbage_bytes=lines.garbage_bytes + len(lost),
                garbage_frames=lines.garbage_frames + max(first, _starts(lost)),
            )
        return lines


def _starts(text: bytes) -> int:
    """Letters at which frames begin and that no digit is."""
    return int(_STARTS[np.frombuffer(text, np.uint8)].sum())


_PADDING = 160
_FLAGS = {
    "t": 0,
    "T": FrameFlag.EXTENDED,
    "x": FrameFlag.EXTENDED,
    "r": FrameFlag.REMOTE,
    "R": FrameFlag.REMOTE | FrameFlag.EXTENDED,
    "d": FrameFlag.FD,
    "D": FrameFlag.FD | FrameFlag.EXTENDED,
    "b": FrameFlag.FD | FrameFlag.BRS,
    "B": FrameFlag.FD | FrameFlag.BRS | FrameFlag.EXTENDED,
}
_NO_FRAME = 0xFFFF
_FLAGS_OF = np.full(256, _NO_FRAME, np.uint16)
_FLAGS_OF[[ord(letter) for letter in _FLAGS]] = list(_FLAGS.values())
_STARTS = np.zeros(256, np.bool_)
_STARTS[list(b"tTrRx")] = True
_MAY_ANSWER = np.zeros(256, np.bool_)
_MAY_ANSWER[list(b"FVNzZse")] = True
_ANSWER = re.compile(rb"F[0-9A-Fa-f]{2}|[VN][0-9A-Za-z]{4}|[zZ]")
"""LAWICEL CANUSB manual 1.0. Its `v` is never asked for, and is a SYNC with one bit turned over."""

_NIBBLE = np.full(256, 0xFF, np.uint8)
_NIBBLE[list(b"0123456789")] = np.arange(10)
_NIBBLE[list(b"ABCDEF")] = _NIBBLE[list(b"abcdef")] = np.arange(10, 16)
_FD_BYTES = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64], np.uint8)
_CLASSIC_BYTES = np.minimum(np.arange(16), 8).astype(np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Frames of one shape: rows of the lines, and their columns."""

    row: NDArray[np.intp]
    can_id: NDArray[np.uint32]
    flags: NDArray[np.uint16]
    dlc: NDArray[np.uint8]
    data: NDArray[np.uint8]
    stamp: NDArray[np.int64]
    stamp_digits: NDArray[np.uint8]


def _read(
    plain: NDArray[np.uint8], begins: NDArray[np.int64], ends: NDArray[np.int64], before: int
) -> Lines:
    begins = begins + (plain[begins] == LF)
    length = ends - begins
    letter = plain[begins]
    flags = np.where(length > 0, _FLAGS_OF[letter], np.uint16(_NO_FRAME))
    groups = []
    for extended in (False, True):
        for fd in (False, True):
            kind = (FrameFlag.EXTENDED if extended else 0) | (FrameFlag.FD if fd else 0)
            rows = np.flatnonzero((flags & _SHAPE) == kind)
            if len(rows):
                groups.append(_group(plain, rows, begins[rows], length[rows], flags[rows]))
    taken = np.zeros(len(ends), np.bool_)
    for group in groups:
        taken[group.row] = True
    other = np.flatnonzero(~taken & (length > 0))
    whole = [
        is_answer(plain[begins[row] : ends[row]].tobytes()) if _MAY_ANSWER[letter[row]] else False
        for row in other.tolist()
    ]
    answers = other[np.array(whole, np.bool_)]
    garbage = np.setdiff1d(other, answers, assume_unique=True)
    damaged = [plain[begins[row] : ends[row]] for row in garbage.tolist()]
    group = _joined(groups)
    zeros = np.zeros(len(group.row), np.int64)
    frames = FrameBatch(
        zeros, zeros.astype(np.uint8), group.can_id, group.flags, group.dlc, group.data
    )
    return Lines(
        frames,
        ends[group.row] - before,
        group.stamp,
        group.stamp_digits,
        [
            (int(ends[row]) - before, plain[begins[row] : ends[row]].tobytes())
            for row in answers[:MAX_ANSWERS].tolist()
        ],
        int(np.count_nonzero((length == 0) & (plain[ends] == CR))),
        int(np.count_nonzero(plain[ends] == BEL)),
        len(garbage),
        int(length[garbage].sum()),
        sum(max(1, int(_STARTS[line].sum())) for line in damaged),
    )


_SHAPE = int(FrameFlag.EXTENDED | FrameFlag.FD) | 0xFF00


def _group(
    plain: NDArray[np.uint8],
    rows: NDArray[np.intp],
    begins: NDArray[np.int64],
    length: NDArray[np.int64],
    flags: NDArray[np.uint16],
) -> _Group:
    """Frames of one shape; rows whose length or digits are wrong are left out."""
    fd = bool(flags[0] & FrameFlag.FD)
    id_digits = 8 if flags[0] & FrameFlag.EXTENDED else 3
    head = id_digits + 2
    numbers = _NIBBLE[_rows_of(plain, begins + 1, id_digits + 1)]
    code = numbers[:, -1]
    dlc = (_FD_BYTES if fd else _CLASSIC_BYTES)[code & 0x0F]
    digits = np.where(flags & FrameFlag.REMOTE, 0, 2 * dlc.astype(np.int64))
    rest = length - head - digits
    esi = (rest & 1) * fd
    stamped = rest - esi
    good = (numbers.max(axis=1) <= 0x0F) & ((stamped == 0) | (stamped == 4) | (stamped == 8))
    can_id = _number(numbers[:, :-1])
    good &= can_id <= (0x1FFF_FFFF if id_digits == 8 else 0x7FF)
    width = 64 if fd else 8
    nibbles = _NIBBLE[_rows_of(plain, begins + head, 2 * width)]
    outside = np.arange(2 * width) >= digits[:, None]
    nibbles[outside] = 0
    good &= nibbles.max(axis=1) <= 0x0F
    stamp, stamp_good = _stamps(plain, begins + head + digits, stamped)
    good &= stamp_good
    if fd and esi.any():
        indicator = plain[np.where(esi, begins + length - 1, 0)]
        good &= (esi == 0) | (indicator == ord("0")) | (indicator == ord("1"))
        flags = np.where(
            (esi != 0) & (indicator == ord("1")), flags | np.uint16(FrameFlag.ESI), flags
        )
    data = (nibbles[:, ::2] << np.uint8(4)) | nibbles[:, 1::2]
    keep = slice(None) if good.all() else good
    return _Group(
        rows[keep],
        can_id[keep],
        flags[keep],
        dlc[keep],
        data[keep],
        stamp[keep],
        stamped[keep].astype(np.uint8),
    )


def _stamps(
    plain: NDArray[np.uint8], at: NDArray[np.int64], digits: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Stamps of 4 or 8 digits at these places, and whether their digits are good."""
    stamp = np.full(len(at), NO_STAMP, np.int64)
    good = np.ones(len(at), np.bool_)
    for width in (4, 8):
        rows = np.flatnonzero(digits == width)
        if len(rows):
            numbers = _NIBBLE[_rows_of(plain, at[rows], width)]
            good[rows] = numbers.max(axis=1) <= 0x0F
            stamp[rows] = _number(numbers)
    return stamp, good


def _number(digits: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """The numbers that rows of up to eight hexadecimal digits write."""
    number = np.zeros(len(digits), np.uint32)
    for column in range(digits.shape[1]):
        number <<= np.uint32(4)
        number |= digits[:, column] & np.uint8(0x0F)
    return number


def _rows_of(plain: NDArray[np.uint8], at: NDArray[np.int64], width: int) -> NDArray[np.uint8]:
    """`width` bytes from each of these places, (n, width)."""
    windows = np.ndarray((len(plain) - width + 1,), f"V{width}", plain, 0, (1,))
    return windows[at].view(np.uint8).reshape(len(at), width)


def _joined(groups: list[_Group]) -> _Group:
    """All groups in the order of their lines."""
    if len(groups) == 1:
        return groups[0]
    if not groups:
        return _EMPTY
    width = max(group.data.shape[1] for group in groups)
    order = np.argsort(np.concatenate([group.row for group in groups]))
    data = [np.pad(g.data, ((0, 0), (0, width - g.data.shape[1]))) for g in groups]
    return _Group(
        np.concatenate([group.row for group in groups])[order],
        np.concatenate([group.can_id for group in groups])[order],
        np.concatenate([group.flags for group in groups])[order],
        np.concatenate([group.dlc for group in groups])[order],
        np.concatenate(data)[order],
        np.concatenate([group.stamp for group in groups])[order],
        np.concatenate([group.stamp_digits for group in groups])[order],
    )


_EMPTY = _Group(
    np.zeros(0, np.intp),
    np.zeros(0, np.uint32),
    np.zeros(0, np.uint16),
    np.zeros(0, np.uint8),
    np.zeros((0, 8), np.uint8),
    np.zeros(0, np.int64),
    np.zeros(0, np.uint8),
)


def is_answer(line: bytes) -> bool:
    """Whether a line is all that an adapter answers or tells, and no rest of a frame.

    >>> is_answer(b"F09"), is_answer(b"sb256256"), is_answer(b"F1122334455667788")
    (True, True, False)
    """
    return _ANSWER.fullmatch(line) is not None or error_frame(line) is not None


def status_of(answer: bytes) -> Status | None:
    """The bits of an answer to `F`; None when it is something else.

    >>> status_of(b"F09") == Status.RX_FULL | Status.OVERRUN, status_of(b"V1013")
    (True, None)
    """
    if len(answer) != 3 or answer[:1] != b"F":
        return None
    numbers = _NIBBLE[np.frombuffer(answer[1:], np.uint8)]
    return Status(int(numbers[0] << 4 | numbers[1])) if numbers.max() <= 0x0F else None


_STATES = {
    ord("a"): (0, Controller.ACTIVE, Controller.ACTIVE),
    ord("w"): (0, Controller.RX_WARNING, Controller.TX_WARNING),
    ord("p"): (0, Controller.RX_PASSIVE, Controller.TX_PASSIVE),
    ord("b"): (ErrorClass.BUS_OFF, Controller(0), Controller(0)),
}
_PROTOCOL_TYPES = {"b": 1 << 3, "B": 1 << 4, "f": 1 << 1, "s": 1 << 2}
_CRC_SEQUENCE = 0x08
_ACK_SLOT = 0x19


def error_frame(answer: bytes) -> tuple[int, bytes] | None:
    """Error classes and data, as SocketCAN has them, of a line that tells a state or errors.

    `s<a|w|p|b><3 digits receive><3 digits transmit counter>`, `e<number><letters>` (Linux,
    drivers/net/can/slcan). None when the line is something else.

    >>> classes, data = error_frame(b"sp130000")
    >>> hex(classes), data.hex()
    ('0x204', '0010000000000082')
    >>> error_frame(b"e1a")[0] == ErrorClass.PROTOCOL | ErrorClass.BUS_ERROR | ErrorClass.NO_ACK
    True
    >>> error_frame(b"s1") is None
    True
    """
    if answer[:1] == b"s":
        return _state_frame(answer)
    if answer[:1] == b"e":
        return _bus_error(answer)
    return None


def _state_frame(answer: bytes) -> tuple[int, bytes] | None:
    counters = answer[2:]
    if len(answer) != 8 or answer[1] not in _STATES or not counters.isdigit():
        return None
    receive, transmit = int(counters[:3]), int(counters[3:])
    classes, by_receive, by_transmit = _STATES[answer[1]]
    data = bytearray(8)
    if not classes & ErrorClass.BUS_OFF:
        classes = ErrorClass.CONTROLLER | ErrorClass.COUNTERS
        data[1] = (by_receive if receive >= transmit else 0) | (
            by_transmit if transmit >= receive else 0
        )
        data[6], data[7] = min(transmit, 255), min(receive, 255)
    return int(classes), bytes(data)


def _bus_error(answer: bytes) -> tuple[int, bytes] | None:
    letters = answer[2:].decode("ascii", "replace")
    if len(answer) < 3 or not answer[1:2].isdigit() or int(answer[1:2]) != len(letters):
        return None
    if not set(letters) <= set("abBcfoOs"):
        return None
    classes, data = ErrorClass(0), bytearray(8)
    for letter in letters:
        if letter in "oO":
            classes |= ErrorClass.CONTROLLER
            data[1] |= Controller.RX_OVERFLOW if letter == "o" else Controller.TX_OVERFLOW
            continue
        classes |= ErrorClass.PROTOCOL | ErrorClass.BUS_ERROR
        data[2] |= _PROTOCOL_TYPES.get(letter, 0)
        if letter == "a":
            classes |= ErrorClass.NO_ACK
            data[3] = _ACK_SLOT
        elif letter == "c":
            data[3] = _CRC_SEQUENCE
    return int(classes), bytes(data)
