"""ASAM MDF 4 files that were never finished, or cut off: links, lengths and counts brought to what stands.

Loggers write what describes the records first and the records after it, as CANedge does; other tools
write the records first, in lists of blocks. Until a file is closed its counts are not true. Source:
ASAM MDF 4.1, "Unfinalized files", "Data block", "Record layout".
"""

from pathlib import Path
from typing import BinaryIO, Final

from syncline_analyzer.readers.mf4_blocks import HEAD_BYTES, LENGTH_AT, Blocks
from syncline_analyzer.readers.mf4_data import Data, Piece
from syncline_analyzer.readers.mf4_mended_data import counted, mended, unlisted, with_values
from syncline_analyzer.readers.mf4_survey import Group, Records, Survey, survey
from syncline_schemas.errors import CaptureError

_FLAGS_AT: Final = 60
_DATA_LINK_AT: Final = HEAD_BYTES + 2 * 8
_CYCLES_AT: Final = 80
_SIZES_AT: Final = 96


def is_whole(file: BinaryIO) -> bool:
    """Whether a file was finished and no block ends behind it; the file's place is kept."""
    place = file.tell()
    try:
        return survey(Blocks(file)).whole
    finally:
        file.seek(place)


def mend(file: BinaryIO, path: Path) -> str | None:
    """Make links, lengths and counts those of what stands; what was missing, None if nothing.

    Raises:
        CaptureError: nothing tells how the records are laid out; `path` is what the file is called.
    """
    blocks = Blocks(file)
    found = survey(blocks)
    if not found.described:
        raise CaptureError(_undescribed(path, blocks))
    for block, number in found.dangling:
        blocks.write_link(block, number, 0)
    left_out = _adopt(found)
    kept, stated = 0, 0
    for records in found.records:
        stated += sum(each.cycles for each in records.groups.values() if each.record_bytes)
        kept += _mend_records(blocks, records, unfinished=found.unfinished)
    blocks.write(0, int.from_bytes(b"MDF     ", "little"))
    blocks.write(_FLAGS_AT, 0, "<I")
    file.flush()
    return _damage(found, kept, stated, left_out)


def _undescribed(path: Path, blocks: Blocks) -> str:
    pieces = list(unlisted(blocks, set(), b"##DT"))
    size = sum(each.stored for each in pieces)
    stands = (
        f"{len(pieces)} block(s) with {size} bytes of them stand, which nothing tells how to read"
    )
    return (
        f"{path}: an ASAM MDF file cut off after {blocks.size} bytes, before what describes its"
        f" records: {stands if pieces else 'none of them stand'}"
    )


def _damage(found: Survey, kept: int, stated: int, left_out: int) -> str | None:
    said = []
    if found.unfinished:
        said.append(f"the file was never finished; what stands is read: {kept} records")
    elif stated:
        said.append(f"the file is cut off: {kept} of {stated} records stand")
    else:
        said.append("the file is cut off")
    if found.undescribed:
        said.append(f"what describes {'some of ' if stated else ''}its records is missing")
    if left_out:
        said.append(f"{left_out} block(s) of records are left out that no list names")
    return "; ".join(said)


def _adopt(found: Survey) -> int:
    """Add blocks that no list names where only one can have named them; how many are left out."""
    missing = [each for each in found.records if each.data.unlisted]
    if not missing:
        return 0
    known = {piece.at for each in found.records for piece in each.data.pieces}
    open_end = found.blocks.size if found.unfinished else 0
    pieces = list(unlisted(found.blocks, known, b"##DT", open_end))
    if len(missing) > 1:
        return len(pieces)
    records = missing[0]
    ends = next((number for number, each in enumerate(pieces) if not each.whole), len(pieces))
    data = Data((*records.data.pieces, *pieces[: ends + 1]), whole=False)
    found.records[found.records.index(records)] = records._replace(data=data)
    return 0


def _mend_records(blocks: Blocks, records: Records, *, unfinished: bool) -> int:
    """Let a data group end with what stands of it; how many records do."""
    cut = [each for each in records.signals if not each.data.whole]
    if not records.data.known or (records.data.whole and not cut and not unfinished):
        return sum(each.cycles for each in records.groups.values() if _frames(each))
    pieces: tuple[Piece, ...] = records.data.pieces
    if not records.data.whole:
        pieces = mended(blocks, records.at + _DATA_LINK_AT, records.data)
    size, counts = counted(blocks, pieces, records.groups, records.id_bytes)
    if len(pieces) == 1 and pieces[0].packing is None:
        blocks.write(pieces[0].at + LENGTH_AT, HEAD_BYTES + size)
    cut = [each._replace(data=Data(mended(blocks, each.link_at, each.data))) for each in cut]
    kept = 0
    for group in records.groups.values():
        count = counts.get(group.record_id)
        if count is None:
            continue
        most = count.records if unfinished else min(count.records, group.cycles)
        for signal in cut if not records.id_bytes else ():
            most = with_values(blocks, pieces, group.record_bytes, signal, most)
        blocks.write(group.at + _CYCLES_AT, most)
        kept += most if _frames(group) else 0
        if not group.record_bytes:
            blocks.write(group.at + _SIZES_AT, count.bytes)
    return kept


def _frames(group: Group) -> bool:
    """Whether the records of a group are ones that can be read, and no values of other ones."""
    return group.described and group.record_bytes > 0
