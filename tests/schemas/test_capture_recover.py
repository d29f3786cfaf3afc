"""Recovery makes a file that strangers can read, with all that was whole in the damaged one."""

import subprocess
import sys
from io import BytesIO
from pathlib import Path

import pytest
from mcap.reader import make_reader

from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import Attachment
from syncline_schemas.capture.recover import is_whole, recover
from syncline_schemas.errors import CaptureError, UsageError
from tests.schemas.capture_builder import capture_bytes, official_messages, rows, scanned

WRITTEN = rows(100, buses=2)


def killed() -> bytes:
    """Five chunks of twenty frames, never closed."""
    return capture_bytes(
        [FrameBatch.from_rows(WRITTEN[i : i + 20]) for i in range(0, 100, 20)],
        buses=2,
        attachments=[Attachment("bus-description.toml", "application/toml", b"[bus]")],
        finish=False,
    )


def doctor(path: Path) -> None:
    """Fail unless the doctor finds neither errors nor warnings."""
    program = Path(sys.executable).with_name("pymcap-cli")
    if program.exists():
        arguments = [
            str(program),
            "doctor",
            "--strict-message-order",
            "--format",
            "jsonl",
            str(path),
        ]
        done = subprocess.run(arguments, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout
        assert '"warning"' not in done.stdout


def test_a_killed_recording_becomes_a_regular_file(tmp_path: Path) -> None:
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    source.write_bytes(killed())
    assert not is_whole(source)
    result = recover(source, target)
    assert is_whole(target)
    assert (result.frames, result.messages, result.lost_chunks) == (100, 100, 0)
    assert not result.whole
    closed = capture_bytes(
        [FrameBatch.from_rows(WRITTEN[i : i + 20]) for i in range(0, 100, 20)], buses=2
    )
    records = [each.record for each in official_messages(target.read_bytes())]
    assert records == [each.record for each in official_messages(closed)]
    reader = make_reader(BytesIO(target.read_bytes()), validate_crcs=True)
    assert [a.name for a in reader.iter_attachments()] == ["bus-description.toml"]
    assert reader.get_summary() is not None
    found, gaps, scan = scanned(target)
    assert (found, gaps, scan.facts.damage) == (WRITTEN, [], [])
    assert scan.facts.metadata is not None
    doctor(target)


@pytest.mark.parametrize("cut", [5, 100, 700])
def test_a_lost_chunk_leaves_a_gap(tmp_path: Path, cut: int) -> None:
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    source.write_bytes(killed()[:-cut])
    before, gaps_before, _ = scanned(source)
    result = recover(source, target)
    found, gaps, scan = scanned(target)
    assert found == before
    assert gaps == gaps_before
    assert result.frames == len(found)
    assert result.lost_chunks == len(gaps)
    assert scan.facts.damage == []
    assert scan.facts.metadata_records["syncline.recover"]["source"] == "a.mcap"
    doctor(target)


def test_a_damaged_chunk_in_the_middle_leaves_a_gap(tmp_path: Path) -> None:
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    data = bytearray(killed())
    place = len(data) // 2
    data[place : place + 10] = bytes(10)
    found_before, gaps_before, _ = scanned(source, bytes(data))
    result = recover(source, target)
    found, gaps, _ = scanned(target)
    assert (found, gaps) == (found_before, gaps_before)
    assert len(found) == 80
    assert (result.lost_chunks, len(gaps)) == (1, 1)
    doctor(target)


def test_every_cut_recovers(tmp_path: Path) -> None:
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    data = killed()
    for size in range(0, len(data), 61):
        source.write_bytes(data[:size])
        recover(source, target)
        assert is_whole(target)
        assert scanned(target)[0] == scanned(source)[0]


def test_a_whole_file_stays_whole(tmp_path: Path) -> None:
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    source.write_bytes(capture_bytes([FrameBatch.from_rows(WRITTEN)], buses=2))
    result = recover(source, target)
    assert result.whole
    assert result.damage == []
    assert scanned(target)[0] == WRITTEN


def test_nothing_is_left_behind_when_the_source_is_no_capture(tmp_path: Path) -> None:
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    source.write_text("no capture at all", encoding="utf-8")
    with pytest.raises(CaptureError):
        recover(source, target)
    assert list(tmp_path.iterdir()) == [source]


def test_a_file_is_not_recovered_onto_itself(tmp_path: Path) -> None:
    source = tmp_path / "a.mcap"
    source.write_bytes(killed())
    with pytest.raises(UsageError):
        recover(source, source)
    with pytest.raises(CaptureError):
        is_whole(tmp_path / "missing.mcap")
