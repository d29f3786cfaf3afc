"""CAN frames put on the wire bit by bit (ISO 11898-1:2015), many frames of one shape at once.

Written from the standard for the tests of the wire lengths; it shares nothing with them and counts
nothing: it builds the bits, and a length is the number of bits that were sent.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Bits = NDArray[np.integer[Any]]

CRC_15 = (15, 0x4599)
CRC_17 = (17, 0x1685B)
CRC_21 = (21, 0x102899)
FD_DLC = {n: n for n in range(9)} | {12: 9, 16: 10, 20: 11, 24: 12, 32: 13, 48: 14, 64: 15}
MOST_BITS = 740


@dataclass(frozen=True)
class Shape:
    """What frames that are sent together have in common."""

    length: int
    extended: bool = False
    remote: bool = False
    fd: bool = False
    brs: bool = False
    esi: bool = False


@dataclass(frozen=True)
class Sent:
    """n frames as they went over the wire, from SOF to intermission.

    bits: (n, MOST_BITS), 2 behind the end of a frame. length and data_phase: (n,) number of bits.
    crc_field: where the CRC field begins and ends, (n,) each. crc: (n,) the CRC itself.
    """

    bits: NDArray[np.uint8]
    length: NDArray[np.int64]
    data_phase: NDArray[np.int64]
    crc_field: tuple[NDArray[np.int64], NDArray[np.int64]]
    crc: NDArray[np.int64]

    def text(self, row: int) -> str:
        """A frame's bits as zeros and ones."""
        return "".join(map(str, self.bits[row, : self.length[row]]))

    def crc_text(self, row: int) -> str:
        """The bits of stuff count and CRC with their stuff bits."""
        begin, end = self.crc_field
        return self.text(row)[begin[row] : end[row]]


class Wire:
    """A transmitter: what it has sent, its run of equal bits and its CRC register."""

    def __init__(self, n: int, crc: tuple[int, int], first: int = 0) -> None:
        self.bits = np.full((n, MOST_BITS), 2, np.uint8)
        self.sent = np.zeros(n, np.int64)
        self.level = np.ones(n, np.uint8)
        self.run = np.zeros(n, np.int64)
        self.stuffed = np.zeros(n, np.int64)
        self.width, self.polynomial = crc
        self.crc = np.full(n, first, np.int64)
        self._all = np.arange(n)

    def put(self, bit: Bits | int) -> None:
        """One bit as it is."""
        level = np.broadcast_to(np.asarray(bit, np.uint8), len(self._all))
        self.bits[self._all, self.sent] = level
        self.sent += 1
        self.run = np.where(level == self.level, self.run + 1, 1)
        self.level = level

    def check(self, bit: Bits | int, rows: Any = slice(None)) -> None:
        """Take a bit into the CRC."""
        register = self.crc[rows]
        feedback = (register >> (self.width - 1)) ^ bit
        register = (register << 1) & ((1 << self.width) - 1)
        self.crc[rows] = np.where(feedback, register ^ self.polynomial, register)

    def stuff(self) -> NDArray[np.intp]:
        """The complement after five equal bits; which frames got one."""
        rows = np.flatnonzero(self.run == 5)
        level = self.level.copy()
        level[rows] ^= 1
        self.bits[rows, self.sent[rows]] = level[rows]
        self.sent[rows] += 1
        self.stuffed[rows] += 1
        self.run[rows] = 1
        self.level = level
        return rows


def _field(value: Bits | int, width: int) -> list[Bits]:
    return [np.asarray(value) >> shift & 1 for shift in reversed(range(width))]


def _classic_head(can_id: Bits, shape: Shape) -> list[Bits]:
    rtr, zero, one = [np.asarray(bit) for bit in (int(shape.remote), 0, 1)]
    dlc = _field(shape.length, 4)
    if shape.extended:
        base, rest = _field(can_id >> 18, 11), _field(can_id & 0x3FFFF, 18)
        return [zero, *base, one, one, *rest, rtr, zero, zero, *dlc]
    return [zero, *_field(can_id, 11), rtr, zero, zero, *dlc]


def _fd_head(can_id: Bits, shape: Shape) -> list[Bits]:
    zero, one = np.asarray(0), np.asarray(1)
    if shape.extended:
        base, rest = _field(can_id >> 18, 11), _field(can_id & 0x3FFFF, 18)
        identifier = [*base, one, one, *rest, zero]  # SRR, IDE; RRS
    else:
        identifier = [*_field(can_id, 11), zero, zero]  # RRS, IDE
    fdf, res, brs, esi = one, zero, np.asarray(int(shape.brs)), np.asarray(int(shape.esi))
    return [zero, *identifier, fdf, res, brs, esi, *_field(FD_DLC[shape.length], 4)]


def _data(data: NDArray[np.uint8], length: int) -> list[Bits]:
    return [bit for k in range(length) for bit in _field(data[:, k], 8)]


def send_classic(can_id: Bits, data: NDArray[np.uint8], shape: Shape) -> Sent:
    """Data or remote frames; can_id: (n,), data: (n, at least length)."""
    wire = Wire(len(can_id), CRC_15)
    for bit in _classic_head(can_id, shape) + _data(data, 0 if shape.remote else shape.length):
        wire.check(bit)
        wire.put(bit)
        wire.stuff()
    begin = wire.sent.copy()
    crc = wire.crc.copy()
    for bit in _field(crc, 15):
        wire.put(bit)
        wire.stuff()
    return _ended(wire, begin, crc, np.zeros_like(begin))


def send_fd(can_id: Bits, data: NDArray[np.uint8], shape: Shape) -> Sent:
    """CAN FD frames; can_id: (n,), data: (n, at least length)."""
    crc_21 = shape.length > 16
    wire = Wire(len(can_id), CRC_21 if crc_21 else CRC_17, 1 << 20 if crc_21 else 1 << 16)
    head = _fd_head(can_id, shape)
    brs = len(head) - 6
    stuffed_part = head + _data(data, shape.length)
    switched = np.zeros(len(can_id), np.int64)
    for number, bit in enumerate(stuffed_part):
        wire.check(bit)
        wire.put(bit)
        if number < len(stuffed_part) - 1:  # then follows the fixed stuff bit, and only that
            rows = wire.stuff()
            wire.check(wire.level[rows], rows)
        if number == brs:
            switched = wire.sent.copy()
    begin = wire.sent.copy()
    count = wire.stuffed % 8
    gray = count ^ count >> 1
    parity = gray ^ gray >> 1 ^ gray >> 2
    stuff_count = [*_field(gray, 3), parity & 1]
    for bit in stuff_count:
        wire.check(bit)
    crc = wire.crc.copy()
    for number, bit in enumerate([*stuff_count, *_field(crc, wire.width)]):
        if number % 4 == 0:
            wire.put(1 - wire.level)
        wire.put(bit)
    return _ended(wire, begin, crc, wire.sent + 1 - switched if shape.brs else 0 * switched)


def _ended(
    wire: Wire, begin: NDArray[np.int64], crc: NDArray[np.int64], data_phase: NDArray[np.int64]
) -> Sent:
    """CRC delimiter, ACK slot, ACK delimiter, end of frame, intermission."""
    field = begin, wire.sent.copy()
    for bit in [1, 0, 1, *[1] * 7, *[1] * 3]:
        wire.put(bit)
    return Sent(wire.bits, wire.sent, data_phase, field, crc)
