"""The `syncline` command: help, errors as one line, exit codes, plug-ins."""

import contextlib
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from syncline_logger import lazy_group
from syncline_logger.cli import OWN_COMMANDS, cli, main
from syncline_logger.option_types import duration_ns
from syncline_schemas.capture.recover import is_whole
from syncline_schemas.errors import MissingExtraError, UsageError
from tests.logger.capture_contents import doctor_complaints, read_capture, syncline

HEAVY = {
    "numpy",
    "can",
    "canopen",
    "pandas",
    "pyarrow",
    "rerun",
    "mcap",
    "rich",
    "google",
}


def run(*words: str, timeout_s: float = 60) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        syncline(*words), capture_output=True, check=False, encoding="utf-8", timeout=timeout_s
    )


@pytest.fixture(autouse=True)
def _plugins_are_looked_up_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "_found", None)


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom syncline_logger.cli import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "print(sorted({name.split('.')[0] for name in sys.modules}), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, check=True, encoding="utf-8"
    )
    imported = set(json.loads(done.stderr.replace("'", '"')))
    assert imported & HEAVY == set()
    for name in ("record", "recover", "devices", "analyze", "demo"):
        assert f"\n  {name} " in done.stdout


@pytest.mark.parametrize("name", sorted(OWN_COMMANDS))
def test_help_of_a_command_ends_with_two_examples(name: str) -> None:
    done = CliRunner().invoke(cli, [name, "--help"])
    assert done.exit_code == 0, done.output
    examples = done.output.split("Examples:\n")[1].splitlines()
    assert len([line for line in examples if line.strip().startswith(f"syncline {name}")]) == 2


def test_version() -> None:
    assert run("--version").stdout.startswith("syncline, version ")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["record", "-i", "nonsense", "-c", "x"], "there is no interface 'nonsense'"),
        (["record"], "no bus is given"),
        (["record", "-i", "slcan", "-c", "/dev/none"], "bus 'none' (slcan /dev/none): cannot open"),
        (["record", "-i", "virtual", "-c", "a", "-c", "a"], "two buses are called 'a'"),
        (["record", "--bus", "can0"], "--bus: 'can0' is not [NAME=]INTERFACE:CHANNEL"),
        (["record", "-i", "virtual", "-c", "a", "--device", "5"], "--device: '5' is not NODE="),
        (["record", "-i", "virtual", "-c", "a", "--device", "5=nothing"], "nothing"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(words: list[str], told: str, tmp_path: Path) -> None:
    done = run(*words, "--for", "1s", "-o", str(tmp_path))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("syncline: ")
    assert told in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="a shell that closes a stream")
@pytest.mark.parametrize(("words", "code"), [("devices", 0), ("info missing.mcap", 2)])
def test_streams_may_be_closed(words: str, code: int, tmp_path: Path) -> None:
    script = "import sys; from syncline_logger.cli import main; main(sys.argv[1:])"
    command = shlex.join([sys.executable, "-c", script, *words.split()])
    for closed in (">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"):
        done = subprocess.run(
            ["/bin/sh", "-c", f"{command} {closed}"], cwd=tmp_path, capture_output=True, check=False
        )
        assert done.returncode == code, (closed, done.stderr)
        assert b"internal error" not in done.stderr


def test_a_traceback_comes_only_with_debug(tmp_path: Path) -> None:
    words = ["record", "-i", "nonsense", "-c", "x", "-o", str(tmp_path)]
    assert "Traceback" not in run(*words).stderr
    assert "Traceback" in run("--debug", *words).stderr


def exit_of(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> int:
    """Exit code of a command that raises this."""

    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(cli, "main", fail)
    with pytest.raises(SystemExit) as exit_info:
        main(["record"])
    assert isinstance(exit_info.value.code, int)
    return exit_info.value.code


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (KeyboardInterrupt(), 130),
        (UsageError("x"), 2),
        (FileNotFoundError(2, "No such file", "x"), 2),
        (ZeroDivisionError("bug"), 1),
        (ModuleNotFoundError("No module named 'pandas'", name="pandas"), 2),
    ],
)
def test_exit_codes(monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int) -> None:
    assert exit_of(monkeypatch, error) == code


