"""One contract for every format: the same frames, written by hand, come out of each."""

import gzip
import re
from pathlib import Path

import pytest
import zstandard
from hypothesis import HealthCheck, assume, given, settings

from syncline_analyzer import readers
from syncline_analyzer.readers import open_capture
from syncline_analyzer.readers.formats import READ_FORMATS
from syncline_schemas.errors import CaptureError
from tests.analyzer.log_builder import Row, frame_rows, read, rows
from tests.analyzer.log_files import IDS, LOG_FILES, LogFile
from tests.analyzer.log_frames import FRAMES

each_format = pytest.mark.parametrize("log", LOG_FILES, ids=IDS)
each_quick_format = pytest.mark.parametrize(
    "log",
    [log for log in LOG_FILES if log.cut_step == 1],
    ids=[i for i, log in zip(IDS, LOG_FILES, strict=True) if log.cut_step == 1],
)
FLOAT_NS = 600
"""Floats of today's epoch, as python-can has them, have steps of 238 ns, and two are subtracted."""


def _written(tmp_path: Path, raw: bytes) -> Path:
    # No ending: the content tells the format.
    path = tmp_path / "capture"
    path.write_bytes(raw)
    return path


def _named(path: Path, log: LogFile) -> list[Row]:
    """The frames with the buses in the order of the format's names."""
    batch, facts, _ = read(path)
    assert set(facts.buses) <= set(log.buses)
    return [(t, log.buses.index(facts.buses[bus]), *rest) for t, bus, *rest in rows(batch)]  # type: ignore[misc]


def _tolerant(log: LogFile, frames: list[Row]) -> list[Row]:
    if log.name != "blf":
        return frames
    return [((t_ns + FLOAT_NS) // 1000 * 1000, *rest) for t_ns, *rest in frames]  # type: ignore[misc]


@each_format
def test_every_column_of_every_frame_is_as_it_was_written(log: LogFile, tmp_path: Path) -> None:
    path = _written(tmp_path, log.encode(FRAMES))
    assert _tolerant(log, _named(path, log)) == log.expected()
    _, facts, _ = read(path)
    assert facts.format == log.name
    assert facts.unparsed_lines == []
    assert facts.damage is None
    assert facts.time_base == ("relative" if log.origin_ns else "utc")


@each_quick_format
@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(frames=frame_rows(back=False))
def test_any_frames_come_out_as_they_were_written(
    log: LogFile, tmp_path: Path, frames: list[Row]
) -> None:
    expected = log.expected(frames)
    assume(expected)
    path = _written(tmp_path, log.encode(frames))
    found = _tolerant(log, _named(path, log))
    assert (found if log.ordered else sorted(found)) == (
        expected if log.ordered else sorted(expected)
    )


@each_format
@pytest.mark.parametrize("pack", [gzip.compress, zstandard.compress], ids=["gz", "zst"])
def test_a_packed_file_reads_the_same(log: LogFile, pack: object, tmp_path: Path) -> None:
    raw = log.encode(FRAMES)
    path = _written(tmp_path, pack(raw))  # type: ignore[operator]
    assert _tolerant(log, _named(path, log)) == log.expected()
    assert read(path)[1].path == path


@each_format
def test_a_file_cut_anywhere_in_its_last_kilobyte_gives_what_is_there(
    log: LogFile, tmp_path: Path
) -> None:
    raw = log.encode(FRAMES)
    whole = rows(read(_written(tmp_path, raw))[0])
    for size in range(max(0, len(raw) - 1024), len(raw), log.cut_step):
        path = _written(tmp_path, raw[:size])
        try:
            batch, facts, _ = read(path)
        except CaptureError as error:
            assert str(path) in str(error)  # noqa: PT017  only this error is allowed
            continue
        found = rows(batch)
        # The last line of a text may be cut where nobody can see it.
        trusted = max(0, len(found) - (log.corrupt is not None))
        # Where a group of frames is missing, those of the others are still read.
        expected = whole if log.ordered else [each for each in whole if each in found]
        assert found[:trusted] == expected[:trusted]
        if log.corrupt is None and len(found) < len(whole):
            ends_with_packet = log.name in ("pcap", "pcapng") and not facts.damage
            assert facts.damage or ends_with_packet


@pytest.mark.parametrize(
    "log",
    [log for log in LOG_FILES if log.corrupt],
    ids=[i for i, log in zip(IDS, LOG_FILES, strict=True) if log.corrupt],
)
def test_a_corrupt_line_is_counted_and_costs_no_other(log: LogFile, tmp_path: Path) -> None:
    raw = log.encode(FRAMES)
    assert log.corrupt is not None
    end = raw.index(b"\n", len(raw) * 2 // 3) + 1
    path = _written(tmp_path, raw[:end] + log.corrupt + raw[end:])
    assert _named(path, log) == log.expected()
    _, facts, _ = read(path)
    assert facts.unparsed_count == 1
    assert facts.unparsed_lines[0][0] == raw[:end].count(b"\n") + 1


@each_format
def test_a_window_holds_what_lies_in_it(log: LogFile, tmp_path: Path) -> None:
    path = _written(tmp_path, log.encode(FRAMES * 3))
    everything = rows(read(path)[0])
    start_ns, end_ns = sorted({frame[0] for frame in everything})[1:3]
    reader = open_capture(path, start_ns=start_ns, end_ns=end_ns)
    found = [frame for batch in reader.batches() for frame in rows(batch)]  # type: ignore[arg-type]
    assert found == [frame for frame in everything if start_ns <= frame[0] < end_ns]


def test_the_registry_names_every_reader() -> None:
    folder = Path(readers.__file__).parent
    names = {
        name
        for module in folder.glob("*.py")
        for name in re.findall(
            r'(?:CaptureFacts\(path, |super\(\).__init__\(path, |facts\.format = )"(\w+)"',
            module.read_text("utf-8"),
        )
    }
    assert names == {each.name for each in READ_FORMATS}


def test_every_format_is_in_the_contract() -> None:
    tested = {log.name for log in LOG_FILES} | {"mcap", "mf4"}  # tests of their own
    assert {each.name for each in READ_FORMATS} == tested
