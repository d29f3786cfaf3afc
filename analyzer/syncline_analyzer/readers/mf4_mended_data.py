"""Lists of records of an ASAM MDF 4 file that end where the file does, and the records they hold counted.

Source: ASAM MDF 4.1, "DLBLOCK", "Record layout", "VLSD".
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from syncline_analyzer.readers.mf4_blocks import HEAD_BYTES, LENGTH_AT, MOST_BLOCKS, Blocks
from syncline_analyzer.readers.mf4_data import PLAIN, Data, Piece, content, piece_of
from syncline_analyzer.readers.mf4_survey import Group, Signal
from syncline_schemas.named_tuples import NamedTuple

_FIRST: Final = 64
_MOST_UNPACKED: Final = 64 << 20
"""Bytes of a cut packed block; writers make them of 4 MB."""
_MOST_RECORD: Final = 1 << 24
_PLACE_BYTES: Final = 8


class Count(NamedTuple):
    """Records of a channel group, and the bytes of those that tell their length."""

    records: int = 0
    bytes: int = 0


def mended(blocks: Blocks, link_at: int, data: Data) -> tuple[Piece, ...]:
    """The blocks of records, all of them whole, to which the link at a place then leads."""
    pieces = [each for each in data.pieces if each.whole]
    if data.pieces and not data.pieces[-1].whole:
        pieces += _standing(blocks, data.pieces[-1])
    if len(pieces) < 2:
        blocks.write(link_at, pieces[0].at if pieces else 0)
        return tuple(pieces)
    places = np.cumsum([0, *(each.size for each in pieces[:-1])]).astype("<u8")
    head = bytes(4) + len(pieces).to_bytes(4, "little")
    listed = blocks.append(b"##DL", (0, *(each.at for each in pieces)), head + places.tobytes())
    blocks.write(link_at, listed)
    return tuple(pieces)


def _standing(blocks: Blocks, piece: Piece) -> Iterator[Piece]:
    """What stands of a cut block, as a whole one."""
    if piece.packing is None and piece.stored:
        blocks.write(piece.at + LENGTH_AT, HEAD_BYTES + piece.stored)
        yield piece._replace(size=piece.stored, whole=True)
        return
    mark = b"##" + blocks.read(piece.at + HEAD_BYTES, 2)
    if piece.packing is None or mark not in PLAIN:
        return
    unpacked = b""
    for part in content(blocks, [piece]):
        unpacked += part
        if len(unpacked) >= _MOST_UNPACKED:
            break
    if unpacked:
        at = blocks.append(mark, (), unpacked)
        size = len(unpacked)
        yield Piece(at, at + HEAD_BYTES, size, size, None, 0, whole=True)


def unlisted(blocks: Blocks, known: set[int], kind: bytes, open_end: int = 0) -> Iterator[Piece]:
    """The blocks of records, in the order of the file, that no list names; see `data_of`."""
    at = _FIRST
    for _ in range(MOST_BLOCKS):
        block = blocks.block(at)
        if block is None or block.mark[:2] != b"##":
            return
        found = piece_of(blocks, block, open_end) if at not in known else None
        packed = b"##" + blocks.read(at + HEAD_BYTES, 2) if block.mark == b"##DZ" else block.mark
        if found is not None and packed == kind:
            yield found
        at += max(block.length, HEAD_BYTES)
        at += -at % 8


def counted(
    blocks: Blocks, pieces: Sequence[Piece], groups: Mapping[int, Group], id_bytes: int
) -> tuple[int, dict[int, Count]]:
    """How many bytes the whole records of these blocks have, and how many records each group has."""
    if id_bytes:
        return _walked(content(blocks, pieces), groups, id_bytes)
    sizes = [each.record_bytes for each in groups.values()]
    if len(sizes) != 1 or not sizes[0]:
        return 0, {}
    count = sum(each.size for each in pieces) // sizes[0]
    return count * sizes[0], dict.fromkeys(groups, Count(count))


def _walked(
    parts: Iterator[bytes], groups: Mapping[int, Group], id_bytes: int
) -> tuple[int, dict[int, Count]]:
    """The same for records of several groups, each after its number."""
    records, sizes = dict.fromkeys(groups, 0), dict.fromkeys(groups, 0)
    held, at, gone = b"", 0, 0
    while True:
        size = _record_bytes(held, at, groups, id_bytes)
        if size is None or size > _MOST_RECORD:
            break
        if not size or at + size > len(held):
            more = next(parts, b"")
            if not more:
                break
            held, gone, at = held[at:] + more, gone + at, 0
            continue
        number = int.from_bytes(held[at : at + id_bytes], "little")
        records[number] += 1
        sizes[number] += size - id_bytes
        at += size
    counts = {
        number: Count(records[number], 0 if group.record_bytes else sizes[number])
        for number, group in groups.items()
    }
    return gone + at, counts


def _record_bytes(held: bytes, at: int, groups: Mapping[int, Group], id_bytes: int) -> int | None:
    """The length of the record at a place; 0 where more bytes are needed, None if it is none."""
    if len(held) - at < id_bytes:
        return 0
    group = groups.get(int.from_bytes(held[at : at + id_bytes], "little"))
    if group is None:
        return None
    if group.record_bytes:
        return id_bytes + group.record_bytes
    told = held[at + id_bytes : at + id_bytes + 4]
    return id_bytes + 4 + int.from_bytes(told, "little") if len(told) == 4 else 0


def with_values(
    blocks: Blocks, pieces: Sequence[Piece], record_bytes: int, signal: Signal, most: int
) -> int:
    """How many of the first records have their values of any length among those that stand.

    Args:
        signal: with what stands of its values.
    """
    if record_bytes < signal.byte + _PLACE_BYTES:
        return most
    stands = sum(each.size for each in signal.data.pieces)
    count, last = 0, 0
    held = b""
    for part in content(blocks, pieces):
        held += part
        rows = len(held) // record_bytes
        if not rows:
            continue
        table = np.frombuffer(held, np.uint8, rows * record_bytes).reshape(rows, record_bytes)
        places = np.ascontiguousarray(table[:, signal.byte : signal.byte + _PLACE_BYTES]).view(
            "<u8"
        )[:, 0]
        within = places <= np.uint64(max(stands - 4, 0))
        kept = rows if within.all() else int(np.argmin(within))
        if kept:
            last = int(places[kept - 1])
        count, held = count + kept, held[rows * record_bytes :]
        if kept < rows:
            break
    if count and last + 4 + _length_at(blocks, signal.data.pieces, last) > stands:
        count -= 1
    return min(count, most)


def _length_at(blocks: Blocks, pieces: Sequence[Piece], place: int) -> int:
    """The length that stands before the value at a place of the unpacked values."""
    held, gone = b"", 0
    for part in content(blocks, pieces):
        held += part
        if gone + len(held) >= place + 4:
            return int.from_bytes(held[place - gone : place - gone + 4], "little")
        keep = min(len(held), max(0, gone + len(held) - place))
        gone, held = gone + len(held) - keep, held[len(held) - keep :]
    return 1 << 32
