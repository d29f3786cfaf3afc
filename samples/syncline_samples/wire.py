"""Bits of a classic CAN data or remote frame on the wire (ISO 11898-1, 11-bit identifiers)."""

from collections.abc import Iterable

CRC_POLYNOMIAL = 0x4599
CRC_BITS = 15
TAIL_BITS = 10
"""CRC delimiter, ACK slot, ACK delimiter, seven bits of EOF: not stuffed."""
INTERMISSION_BITS = 3
ERROR_BITS = 6 + 6 + 8
"""Superposed error flags and error delimiter."""


def crc15(bits: Iterable[int]) -> int:
    """CRC-15 of a bit sequence as CAN sends it.

    >>> hex(crc15(to_bits(int.from_bytes(b"123456789", "big"), 72)))
    '0x59e'
    """
    crc = 0
    for bit in bits:
        crc = _crc_step(crc, bit)
    return crc


def _crc_step(crc: int, bit: int) -> int:
    shifted = crc << 1 & 0x7FFF
    return shifted ^ CRC_POLYNOMIAL if bit ^ crc >> 14 else shifted


def to_bits(value: int, width: int) -> list[int]:
    """Bits of a number, most significant first."""
    return [value >> shift & 1 for shift in range(width - 1, -1, -1)]


def frame_bits(can_id: int, data: bytes, remote_dlc: int | None = None) -> list[int]:
    """Bits from SOF to the end of the CRC, before stuffing."""
    bits = _head_bits(
        can_id, len(data) if remote_dlc is None else remote_dlc, remote_dlc is not None
    )
    for byte in data:
        bits += to_bits(byte, 8)
    return bits + to_bits(crc15(bits), CRC_BITS)


def _head_bits(can_id: int, dlc: int, remote: bool) -> list[int]:
    return [0, *to_bits(can_id, 11), int(remote), 0, 0, *to_bits(dlc, 4)]


def stuff(bits: Iterable[int]) -> list[int]:
    """The bits with a complementary bit after each five equal ones.

    >>> stuff([0, 0, 0, 0, 0, 1, 1, 1, 1, 0])
    [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 0, 0]
    """
    sent: list[int] = []
    run = 0
    for bit in bits:
        run = run + 1 if sent and sent[-1] == bit else 1
        sent.append(bit)
        if run == 5:
            sent.append(1 - bit)
            run = 1
    return sent


# Stuffing as an automaton over whole bytes: a state is the last bit and the length of its run
# (1..4; the fifth equal bit makes a stuff bit, which starts the next run). State 8 is the start.
_START = 8


def _walk(state: int, bits: Iterable[int]) -> tuple[int, int]:
    stuffed = 0
    last, run = (state >> 2, (state & 3) + 1) if state != _START else (2, 0)
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed += 1
            last, run = 1 - bit, 1
    return last << 2 | (run - 1), stuffed


_BYTE_WALK = [[_walk(state, to_bits(byte, 8)) for byte in range(256)] for state in range(8)]
_SEVEN_WALK = [[_walk(state, to_bits(low, 7))[1] for low in range(128)] for state in range(8)]
_CRC_OF_BYTE = [crc15(to_bits(byte, 8)) for byte in range(256)]
_heads: dict[tuple[int, int | None, int], tuple[int, int, int]] = {}


def _head(can_id: int, remote_dlc: int | None, length: int) -> tuple[int, int, int]:
    dlc = length if remote_dlc is None else remote_dlc
    bits = _head_bits(can_id, dlc, remote_dlc is not None)
    state, stuffed = _walk(_START, bits)
    plain = len(bits) + 8 * length + CRC_BITS + TAIL_BITS + INTERMISSION_BITS
    return crc15(bits), state, plain + stuffed


def wire_bits(can_id: int, data: bytes, remote_dlc: int | None = None) -> int:
    """Bits that a frame occupies on the bus, intermission included.

    The same as counting `stuff(frame_bits(...))`, by tables of whole bytes.
    """
    key = (can_id, remote_dlc, len(data))
    head = _heads.get(key)
    if head is None:
        head = _heads[key] = _head(can_id, remote_dlc, len(data))
    crc, state, bits = head
    for byte in data:
        crc = (crc << 8 ^ _CRC_OF_BYTE[crc >> 7 ^ byte]) & 0x7FFF
        state, stuffed = _BYTE_WALK[state][byte]
        bits += stuffed
    state, stuffed = _BYTE_WALK[state][crc >> 7]
    return bits + stuffed + _SEVEN_WALK[state][crc & 0x7F]
