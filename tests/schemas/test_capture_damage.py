"""Files that were cut off, damaged, or never closed: all that is whole is read, nothing raises."""

import random
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.scan import CaptureScan
from syncline_schemas.errors import CaptureError
from tests.schemas.capture_builder import T0, Row, capture_bytes, rows, scanned

CHUNK = 20
WRITTEN = rows(100, buses=2)


def capture(*, finish: bool = True, compression: str = "zstd") -> bytes:
    """Five chunks of twenty frames."""
    return capture_bytes(
        [FrameBatch.from_rows(WRITTEN[i : i + CHUNK]) for i in range(0, 100, CHUNK)],
        buses=2,
        compression=compression,  # type: ignore[arg-type]
        finish=finish,
    )


def chunk_ends(data: bytes) -> list[tuple[int, int]]:
    """(start, end) of each chunk record, as the official reader says."""
    summary = make_reader(BytesIO(data)).get_summary()
    assert summary is not None
    return [
        (index.chunk_start_offset, index.chunk_start_offset + index.chunk_length)
        for index in summary.chunk_indexes
    ]


DATA = capture()
CHUNKS = chunk_ends(DATA)


def expected_frames(size: int) -> list[Row]:
    """Frames of the chunks that lie whole within the first `size` bytes."""
    return WRITTEN[: CHUNK * sum(end <= size for _, end in CHUNKS)]


def test_a_file_cut_at_any_byte_of_its_last_kilobyte_is_read_up_to_the_cut(tmp_path: Path) -> None:
    for size in range(len(DATA) - 1024, len(DATA)):
        found, gaps, scan = scanned(tmp_path / "a.mcap", DATA[:size])
        assert found == WRITTEN
        assert gaps == []
        assert not scan.facts.closed
        assert scan.facts.damage


def test_a_killed_recording_is_read_up_to_the_last_whole_chunk(tmp_path: Path) -> None:
    data = capture(finish=False)
    draw = random.Random(1)
    cuts = {draw.randrange(len(data)) for _ in range(300)}
    cuts |= {place + d for pair in CHUNKS for place in pair for d in (-1, 0, 1)}
    for size in cuts:
        found, gaps, scan = scanned(tmp_path / "a.mcap", data[:size])
        assert found == expected_frames(size)
        assert scan.facts.damage
        cut_chunk = any(start < size < end for start, end in CHUNKS)
        if scan.facts.lost_chunks:
            assert cut_chunk
            assert len(gaps) == 1
            assert gaps[0].end_ns > gaps[0].start_ns >= (found[-1][0] if found else 0)


def test_the_stretch_of_a_chunk_that_is_cut_off_is_a_gap(tmp_path: Path) -> None:
    start, end = CHUNKS[4]
    _, gaps, scan = scanned(tmp_path / "a.mcap", DATA[: end - 1])
    assert gaps == [Gap(WRITTEN[80][0], WRITTEN[99][0] + 1, "damaged chunk in the capture file")]
    assert f"chunk at byte {start} is cut off, 1 bytes are missing" in scan.facts.damage


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("finish", [True, False])
def test_flipped_bits_in_a_chunk_cost_that_chunk_and_are_reported(
    tmp_path: Path, compression: str, finish: bool
) -> None:
    places = chunk_ends(capture(compression=compression))
    data = bytearray(capture(compression=compression, finish=finish))
    start, end = places[2]
    data[end - 30] ^= 0x10
    found, gaps, scan = scanned(tmp_path / "a.mcap", bytes(data))
    assert found == WRITTEN[:40] + WRITTEN[60:]
    reason = "damaged chunk in the capture file"
    assert gaps == [Gap(WRITTEN[40][0], WRITTEN[59][0] + 1, reason, 20)]
    assert (scan.facts.lost_chunks, scan.facts.lost_frames) == (1, 20)
    assert any(f"chunk at byte {start}" in text for text in scan.facts.damage)


@pytest.mark.parametrize("finish", [True, False])
def test_after_an_unreadable_length_the_next_chunk_is_found(tmp_path: Path, finish: bool) -> None:
    data = bytearray(capture(finish=finish))
    start, _ = CHUNKS[1]
    data[start + 4] ^= 0x01
    found, gaps, scan = scanned(tmp_path / "a.mcap", bytes(data))
    assert found == WRITTEN[:20] + WRITTEN[40:]
    assert len(gaps) == 1
    assert gaps[0].start_ns <= WRITTEN[20][0]
    assert gaps[0].end_ns >= WRITTEN[39][0]
    assert scan.facts.lost_chunks == 1