def plugin(monkeypatch: pytest.MonkeyPatch, *entries: EntryPoint) -> None:
    monkeypatch.setattr(lazy_group, "entry_points", lambda **_: entries)


def test_a_missing_extra_is_told_with_the_pip_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def load(_: str) -> Any:
        raise ModuleNotFoundError("No module named 'pandas'", name="pandas")

    monkeypatch.setattr("importlib.import_module", load)
    with pytest.raises(SystemExit) as exit_info:
        main(["analyze", "x.mcap"])
    assert exit_info.value.code == 2
    assert capsys.readouterr().err == (
        "syncline: 'syncline analyze' needs the package 'pandas', which is not installed;"
        ' type: pip install "syncline[analyzer]"\n'
    )


def test_our_commands_are_those_of_the_entry_points() -> None:
    ours = [each for each in entry_points(group=lazy_group.PLUGIN_GROUP) if _is_ours(each)]
    targets = {name: target for name, (target, _) in lazy_group.OF_OUR_EXTRAS.items()}
    assert {each.name: each.value for each in ours} == targets


def _is_ours(found: EntryPoint) -> bool:
    return found.dist is not None and found.dist.name == "syncline"


def test_a_command_of_ours_looks_through_nothing_that_is_installed() -> None:
    code = (
        "import sys\nfrom syncline_logger.cli import main\n"
        "try: main(['analyze', '--help'])\nexcept SystemExit: pass\n"
        "sys.exit('importlib.metadata' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)


def test_a_plugin_cannot_replace_an_own_command(monkeypatch: pytest.MonkeyPatch) -> None:
    plugin(monkeypatch, EntryPoint("record", "nowhere:evil", lazy_group.PLUGIN_GROUP))
    done = CliRunner().invoke(cli, ["record", "--help"])
    assert "Record CAN buses until stopped" in done.output


def test_a_broken_plugin_does_not_break_the_help(monkeypatch: pytest.MonkeyPatch) -> None:
    plugin(monkeypatch, EntryPoint("broken", "nowhere:nothing", lazy_group.PLUGIN_GROUP))
    assert "broken" in CliRunner().invoke(cli, ["--help"]).output
    with pytest.raises(MissingExtraError, match="nowhere"):
        CliRunner().invoke(cli, ["broken"], catch_exceptions=False)


def test_a_missing_module_of_ours_is_a_bug_and_no_missing_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "syncline_schemas.nothing"
    assert exit_of(monkeypatch, ModuleNotFoundError("x", name=name)) == 1
    assert "internal error" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("500ms", 500_000_000),
        ("10", 10_000_000_000),
        ("1.5s", 1_500_000_000),
        ("5m", 300_000_000_000),
        ("2h", 7_200_000_000_000),
        ("1d", 86_400_000_000_000),
    ],
)
def test_times(text: str, ns: int) -> None:
    assert duration_ns(text) == ns


@pytest.mark.parametrize("text", ["", "s", "-1s", "1w", "0", "1e3"])
def test_wrong_times(text: str) -> None:
    done = CliRunner().invoke(cli, ["record", "--for", text])
    assert done.exit_code == 2


def test_record_for_a_time(tmp_path: Path) -> None:
    target = tmp_path / "new" / "x.mcap"
    done = run(
        "record", "-i", "virtual", "-c", "a", "-c", "b", "-b", "500000", "--bus-kwargs",
        "rx_queue_size=100", "preserve_timestamps=true", "--device", "10=jn2100",
        "--for", "0.3", "-o", str(target),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    started, *_, last = (json.loads(line) for line in done.stdout.splitlines())
    assert started == {"path": str(target)}
    assert [bus["bus"] for bus in last["buses"]] == ["a", "b"]
    assert doctor_complaints(target) == []
    contents = read_capture(target)
    assert contents.channel_metadata["/can/a/status"] is not None
    assert "jn2100.eds" in contents.attachments
    assert b"jn2100" in contents.attachments["bus-description.toml"]


@contextlib.contextmanager
def heard(number: signal.Signals) -> Iterator[None]:
    """A signal that children take notice of, though the tests may run where it is ignored."""
    before = signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(number, before)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGTERM to catch")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_recording_properly(tmp_path: Path, number: signal.Signals) -> None:
    command = syncline("record", "-i", "virtual", "-c", "a", "-o", str(tmp_path))
    with (
        heard(number),
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8"
        ) as recorder,
    ):
        assert recorder.stdout is not None
        path = Path(json.loads(recorder.stdout.readline())["path"])
        time.sleep(0.3)
        recorder.send_signal(number)
        _, told = recorder.communicate(timeout=30)
    assert recorder.returncode == 0, told
    assert doctor_complaints(path) == []
    assert read_capture(path).metadata["syncline.stop"]["reason"] == "stopped"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send")
