"""How long a frame occupies the bus: its exact length in bits, stuff bits included (ISO 11898-1).

Lengths are those of the frame as its sender puts it out. What no log tells is left out: the delay
of the bus, for which the receivers' ACK may stretch a frame by a fraction of a bit; the DLC values
9 to 15 that a classic frame may carry for its eight bytes; error, overload and suspended bits.
CAN FD is ISO CAN FD: frames of the older, non-ISO protocol have no stuff count and are five bits
shorter, which their log does not show. ESI is what the frame's flag says.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from syncline_schemas import native
from syncline_schemas.batch import FrameBatch, FrameFlag

INTERMISSION_BITS = 3
"""Recessive bits that keep the bus busy after the end of each data or remote frame."""
TRAILER_BITS = 10
"""CRC delimiter, ACK slot, ACK delimiter and end of frame; never stuffed."""
CRC_POLYNOMIAL = 0x4599
CRC_BITS = 15
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Data bytes of a CAN FD frame by its DLC code."""
_RUN = 5
_STATES = 8
_STATE, _COUNT = np.uint8(7), np.uint8(0xF8)
"""Parts of what a walk over bits tells: the state behind them, and the stuff bits so far << 3."""
_REMOTE, _EXTENDED = 1 << 4, 1 << 5
_FD, _ERROR = 1 << 6, (1 << 6) + 1
"""Shapes of frames; those of classic frames are the length with the two bits above."""
_EXTENDED_HEADER_BITS = 39
_STANDARD_HEADER_BITS = 19
_FD_START_BITS = {False: 17, True: 36}
"""SOF to BRS without stuff bits, by 11- or 29-bit identifier."""
_FD_CONTROL_BITS = 5
"""ESI and DLC."""
_CRC17_LENGTH = 16
"""Most data bytes that CRC-17 protects."""
_CRC17_FIELD_BITS = 4 + 17 + 6
"""Stuff count, CRC-17, and the fixed stuff bits before them and after each fourth bit."""
_CRC21_FIELD_BITS = 4 + 21 + 7

_Word = TypeVar("_Word", np.uint32, np.uint64)
_Walked = tuple[NDArray[np.uint16], NDArray[np.uint8]]


def wire_bits(batch: FrameBatch, *, intermission: bool = True) -> NDArray[np.int64]:
    """Bits at the nominal bit rate per frame: SOF to end of frame, and the intermission behind it.

    Classic data and remote frames: the CRC-15 is computed and the stuff bits of SOF to CRC are
    counted in the real bits. CAN FD frames: the stuff bits up to the end of the data are counted;
    those of stuff count and CRC stand at fixed places whatever the CRC is, and the first of them
    takes the place of a stuff bit behind the last data bit (ISO 11898-1:2015 10.5). A length that
    no FD frame can have counts as the next longer one, filled up with zeros. FD frames with bit
    rate switch (BRS): all but `data_phase_bits`. Error frames get 0, as their length is unknown.

    A frame's stamp is taken at its end of frame, so the distance of two back-to-back stamps is one
    intermission plus the second frame without its own: equal to the second frame's length with
    intermission.

    Returns: (n,) int64 [bit].
    """
    return short_wire_bits(batch, intermission=intermission).astype(np.int64)


def short_wire_bits(batch: FrameBatch, *, intermission: bool = True) -> NDArray[np.uint16]:
    """`wire_bits` in a quarter of the memory, (n,) uint16: not to be computed with."""
    between = INTERMISSION_BITS if intermission else 0
    bits, fd = (_native_bits if native.available() else _numpy_bits)(batch, between)
    if len(fd):
        bits[fd] = _fd_nominal_bits(batch[fd]) + between
    return bits


def data_phase_bits(batch: FrameBatch) -> NDArray[np.int64]:
    """Bits at the data bit rate per frame: ESI to CRC delimiter of FD frames with BRS, else 0.

    Exact. BRS counts as a nominal bit and the CRC delimiter as a data bit: the rates are switched
    at the sample points within these two, and where those are cancels out in the sum.

    Returns: (n,) int64 [bit].
    """
    bits = np.zeros(len(batch), np.int64)
    told = FrameFlag.FD | FrameFlag.BRS
    rows = np.flatnonzero((batch.flags & (told | FrameFlag.ERROR)) == told)
    if len(rows):
        frames = batch[rows]
        bits[rows] = _fd_data_bits(frames, _fd_start(frames)[1])
    return bits


