"""Outputs that raise, stand still or are closed harm no recording."""

import contextlib
import json
import logging
import os
import signal
import subprocess
import threading
import time
import weakref
from pathlib import Path

import pytest

from syncline_logger import own_log as own_log_module
from syncline_logger import record_outputs
from syncline_logger.aside import MOST_WAITING, Aside
from syncline_logger.batcher import FrameBuffer
from syncline_logger.own_log import own_log
from syncline_logger.record_options import RecordOptions
from syncline_logger.record_outputs import RecordOutputs
from syncline_logger.recorder import record
from syncline_logger.source import SourceFacts
from tests.logger.capture_contents import doctor_complaints, read_capture, syncline
from tests.logger.status_builder import S, bus, status


class OneFrame:
    """A source that gives one frame and ends the recording."""

    def __init__(self, stop: threading.Event) -> None:
        self.facts = SourceFacts("a", "virtual", "one")
        self._stop = stop

    def open(self) -> None:
        pass

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        if self._stop.is_set():
            return 0
        buffer.append(0, bus, 0x185, 0, 1, b"\x05")
        self._stop.wait(2 * timeout_s)
        self._stop.set()
        return 1

    def fileno(self) -> None:
        return None

    def close(self) -> None:
        pass


class Silent:
    def started(self, path: Path) -> None:
        pass

    def status(self, snapshot: object) -> None:
        pass

    def words(self, text: str) -> None:
        pass


class Raising:
    """A view that fails whenever it is asked."""

    def __init__(self) -> None:
        self.asked = 0

    def started(self, path: Path) -> None:
        raise BrokenPipeError("nobody reads")

    def status(self, snapshot: object) -> None:
        self.asked += 1
        raise RuntimeError("no such terminal")

    def words(self, text: str) -> None:
        raise RuntimeError("no such terminal")


def test_an_output_that_raises_is_told_once_and_harms_no_other(tmp_path: Path) -> None:
    view = Raising()
    with (
        own_log(tmp_path / "x.log", 10_000, 1),
        RecordOutputs(view, tmp_path / "s.json") as outputs,
    ):
        outputs.started(Path("a.mcap"))
        for n in range(3):
            outputs.status(status(bus(frames=n)))
    assert view.asked == 3, "it may work again"
    assert json.loads((tmp_path / "s.json").read_text(encoding="utf-8"))["frames"] == 2
    log = (tmp_path / "x.log").read_text(encoding="utf-8")
    assert log.count("WARNING") == 1
    assert "the view: BrokenPipeError: nobody reads; the recording goes on" in log