@pytest.mark.parametrize("finish", [True, False])
def test_a_damaged_message_index_costs_nothing(tmp_path: Path, finish: bool) -> None:
    data = bytearray(capture(finish=finish))
    _, end = CHUNKS[1]
    data[end + 9 + 6 + 8] ^= 0x01
    found, gaps, _ = scanned(tmp_path / "a.mcap", bytes(data))
    assert (found, gaps) == (WRITTEN, [])


def test_a_damaged_summary_is_reported_and_not_needed(tmp_path: Path) -> None:
    data = bytearray(DATA)
    data[-100] ^= 0x01
    found, _, scan = scanned(tmp_path / "a.mcap", bytes(data))
    assert found == WRITTEN
    assert scan.facts.damage == ["the summary is damaged; read from the start instead"]


@settings(max_examples=200, deadline=None)
@given(place=st.integers(0, len(DATA) - 1), bit=st.integers(0, 7), finish=st.booleans())
def test_one_flipped_bit_never_raises_nor_invents(
    tmp_path_factory: pytest.TempPathFactory, place: int, bit: int, finish: bool
) -> None:
    data = bytearray(DATA if finish else capture(finish=False))
    data[place % len(data)] ^= 1 << bit
    path = tmp_path_factory.getbasetemp() / "flip.mcap"
    found, _, scan = scanned(path, bytes(data))
    # Bus names and times outside chunks may be the flipped ones; frames are checksummed.
    written = {(t, can_id, flags, dlc, payload) for t, _, can_id, flags, dlc, payload in WRITTEN}
    assert {(t, c, f, d, p) for t, _, c, f, d, p in found} <= written
    if len(found) < len(WRITTEN):
        assert scan.facts.damage


@settings(max_examples=200, deadline=None)
@given(data=st.binary(max_size=400), keep=st.integers(0, len(DATA)))
def test_garbage_after_any_beginning_never_raises(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, keep: int
) -> None:
    found, _, scan = scanned(
        tmp_path_factory.getbasetemp() / "garbage.mcap", DATA[: max(keep, 8)] + data
    )
    assert found == expected_frames(max(keep, 8))
    if data:
        assert scan.facts.damage


@pytest.mark.parametrize("bit", range(8))
def test_a_chunk_whose_mark_is_damaged_is_read_or_missed_aloud(tmp_path: Path, bit: int) -> None:
    data = bytearray(capture(finish=False))
    data[CHUNKS[1][0]] ^= 1 << bit
    found, gaps, scan = scanned(tmp_path / "a.mcap", bytes(data))
    if found != WRITTEN:
        assert found == WRITTEN[:20] + WRITTEN[40:]
        assert (len(gaps), scan.facts.lost_chunks) == (1, 1)


@pytest.mark.parametrize("name", [b"/can/can0/frames", b"syncline.Frame", b"protobuf"])
def test_frames_are_known_when_their_definition_is_damaged(tmp_path: Path, name: bytes) -> None:
    data = bytearray(capture(finish=False))
    place = data.index(name, data.index(b"syncline.Frame"))
    for at in (place - 4, place + 1):
        damaged = bytearray(data)
        damaged[at] ^= 0x02
        found, _, _ = scanned(tmp_path / "a.mcap", bytes(damaged))
        without_bus = [(row[0], *row[2:]) for row in found]
        assert without_bus == [(row[0], *row[2:]) for row in WRITTEN]


def test_a_tail_of_zeros_is_damage(tmp_path: Path) -> None:
    found, _, scan = scanned(tmp_path / "a.mcap", capture(finish=False) + bytes(4096))
    assert found == WRITTEN
    assert any("no readable record" in text for text in scan.facts.damage)


@pytest.mark.parametrize("size", range(9))
def test_empty_and_nearly_empty_files_are_read_as_damaged(tmp_path: Path, size: int) -> None:
    found, gaps, scan = scanned(tmp_path / "a.mcap", DATA[:size])
    assert (found, gaps) == ([], [])
    assert scan.facts.damage


def test_what_is_no_capture_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("(1.0) can0 123#00\n", encoding="utf-8")
    with pytest.raises(CaptureError, match="no MCAP file"):
        CaptureScan(path)
    with pytest.raises(CaptureError, match="cannot be opened"):
        CaptureScan(tmp_path / "missing.mcap")


def test_size_fields_that_lie_do_not_take_memory(tmp_path: Path) -> None:
    data = bytearray(capture(finish=False))
    start, _ = CHUNKS[0]
    data[start + 9 + 16 : start + 9 + 24] = (2**62).to_bytes(8, "little")
    found, _, scan = scanned(tmp_path / "a.mcap", bytes(data))
    assert found == WRITTEN[20:]
    assert scan.facts.lost_frames == 20
    assert WRITTEN[0][0] == T0
