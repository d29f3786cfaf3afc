"""Recordings of a machine whose clock was set while it recorded, against one whose clock was right."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from syncline_analyzer import open_session
from syncline_analyzer.info import inspect
from syncline_logger.batcher import FrameBuffer
from syncline_logger.clock import RecorderClock
from syncline_logger.record_options import RecordOptions
from syncline_logger.recording import Recording
from syncline_logger.segments import Split
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo

SECOND = 1_000_000_000
TRUE_NS = 1_763_780_000 * SECOND
PERIOD_NS = 900_000_000
STEP_NS = 10_000_000

Offset = Callable[[int], int]
"""UTC less the true time, by the time since the machine started [ns]."""


@dataclass
class Machine:
    """A recorder's machine, its UTC off by `offset`; the true time is TRUE_NS + elapsed_ns."""

    offset: Offset
    elapsed_ns: int = 0

    def utc_ns(self) -> int:
        return TRUE_NS + self.elapsed_ns + self.offset(self.elapsed_ns)


def right(elapsed_ns: int) -> int:
    return 0


def without_battery(elapsed_ns: int) -> int:
    """1970 until the time server is found."""
    return -TRUE_NS if elapsed_ns < 20 * SECOND else 0


def old_date(elapsed_ns: int) -> int:
    return -90 * 86_400 * SECOND if elapsed_ns < 33_337_000_000 else 0


def set_back(elapsed_ns: int) -> int:
    return 7_200 * SECOND if elapsed_ns < 20 * SECOND else 0


def set_twice(elapsed_ns: int) -> int:
    return -TRUE_NS if elapsed_ns < 10 * SECOND else 45 * SECOND if elapsed_ns < 40 * SECOND else 0


WRONG = [without_battery, old_date, set_back, set_twice]


def traffic(buffer: FrameBuffer, machine: Machine, by: str) -> None:
    """A healthy bus for 10 ms: SYNC and its answer each time, heartbeats every 100 ms."""
    machine.elapsed_ns += 100_000
    t_ns = machine.utc_ns() if by == "kernel" else 0
    turn = machine.elapsed_ns // STEP_NS
    machine.elapsed_ns += 150_000
    buffer.append(t_ns, 0, 0x080, 0, 0, b"")
    t_ns = machine.utc_ns() if by == "kernel" else 0
    machine.elapsed_ns += 150_000
    buffer.append(t_ns, 0, 0x185, 0, 4, (turn % 1000).to_bytes(4, "little"))
    for node in (5, 6):
        if turn % 10 == node:
            machine.elapsed_ns += 100_000
            t_ns = machine.utc_ns() if by == "kernel" else 0
            buffer.append(t_ns, 0, 0x700 + node, 0, 1, b"\x05")


def record(folder: Path, offset: Offset, by: str = "kernel", split: Split | None = None) -> Path:
    """A minute of it, recorded as the recorder does."""
    machine = Machine(offset)
    clock = RecorderClock(machine.utc_ns, lambda: machine.elapsed_ns)
    buffer = FrameBuffer(clock.now_ns)
    folder.mkdir()
    recording = Recording(
        folder,
        [BusInfo("can0", 0, 500_000, interface="socketcan", clock=by)],
        RecordOptions(sync=False, decode=False, recording_id="one", split=split or Split()),
        start_ns=clock.now_ns(),
    )
    due_ns = 0
    for begin_ns in range(0, 60 * SECOND, STEP_NS):
        machine.elapsed_ns = begin_ns
        if begin_ns >= due_ns:
            write(recording, clock, buffer)
            due_ns += PERIOD_NS
        traffic(buffer, machine, by)
    write(recording, clock, buffer)
    recording.finish(clock.now_ns(), "the test is over")
    return folder


def write(recording: Recording, clock: RecorderClock, buffer: FrameBuffer) -> None:
    now_ns = clock.now_ns()
    recording.add_clock(clock.sample(), now_ns)
    taken = buffer.take()
    recording.take_frames(taken.frames, taken.log_ns)
    recording.write(taken.frames, taken.log_ns, [], now_ns)


def stamps(path: Path) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return FrameBatch.concat(list(open_session(sorted(path.glob("*.mcap"))).frames())).t_ns


@pytest.mark.parametrize("by", ["kernel", "host"])
@pytest.mark.parametrize("offset", WRONG)
def test_the_stamps_are_those_of_a_clock_that_was_right(
    tmp_path: Path, offset: Offset, by: str
) -> None:
    truth = stamps(record(tmp_path / "right", right, by))
    repaired = stamps(record(tmp_path / "wrong", offset, by))
    assert len(truth) > 12_000
    assert (repaired - truth).tolist() == [0] * len(truth)


@pytest.mark.parametrize("offset", WRONG)
def test_nobody_is_accused_and_the_note_tells(tmp_path: Path, offset: Offset) -> None:
    (good,) = record(tmp_path / "right", right).glob("*.mcap")
    (path,) = record(tmp_path / "wrong", offset).glob("*.mcap")
    expected = open_session(good).analysis
    got = open_session(path).analysis
    assert [each.id for each in got.findings] == [each.id for each in expected.findings]
    assert not [each for each in got.findings if each.severity != "info"]
    (note,) = [note for note in got.capture.notes if "clock" in note]
    assert note.startswith("the recorder's clock was set ")
    assert got.capture.first_ns == expected.capture.first_ns
    info = inspect(path)
    assert (info.steps_back, info.first_ns, note in info.notes) == (0, inspect(good).first_ns, True)


def test_a_later_segment_tells_the_truth_for_the_earlier(tmp_path: Path) -> None:
    truth = stamps(record(tmp_path / "right", right))
    folder = record(tmp_path / "wrong", without_battery, split=Split(size_bytes=40_000))
    paths = sorted(folder.glob("*.mcap"))
    assert len(paths) > 3
    assert (stamps(folder) - truth).tolist() == [0] * len(truth)
    alone = inspect(paths[0])
    assert alone.first_ns is not None
    assert alone.first_ns < 60 * SECOND
    (note,) = alone.notes
    assert note.startswith("the recorder's clock was never set while it recorded")
    assert "1970-01-01" in note


def test_a_recording_that_was_cut_off_is_repaired_too(tmp_path: Path) -> None:
    truth = stamps(record(tmp_path / "right", right))
    (path,) = record(tmp_path / "wrong", without_battery).glob("*.mcap")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 3 // 4])
    repaired = stamps(tmp_path / "wrong")
    assert 0 < len(repaired) < len(truth)
    assert (repaired - truth[: len(repaired)]).tolist() == [0] * len(repaired)


def test_a_clock_that_is_right_is_not_spoken_of(tmp_path: Path) -> None:
    (path,) = record(tmp_path / "right", right).glob("*.mcap")
    assert inspect(path).notes == []
