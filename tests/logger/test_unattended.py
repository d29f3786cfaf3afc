"""What is told of a recorder that nobody looks at: files, log, service manager."""

import json
import logging
import os
import re
import socket
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest

from syncline_logger.notes import Note
from syncline_logger.own_log import own_log
from syncline_logger.prometheus import prometheus_text
from syncline_logger.record_outputs import RecordOutputs
from syncline_logger.sd_notify import ServiceManager
from syncline_logger.small_file import replace_file
from syncline_logger.status_file import StatusFile
from syncline_logger.status_view import plain_line, status_file_text, status_json
from syncline_schemas.errors import UsageError
from tests.logger.status_builder import S, bus, status

# --- the status file ---


def test_the_status_file_holds_the_json_line_and_whether_it_runs(tmp_path: Path) -> None:
    path = tmp_path / "status.json"
    file = StatusFile(path, status_file_text)
    file.show(status(bus(frames=7)))
    told = json.loads(path.read_text(encoding="utf-8"))
    assert told.pop("state") == "recording"
    assert told.pop("pid") == os.getpid()
    assert told == json.loads(status_json(status(bus(frames=7))))
    file.show(status(), running=False)
    assert json.loads(path.read_text(encoding="utf-8"))["state"] == "stopped"


def test_a_reader_never_sees_a_part_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "status.json"
    replace_file(path, "old")

    def full(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OSError, match="No space"):
        replace_file(path, "new")
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_cannot_be_written_is_logged_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = StatusFile(tmp_path / "none" / "status.json", status_file_text)
    for _ in range(3):
        file.show(status())
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    (tmp_path / "none").mkdir()
    file.show(status())
    assert (tmp_path / "none" / "status.json").exists()


# --- Prometheus: the format as its specification has it (exposition format 0.0.4) ---

METRIC_NAME = re.compile(r"[a-zA-Z_:][a-zA-Z0-9_:]*")
SAMPLE = re.compile(r"(?P<name>[a-zA-Z_:][a-zA-Z0-9_:]*)(?:\{(?P<labels>.*)\})? (?P<value>\S+)")
LABEL = re.compile(r'([a-zA-Z_][a-zA-Z0-9_]*)="((?:[^"\\]|\\["\\n])*)"(?:,|$)')
UNESCAPED = {"\\\\": "\\", '\\"': '"', "\\n": "\n"}
Samples = dict[str, dict[tuple[tuple[str, str], ...], float]]


def parsed(text: str) -> Samples:
    """Samples by metric; a reader of the format that fails on everything else."""
    assert text.endswith("\n")
    samples: Samples = {}
    types: dict[str, str] = {}
    helped: set[str] = set()
    for line in text.splitlines():
        if line.startswith("# HELP "):
            name = line.split(" ")[2]
            assert METRIC_NAME.fullmatch(name)
            assert name not in helped
            helped.add(name)
        elif line.startswith("# TYPE "):
            _, _, name, kind = line.split(" ")
            assert kind in ("counter", "gauge")
            assert name not in types, "one TYPE line per metric, before its samples"
            types[name] = kind
        else:
            match = SAMPLE.fullmatch(line)
            assert match, line
            name, labels = match["name"], match["labels"] or ""
            assert list(types)[-1] == name, "the samples of a metric stand together"
            pairs = LABEL.findall(labels)
            assert "".join(f'{key}="{value}",' for key, value in pairs).rstrip(",") == labels
            key = tuple((k, re.sub(r"\\[\\\"n]", lambda m: UNESCAPED[m[0]], v)) for k, v in pairs)
            rows = samples.setdefault(name, {})
            assert key not in rows, "a time series stands once"
            rows[key] = float(match["value"])
    assert all((kind == "counter") == name.endswith("_total") for name, kind in types.items())
    return samples


def test_the_metrics_say_what_the_status_says() -> None:
    now = status(
        bus("can0", frames=12_345_678_901, load_percent=25.0, dropped_frames=3, nodes={5: "LOST"}),
        bus("can1", adapter_present=False, state="off", frames_per_s=1.5),
        gaps=2,
        t_ns=1_760_000_000 * S,
    )
    told = parsed(prometheus_text(now, True))
    can0, can1 = (("bus", "can0"),), (("bus", "can1"),)
    assert told["syncline_up"] == {(): 1}
    assert told["syncline_status_time_seconds"] == {(): 1_760_000_000}
    assert told["syncline_gaps_total"] == {(): 2}
    assert told["syncline_disk_trouble"] == {(): 0}
    assert told["syncline_frames_total"] == {can0: 12_345_678_901, can1: 0}
    assert told["syncline_frames_per_second"][can1] == 1.5
    assert told["syncline_bus_load_ratio"] == {can0: 0.25}
    assert told["syncline_lost_frames_total"] == {can0: 3, can1: 0}
    assert told["syncline_adapter_present"] == {can0: 1, can1: 0}
    states = told["syncline_bus_state"]
    assert [key for key, value in states.items() if value == 1] == [
        (("bus", "can0"), ("state", "active")),
        (("bus", "can1"), ("state", "off")),
    ]
    assert told["syncline_node_state"] == {(("bus", "can0"), ("node", "5"), ("state", "LOST")): 1}
    ended = parsed(prometheus_text(replace(now, trouble="the disk is full"), False))
    assert ended["syncline_up"] == {(): 0}
    assert ended["syncline_disk_trouble"] == {(): 1}


def test_names_of_buses_are_escaped() -> None:
    name = 'a"b\\c\nd'
    told = parsed(prometheus_text(status(bus(name)), True))
    assert (("bus", name),) in told["syncline_frames_total"]


# --- the own log ---