def test_an_output_that_stands_still_holds_up_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a terminal after Ctrl-S, or a pipe that nobody reads."""
    goes_on = threading.Event()

    class Still(Silent):
        def status(self, snapshot: object) -> None:
            goes_on.wait()

    monkeypatch.setattr(record_outputs, "LAST_OUTPUTS_S", 1.0)
    with (
        own_log(tmp_path / "x.log", 100_000, 1),
        RecordOutputs(Still()) as outputs,
    ):
        for n in range(3 * MOST_WAITING):
            outputs.status(status(bus(frames=n)))
    goes_on.set()
    assert "stopped: " in (tmp_path / "x.log").read_text(encoding="utf-8")


class StandsStill:
    """A log file on a disk that hangs."""

    def __init__(self) -> None:
        self.asked, self.goes_on = threading.Event(), threading.Event()

    def write(self, text: str) -> None:
        self.asked.set()
        self.goes_on.wait()

    def seek(self, *_: int) -> None:
        self.write("")

    def tell(self) -> int:
        return 0

    def flush(self) -> None:
        self.write("")

    def close(self) -> None:
        self.write("")


def own_handlers() -> list[logging.FileHandler]:
    handlers = logging.getLogger("syncline").handlers
    return [each for each in handlers if isinstance(each, logging.FileHandler)]


def test_a_log_that_stands_still_does_not_hold_up_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record_outputs, "LAST_OUTPUTS_S", 0.1)
    monkeypatch.setattr(own_log_module, "LAST_LINES_S", 0.1)
    file = StandsStill()

    def run() -> None:
        with own_log(tmp_path / "x.log", 10_000, 1), RecordOutputs(Silent()) as outputs:
            (handler,) = own_handlers()
            handler.stream.close()  # type: ignore[union-attr]
            handler.stream = file  # type: ignore[assignment]
            outputs.status(status(bus(frames=1)))
            outputs.started(Path("a.mcap"))
            file.asked.wait()
        logging.shutdown([weakref.ref(handler)])  # what Python does at the end of a process

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(60)
    ended = not thread.is_alive()
    file.goes_on.set()
    thread.join(60)
    assert ended
    assert own_handlers() == []


def test_what_is_left_out_is_counted(caplog: pytest.LogCaptureFixture) -> None:
    goes_on, did = threading.Event(), []
    aside = Aside(most=2)
    aside.do("x", goes_on.wait)
    for n in range(10):
        aside.do("x", lambda n=n: did.append(n))  # type: ignore[misc]
    goes_on.set()
    assert aside.close(60)
    assert 1 <= len(did) <= 2
    assert f"{10 - len(did)} outputs were left out" in caplog.text


def test_callbacks_that_raise_end_no_recording(tmp_path: Path) -> None:
    stop = threading.Event()

    def fails(*_: object) -> None:
        raise ValueError("a bug")

    def asked() -> list[str]:
        raise ValueError("a bug")

    result = record(
        [OneFrame(stop)],
        tmp_path / "x.mcap",
        RecordOptions(decode=False),
        stop=stop,
        duration_ns=60 * S,
        on_start=fails,
        on_status=fails,
        on_turn=fails,
        on_note=fails,
        asked=asked,
        status_period_ns=1,
    )
    assert result.frame_count == 1
    assert doctor_complaints(result.path) == []
    told = [text for text in result.problems if text.endswith("a bug; the recording goes on")]
    assert len(told) == len(set(told)) == 5


def recording_process(folder: Path, stdout: int, *words: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        syncline("record", "-i", "virtual", "-c", "a", "-o", str(folder / "x.mcap"), *words),
        stdout=stdout,
        stderr=subprocess.PIPE,
    )


def test_a_reader_of_stdout_that_goes_away_ends_nothing(tmp_path: Path) -> None:
    """As `syncline record ... | head -1`."""
    words = ["--for", "1s", "--status-period", "50ms", "--log", str(tmp_path / "x.log")]
    with recording_process(tmp_path, subprocess.PIPE, *words) as child:
        assert child.stdout is not None
        assert json.loads(child.stdout.readline())["path"].endswith("x.mcap")
        child.stdout.close()
        assert child.stderr is not None
        errors = child.stderr.read().decode()
    assert child.returncode == 0, errors
    assert "Traceback" not in errors
    assert "Broken" not in errors
    assert "WARNING" not in (tmp_path / "x.log").read_text(encoding="utf-8")
    stop = read_capture(tmp_path / "x.mcap").metadata["syncline.stop"]
    assert stop["reason"] == "time is over"


def fill(pipe: int) -> None:
    """Make the next byte wait."""
    os.set_blocking(pipe, False)
    for size in (4096, 1):
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(pipe, bytes(size))
    os.set_blocking(pipe, True)


@pytest.mark.skipif(os.name != "posix", reason="needs signals and pipes that block")
def test_a_reader_of_stdout_that_does_not_read_holds_up_nothing(tmp_path: Path) -> None:
    """As `syncline record ... | less` after a while: the pipe is full."""
    reader, writer = os.pipe()
    fill(writer)
    words = ["--status-period", "1ms", "--log", str(tmp_path / "x.log")]
    with recording_process(tmp_path, writer, *words) as child:
        while not (tmp_path / "x.mcap").exists() and child.poll() is None:
            time.sleep(0.01)
        child.send_signal(signal.SIGTERM)
        assert child.stderr is not None
        errors = child.stderr.read().decode()
        child.wait()
    os.close(writer)
    os.close(reader)
    assert child.returncode == 0, errors
    assert "Fatal" not in errors
    assert read_capture(tmp_path / "x.mcap").metadata["syncline.stop"]["reason"] == "stopped"
    assert "stopped: 0 frames" in (tmp_path / "x.log").read_text(encoding="utf-8")


@pytest.mark.skipif(os.name != "posix", reason="needs signals and pipes that block")
def test_a_log_that_nobody_reads_does_not_hold_up_the_stop(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "log")
    pipe = os.open(tmp_path / "log", os.O_RDWR)
    fill(pipe)
    words = ["--log", str(tmp_path / "log")]
    with recording_process(tmp_path, subprocess.DEVNULL, *words) as child:
        while not (tmp_path / "x.mcap").exists() and child.poll() is None:
            time.sleep(0.01)
        child.send_signal(signal.SIGTERM)
        try:
            _, errors = child.communicate(timeout=120)
        finally:
            child.kill()
            os.close(pipe)
    assert child.returncode == 0, errors
    assert b"Fatal" not in errors
    assert b"x.mcap: 0 frames" in errors