def wire_ns(
    batch: FrameBatch,
    bitrate: float,
    data_bitrate: float | None = None,
    *,
    intermission: bool = True,
) -> NDArray[np.float64]:
    """Time on the wire per frame at these bit rates [bit/s].

    Without a data bit rate the data phase counts at the nominal one: at most, as it is no slower.

    Returns: (n,) float64 [ns].
    """
    nominal = wire_bits(batch, intermission=intermission) * (1e9 / bitrate)
    return nominal + data_phase_bits(batch) * (1e9 / (data_bitrate or bitrate))


def crc15(message: bytes) -> int:
    """CRC-15 of CAN over whole bytes, for check values.

    >>> hex(crc15(b"123456789"))
    '0x59e'
    """
    crc = 0
    for byte in message:
        crc = (crc << 8 & 0x7FFF) ^ int(_crc_table()[(crc >> 7 ^ byte) & 0xFF])
    return crc


def longest_bits(length: int, *, extended: bool = False, fd: bool = False) -> int:
    """No frame with this many data bytes has more bits than this, intermission included.

    >>> longest_bits(8), longest_bits(8, extended=True), longest_bits(64, fd=True)
    (135, 160, 712)
    """
    if fd:
        stuffed = _FD_START_BITS[extended] + _FD_CONTROL_BITS + 8 * length
        # The last bit before the CRC field never gets a stuff bit.
        places, fixed = stuffed - 1, _fd_crc_field_bits(length)
    else:
        header = _EXTENDED_HEADER_BITS if extended else _STANDARD_HEADER_BITS
        stuffed = header + 8 * length + CRC_BITS
        places, fixed = stuffed, 0
    return stuffed + (places - 1) // 4 + fixed + TRAILER_BITS + INTERMISSION_BITS


def _native_bits(batch: FrameBatch, between: int) -> tuple[NDArray[np.uint16], NDArray[np.intp]]:
    """Bits of the classic frames with those between two frames, and the rows of CAN FD frames."""
    bits, fd = native.wire_bits(
        batch.can_id, batch.flags, batch.dlc, batch.data, _native_tables(), between
    )
    if not fd:
        return bits, np.zeros(0, np.intp)
    kind = batch.flags & (FrameFlag.FD | FrameFlag.ERROR)
    return bits, np.flatnonzero(kind == FrameFlag.FD)


def _numpy_bits(batch: FrameBatch, between: int) -> tuple[NDArray[np.uint16], NDArray[np.intp]]:
    """The same as `_native_bits`."""
    bits = np.zeros(len(batch), np.uint16)
    shape = _shapes(batch)
    words = np.ascontiguousarray(batch.data[:, :8]).view(np.uint64)[:, 0]
    for kind in np.flatnonzero(np.bincount(shape, minlength=_ERROR + 1)[:_FD]).tolist():
        rows = _rows(shape, kind)
        classic = _classic_bits(
            _taken(batch.can_id, rows),
            kind & 15,
            _taken(words, rows),
            bool(kind & _REMOTE),
            bool(kind & _EXTENDED),
        )
        bits[rows] = classic + between
    return bits, np.flatnonzero(shape == _FD)


def _shapes(batch: FrameBatch) -> NDArray[np.uint8]:
    """(n,) what frames of one length of the fixed parts have in common."""
    flags, shape = batch.flags, np.minimum(batch.dlc, np.uint8(8))
    seen = int(np.bitwise_or.reduce(flags, initial=0))
    for flag, bit in ((FrameFlag.REMOTE, _REMOTE), (FrameFlag.EXTENDED, _EXTENDED)):
        if seen & flag:
            shape[(flags & flag) != 0] |= np.uint8(bit)
    for flag, value in ((FrameFlag.FD, _FD), (FrameFlag.ERROR, _ERROR)):
        if seen & flag:
            shape[(flags & flag) != 0] = value
    return shape


def _rows(shape: NDArray[np.uint8], kind: int) -> slice | NDArray[np.intp]:
    rows = np.flatnonzero(shape == kind)
    return slice(None) if len(rows) == len(shape) else rows


def _taken(column: NDArray[_Word], rows: slice | NDArray[np.intp]) -> NDArray[_Word]:
    return column[rows] if isinstance(rows, slice) else column.take(rows)