def test_a_reader_that_goes_away_does_not_end_the_recording(tmp_path: Path) -> None:
    words = ("record", "-i", "virtual", "-c", "a", "--status-period", "100ms", "-o", str(tmp_path))
    with (
        heard(signal.SIGINT),
        subprocess.Popen(
            syncline(*words), stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8"
        ) as recorder,
    ):
        assert recorder.stdout is not None
        assert recorder.stderr is not None
        path = Path(json.loads(recorder.stdout.readline())["path"])
        recorder.stdout.close()
        time.sleep(1)
        assert recorder.poll() is None
        recorder.send_signal(signal.SIGINT)
        told = recorder.stderr.read()
    assert recorder.returncode == 0, told
    assert "Traceback" not in told
    assert doctor_complaints(path) == []


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals on Windows")
def test_on_a_terminal_there_is_one_line_and_no_json(tmp_path: Path) -> None:
    far, near = os.openpty()
    command = syncline("record", "-i", "virtual", "-c", "a", "--for", "2500ms", "-o", str(tmp_path))
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=near) as recorder:
        os.close(near)
        shown = b""
        while recorder.poll() is None:
            with contextlib.suppress(OSError):  # the terminal is gone when its last user is
                shown += os.read(far, 1000)
        assert recorder.stdout is not None
        assert recorder.stdout.read() == b""
    os.close(far)
    assert b"Ctrl-C stops" in shown
    assert shown.count(b"00:00:0") >= 2
    assert b"\x1b[2K" in shown, "the line is written over"


def test_a_cut_file_in_the_folder_is_finished_by_the_next_start(tmp_path: Path) -> None:
    words = ("record", "-i", "virtual", "-c", "a", "--for", "100ms", "-o", str(tmp_path))
    run(*words)
    [cut] = tmp_path.glob("*.mcap")
    cut.write_bytes(cut.read_bytes()[:-50])
    for manifest in tmp_path.glob("*.json"):
        manifest.unlink()
    assert not is_whole(cut)
    told = run(*words)
    assert is_whole(cut)
    assert f"{cut.name} was cut off and is finished now" in told.stdout + told.stderr


def test_recover_of_a_whole_file_and_of_no_capture(tmp_path: Path) -> None:
    whole = tmp_path / "x.mcap"
    run("record", "-i", "virtual", "-c", "a", "--for", "100ms", "-o", str(whole))
    done = run("recover", str(whole), "-o", str(tmp_path / "y.mcap"))
    assert done.returncode == 0, done.stderr
    assert doctor_complaints(tmp_path / "y.mcap") == []
    again = run("recover", str(whole), "-o", str(tmp_path / "y.mcap"))
    assert (again.returncode, "exists" in again.stderr) == (2, True)
    text = tmp_path / "text.mcap"
    text.write_text("no capture", encoding="utf-8")
    assert run("recover", str(text)).returncode == 2


@pytest.mark.parametrize("words", [["record", "--for", "1s"], ["probe", "--nodes", "5"]])
def test_a_place_where_no_file_can_be_made_is_told_in_words(
    tmp_path: Path, words: list[str]
) -> None:
    (tmp_path / "file").touch()
    place = tmp_path / "file" / "x"
    done = CliRunner().invoke(cli, [*words, "-i", "virtual", "-c", "nowhere", "-o", str(place)])
    told = f"nothing can be written to {place}: "
    assert str(done.exception).startswith(told)
    assert str(done.exception).endswith("; name a folder in which files can be made with -o")
