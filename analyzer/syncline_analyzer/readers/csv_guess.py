"""What cells of a CSV log mean that no column name explains: number bases, words for yes and no."""

import re
from collections.abc import Sequence
from typing import Final

_LIST: Final = re.compile(rb"\[\d{1,3}(?:, *\d{1,3})+\]")


def ids_are_decimal(cells: Sequence[bytes]) -> bool:
    """Whether identifiers are decimal: no letter in any, and more than hexadecimal numbers can be.

    Without such a proof they are hexadecimal, as nearly all tools write them.
    """
    if not may_be_decimal(cells):
        return False
    as_hex, as_decimal = [int(cell, 16) for cell in cells], [int(cell) for cell in cells]
    short = all(len(cell) <= 4 for cell in cells)
    return max(as_hex) > 0x1FFFFFFF or (short and max(as_hex) > 0x7FF >= max(as_decimal))


def may_be_decimal(cells: Sequence[bytes]) -> bool:
    """Whether nothing speaks against decimal identifiers: letters, leading zeros, too large ones."""
    if not cells or not all(cell.isdigit() for cell in cells):
        return False
    padded = any(cell[:1] == b"0" and len(cell) > 1 for cell in cells)
    return not padded and max(map(int, cells)) <= 0x1FFFFFFF


def data_are_decimal(texts: Sequence[bytes], *, sure: bool) -> bool:
    """Whether data bytes are decimal: no letter in any, and not all of two digits.

    sure: the identifiers are decimal, so fewer bytes prove it; so does it when they stand in a list
    of numbers, `[17, 34]`.
    """
    tokens = [token for text in texts for token in re.split(rb"[\s,;\[\](){}]+", text) if token]
    if not tokens or not all(token.isdigit() and len(token) <= 3 for token in tokens):
        return False
    lengths = {len(token) for token in tokens}
    listed = any(_LIST.fullmatch(text.strip()) for text in texts)
    padded = any(token[:1] == b"0" and len(token) == 2 for token in tokens)
    if listed and not padded:
        return max(map(int, tokens)) <= 255
    enough = 3 in lengths or len(tokens) >= 16 or (sure and not padded)
    return lengths != {2} and max(map(int, tokens)) <= 255 and enough


def is_false(value: bytes | None) -> bool:
    return (value or b"").strip().lower() in (b"0", b"false", b"no", b"nein", b"non", b"n")


def is_true(value: bytes | None) -> bool:
    return (value or b"").strip().lower() in (
        b"1",
        b"true",
        b"t",
        b"yes",
        b"x",
        b"ja",
        b"oui",
        b"si",
        b"s\xc3\xad",
        b"wahr",
        b"vrai",
        b"y",
        b"ext",
        b"extended",
        b"xtd",
        b"rtr",
        b"remote",
    )