def test_the_log_is_rotated_and_says_utc(tmp_path: Path) -> None:
    path = tmp_path / "log" / "recorder.log"
    with own_log(path, size=2000, keep=2):
        for number in range(200):
            logging.getLogger("syncline.x").info("line %03d", number)
    names = sorted(each.name for each in path.parent.iterdir())
    assert names == ["recorder.log", "recorder.log.1", "recorder.log.2"]
    assert all(each.stat().st_size <= 2000 for each in path.parent.iterdir())
    last = path.read_text(encoding="utf-8").splitlines()[-1]
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z INFO line 199", last)


def test_a_full_disk_loses_the_line_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with own_log(tmp_path / "x.log", size=1000, keep=1):
        monkeypatch.setattr("logging.handlers.RotatingFileHandler.shouldRollover", full)
        logging.getLogger("syncline.x").warning("lost")
        monkeypatch.undo()
    assert capsys.readouterr().err == ""


def test_a_log_that_cannot_be_opened_is_a_mistake_of_the_user(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be written"), own_log(tmp_path, 1000, 1):
        pass


def test_without_a_log_nothing_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with own_log(None, 1000, 1):
        logging.getLogger("syncline.x").warning("nobody hears")
    assert capsys.readouterr() == ("", "")


# --- the service manager ---

needs_unix = pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="needs UNIX sockets")


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The service manager's end; its address is relative, as paths of sockets must be short."""
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind("notify")
        receiver.setblocking(False)
        yield receiver


def heard(receiver: socket.socket) -> list[str]:
    messages = []
    while True:
        try:
            messages.append(receiver.recv(4096).decode())
        except BlockingIOError:
            return messages


@needs_unix
def test_the_manager_hears_ready_status_and_stopping(manager: socket.socket) -> None:
    service = ServiceManager({"NOTIFY_SOCKET": "notify"})
    service.ready("recording\nto x")
    service.status("fine")
    service.alive()
    service.stopping()
    service.close()
    service.status("nobody hears")
    assert heard(manager) == [
        f"READY=1\nSTATUS=recording to x\nMAINPID={os.getpid()}",
        "STATUS=fine",
        "STOPPING=1",
    ]


@needs_unix
def test_the_watchdog_is_fed_twice_per_its_time(manager: socket.socket) -> None:
    turns_ns = iter(range(0, 60 * S, S // 10))
    service = ServiceManager(
        {"NOTIFY_SOCKET": "notify", "WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getpid())},
        lambda: next(turns_ns),
    )
    for _ in range(600):
        service.alive()
    service.close()
    assert heard(manager) == ["WATCHDOG=1"] * 4


@needs_unix
def test_the_watchdog_of_another_process_is_not_fed(manager: socket.socket) -> None:
    environ = {"NOTIFY_SOCKET": "notify", "WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}
    service = ServiceManager(environ)
    service.alive()
    service.close()
    assert heard(manager) == []


@pytest.mark.parametrize("address", ["", "nobody-listens-here"])
def test_without_a_manager_nothing_happens(address: str) -> None:
    service = ServiceManager({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1"})
    service.ready("x")
    service.alive()
    service.stopping()
    service.close()


@pytest.mark.skipif(not Path("/proc").exists(), reason="abstract sockets are Linux's")
def test_an_abstract_address() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(f"\0syncline-test-{os.getpid()}")
        receiver.setblocking(False)
        service = ServiceManager({"NOTIFY_SOCKET": f"@syncline-test-{os.getpid()}"})
        service.status("x")
        service.close()
        assert heard(receiver) == ["STATUS=x"]


# --- all together ---


class Silent:
    def started(self, path: Path) -> None:
        self.path = path

    def status(self, snapshot: object) -> None:
        self.last = snapshot

    def words(self, text: str) -> None:
        self.told = text


@needs_unix
def test_everyone_is_told(manager: socket.socket, tmp_path: Path) -> None:
    view = Silent()
    service = ServiceManager({"NOTIFY_SOCKET": "notify"})
    with (
        own_log(tmp_path / "x.log", 10_000, 1),
        RecordOutputs(view, tmp_path / "s.json", tmp_path / "x.prom", service) as outputs,
    ):
        outputs.started(Path("a.mcap"))
        outputs.status(status(bus(frames=3)))
        outputs.note(Note(1_500_000_000, "unplugged", "can0", serious=True))
        outputs.alive()
    assert json.loads((tmp_path / "s.json").read_text(encoding="utf-8"))["frames"] == 3
    assert view.path == Path("a.mcap")
    assert view.last == status(bus(frames=3))
    assert json.loads((tmp_path / "s.json").read_text(encoding="utf-8"))["state"] == "stopped"
    assert parsed((tmp_path / "x.prom").read_text(encoding="utf-8"))["syncline_up"] == {(): 0}
    assert [message.split("\n")[0] for message in heard(manager)] == [
        "READY=1",
        f"STATUS={plain_line(status(bus(frames=3)))}",
        "STOPPING=1",
    ]
    log = (tmp_path / "x.log").read_text(encoding="utf-8")
    assert [line.split(" ", 1)[1] for line in log.splitlines()] == [
        f"INFO syncline {version('syncline')} starts",
        "INFO recording to a.mcap",
        "WARNING can0: unplugged",
        f"INFO stopped: {plain_line(status(bus(frames=3)))}",
    ]
    assert log.splitlines()[2].startswith("1970-01-01T00:00:01.500Z "), "when it happened"


def test_the_log_says_what_ended_it(tmp_path: Path) -> None:
    with (
        own_log(tmp_path / "x.log", 10_000, 1),
        pytest.raises(OSError, match="gone"),
        RecordOutputs(Silent()),
    ):
        raise OSError("the disk is gone")
    assert "ended by OSError: the disk is gone" in (tmp_path / "x.log").read_text(encoding="utf-8")
