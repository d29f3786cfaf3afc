"""Captures read by another process tell what they tell in one, and how that process may end."""

import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest

from syncline_analyzer import open_session
from syncline_analyzer.batch_transfer import packed, unpacked
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.reading import LocalReading
from syncline_analyzer.reading_child import begun
from syncline_analyzer.reading_request import Request
from syncline_analyzer.remote_reading import RemoteReading
from syncline_analyzer.session import Session
from syncline_analyzer.views.json_view import to_object
from syncline_schemas import second_process
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.capture.layout import BusInfo, CaptureMetadata
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.errors import CaptureError, SynclineError, UsageError

SAMPLES = Path(__file__).parents[2] / "samples"
SECOND = 1_000_000_000
T0 = 1_790_000_000 * SECOND
NOTHING_IS_WORTH_IT = 1 << 60


@cache
def traffic(frames: int, buses: int = 1) -> FrameBatch:
    """Heartbeats, a SYNC, PDOs and some error frames, a frame every 400 us."""
    row = np.arange(frames)
    ids = np.array([0x080, 0x181, 0x182, 0x183, 0x701, 0x702], np.uint32)[row % 6]
    data = np.zeros((frames, 8), np.uint8)
    data[:, 0] = np.where(ids >= 0x700, 5, row % 251)
    flags = np.where(row % 1009 == 1008, int(FrameFlag.ERROR), 0).astype(np.uint16)
    lengths = np.where(flags > 0, 8, np.where(ids == 0x080, 0, np.where(ids >= 0x700, 1, 8)))
    data[ids == 0x080] = 0
    return FrameBatch(
        T0 + row * 400_000,
        (row // 7 % buses).astype(np.uint8),
        np.where(flags > 0, np.uint32(0x4), ids),
        flags,
        lengths.astype(np.uint8),
        data,
    )


def write(path: Path, frames: FrameBatch, segment: int | None = None) -> Path:
    """A capture of ours; with a number, a segment of one recording."""
    recording = "one" if segment is not None else path.stem
    metadata = CaptureMetadata("0", recording, segment=segment or 0, clock="kernel")
    with path.open("wb") as stream:
        writer = CaptureWriter(stream, metadata, [BusInfo("a", 0, 500_000), BusInfo("b", 1)])
        writer.write_frames(frames)
        writer.finish()
    return path


@pytest.fixture(params=["samples", "two buses", "segments", "overlapping", "damaged", "cut"])
def captures(request: pytest.FixtureRequest, tmp_path: Path) -> list[Path]:
    """Captures of one machine; the frames are more than go into one batch."""
    frames, made = traffic(90_000), tmp_path / "a.mcap"
    match request.param:
        case "samples":
            return [SAMPLES / "bad_day.mcap"]
        case "two buses":
            return [write(made, traffic(90_000, 2))]
        case "segments":
            edges = pairwise((0, 10_000, 45_000, 90_000))
            parts = [frames[begin:stop] for begin, stop in edges]
            return [write(tmp_path / f"{n}.mcap", part, n) for n, part in enumerate(parts)]
        case "overlapping":
            late = frames[15_000:22_000]
            return [write(made, frames[:20_000]), write(tmp_path / "b.mcap", late)]
    write(made, frames)
    content = bytearray(made.read_bytes())
    if request.param == "damaged":
        content[len(content) // 2] ^= 0xFF
    made.write_bytes(content if request.param == "damaged" else content[: len(content) // 2])
    return [made]


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A capture of a few frames."""
    return write(tmp_path / "small.mcap", traffic(500))


@pytest.fixture
def other_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """However small captures are, another process reads them."""
    monkeypatch.setattr(second_process, "LEAST_BYTES", 0)
    monkeypatch.setattr(second_process, "processors", lambda: 2)


def told(session: Session, least_bytes: int, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.setattr(second_process, "LEAST_BYTES", least_bytes)
    return to_object(session.analysis)


@pytest.mark.usefixtures("other_process")
def test_two_processes_tell_what_one_tells(
    captures: Sequence[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = told(open_session(captures), NOTHING_IS_WORTH_IT, monkeypatch)
    two = told(open_session(captures), 0, monkeypatch)
    assert one["capture"]["frames"] > 10_000
    for table in one:
        assert two[table] == one[table], table


@pytest.mark.usefixtures("other_process")
@pytest.mark.parametrize(
    ("capture", "start", "end"),
    [
        ("healthy_line.mcap", None, None),
        ("jittery_sync.log", None, None),
        ("bad_day.mcap", "10s", "1m"),
        ("jittery_sync.log", "5s", None),
    ],
)
def test_samples_and_stretches_of_them(
    capture: str, start: str | None, end: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = SAMPLES / capture
    one = told(open_session(path, start=start, end=end), NOTHING_IS_WORTH_IT, monkeypatch)
    two = told(open_session(path, start=start, end=end), 0, monkeypatch)
    for table in one:
        assert two[table] == one[table], table


@pytest.mark.usefixtures("other_process")
def test_the_other_process_is_used_and_gone_in_the_end(small: Path) -> None:
    with begun(Request([small])) as opened:
        reading = opened()
        assert isinstance(reading, RemoteReading)
        process = reading._child.process
        next(reading.steps())
    assert process.returncode is not None


@pytest.mark.usefixtures("other_process")
@pytest.mark.parametrize("least_bytes", [0, NOTHING_IS_WORTH_IT])
def test_what_is_to_be_done_meanwhile_comes_before_the_frames(
    small: Path, least_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(second_process, "LEAST_BYTES", least_bytes)
    done: list[int] = []
    session = open_session(small)
    session.analyze(done.append, lambda: done.append(-1))
    session.analyze(done.append, lambda: done.append(-1))
    assert done[0] == -1
    assert done.count(-1) == 1
    assert done[-1] == 500


@pytest.mark.usefixtures("other_process")
def test_it_is_gone_after_an_error_of_the_analysis(
    small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def noted(*args: Any, **options: Any) -> subprocess.Popen[bytes]:
        started.append(popen(*args, **options))
        return started[-1]

    def stop(frames: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess, "Popen", noted)
    with pytest.raises(KeyboardInterrupt):
        open_session(small).analyze(stop)
    assert [each.returncode is not None for each in started] == [True]


@pytest.mark.usefixtures("other_process")
@pytest.mark.parametrize(("start", "end"), [("20s", "10s"), ("9h", None)])
def test_errors_are_those_of_one_process(
    small: Path, start: str, end: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts = []
    for least in (NOTHING_IS_WORTH_IT, 0):
        with pytest.raises(UsageError) as raised:
            told(open_session(small, start=start, end=end), least, monkeypatch)
        texts.append(str(raised.value))
    assert texts[0] == texts[1]


@pytest.mark.usefixtures("other_process")
@pytest.mark.parametrize("content", [b"no capture at all", bytes(range(256))])
def test_a_file_that_is_no_capture(
    content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    texts = []
    for least in (NOTHING_IS_WORTH_IT, 0):
        with pytest.raises(SynclineError) as raised:
            told(open_session(path), least, monkeypatch)
        texts.append((type(raised.value), str(raised.value)))
    assert texts[0] == texts[1]


def child_that(code: str) -> str:
    """The code of a child that does something else on its way; `rp` is the module."""
    start = "import sys; sys.path[:] = sys.argv[2:]\n"
    module = "import os; from syncline_analyzer import reading_process as rp\n"
    return start + module + dedent(code) + "\nrp.main()"


@pytest.mark.usefixtures("other_process")
def test_a_process_that_dies_is_told(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = child_that("""
        put = rp.MessageWriter.put
        def die(writer):
            writer._waiting.put(None)
            writer._thread.join()
            os._exit(7)
        rp.MessageWriter.put = lambda to, m: put(to, m) if type(m) is rp.Opened else die(to)
        """)
    monkeypatch.setattr(second_process, "_CODE", code)
    with pytest.raises(CaptureError, match=r"ended before their end \(exit code 7\)"):
        open_session(small).analyze()


@pytest.mark.usefixtures("other_process")
def test_an_error_in_it_is_raised_here(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = child_that("def fail(batch): raise ZeroDivisionError('by us')\nrp.packed = fail")
    monkeypatch.setattr(second_process, "_CODE", code)
    with pytest.raises(ZeroDivisionError, match="by us") as raised:
        open_session(small).analyze()
    assert "reading_process" in raised.value.__notes__[0]


@pytest.mark.usefixtures("other_process")
@pytest.mark.parametrize(
    "code", ["raise SystemExit(1)", "import no_such_module", "print('hello' * 99)"]
)
def test_where_no_process_can_be_started_this_one_reads(
    small: Path, code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(second_process, "_CODE", code)
    with begun(Request([small])) as opened:
        assert isinstance(opened(), LocalReading)


@pytest.mark.parametrize("program", ["", "/usr/bin/blender", "no/such/python"])
@pytest.mark.usefixtures("other_process")
def test_only_a_python_is_started(
    small: Path, program: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", program)
    with begun(Request([small])) as opened:
        assert isinstance(opened(), LocalReading)


def test_small_captures_and_single_processors_need_none(
    small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with begun(Request([small])) as opened:
        assert isinstance(opened(), LocalReading)
    monkeypatch.setattr(second_process, "LEAST_BYTES", 0)
    with begun(Request([small]), 1) as opened:
        assert isinstance(opened(), LocalReading)
    monkeypatch.setattr(second_process, "processors", lambda: 1)
    with begun(Request([small])) as opened:
        assert isinstance(opened(), LocalReading)


def test_a_script_without_a_guard_works(small: Path, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        dedent(f"""
        from syncline_analyzer import open_session
        from syncline_schemas import second_process
        second_process.LEAST_BYTES = 0
        second_process.processors = lambda: 2
        print(open_session({str(small)!r}).analysis.capture.frames)
        """),
        encoding="utf-8",
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert done.stdout.strip().isdecimal()
    assert not done.stderr


def mixed(frames: FrameBatch) -> IndexedBatch:
    """Every second frame of a bus among those of others."""
    rows = np.arange(0, len(frames), 2)
    return IndexedBatch(frames[rows], seqs=10 + rows)


@pytest.mark.parametrize(
    "batch",
    [
        IndexedBatch(traffic(5_000), 7),
        IndexedBatch(traffic(100_000)),
        mixed(traffic(3_000)),
        IndexedBatch(traffic(1)),
        IndexedBatch(FrameBatch.from_rows([(1, 3, 0x1FFFFFFF, 1, 2, b"ab")]), timed=False),
        IndexedBatch(FrameBatch.from_rows([(5, 0, 0x181, 8, 12, bytes(range(12)))] * 3)),
        IndexedBatch(FrameBatch.from_rows([(5, 0, 0x181, 2, 0, b""), (4, 0, 0, 0, 2, b"\1\2")])),
    ],
)
def test_a_batch_arrives_as_it_was(batch: IndexedBatch) -> None:
    arrived = unpacked(packed(batch))
    for name in ("t_ns", "bus", "can_id", "flags", "dlc", "data"):
        here, there = getattr(batch.frames, name), getattr(arrived.frames, name)
        assert here.dtype == there.dtype
        assert np.array_equal(here, there), name
    names = ("seqs", "rows_by_id", "t_ns_by_id", "seqs_by_id", "words_by_id", "wire_bits")
    for name in names:
        here, there = getattr(batch, name), getattr(arrived, name)
        assert here.dtype == there.dtype, name
        assert np.array_equal(here, there), name
    assert np.array_equal(batch.grouping.key, arrived.grouping.key)
    for name in ("seq0", "timed", "scattered", "buses", "flags_seen", "ascending", "lengths"):
        assert getattr(batch, name) == getattr(arrived, name), name
    assert arrived.ids() == batch.ids()


@pytest.mark.parametrize(
    ("module", "left_out"),
    [
        ("session", ("numpy", "syncline_analyzer.engine")),
        ("engine", ("google.protobuf", "statistics", "tempfile", "numpy.ma")),
        ("remote_reading", ("syncline_analyzer.readers", "syncline_analyzer.results")),
        ("reading_process", ("syncline_analyzer.results", "syncline_analyzer.findings", "pandas")),
        ("reading_process", ("google.protobuf", "numpy.ma", "syncline_analyzer.readers.pcap")),
    ],
)
def test_no_process_imports_what_the_other_needs(module: str, left_out: tuple[str, ...]) -> None:
    code = f"import sys, syncline_analyzer.{module}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(left_out) & set(done.stdout.split())
