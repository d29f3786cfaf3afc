"""The recorder as a service: begins without its bus, tells the manager, keeps its files."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from syncline_logger import source_thread
from syncline_logger.batcher import FrameBuffer
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder import record
from syncline_logger.source import SourceFacts
from syncline_schemas.errors import SourceError
from tests.logger.capture_contents import doctor_complaints, read_capture, syncline

DEPLOY = Path(__file__).parents[2] / "deploy"


class LateSource:
    """An adapter that is plugged in after some tries, gives one frame and ends the recording."""

    def __init__(self, stop: threading.Event, tries: int) -> None:
        self.facts = SourceFacts("a", "virtual", "late")
        self._stop = stop
        self._tries = tries

    def open(self) -> None:
        self._tries -= 1
        if self._tries >= 0:
            raise SourceError("bus 'a' (virtual late): cannot open: no such device")

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        if self._stop.is_set():
            return 0
        buffer.append(0, bus, 0x185, 0, 1, b"\x05")
        self._stop.set()
        return 1

    def fileno(self) -> None:
        return None

    def close(self) -> None:
        pass


def test_a_bus_that_is_not_there_yet_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(source_thread, "FIRST_RETRY_S", 0.01)
    stop = threading.Event()
    result = record(
        [LateSource(stop, tries=3)],
        tmp_path / "x.mcap",
        RecordOptions(wait_for_bus=True),
        stop=stop,
        duration_ns=30_000_000_000,
    )
    assert result.frame_count == 1
    (gap,) = result.gaps
    assert gap.reason == "bus 'a' (virtual late): cannot open: no such device"
    assert gap.end_ns > gap.start_ns
    assert doctor_complaints(result.path) == []


def test_without_the_wish_it_is_a_mistake(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="no such device"):
        record([LateSource(threading.Event(), tries=1)], tmp_path / "x.mcap", RecordOptions())
    assert list(tmp_path.iterdir()) == []


def test_a_bus_that_never_comes_is_one_long_gap(tmp_path: Path) -> None:
    stop = threading.Event()
    turns = 0

    def turn() -> None:
        nonlocal turns
        turns += 1
        if turns == 3:
            stop.set()

    result = record(
        [LateSource(threading.Event(), tries=10**6)],
        tmp_path / "x.mcap",
        RecordOptions(wait_for_bus=True),
        stop=stop,
        duration_ns=30_000_000_000,
        on_turn=turn,
    )
    assert turns == 3
    assert (result.frame_count, result.gap_count) == (0, 1)
    assert [gap.reason for gap in result.gaps] == [
        "bus 'a' (virtual late): cannot open: no such device"
    ]


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="needs UNIX sockets")
@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_the_whole_service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "logger.toml").write_text(
        'output = "captures"\nstatus_file = "status.json"\nprometheus = "x.prom"\nlog = "own.log"\n'
        'status_period = "100ms"\nwait_for_bus = true\n'
        '[[bus]]\nname = "press"\ninterface = "virtual"\nchannel = "service"\n'
        '[[bus]]\nname = "robot"\ninterface = "slcan"\nchannel = "/dev/not-plugged-in"\n',
        encoding="utf-8",
    )
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("notify")
        manager.settimeout(60)
        environ = os.environ | {"NOTIFY_SOCKET": "notify", "WATCHDOG_USEC": "200000"}
        environ.pop("WATCHDOG_PID", None)
        child = subprocess.Popen(
            syncline("record", "--config", "logger.toml"),
            env=environ,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            encoding="utf-8",
        )
        heard: list[str] = []
        while not {"WATCHDOG=1", "STATUS"} <= {text.split(":")[0] for text in heard[1:]}:
            text = manager.recv(4096).decode()
            heard.append("STATUS" if text.startswith("STATUS") else text)
        # Files are written beside the loop that tells the manager.
        while not Path("status.json").exists():
            heard.append(manager.recv(4096).decode())
        running = json.loads(Path("status.json").read_text(encoding="utf-8"))
        child.send_signal(signal.SIGTERM)
        _, errors = child.communicate(timeout=60)
        while heard[-1] != "STOPPING=1":
            heard.append(manager.recv(4096).decode())
    assert child.returncode == 0, errors
    assert heard[0].startswith("READY=1\nSTATUS=recording to captures")
    assert (running["state"], running["pid"]) == ("recording", child.pid)
    assert [bus["adapter_present"] for bus in running["buses"]] == [True, False]
    stopped = json.loads(Path("status.json").read_text(encoding="utf-8"))
    assert stopped["state"] == "stopped"
    assert "\nsyncline_up 0\n" in Path("x.prom").read_text(encoding="utf-8")
    log = Path("own.log").read_text(encoding="utf-8")
    assert "INFO robot: bus 'robot' (slcan /dev/not-plugged-in): cannot open: " in log
    assert "WARNING robot: not heard from " in log
    assert "INFO stopped: 0 frames" in log.splitlines()[-1]
    (gap,) = read_capture(Path(stopped["path"])).values("/recorder/gap")
    assert "cannot open" in gap.reason


def test_the_unit_says_what_the_recorder_needs() -> None:
    unit = (DEPLOY / "syncline.service").read_text(encoding="utf-8")
    settings = dict(
        line.split("=", 1) for line in unit.splitlines() if "=" in line and line[0] != "#"
    )
    assert settings["Type"] == "notify"
    assert settings["Restart"] == "always"
    assert int(settings["WatchdogSec"]) >= 30, "a slow SD card may hold up a write for seconds"
    assert settings["ExecStart"].endswith("record --config /etc/syncline/logger.toml")
    assert "AF_CAN" in settings["RestrictAddressFamilies"]
    assert settings["CapabilityBoundingSet"] == settings["AmbientCapabilities"] == ""
    example = (DEPLOY / "logger.toml").read_text(encoding="utf-8")
    for folder, setting in (
        ("/var/lib/", "StateDirectory"),
        ("/run/", "RuntimeDirectory"),
        ("/var/log/", "LogsDirectory"),
    ):
        assert f'"{folder}{settings[setting]}' in example


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_understands_the_unit(tmp_path: Path) -> None:
    unit = (DEPLOY / "syncline.service").read_text(encoding="utf-8")
    here = tmp_path / "syncline.service"
    here.write_text(unit.replace("/opt/syncline/bin/syncline", sys.executable), encoding="utf-8")
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(here)],
        capture_output=True,
        check=False,
        encoding="utf-8",
    )
    # What it says of the machine's own units is not ours.
    assert [line for line in done.stderr.splitlines() if "syncline.service" in line] == []