def _classic_bits(
    can_id: NDArray[np.uint32],
    length: int,
    data: NDArray[np.uint64],
    remote: bool,
    extended: bool,
) -> NDArray[np.integer[Any]]:
    """Length without intermission of frames of one shape; `data` are their eight bytes."""
    payload = 0 if remote else length
    if extended:
        crc, step = _extended_header(can_id, remote << 6 | length)
        fixed = _EXTENDED_HEADER_BITS + 8 * payload + CRC_BITS + TRAILER_BITS
    else:
        headers = _standard_headers(remote << 6 | length)
        short = can_id & np.uint32(0x7FF)
        crc, step = headers[0].take(short), headers[1].take(short)
        fixed = _STANDARD_HEADER_BITS + 8 * payload + CRC_BITS + TRAILER_BITS
    if payload:
        crc, step = _after_data(crc, step, data, payload)
    # The CRC in 15 bits, and one more that makes no stuff bit.
    end = _stuff_table_16().take(_place(step, crc << np.uint16(1) | ~crc & np.uint16(1)))
    stuffed: NDArray[np.integer[Any]] = ((step >> 3) + (end >> 3)).astype(np.int64) + fixed
    return stuffed


def _after_data(
    crc: NDArray[np.uint16], step: NDArray[np.uint8], data: NDArray[np.uint64], payload: int
) -> _Walked:
    """CRC, and stuff bits with the state, behind the data bytes as well."""
    word_crc, word_stuff = _crc_table_16(), _stuff_table_16()
    words = data.view(">u2").reshape(-1, 4)
    for k in range(payload // 2):
        word = words[:, k].astype(np.uint16)
        crc = word_crc.take(crc << np.uint16(1) ^ word)
        step = word_stuff.take(_place(step, word)) + (step & _COUNT)
    if payload % 2:
        last = np.ascontiguousarray(data.view(np.uint8).reshape(-1, 8)[:, payload - 1])
        crc = (crc << np.uint16(8)) & np.uint16(0x7FFF) ^ _crc_table().take(
            crc >> np.uint16(7) ^ last & np.uint16(0xFF)
        )
        step = _stuff_table(8).take((step & _STATE).astype(np.uint16) << 8 | last) + (step & _COUNT)
    return crc, step


def _place(step: NDArray[np.uint8], word: NDArray[np.uint16]) -> NDArray[np.uint32]:
    """Where `_stuff_table_16` tells what follows a state and 16 bits."""
    place: NDArray[np.uint32] = (step & _STATE).astype(np.uint32) << np.uint32(16) | word
    return place


@cache
def _standard_headers(control: int) -> _Walked:
    """(2048,) CRC, and stuff bits with the state, behind the header of each 11-bit identifier."""
    can_id = np.arange(1 << 11, dtype=np.uint32)
    return _header(can_id >> 9, 3, [(can_id & 0x1FF) << 7 | control])


def _extended_header(can_id: NDArray[np.uint32], control: int) -> _Walked:
    """The same of 29-bit identifiers, (n,)."""
    middle = (can_id >> 18 & 0x1F) << 11 | 0x600 | can_id >> 9 & 0x1FF
    return _header(can_id >> 23 & 0x3F, 7, [middle, (can_id & 0x1FF) << 7 | control])


def _header(
    first: NDArray[np.integer[Any]], prefix_bits: int, words: Sequence[NDArray[np.integer[Any]]]
) -> _Walked:
    """CRC, and stuff bits with the state, of a prefix of a few bits and 16-bit words."""
    word_crc, word_stuff = _crc_table_16(), _stuff_table_16()
    crc, step = word_crc[first], _prefix_table(prefix_bits)[first]
    for word in words:
        word16 = word.astype(np.uint16)
        crc = word_crc[(crc << np.uint16(1)) ^ word16]
        step = word_stuff[_place(step, word16)] + (step & _COUNT)
    return crc, step


def _fd_nominal_bits(frames: FrameBatch) -> NDArray[np.int64]:
    """Nominal bits without intermission of FD frames."""
    bits, state = _fd_start(frames)
    bits += TRAILER_BITS - 1
    steady = np.flatnonzero((frames.flags & FrameFlag.BRS) == 0)
    bits[steady] += _fd_data_bits(frames[steady], state[steady])
    return bits


def _fd_start(frames: FrameBatch) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """SOF to BRS of FD frames: bits with stuff bits, and the state after BRS."""
    bits = np.empty(len(frames), np.int64)
    state = np.empty(len(frames), np.uint8)
    extended = (frames.flags & FrameFlag.EXTENDED) != 0
    # RRS 0, FDF 1, res 0, BRS; with an 11-bit identifier IDE stands between RRS and FDF.
    ends = ((frames.flags & FrameFlag.BRS) != 0) | np.uint32(0b0100)
    for kind in (False, True):
        rows = np.flatnonzero(extended == kind)
        if len(rows):
            can_id, end = frames.can_id[rows], ends[rows]
            stuffed, state[rows] = _fd_extended(can_id, end) if kind else _fd_standard(can_id, end)
            bits[rows] = stuffed + _FD_START_BITS[kind]
    return bits, state


def _fd_standard(
    can_id: NDArray[np.uint32], end: NDArray[np.uint32]
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Stuff bits of SOF to BRS and the state after it, with 11-bit identifiers."""
    return _walk_words(np.broadcast_to(_prefix_table(1), len(can_id)), [can_id << 5 | end])


def _fd_extended(
    can_id: NDArray[np.uint32], end: NDArray[np.uint32]
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Stuff bits of SOF to BRS and the state after it, with 29-bit identifiers."""
    # SRR and IDE, both 1, stand between the 11 and the 18 bits of the identifier.
    base = (can_id >> 18 & 0xFF) << 8 | 0xC0 | can_id >> 12 & 0x3F
    return _walk_words(_prefix_table(4)[can_id >> 26], [base, (can_id & 0xFFF) << 4 | end])


def _walk_words(
    step: NDArray[np.uint8], words: Sequence[NDArray[np.integer[Any]]]
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Stuff bits of the step before and of 16-bit words behind it, and the step of the last."""
    count = (step >> 3).astype(np.int64)
    table = _stuff_table_16()
    for word in words:
        step = table[(step & 7).astype(np.uint32) << 16 | word]
        count += step >> 3
    return count, step


def _fd_data_bits(frames: FrameBatch, state: NDArray[np.uint8]) -> NDArray[np.int64]:
    """ESI to CRC delimiter of FD frames, from the state after BRS."""
    bits = np.empty(len(frames), np.int64)
    code = np.searchsorted(FD_LENGTHS, np.minimum(frames.dlc, FD_LENGTHS[-1])).astype(np.uint8)
    control = (((frames.flags & FrameFlag.ESI) != 0) << np.uint8(4)) | code
    for kind in np.flatnonzero(np.bincount(code)).tolist():
        rows, length = _rows(code, kind), FD_LENGTHS[kind]
        data = _bytes(frames.data[rows], length)
        stuffed = _fd_data_stuff_bits(state[rows], control[rows], data, length)
        plain = _FD_CONTROL_BITS + 8 * length + _fd_crc_field_bits(length) + 1
        bits[rows] = stuffed + plain
    return bits


def _bytes(data: NDArray[np.uint8], length: int) -> NDArray[np.uint8]:
    """(n, >= length) contiguous bytes, filled up with zeros."""
    missing = max(length - data.shape[1], 0)
    return np.pad(data, ((0, 0), (0, missing))) if missing else np.ascontiguousarray(data)


def _fd_data_stuff_bits(
    state: NDArray[np.uint8], control: NDArray[np.uint8], data: NDArray[np.uint8], length: int
) -> NDArray[np.int64]:
    """Stuff bits within ESI, DLC and data; a run that their last bit ends makes none."""
    if not length:
        return _last_stuff_bits(state, control, _FD_CONTROL_BITS)
    step = _stuff_table(_FD_CONTROL_BITS)[(state & 7) << np.uint8(_FD_CONTROL_BITS) | control]
    words = data.view(">u2")
    count, step = _walk_words(step, [words[:, k] for k in range((length - 1) // 2)])
    if length % 2 == 0:
        step = _stuff_table(8)[(step & 7).astype(np.uint16) << 8 | data[:, length - 2]]
        count += step >> 3
    return count + _last_stuff_bits(step, data[:, length - 1], 8)


def _last_stuff_bits(
    step: NDArray[np.uint8], value: NDArray[np.uint8], bits: int
) -> NDArray[np.int64]:
    """Stuff bits within the last bits before the CRC field, none behind the very last."""
    last = _stuff_table(bits - 1)[(step & 7).astype(np.uint16) << (bits - 1) | value >> 1]
    count: NDArray[np.int64] = (last >> 3).astype(np.int64)
    return count


def _fd_crc_field_bits(length: int) -> int:
    return _CRC17_FIELD_BITS if length <= _CRC17_LENGTH else _CRC21_FIELD_BITS


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


@cache
def _native_tables() -> NDArray[np.uint16]:
    """(5444,) what `native/wire_length.c` looks up: CRC with bytes behind, steps, both prefixes."""
    crc = [_crc_table()]
    for _ in range(_EXTENDED_HEADER_BITS // 8 + 8):
        crc.append((crc[-1] << np.uint16(8)) & np.uint16(0x7FFF) ^ crc[0][crc[-1] >> np.uint16(7)])
    step = np.concatenate([_stuff_table(8), _prefix_table(3), _prefix_table(7)]).astype(np.uint16)
    return np.concatenate([*crc, (step & _STATE) << np.uint16(8) | step >> np.uint16(3)])
