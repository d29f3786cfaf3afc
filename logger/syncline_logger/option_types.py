"""Values on the command line: durations, sizes, and options that take several words as python-can's do."""

import re
from contextlib import suppress
from typing import Literal, get_args

import click

from syncline_schemas.capture.layout import Compression

MAX_ZSTD_LEVEL = 19
ZSTD_LEVEL = 1
"""Where none is given: fast, and for these records also small."""

_UNIT_NS = {
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "m": 60_000_000_000,
    "h": 3_600_000_000_000,
    "d": 86_400_000_000_000,
}


def duration_ns(text: str) -> int:
    """Nanoseconds of a time span written as 500ms, 10s, 5m, 2h, 1d, or in seconds.

    >>> duration_ns("1.5s"), duration_ns("5m")
    (1500000000, 300000000000)
    """
    match = re.fullmatch(r"(\d+)(?:\.(\d{1,9}))?\s*(ms|s|m|h|d)?", text.strip())
    if not match:
        raise click.BadParameter(f"'{text}' is no time; write 500ms, 10s, 5m, 2h or 1d")
    unit = _UNIT_NS[match[3] or "s"]
    billionths = int((match[2] or "").ljust(9, "0"))
    span_ns = int(match[1]) * unit + billionths * unit // 1_000_000_000
    if span_ns == 0:
        raise click.BadParameter("the time must be more than nothing")
    return span_ns


_UNIT_BYTES = {
    "": 1,
    "kb": 10**3,
    "mb": 10**6,
    "gb": 10**9,
    "tb": 10**12,
    "kib": 2**10,
    "mib": 2**20,
    "gib": 2**30,
    "tib": 2**40,
}


def size_bytes(text: str) -> int:
    """Bytes of a size written as 256MB, 4GiB, or in bytes.

    >>> size_bytes("256MB"), size_bytes("1.5 KiB")
    (256000000, 1536)
    """
    match = re.fullmatch(r"(\d+)(?:\.(\d{1,9}))?\s*([kmgt]i?b)?", text.strip().lower())
    if not match:
        raise click.BadParameter(f"'{text}' is no size; write 256MB, 4GB or 1GiB")
    unit = _UNIT_BYTES[match[3] or ""]
    billionths = int((match[2] or "").ljust(9, "0"))
    size = int(match[1]) * unit + billionths * unit // 1_000_000_000
    if size == 0:
        raise click.BadParameter("the size must be more than nothing")
    return size


def size_or_duration(text: str) -> tuple[Literal["bytes", "ns"], int]:
    """A size, or a time span, with which of them it is.

    >>> size_or_duration("20GB"), size_or_duration("14d")
    (('bytes', 20000000000), ('ns', 1209600000000000))
    """
    for unit, parse in (("bytes", size_bytes), ("ns", duration_ns)):
        with suppress(click.BadParameter):
            if not text.strip()[-1:].isdigit():
                return ("bytes" if unit == "bytes" else "ns"), parse(text)
    raise click.BadParameter(f"'{text}' is no size and no time; write 20GB or 14d")


def compression(text: str) -> tuple[Compression, int]:
    """How chunks are compressed, and how hard.

    >>> compression("zstd:3"), compression("lz4")
    (('zstd', 3), ('lz4', 1))
    """
    name, _, level = text.partition(":")
    for known in get_args(Compression):
        if name == known and not level:
            return known, ZSTD_LEVEL
    if name == "zstd" and level.isdecimal() and 1 <= int(level) <= MAX_ZSTD_LEVEL:
        return "zstd", int(level)
    raise click.BadParameter(
        f"'{text}' is no compression; write none, lz4, zstd or zstd:1 ... zstd:{MAX_ZSTD_LEVEL}"
    )


class SeveralWordsCommand(click.Command):
    """A command whose options in `several` take all words up to the next option.

    So that `--bus-kwargs app_name=x serial=1` works as with python-can's own tools.
    """

    several: frozenset[str] = frozenset({"--bus-kwargs", "--timing", "--filter"})

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse with each further word given its option again."""
        spread: list[str] = []
        option = None
        for word in args:
            if word.startswith("-"):
                option = word if word in self.several else None
                if option is None:
                    spread.append(word)
            elif option is not None:
                spread += [option, word]
            else:
                spread.append(word)
        return super().parse_args(ctx, spread)
