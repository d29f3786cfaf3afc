"""A recorder as a process of its own, with a serial adapter: triggers, signals, limits."""

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from syncline_logger import source_thread
from syncline_logger.bus_options import BusOptions
from syncline_logger.recorder import record
from syncline_logger.sources.slcan import SlcanSource
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.scan import CaptureScan
from tests.logger.capture_contents import doctor_complaints, syncline
from tests.logger.slcan_adapter import Adapter, numbered, unplug_all
from tests.logger.store_runs import files_of, gaps_in, numbers_in

pytest.importorskip("serial")
if sys.platform == "win32":
    pytest.skip("no pseudo terminals on Windows", allow_module_level=True)

WAIT_S = 60.0


def wait_for(what: Callable[[], bool]) -> None:
    """Poll until something is so."""
    until = time.monotonic() + WAIT_S
    while not what():
        assert time.monotonic() < until
        time.sleep(0.02)


@pytest.fixture
def adapter(tmp_path: Path) -> Iterator[Adapter]:
    yield Adapter(link=tmp_path / "tty")
    unplug_all()


@dataclass
class Recorder:
    """A running `syncline record`."""

    process: "subprocess.Popen[str]"
    folder: Path
    status_path: Path

    @property
    def frames(self) -> int:
        """Frames that it has taken in, by its status file."""
        if not self.status_path.exists():
            return -1
        found: int = json.loads(self.status_path.read_text(encoding="utf-8"))["frames"]
        return found

    def stop(self, number: int = signal.SIGTERM) -> str:
        """End it; what it said."""
        self.process.send_signal(number)
        _, told = self.process.communicate(timeout=WAIT_S)
        assert self.process.returncode == 0, told
        return told


@contextmanager
def recorder(tmp_path: Path, adapter: Adapter, *words: str) -> Iterator[Recorder]:
    """Record from an adapter in a process of its own."""
    folder, status = tmp_path / "captures", tmp_path / "status.json"
    command = syncline(
        *("record", "-i", "slcan", "-c", str(adapter.link), "-b", "500000", "-o", str(folder)),
        *("--bus-kwargs", "sleep_after_open=0.05", "--flush", "200ms"),
        *("--status-file", str(status), "--status-period", "100ms", *words),
    )
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, encoding="utf-8"
    )
    try:
        assert adapter.opened.wait(WAIT_S)
        yield Recorder(process, folder, status)
    finally:
        process.kill()
        process.communicate()


def reasons_in(path: Path) -> list[str]:
    """Reasons of the marks in a file."""
    scan = CaptureScan(path)
    assert all(isinstance(item, object) for item in scan.items())
    return [mark.reason for mark in scan.facts.marks]


def test_a_command_and_a_signal_write_the_ring_before_and_what_follows(
    tmp_path: Path, adapter: Adapter
) -> None:
    around = ("--triggered-only", "--before", "10m", "--after", "1s")
    with recorder(tmp_path, adapter, *around) as running:
        adapter.send(numbered(0, 100))
        wait_for(lambda: running.frames == 100)
        assert files_of(running.folder) == []
        asked = subprocess.run(
            syncline("trigger", str(running.folder), "--text", "it fell"),
            capture_output=True,
            timeout=WAIT_S,
            check=False,
        )
        assert asked.returncode == 0, asked.stderr
        wait_for(lambda: len(files_of(running.folder)) == 1)
        adapter.send(numbered(100, 100))
        # The event is over: its file has its end.
        wait_for(lambda: CaptureScan(files_of(running.folder)[0]).facts.closed)
        adapter.send(numbered(200, 100))
        wait_for(lambda: running.frames == 300)
        running.process.send_signal(signal.SIGUSR1)
        wait_for(lambda: len(files_of(running.folder)) == 2)
        adapter.send(numbered(300, 100))
        wait_for(lambda: running.frames == 400)
        running.stop()
    first, second = files_of(running.folder)
    assert numbers_in(first)[:100] == list(range(100))
    assert numbers_in(first, second) == list(range(400))
    assert numbers_in(second)[0] in range(100, 201)
    assert reasons_in(first) == ["asked for by syncline trigger: it fell"]
    assert reasons_in(second) == ["asked for by SIGUSR1"]
    assert [gap.reason for gap in gaps_in(first, second)] == []
    assert doctor_complaints(first) == doctor_complaints(second) == []


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_signals_that_stop_leave_a_whole_file(
    tmp_path: Path, adapter: Adapter, number: signal.Signals
) -> None:
    with recorder(tmp_path, adapter) as running:
        adapter.send(numbered(0, 100))
        wait_for(lambda: running.frames == 100)
        running.stop(number)
    [path] = files_of(running.folder)
    assert numbers_in(path) == list(range(100))
    assert doctor_complaints(path) == []


def test_an_adapter_that_is_unplugged_and_comes_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(source_thread, "FIRST_RETRY_S", 0.05)
    link, stop, failed = tmp_path / "tty", threading.Event(), []
    seen = [0]
    state = [True]

    def plug() -> None:
        try:
            for turn in range(3):
                adapter = Adapter(link=link)
                assert adapter.opened.wait(WAIT_S)
                adapter.send(numbered(100 * turn, 100))
                wait_for(lambda: seen[0] == 100 * (turn + 1) and state[0])  # noqa: B023
                adapter.unplug()
                wait_for(lambda: not state[0])
        except AssertionError as error:
            failed.append(error)
        finally:
            stop.set()

    def look(snapshot: "object") -> None:
        [bus] = snapshot.buses  # type: ignore[attr-defined]
        seen[0], state[0] = bus.frames, bus.adapter_present

    first = Adapter(link=link)
    options = BusOptions(
        "a", "slcan", str(link), bitrate=500_000, arguments={"sleep_after_open": 0.05}
    )
    thread = threading.Thread(target=plug, daemon=True)

    def started(path: Path) -> None:
        first.unplug()
        thread.start()

    source = SlcanSource(options)
    result = record([source], tmp_path / "x.mcap", stop=stop, on_start=started, on_status=look, status_period_ns=50_000_000)  # fmt: skip
    thread.join()
    unplug_all()
    assert failed == []
    assert numbers_in(result.path) == list(range(300))
    gaps = [gap for gap in gaps_in(result.path) if "lost" in gap.reason]
    assert len(gaps) == 4
    stamps = [
        t for item in CaptureScan(result.path).batches() if isinstance(item, FrameBatch)
        for t in item.t_ns.tolist()
    ]  # fmt: skip
    for gap, last, following in zip(gaps[1:-1], (99, 199), (100, 200), strict=True):
        assert stamps[last] <= gap.start_ns < gap.end_ns <= stamps[following]
    assert gaps[-1].start_ns >= stamps[-1]
    assert result.lost_frames == 0
