"""Text fields of many lines at once: eight characters in one 64-bit word.

Lines are first translated byte by byte (`TRANSLATION`): a hexadecimal digit becomes its value in
the low four bits (capitals 10..15, small letters 26..31), every other character a code from 32 on.
So a digit's value is `code & 15`, and what kind of character stands somewhere is a comparison.
Words are little endian: the first character is the lowest byte.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.integer[Any]]
"""(n,) uint64; declared wider because numpy's stubs take a mask given as int for a signed number."""

_EVEN_BYTES: Final = 0x00FF00FF00FF00FF
_EVEN_PAIRS: Final = 0x0000FFFF0000FFFF
_LOW_HALF: Final = 0xFFFFFFFF


def _translation() -> bytes:
    table = bytearray(256)
    spare = iter(range(34, 256))
    for byte in range(256):
        if chr(byte) in "0123456789ABCDEF":
            table[byte] = int(chr(byte), 16)
        elif chr(byte) in "abcdef":
            table[byte] = 16 + int(chr(byte), 16)
        elif byte < 32 and byte not in b"\t\r":
            table[byte] = 32
        else:
            table[byte] = next(spare)
    return bytes(table)


TRANSLATION: Final = _translation()
"""Codes of all bytes; control characters but tab and CR share one, all others differ."""


def field_mask(first: int, last: int, byte: int) -> int:
    """A word with `byte` in the bytes [first, last) and 0 elsewhere.

    >>> hex(field_mask(1, 3, 0x0F))
    '0xf0f00'
    """
    return sum(byte << 8 * i for i in range(first, last))


def hex_number(words: Words, digits: int) -> Words:
    """(n,) numbers of up to eight hexadecimal digits that end each word."""
    nibbles = words & field_mask(8 - digits, 8, 0x0F)
    if digits <= 4:
        value = nibbles >> 56
        for place in range(1, digits):
            value |= (nibbles >> (56 - 12 * place)) & (0xF << 4 * place)
        return value
    return _packed(nibbles).astype(np.uint32).byteswap().astype(np.uint64)


def decimal_number(words: Words, digits: int) -> Words:
    """(n,) numbers of up to eight decimal digits that end each word."""
    value = words & field_mask(8 - digits, 8, 0x0F)
    value = (value * 10 + (value >> 8)) & _EVEN_BYTES
    value = (value * 100 + (value >> 16)) & _EVEN_PAIRS
    return (value * 10000 + (value >> 32)) & _LOW_HALF


def compact_bytes(words: Words, count: int) -> Words:
    """(n,) words whose low `count` (up to 4) bytes are those written as `1122..` in each word."""
    return _packed(words & field_mask(0, 2 * count, 0x0F))


def spaced_bytes(words: Words, count: int, *, step: int = 3) -> Words:
    """(n,) words whose low `count` bytes are those written every `step` characters in each word."""
    nibbles = words & sum(field_mask(step * i, step * i + 2, 0x0F) for i in range(count))
    pairs = (nibbles << 4) | (nibbles >> 8)
    value = pairs & 0xFF
    for i in range(1, count):
        value |= (pairs >> 8 * (step - 1) * i) & (0xFF << 8 * i)
    return value


def _packed(nibbles: Words) -> Words:
    value = ((nibbles << 4) | (nibbles >> 8)) & _EVEN_BYTES
    value = (value | (value >> 8)) & _EVEN_PAIRS
    return (value | (value >> 16)) & _LOW_HALF
