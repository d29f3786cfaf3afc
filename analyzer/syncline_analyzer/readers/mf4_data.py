"""The records of an ASAM MDF 4 file, in one block or a list of them, plain or packed; as far as they stand.

Source: ASAM MDF 4.1, "DTBLOCK", "DZBLOCK" (deflated, or turned about and deflated), "HLBLOCK", "DLBLOCK".
"""

import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from syncline_analyzer.readers.mf4_blocks import HEAD_BYTES, Block, Blocks
from syncline_schemas.named_tuples import NamedTuple

PLAIN: Final = (b"##DT", b"##SD")
_READ_BYTES: Final = 1 << 20
_DZ_BYTES: Final = 24
_TURNED: Final = 1
"""Kind of packing that stores the first byte of each record, then the second of each, and so on."""
_MOST_TURNED: Final = 64 << 20
"""Bytes of a turned block; writers make them of 4 MB."""
_MOST_PIECES: Final = 1_000_000


class Piece(NamedTuple):
    """One block of records.

    Attributes:
        at: of the block.
        start: of what is stored in it; `stored` bytes of that stand.
        size: bytes of records, as the block says.
        packing: None, 0 deflated, 1 turned about and deflated.
        width: bytes of a record, where it is turned about.
        whole: whether it ends within the file.
    """

    at: int
    start: int
    stored: int
    size: int
    packing: int | None
    width: int
    whole: bool


class Data(NamedTuple):
    """What a link to data leads to.

    Attributes:
        pieces: in order; only the last may be cut.
        whole: whether nothing is missing.
        unlisted: whether blocks may stand that a missing list would name.
        known: whether its kind of list is one that is read here.
    """

    pieces: tuple[Piece, ...] = ()
    whole: bool = True
    unlisted: bool = False
    known: bool = True


def data_of(blocks: Blocks, link: int, *, open_end: int = 0) -> Data:
    """The blocks that a link to data leads to.

    Args:
        open_end: where records end whose block was never given a length; 0 if all have one.
    """
    if not link:
        return Data()
    first = blocks.block(link)
    if first is None:
        return Data((), whole=False, unlisted=True)
    if first.mark == b"##HL":
        return _listed(blocks, first.link(0), open_end)
    if first.mark == b"##DL":
        return _listed(blocks, link, open_end)
    found = piece_of(blocks, first, open_end)
    if found is None:
        return Data(known=False)
    return Data((found,), whole=found.whole)


def _listed(blocks: Blocks, link: int, open_end: int) -> Data:
    pieces: list[Piece] = []
    met: set[int] = set()
    while link and link not in met and len(pieces) < _MOST_PIECES:
        met.add(link)
        part = blocks.block(link)
        if part is None or part.mark != b"##DL":
            return Data(tuple(pieces), whole=False, unlisted=True)
        for each in part.links[1:]:
            block = blocks.block(each) if each else None
            found = piece_of(blocks, block, open_end) if block else None
            if each and found is None:
                return Data(tuple(pieces), whole=False)
            if found is not None:
                pieces.append(found)
                if not found.whole:
                    return Data(tuple(pieces), whole=False)
        if not part.whole:
            return Data(tuple(pieces), whole=False, unlisted=True)
        link = part.link(0)
    return Data(tuple(pieces), unlisted=bool(open_end), whole=not open_end)


def piece_of(blocks: Blocks, block: Block, open_end: int = 0) -> Piece | None:
    """A block of records; None where it is none."""
    start = block.at + HEAD_BYTES
    if block.mark in PLAIN:
        stored = block.length - HEAD_BYTES
        if open_end and stored <= 0:
            return Piece(block.at, start, open_end - start, open_end - start, None, 0, whole=False)
        stands = max(0, min(stored, blocks.size - start))
        return Piece(block.at, start, stands, max(0, stored), None, 0, block.whole)
    raw = blocks.read(start, _DZ_BYTES)
    if block.mark != b"##DZ":
        return None
    if len(raw) < _DZ_BYTES:
        return Piece(block.at, start, 0, 0, 0, 0, whole=False)
    packing, width, size, packed = struct.unpack("<2xBxIQQ", raw)
    start += _DZ_BYTES
    stands = max(0, min(packed, blocks.size - start))
    return Piece(block.at, start, stands, size, packing, width, block.whole)


def content(blocks: Blocks, pieces: Sequence[Piece]) -> Iterator[bytes]:
    """The bytes of the records that stand, in parts."""
    for piece in pieces:
        if piece.packing == _TURNED:
            yield _turned_back(blocks, piece)
            continue
        unpack = None if piece.packing is None else zlib.decompressobj()
        left, at, end = piece.size, piece.start, piece.start + piece.stored
        while left > 0 and at < end:
            raw = blocks.read(at, min(_READ_BYTES, end - at))
            at += len(raw)
            for part in [raw] if unpack is None else _inflated(unpack, raw):
                yield part[:left]
                left -= len(part)
                if left <= 0:
                    break


def _inflated(unpack: "zlib._Decompress", raw: bytes) -> Iterator[bytes]:
    try:
        while raw:
            part = unpack.decompress(raw, _READ_BYTES)
            raw = unpack.unconsumed_tail
            if not part:
                return
            yield part
    except zlib.error:
        return


def _turned_back(blocks: Blocks, piece: Piece) -> bytes:
    """A block whose columns were stored one after another: all of it, or nothing."""
    if not piece.whole or piece.size > _MOST_TURNED or not piece.width:
        return b""
    raw = blocks.read(piece.start, piece.stored)
    try:
        flat = zlib.decompressobj().decompress(raw, piece.size)
    except zlib.error:
        return b""
    count = len(flat) // piece.width
    turned = np.frombuffer(flat, np.uint8, count * piece.width).reshape(piece.width, count)
    return turned.T.tobytes() + flat[count * piece.width :]
