"""Blocks of an ASAM MDF 4 file, as far as they stand: a cut file has links to what is not there.

Source: ASAM MDF 4.1, "Block structure": id, reserved, length, number of links, links, then data.
"""

import os
import struct
from typing import BinaryIO, Final

from syncline_schemas.named_tuples import NamedTuple

HEAD_BYTES: Final = 24
LENGTH_AT: Final = 8
"""Of a block: where its length stands."""
MOST_BLOCKS: Final = 1_000_000
"""Of a file that are looked at one after another."""
_MOST_LINKS: Final = 1 << 16
_MOST_LISTED: Final = 1 << 24
"""Links of a list of records, which may be long."""
_ALIGNED: Final = 8


class Block(NamedTuple):
    """A block of which at least the head stands.

    Attributes:
        at: where it begins.
        mark: its id, such as b"##DG".
        length: of all of it, as its head says.
        links: those that stand.
        whole: whether it ends within the file.
    """

    at: int
    mark: bytes
    length: int
    links: tuple[int, ...]
    whole: bool

    def link(self, number: int) -> int:
        """A link, 0 where there is none."""
        return self.links[number] if number < len(self.links) else 0

    @property
    def data_at(self) -> int:
        """Where what follows the links begins."""
        return self.at + HEAD_BYTES + 8 * len(self.links)


class Blocks:
    """The blocks of a file, by their places."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.size = file.seek(0, os.SEEK_END)

    def read(self, at: int, count: int) -> bytes:
        """Bytes of the file; fewer where it ends, none where no file reaches."""
        if at >= self.size or count <= 0:
            return b""
        self.file.seek(at)
        return self.file.read(count)

    def block(self, at: int) -> Block | None:
        """The block at an address; None where not even its head stands."""
        raw = self.read(at, HEAD_BYTES) if at else b""
        if len(raw) < HEAD_BYTES:
            return None
        mark, _, length, count = struct.unpack("<4sIQQ", raw)
        most = _MOST_LISTED if mark == b"##DL" else _MOST_LINKS
        stored = self.read(at + HEAD_BYTES, 8 * min(count, most))
        links = struct.unpack(f"<{len(stored) // 8}Q", stored[: len(stored) // 8 * 8])
        whole = at + max(length, HEAD_BYTES) <= self.size and len(links) == count
        return Block(at, mark, length, links, whole)

    def write(self, at: int, value: int, form: str = "<Q") -> None:
        """Put a number in its place."""
        self.file.seek(at)
        self.file.write(struct.pack(form, value))

    def write_link(self, block: Block, number: int, to: int) -> None:
        """Let a link of a block lead elsewhere, 0 being nowhere."""
        self.write(block.at + HEAD_BYTES + 8 * number, to)

    def append(self, mark: bytes, links: tuple[int, ...], data: bytes) -> int:
        """Write a block behind all others; where it stands."""
        end = self.file.seek(0, os.SEEK_END)
        self.file.write(bytes(-end % _ALIGNED))
        at = self.file.tell()
        length = HEAD_BYTES + 8 * len(links) + len(data)
        head = struct.pack(f"<4sIQQ{len(links)}Q", mark, 0, length, len(links), *links)
        self.file.write(head + data)
        self.size = self.file.tell()
        return at
