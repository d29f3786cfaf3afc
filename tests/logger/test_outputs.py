"""Outputs that raise, stand still or are closed harm no recording."""

import json
import signal
import struct
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from syncline_logger import record_outputs
from syncline_logger.aside import MOST_WAITING, Aside
from syncline_logger.batcher import FrameBuffer
from syncline_logger.own_log import own_log
from syncline_logger.record_outputs import RecordOutputs
from syncline_logger.recorder import record
from syncline_logger.recording import RecordOptions
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


class Raising:
    """A view that fails whenever it is asked."""

    def __init__(self) -> None:
        self.asked = 0

    def started(self, path: Path) -> None:
        raise BrokenPipeError("nobody reads")

    def status(self, snapshot: object) -> None:
        self.asked += 1
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

    monkeypatch.setattr(record_outputs, "LAST_OUTPUTS_S", 0.01)
    monkeypatch.setattr(record_outputs, "forget_stdout", lambda: forgotten.append(True))
    forgotten: list[bool] = []
    with own_log(tmp_path / "x.log", 100_000, 1), RecordOutputs(Still()) as outputs:
        for _ in range(3 * MOST_WAITING):
            outputs.status(status())
    assert forgotten
    goes_on.set()


def test_what_is_left_out_is_counted(caplog: pytest.LogCaptureFixture) -> None:
    goes_on, did = threading.Event(), []
    aside = Aside(most=2)
    aside.do("x", goes_on.wait)  # type: ignore[arg-type]
    for n in range(10):
        aside.do("x", lambda n=n: did.append(n))  # type: ignore[misc]
    goes_on.set()
    assert aside.close(60)
    assert 2 <= len(did) <= 3
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


def recording_process(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        syncline("record", "-i", "virtual", "-c", "a", "-o", str(folder / "x.mcap"), *words),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def test_a_reader_of_stdout_that_goes_away_ends_nothing(tmp_path: Path) -> None:
    """As `syncline record ... | head -1`."""
    with recording_process(tmp_path, "--for", "1s", "--status-period", "50ms") as child:
        assert child.stdout is not None
        assert json.loads(child.stdout.readline())["path"].endswith("x.mcap")
        child.stdout.close()
        assert child.stderr is not None
        errors = child.stderr.read().decode()
    assert child.returncode == 0, errors
    assert "Traceback" not in errors
    assert "Broken" not in errors
    stop = read_capture(tmp_path / "x.mcap").metadata["syncline.stop"]
    assert stop["reason"] == "time is over"


@pytest.mark.skipif(sys.platform != "linux", reason="asks how full a pipe is")
def test_a_reader_of_stdout_that_does_not_read_holds_up_nothing(tmp_path: Path) -> None:
    """As `syncline record ... | less`: the pipe is full after a while."""
    fcntl, termios = pytest.importorskip("fcntl"), pytest.importorskip("termios")
    with recording_process(tmp_path, "--status-period", "1ms") as child:
        assert child.stdout is not None
        assert child.stderr is not None
        size = fcntl.fcntl(child.stdout, getattr(fcntl, "F_GETPIPE_SZ", 1032))
        waiting = 0
        while waiting < size - 1000:
            (waiting,) = struct.unpack("i", fcntl.ioctl(child.stdout, termios.FIONREAD, bytes(4)))
        child.send_signal(signal.SIGTERM)
        errors = child.stderr.read().decode()
        child.wait()
    assert child.returncode == 0, errors
    assert "Fatal" not in errors
    assert read_capture(tmp_path / "x.mcap").metadata["syncline.stop"]["reason"] == "stopped"
