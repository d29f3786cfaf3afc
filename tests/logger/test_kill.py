"""SIGKILL at any moment loses at most the last second of frames, and never more of the file."""

import random
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.scan import CaptureScan
from tests.logger.capture_contents import doctor_complaints, read_cut_frames, syncline

CHILD = Path(__file__).with_name("recording_child.py")
PROMISE_NS = 1_000_000_000
MARGIN_NS = 500_000_000
"""For what passes between the sidecar's line and the frame's way to the recorder on a busy machine."""

KILLS = 20
AT_ONCE = 4


@dataclass(frozen=True)
class Killed:
    """A recorder that was killed: its file, the frames it should hold, and those on the way."""

    path: Path
    safe: int
    sent: int

    def check(self) -> None:
        """What was sent in time is there, in order and intact."""
        numbers = [int.from_bytes(data, "little") for data in read_cut_frames(self.path)]
        assert numbers == list(range(len(numbers)))
        assert self.safe <= len(numbers) <= self.sent


def kill_after(folder: Path, seconds: float, pause_s: float) -> Killed:
    """Start a recording, let it run for a while, kill it."""
    folder.mkdir()
    sidecar = folder / "sent.txt"
    command = [sys.executable, str(CHILD), str(folder), str(sidecar), str(pause_s)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, encoding="utf-8") as child:
        assert child.stdout is not None
        path = Path(child.stdout.readline().strip())
        time.sleep(seconds)
        killed_ns = time.time_ns()
        child.kill()
    lines = [line.split() for line in sidecar.read_text(encoding="utf-8").splitlines()]
    before = killed_ns - PROMISE_NS - MARGIN_NS
    return Killed(path, sum(int(t_ns) < before for t_ns, _ in lines), len(lines))


def test_a_killed_recorder_loses_at_most_a_second(tmp_path: Path) -> None:
    moments = random.Random(2).choices([0.2 + 0.1 * n for n in range(32)], k=KILLS)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        trials = [
            pool.submit(kill_after, tmp_path / str(n), moment, 0.004)
            for n, moment in enumerate(moments)
        ]
        killed = [trial.result() for trial in trials]
    for each in killed:
        each.check()
    assert sum(each.safe for each in killed) > KILLS * 20


def test_a_quiet_bus_loses_no_more(tmp_path: Path) -> None:
    with ThreadPoolExecutor(AT_ONCE) as pool:
        trials = [pool.submit(kill_after, tmp_path / str(n), 2.6 + 0.25 * n, 1.0) for n in range(4)]
        killed = [trial.result() for trial in trials]
    for each in killed:
        each.check()
    assert all(each.safe >= 1 for each in killed)


@pytest.fixture
def cut(tmp_path: Path) -> Killed:
    """A capture whose recorder was killed after two seconds."""
    return kill_after(tmp_path / "cut", 2.0, 0.01)


def test_a_cut_file_opens_as_it_is(cut: Killed) -> None:
    scan = CaptureScan(cut.path)
    rows = [batch for batch in scan.batches() if isinstance(batch, FrameBatch)]
    assert FrameBatch.concat(rows).data[:, 0].tolist() == list(
        range(len(read_cut_frames(cut.path)))
    )
    assert not scan.facts.closed


def test_recover_makes_a_regular_file_of_it(cut: Killed) -> None:
    done = subprocess.run(
        syncline("recover", str(cut.path)), capture_output=True, check=False, encoding="utf-8"
    )
    target = cut.path.with_name(f"{cut.path.stem}.recovered.mcap")
    assert done.stdout.strip() == str(target)
    assert done.returncode == 0, done.stderr
    assert doctor_complaints(target) == []
    assert read_cut_frames(target) == read_cut_frames(cut.path)
