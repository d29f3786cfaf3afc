"""How long a frame occupies the bus: its exact length in bits, stuff bits included (ISO 11898-1)."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag

INTERMISSION_BITS = 3
"""Recessive bits that keep the bus busy after the end of each data or remote frame."""
TRAILER_BITS = 10
"""CRC delimiter, ACK slot, ACK delimiter and end of frame; never stuffed."""
CRC_POLYNOMIAL = 0x4599
CRC_BITS = 15
_RUN = 5
_STATES = 8
_EXTENDED_HEADER_BITS = 39
_STANDARD_HEADER_BITS = 19


def wire_bits(batch: FrameBatch, *, intermission: bool = True) -> NDArray[np.int64]:
    """Bits on the wire per frame: SOF to end of frame, and the intermission behind it.

    Classic data and remote frames are exact: the CRC-15 is computed and the stuff bits of SOF to
    CRC are counted in the real bits. A frame's stamp is taken at its end of frame, so the distance
    of two back-to-back stamps is one intermission plus the second frame without its own: equal to
    the second frame's length with intermission.

    CAN FD frames get the longest their length allows (worst stuffing, all at the nominal bit
    rate): an upper bound. Error frames get 0, as their length cannot be told.

    Returns: (n,) int64 [bit].
    """
    flags = batch.flags
    error = (flags & FrameFlag.ERROR) != 0
    bits = np.zeros(len(batch), np.int64)
    data = np.ascontiguousarray(batch.data[:, :8])
    remote = (flags & FrameFlag.REMOTE) != 0
    length = np.minimum(batch.dlc, 8)
    shape = length.astype(np.uint8) | (remote << 4) | (((flags & FrameFlag.EXTENDED) != 0) << 5)
    shape[((flags & FrameFlag.FD) != 0) | error] = 0xFF
    for kind in np.flatnonzero(np.bincount(shape, minlength=256)[:0xFF]):
        rows = _rows(shape, int(kind))
        bits[rows] = _classic_bits(
            batch.can_id[rows], int(kind) & 15, data[rows], bool(kind & 16), bool(kind & 32)
        )
    rows = np.flatnonzero((shape == 0xFF) & ~error)
    if len(rows):
        bits[rows] = _fd_bits_at_most(batch[rows])
    if intermission:
        bits[~error] += INTERMISSION_BITS
    return bits


def crc15(message: bytes) -> int:
    """CRC-15 of CAN over whole bytes, for check values.

    >>> hex(crc15(b"123456789"))
    '0x59e'
    """
    crc = 0
    for byte in message:
        crc = (crc << 8 & 0x7FFF) ^ int(_crc_table()[(crc >> 7 ^ byte) & 0xFF])
    return crc


def longest_bits(length: int, *, extended: bool = False) -> int:
    """Longest classic frame with this many data bytes, intermission included.

    >>> longest_bits(8), longest_bits(8, extended=True)
    (135, 160)
    """
    header = _EXTENDED_HEADER_BITS if extended else _STANDARD_HEADER_BITS
    stuffed = header + 8 * length + CRC_BITS
    return stuffed + (stuffed - 1) // 4 + TRAILER_BITS + INTERMISSION_BITS


def _rows(shape: NDArray[np.uint8], kind: int) -> slice | NDArray[np.intp]:
    rows = np.flatnonzero(shape == kind)
    return slice(None) if len(rows) == len(shape) else rows


def _classic_bits(
    can_id: NDArray[np.uint32], length: int, data: NDArray[np.uint8], remote: bool, extended: bool
) -> NDArray[np.int64]:
    """Length without intermission of frames of one shape."""
    if extended:
        first = can_id >> 23
        control = (remote << 6) | length
        words: list[NDArray[np.integer[Any]]] = [
            (can_id >> 18 & 0x1F) << 11 | 0x600 | can_id >> 9 & 0x1FF,
            (can_id & 0x1FF) << 7 | control,
        ]
        prefix_bits = 7
    else:
        first = can_id >> 9
        words = [(can_id & 0x1FF) << 7 | ((remote << 6) | length)]
        prefix_bits = 3
    header_bits = prefix_bits + 16 * len(words)
    payload = 0 if remote else length
    words += [data.view(">u2")[:, k] for k in range(payload // 2)]
    last = data[:, payload - 1] if payload % 2 else None
    stuffed = _stuff_bits(first, prefix_bits, words, last)
    return stuffed + (header_bits + 8 * payload + CRC_BITS + TRAILER_BITS)


def _stuff_bits(
    first: NDArray[np.integer[Any]],
    prefix_bits: int,
    words: list[NDArray[np.integer[Any]]],
    last: NDArray[np.uint8] | None,
) -> NDArray[np.int64]:
    """Stuff bits of a prefix of a few bits, 16-bit words, perhaps a byte, and the CRC of all."""
    word_crc, word_stuff = _crc_table_16(), _stuff_table_16()
    crc = word_crc[first]
    step = _prefix_table(prefix_bits)[first]
    count = (step >> 3).astype(np.int64)
    for word in words:
        word16 = word.astype(np.uint16)
        crc = word_crc[(crc << np.uint16(1)) ^ word16]
        step = word_stuff[(step & 7).astype(np.uint32) << 16 | word16]
        count += step >> 3
    if last is not None:
        crc = ((crc << np.uint16(8)) & np.uint16(0x7FFF)) ^ _crc_table()[(crc >> 7 ^ last) & 0xFF]
        step = _stuff_table(8)[(step & 7).astype(np.uint16) << 8 | last]
        count += step >> 3
    # The CRC follows in 15 bits: the high 8 and the low 7.
    step = _stuff_table(8)[(step & 7).astype(np.uint16) << 8 | crc >> 7]
    count += step >> 3
    step = _stuff_table(7)[(step & 7).astype(np.uint16) << 7 | crc & np.uint16(0x7F)]
    total: NDArray[np.int64] = count + (step >> 3)
    return total


def _fd_bits_at_most(frames: FrameBatch) -> NDArray[np.int64]:
    """Longest FD frames of these lengths, without intermission."""
    length = frames.dlc.astype(np.int64)
    header = np.where((frames.flags & FrameFlag.EXTENDED) != 0, 41, 22)
    dynamic = header + 8 * length
    # Stuff count (4) and CRC-17 or CRC-21 with their fixed stuff bits: 27 or 32 bits.
    crc = np.where(length <= 16, 27, 32)
    return dynamic + (dynamic - 1) // 4 + crc + TRAILER_BITS + 1


@cache
def _crc_table() -> NDArray[np.uint16]:
    """(256,) CRC-15 of a byte."""
    crc = np.arange(256, dtype=np.uint32) << 7
    for _ in range(8):
        crc = np.where(crc & 0x4000, (crc << 1) ^ CRC_POLYNOMIAL, crc << 1) & 0x7FFF
    return crc.astype(np.uint16)


@cache
def _crc_table_16() -> NDArray[np.uint16]:
    """(65536,) CRC-15 of a 16-bit word."""
    value = np.arange(65536, dtype=np.uint32)
    byte = _crc_table()
    high = byte[value >> 8].astype(np.uint32)
    low = byte[(high >> 7 ^ value) & 0xFF]
    crc: NDArray[np.uint16] = (high << 8 & 0x7FFF).astype(np.uint16) ^ low
    return crc


def _stuff_step(
    last: NDArray[np.int64], run: NDArray[np.int64], bit: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """One bit: (last bit on the wire, its run length 1..4, stuff bits put in)."""
    run = np.where(bit == last, run + 1, 1)
    stuffed = run == _RUN
    return np.where(stuffed, 1 - bit, bit), np.where(stuffed, 1, run), stuffed.astype(np.int64)


def _walk(
    value: NDArray[np.int64], bits: int, last: NDArray[np.int64], run: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """State after the bits of `value`: stuff bits << 3 | last bit << 2 | run - 1."""
    count = np.zeros_like(value)
    for position in reversed(range(bits)):
        last, run, stuffed = _stuff_step(last, run, value >> position & 1)
        count += stuffed
    return (count << 3 | last << 2 | (run - 1)).astype(np.uint8)


@cache
def _prefix_table(bits: int) -> NDArray[np.uint8]:
    """State after SOF and the first `bits - 1` identifier bits, by their value."""
    value = np.arange(1 << (bits - 1), dtype=np.int64)
    # Before SOF the bus is idle: the run of recessive bits does not count.
    return _walk(value, bits, np.ones_like(value), np.ones_like(value))


@cache
def _stuff_table(bits: int) -> NDArray[np.uint8]:
    """(8 << bits,) state after `bits` bits, by state << bits | value."""
    state = np.arange(_STATES << bits, dtype=np.int64)
    value = state & ((1 << bits) - 1)
    return _walk(value, bits, state >> bits + 2, (state >> bits & 3) + 1)


@cache
def _stuff_table_16() -> NDArray[np.uint8]:
    """(8 << 16,) state after 16 bits, by state << 16 | value."""
    byte = _stuff_table(8)
    index = np.arange(_STATES << 16, dtype=np.uint32)
    high = byte[index >> 8]
    low = byte[(high & 7).astype(np.uint32) << 8 | (index & 0xFF)]
    return np.asarray((low & 7) | ((low >> 3) + (high >> 3)) << 3, np.uint8)
