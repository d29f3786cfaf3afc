"""Small and large damage to the bytes of a file, chosen by chance."""

import re
from collections.abc import Callable, Sequence
from random import Random

MAX_BYTES = 8 << 20
"""A mutated file is cut here."""
TAIL_BYTES = 1024
"""Of these at the end of a file every cut is tried."""
_NUMBERS = (
    b"0",
    b"-1",
    b"4294967296",
    b"9223372036854775807",
    b"99999999999999999999999999999999",
    b"1e308",
    b"1e-400",
    b"nan",
    b"inf",
    b"0x",
    b"FFFFFFFF",
    b"9" * 400,
    "\u0663\u0664".encode(),
)
_WORDS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, (1 << 63) - 1)
_DIGITS = re.compile(rb"[0-9A-Fa-f.]+")

Mutation = Callable[[Random, bytes], bytes]


def mutated(chance: Random, raw: bytes, others: Sequence[bytes]) -> bytes:
    """One to four kinds of damage; `others` are files of which pieces may come in."""
    for _ in range(chance.choice((1, 1, 1, 2, 2, 4))):
        if chance.random() < 0.1:
            raw = _grafted(chance, raw, chance.choice(others))
        else:
            raw = chance.choices(_MUTATIONS, _WEIGHTS)[0](chance, raw)
    return raw[:MAX_BYTES] or b"\0"


def _place(chance: Random, raw: bytes) -> int:
    return chance.randrange(len(raw)) if raw else 0


def _bits(chance: Random, raw: bytes) -> bytes:
    out = bytearray(raw)
    for _ in range(chance.choice((1, 1, 2, 8, 64))):
        if out:
            out[_place(chance, raw)] ^= 1 << chance.randrange(8)
    return bytes(out)


def _bytes(chance: Random, raw: bytes) -> bytes:
    at = _place(chance, raw)
    new = chance.randbytes(chance.choice((1, 2, 4, 16)))
    return raw[:at] + new + raw[at + chance.choice((0, len(new))) :]


def _cut(chance: Random, raw: bytes) -> bytes:
    return raw[: _place(chance, raw)]


def _number(chance: Random, raw: bytes) -> bytes:
    """A run of digits becomes an absurd one."""
    runs = [found.span() for found in _DIGITS.finditer(raw[: 1 << 16])]
    if not runs:
        return raw
    start, end = chance.choice(runs)
    return raw[:start] + chance.choice(_NUMBERS) + raw[end:]


def _word(chance: Random, raw: bytes) -> bytes:
    """Binary numbers of any width and order become absurd ones, or move by a little."""
    width = chance.choice((1, 2, 4, 8))
    order = "little" if chance.random() < 0.8 else "big"
    at = _place(chance, raw) // chance.choice((1, 2, 4)) * chance.choice((1, 2, 4))
    old = int.from_bytes(raw[at : at + width], "little")
    value = old + chance.choice((-8, -1, 1, 8)) if chance.random() < 0.4 else chance.choice(_WORDS)
    new = (value % (1 << 8 * width)).to_bytes(width, "little" if order == "little" else "big")
    return raw[:at] + new + raw[at + width :]


def _nothing(chance: Random, raw: bytes) -> bytes:
    """A stretch of NULs, as after a loss of power."""
    at = _place(chance, raw)
    size = chance.choice((1, 4, 64, 512, 4096, 70_000))
    return raw[:at] + bytes(size) + raw[at + chance.choice((0, size)) :]


def _moved(chance: Random, raw: bytes) -> bytes:
    """A stretch is left out, stands twice, or stands elsewhere."""
    at, to = _place(chance, raw), _place(chance, raw)
    size = chance.choice((1, 3, 16, 100, 1000))
    piece = raw[at : at + size]
    rest = raw[:at] + raw[at + size :] if chance.random() < 0.6 else raw
    return rest[:to] + piece * chance.choice((0, 1, 1, 2)) + rest[to:]


def _lines(chance: Random, raw: bytes) -> bytes:
    lines = raw.split(b"\n")
    first, second = chance.randrange(len(lines)), chance.randrange(len(lines))
    kind = chance.randrange(4)
    if kind == 0:
        lines[first], lines[second] = lines[second], lines[first]
    elif kind == 1:
        lines[first] = lines[first][: chance.randrange(80)] + lines[second]
    elif kind == 2:
        lines.insert(first, lines[second] * chance.choice((1, 2, 100)))
    else:
        del lines[first]
    return b"\n".join(lines)


def _long(chance: Random, raw: bytes) -> bytes:
    """A stretch without an end, or very many ends."""
    at = _place(chance, raw)
    filling = chance.choice((b"A", b"0", b" ", b",", b"\n", b"\r", b"[", b"#", b'"', b"\xff"))
    return raw[:at] + filling * chance.choice((300, 66_000, 200_000)) + raw[at:]


def _grafted(chance: Random, raw: bytes, other: bytes) -> bytes:
    at, start = _place(chance, raw), _place(chance, other)
    return raw[:at] + other[start : start + chance.choice((20, 200, 2000))] + raw[at:]


_MUTATIONS: tuple[Mutation, ...] = (
    _bits,
    _bytes,
    _cut,
    _number,
    _word,
    _nothing,
    _moved,
    _lines,
    _long,
)
_WEIGHTS = (20, 15, 5, 15, 15, 4, 10, 8, 1)
