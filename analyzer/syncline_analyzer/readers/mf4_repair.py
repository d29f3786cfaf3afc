"""ASAM MDF 4 files that were never finished, or cut off: lengths and counts brought to what stands.

Loggers write what describes the records first and the records after it, as CANedge does; until a file
is closed its counts are not true. Source: ASAM MDF 4.1, "Unfinalized files", "Data block", "Record layout".
"""

import os
import struct
from collections.abc import Iterator
from typing import BinaryIO, Final, NamedTuple

_HD: Final = 64
_HEAD: Final = 24
_FLAGS_AT: Final = 60
_MOST_BLOCKS: Final = 100_000
_VLSD: Final = 1
"""Flag of a channel group: its records are of variable length, each after its length."""
_READ_BYTES: Final = 1 << 20


class _Group(NamedTuple):
    """A channel group: where its block is, and how long its records are; 0 where each tells."""

    at: int
    record_id: int
    cycles: int
    record_bytes: int


def is_whole(file: BinaryIO) -> bool:
    """Whether a file was finished and no data block ends behind it; the file's place is kept."""
    place = file.tell()
    try:
        file.seek(0)
        if file.read(8) == b"UnFinMF ":
            return False
        size = _size(file)
        return all(at + length <= size for _, at, length in _data(file))
    finally:
        file.seek(place)


def mend(file: BinaryIO) -> str | None:
    """Make lengths and counts those of the records that stand; what was missing, None if nothing."""
    size, cut = _size(file), False
    for group, at, length in list(_data(file)):
        unknown = length <= _HEAD
        if not unknown and at + length <= size:
            continue
        cut |= not unknown
        kept, counts = _counted(file, group, at + _HEAD, size)
        _write(file, at + 8, kept - at)
        for each in _groups(file, group):
            _write(file, each.at + 80, counts.get(each.record_id, 0))
    file.seek(0)
    file.write(b"MDF     ")
    file.seek(_FLAGS_AT)
    file.write(bytes(4))
    file.flush()
    return "the file is cut off" if cut else "the file was never finished; what stands is read"


def _size(file: BinaryIO) -> int:
    return file.seek(0, os.SEEK_END)


def _links(file: BinaryIO, at: int, count: int) -> tuple[int, ...]:
    raw = _at(file, at + _HEAD, 8 * count)
    return struct.unpack(f"<{count}Q", raw) if len(raw) == 8 * count else (0,) * count


def _at(file: BinaryIO, at: int, count: int) -> bytes:
    try:
        file.seek(at)
    except (OSError, ValueError, OverflowError):  # further than any file reaches
        return b""
    return file.read(count)


def _write(file: BinaryIO, at: int, value: int) -> None:
    file.seek(at)
    file.write(struct.pack("<Q", value))


def _data(file: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """Of each data group with one plain data block: where it is, where the block is, its length."""
    group = _links(file, _HD, 1)[0]
    for _ in range(_MOST_BLOCKS):
        if not group:
            return
        following, _, data = _links(file, group, 3)
        head = _at(file, data, 16) if data else b""
        if head[:4] == b"##DT" and len(head) == 16:
            yield group, data, struct.unpack("<Q", head[8:])[0]
        group = following


def _groups(file: BinaryIO, data_group: int) -> Iterator[_Group]:
    at = _links(file, data_group, 2)[1]
    for _ in range(_MOST_BLOCKS):
        raw = _at(file, at + 72, 32) if at else b""
        if len(raw) < 32:
            return
        record_id, cycles, flags, _, _, size, invalid = struct.unpack("<QQHHIII", raw)
        yield _Group(at, record_id, cycles, 0 if flags & _VLSD else size + invalid)
        at = _links(file, at, 1)[0]


def _counted(file: BinaryIO, data_group: int, start: int, end: int) -> tuple[int, dict[int, int]]:
    """Where the last whole record ends, and how many records each group has."""
    groups = {each.record_id: each for each in _groups(file, data_group)}
    id_bytes = (_at(file, data_group + _HEAD + 32, 1) or b"\0")[0]
    if not id_bytes:
        sizes = [each.record_bytes for each in groups.values()]
        if len(sizes) != 1 or not sizes[0]:
            return start, {}
        count = (end - start) // sizes[0]
        return start + count * sizes[0], dict.fromkeys(groups, count)
    return _walked(file, groups, id_bytes, (start, end))


def _walked(
    file: BinaryIO, groups: dict[int, _Group], id_bytes: int, span: tuple[int, int]
) -> tuple[int, dict[int, int]]:
    """The same for records of several groups, each after its number."""
    counts = dict.fromkeys(groups, 0)
    at, end = span
    block, begin = b"", at
    while at < end:
        if at + id_bytes + 4 > begin + len(block):
            begin, block = at, _at(file, at, min(_READ_BYTES, end - at))
        place = at - begin
        group = groups.get(int.from_bytes(block[place : place + id_bytes], "little"))
        if group is None:
            break
        size = group.record_bytes
        if not size:
            told = block[place + id_bytes : place + id_bytes + 4]
            if len(told) < 4:
                break
            size = 4 + int.from_bytes(told, "little")
        if at + id_bytes + size > end:
            break
        at += id_bytes + size
        counts[group.record_id] += 1
    return at, counts
