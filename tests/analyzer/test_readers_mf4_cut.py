"""ASAM MDF 4 files that end too early: what stands is read, and what is missing is told."""

import re
import struct
from pathlib import Path

import pytest

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.readers.mf4_child import messages
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.errors import CaptureError
from tests.analyzer.log_builder import Row, row, rows
from tests.analyzer.log_frames import FRAMES
from tests.analyzer.mf4_files import (
    RECORD_BYTES,
    canedge,
    canedge_unsorted,
    kind_of,
    listed_mf4,
    mf4,
)

pytest.importorskip("asammdf")

LOGGED = tuple(
    row(number * 1000, 0x181 + number % 4, bytes([number % 256, number // 256]), bus=number % 2)
    if number % 5
    else row(number * 1000, 0x70A, flags=FrameFlag.REMOTE, dlc=1)
    for number in range(60)
)
PER_BLOCK = 16
"""60 records: three full blocks and one of 12."""


def _read(folder: Path, raw: bytes) -> tuple[list[Row], CaptureFacts]:
    """What the process that reads MDF tells, in this one."""
    path = folder / "x.mf4"
    path.write_bytes(raw)
    told = list(messages(path))
    facts = told[-1].facts
    assert facts is not None
    found = rows(FrameBatch.concat([each.frames for each in told if each.frames is not None]))
    return [(each[0], int(facts.buses[each[1]]) - 1, *each[2:]) for each in found], facts


def _starts(raw: bytes, mark: bytes) -> list[int]:
    return [found.start() for found in re.finditer(re.escape(mark), raw)]


@pytest.mark.parametrize("list_first", [True, False])
@pytest.mark.parametrize("packing", [None, 0, 1])
def test_lists_of_records_that_stand_whole_need_no_repair(
    tmp_path: Path, packing: int | None, list_first: bool
) -> None:
    raw = listed_mf4(LOGGED, per_block=PER_BLOCK, packing=packing, list_first=list_first)
    found, facts = _read(tmp_path, raw)
    assert found == list(LOGGED)
    assert facts.damage is None


@pytest.mark.parametrize("list_first", [True, False])
def test_a_list_of_plain_blocks_gives_every_record_before_the_cut(
    tmp_path: Path, list_first: bool
) -> None:
    raw = listed_mf4(LOGGED, per_block=PER_BLOCK, list_first=list_first)
    third = _starts(raw, b"##DT")[2]
    found, facts = _read(tmp_path, raw[: third + 24 + 5 * RECORD_BYTES + 7])
    assert found == list(LOGGED[: 2 * PER_BLOCK + 5])
    assert facts.damage == "the file is cut off: 37 of 60 records stand"


@pytest.mark.parametrize("list_first", [True, False])
@pytest.mark.parametrize("packing", [0, 1])
def test_a_cut_packed_block_gives_what_can_be_unpacked(
    tmp_path: Path, packing: int, list_first: bool
) -> None:
    raw = listed_mf4(LOGGED, per_block=PER_BLOCK, packing=packing, list_first=list_first)
    third, fourth = _starts(raw, b"##DZ")[2:]
    found, facts = _read(tmp_path, raw[: fourth - 20])
    assert found == list(LOGGED[: len(found)])
    # Of records that were turned about nothing is whole before the end.
    assert len(found) == 2 * PER_BLOCK if packing else 2 * PER_BLOCK < len(found) < 3 * PER_BLOCK
    assert facts.damage == f"the file is cut off: {len(found)} of 60 records stand"
    assert _read(tmp_path, raw[: third + 3])[0] == list(LOGGED[: 2 * PER_BLOCK])


def test_blocks_whose_list_is_missing_are_found_where_they_stand(tmp_path: Path) -> None:
    raw = listed_mf4(LOGGED, per_block=PER_BLOCK)
    listed = _starts(raw, b"##DL")[0]
    for end in (listed, listed + 10, listed + 40, len(raw) - 1):
        found, facts = _read(tmp_path, raw[:end])
        assert found == list(LOGGED)
        assert facts.damage == "the file is cut off: 60 of 60 records stand"


def test_values_that_stand_apart_end_the_frames_where_they_do(tmp_path: Path) -> None:
    frames = [row(number * 1000, 0x181, bytes([number, 1, 2])) for number in range(20)]
    raw = canedge(frames)
    start = _starts(raw, b"##SD")[0]
    values = raw[start : start + int.from_bytes(raw[start + 8 : start + 16], "little")]
    moved = len(raw) + -len(raw) % 8
    raw = raw.replace(struct.pack("<Q", start), struct.pack("<Q", moved))
    raw = raw.ljust(moved, b"\0") + values
    assert _read(tmp_path, raw)[0] == frames
    # Each value: four bytes of length, 64 of data.
    for missing, kept in ((1, 19), (67, 19), (68, 19), (69, 18), (10 * 68, 10)):
        found, facts = _read(tmp_path, raw[: len(raw) - missing])
        assert found == frames[:kept]
        assert facts.damage == f"the file is cut off: {kept} of 20 records stand"


def test_groups_whose_description_stands_are_read_without_the_others(tmp_path: Path) -> None:
    raw = mf4(FRAMES)
    last = _starts(raw, b"##CG")[-1]
    found, facts = _read(tmp_path, raw[: last + 50])
    kinds = list(dict.fromkeys(kind_of(frame) for frame in FRAMES))
    assert found == [frame for frame in FRAMES if kind_of(frame) in kinds[:2]]
    assert "what describes some of its records is missing" in (facts.damage or "")


@pytest.mark.parametrize(
    ("mark", "said"),
    [
        (b"##DG", r"cut off after \d+ bytes, before what describes .* 3 block\(s\) with \d+ bytes"),
        (
            b"##CG",
            "without recorded CAN frames; the file is cut off; what describes its records is",
        ),
        (b"##HD", "cut off after 64 bytes, before what describes .* none of them stand"),
    ],
)
def test_a_file_that_describes_no_records_is_refused_with_what_was_found(
    tmp_path: Path, mark: bytes, said: str
) -> None:
    raw = mf4(FRAMES)
    with pytest.raises(CaptureError, match=said) as caught:
        _read(tmp_path, raw[: _starts(raw, mark)[0]])
    assert str(caught.value).startswith(str(tmp_path / "x.mf4"))


def test_every_cut_of_the_last_kilobyte_tells_what_is_missing(tmp_path: Path) -> None:
    raw = listed_mf4(LOGGED, per_block=PER_BLOCK, packing=0)
    before = len(LOGGED)
    for missing in range(1, 1024, 7):
        found, facts = _read(tmp_path, raw[: len(raw) - missing])
        assert found == list(LOGGED[: len(found)])
        assert len(found) <= before
        assert facts.damage == f"the file is cut off: {len(found)} of 60 records stand"
        before = len(found)


APART = [row(number * 1000, 0x181 + number, bytes(range(number % 9))) for number in range(20)]


@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize("missing", [0, 1, 200])
def test_data_bytes_in_records_of_their_own_are_read_to_the_cut(
    tmp_path: Path, finished: bool, missing: int
) -> None:
    raw = canedge_unsorted(APART, finished=finished)
    found, facts = _read(tmp_path, raw[: len(raw) - missing])
    assert found == APART[: len(found)]
    sizes = [RECORD_BYTES + 5 + len(frame[5]) for frame in APART]
    stands = sum(sizes) - missing
    assert len(found) == sum(sum(sizes[: n + 1]) <= stands for n in range(len(sizes)))
    if finished and missing:
        assert facts.damage == f"the file is cut off: {len(found)} of 20 records stand"


def test_frames_whose_data_bytes_lie_outside_are_left_out(tmp_path: Path) -> None:
    raw = bytearray(canedge(APART))
    data = _starts(bytes(raw), b"##DT")[0]
    record_bytes = (int.from_bytes(raw[data + 8 : data + 16], "little") - 24) // len(APART)
    # The place of the bytes is the last field of a record.
    end = data + 24 + 5 * record_bytes
    raw[end - 8 : end] = struct.pack("<Q", 1 << 62)
    found, facts = _read(tmp_path, bytes(raw))
    assert found == APART[:4] + APART[5:]
    assert facts.damage == "the data bytes of 1 frame(s) are missing"


def test_records_that_a_count_names_and_that_are_missing_are_told(tmp_path: Path) -> None:
    raw = bytearray(mf4(FRAMES))
    group = _starts(bytes(raw), b"##CG")[0]
    count = int.from_bytes(raw[group + 80 : group + 88], "little")
    raw[group + 80 : group + 88] = struct.pack("<Q", count + 1000)
    found, facts = _read(tmp_path, bytes(raw))
    assert sorted(found) == sorted(FRAMES)
    assert f"1000 of {count + 1000} records of {kind_of(FRAMES[0])} are missing" == facts.damage


def test_a_list_that_was_never_finished_gives_the_blocks_behind_it(tmp_path: Path) -> None:
    raw = bytearray(listed_mf4(LOGGED, per_block=PER_BLOCK, list_first=True))
    listed, last = _starts(bytes(raw), b"##DL")[0], _starts(bytes(raw), b"##DT")[-1]
    # The last two links and the length of the last block were still to be written, and all counts.
    raw[listed + 32 + 16 : listed + 32 + 32] = bytes(16)
    raw[last + 8 : last + 16] = struct.pack("<Q", 24)
    for group in _starts(bytes(raw), b"##CG"):
        raw[group + 80 : group + 88] = bytes(8)
    raw[:8], raw[60:62] = b"UnFinMF ", struct.pack("<H", 0x15)
    found, facts = _read(tmp_path, bytes(raw))
    assert found == list(LOGGED)
    assert facts.damage == "the file was never finished; what stands is read: 60 records"
