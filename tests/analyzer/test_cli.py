"""The analyzer's commands: what they print where, what they write, and how they exit."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from syncline_analyzer import cli
from syncline_analyzer.results import Analysis
from syncline_analyzer.viewer import viewer_command
from syncline_schemas.batch import FrameBatch
from syncline_schemas.errors import UsageError
from tests.analyzer.analysis_builder import analysis, bad_day, capture_row, finding, node_row

CANDUMP = "(1700000000.000100) can0 70A#00\n(1700000000.100100) can0 70A#05\n"


class FakeSession:
    """A session that knows its analysis beforehand."""

    decoding = None

    def __init__(self, told: Analysis) -> None:
        self.told = told
        self.asked: dict[str, Any] = {}

    def __call__(self, captures: Any, **options: Any) -> "FakeSession":
        self.asked = {"captures": captures, **options}
        return self

    def analyze(self, progress: object, meanwhile: Callable[[], object]) -> Analysis:
        assert progress is None, "no progress where stderr is no terminal"
        meanwhile()
        return self.told

    @property
    def analysis(self) -> Analysis:
        return self.told

    def frames(self, start: object, end: object) -> Iterator[FrameBatch]:
        return iter(())


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> FakeSession:
    fake = FakeSession(bad_day())
    monkeypatch.setattr("syncline_analyzer.session.open_session", fake)
    return fake


def run(command: Any, *words: str) -> Result:
    return CliRunner().invoke(command, words, standalone_mode=True)


def test_analyze_prints_a_summary(session: FakeSession) -> None:
    result = run(cli.analyze, "a.mcap")
    assert result.exit_code == 0, result.output
    assert "2 errors, 1 warning, 1 note" in result.stdout
    assert result.stderr == ""
    assert session.asked["captures"] == (Path("a.mcap"),)


def test_analyze_hands_its_options_on(session: FakeSession) -> None:
    words = "a.log b.log --description bus.toml --device 10=jn2100 --device 0x10=x=y.eds"
    run(
        cli.analyze,
        *words.split(),
        "--bitrate",
        "250000",
        "--from",
        "10s",
        "--to",
        "1m30s",
        "--data-bitrate",
        "2000000",
        "--offset",
        "a=b.log=+3600",
    )
    assert session.asked == {
        "captures": (Path("a.log"), Path("b.log")),
        "description": Path("bus.toml"),
        "devices": {10: "jn2100", 16: "x=y.eds"},
        "bitrate": 250_000,
        "data_bitrate": 2_000_000,
        "start": "10s",
        "end": "1m30s",
        "offsets": {"a=b.log": "+3600"},
    }


def test_json_is_the_only_thing_on_stdout(session: FakeSession, tmp_path: Path) -> None:
    result = run(cli.analyze, "a.mcap", "--format", "json", "--out", str(tmp_path / "new" / "out"))
    assert json.loads(result.stdout)["schema"] == "syncline.analysis/1"
    assert "report.html" in result.stderr


def test_out_writes_what_the_interface_names(session: FakeSession, tmp_path: Path) -> None:
    run(cli.analyze, "a.mcap", "--out", str(tmp_path))
    written = {str(path.relative_to(tmp_path).as_posix()) for path in tmp_path.rglob("*.*")}
    assert {"report.html", "session.rrd", "findings.json", "tables/emcy.parquet"} <= written


@pytest.mark.parametrize(
    ("severity", "check", "code"),
    [
        ("error", "error", 1),
        ("error", "warning", 1),
        ("warning", "error", 0),
        ("warning", "warning", 1),
        ("info", "warning", 0),
    ],
)
def test_check_exits_with_1_when_the_findings_are_that_bad(
    session: FakeSession, severity: str, check: str, code: int
) -> None:
    session.told = analysis(nodes=[node_row()], findings=[finding(severity=severity)])
    assert run(cli.analyze, "a.mcap", "--check", check).exit_code == code
    assert run(cli.analyze, "a.mcap").exit_code == 0


def test_damaged_capture_exits_with_1(session: FakeSession) -> None:
    session.told = analysis(capture=capture_row(damage=["a.mcap: no footer"]))
    result = run(cli.analyze, "a.mcap")
    assert result.exit_code == 1
    assert "no footer" in result.stdout


@pytest.mark.parametrize("text", ["10", "=jn2100", "10=", "0=jn2100", "128=jn2100", "x=jn2100"])
def test_device_that_makes_no_sense_is_a_usage_error(text: str) -> None:
    result = run(cli.analyze, "a.mcap", "--device", text)
    assert isinstance(result.exception, UsageError)
    assert "10=jn2100" in str(result.exception)


def test_view_shows_a_recording_to_this_machine_only(
    session: FakeSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[tuple[bool, bool]] = []

    def show(recording: Path, *, web: bool) -> int:
        shown.append((recording.stat().st_size > 1000, web))
        return 0

    monkeypatch.setattr("syncline_analyzer.viewer.show", show)
    assert run(cli.view, "a.mcap").exit_code == 0
    assert run(cli.view, "a.mcap", "--web").exit_code == 0
    assert shown == [(True, False), (True, True)]
    for web in (False, True):
        command = viewer_command(Path("s.rrd"), web=web)
        assert command[command.index("--bind") + 1] == "127.0.0.1"
        assert ("--web-viewer" in command) == web


def test_info_tells_what_is_in_a_capture(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text(CANDUMP, encoding="ascii")
    result = run(cli.info, str(path))
    assert result.exit_code == 0, result.output
    for word in (
        "candump",
        "whole",
        "yes",
        "2 data",
        "2023-11-14 22:13:20.000100 UTC",
        "100 ms",
        "can0",
    ):
        assert word in result.stdout, word


def test_info_goes_on_after_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    good = tmp_path / "a.log"
    good.write_text(CANDUMP, encoding="ascii")
    result = run(cli.info, str(tmp_path / "none.log"), str(good))
    assert result.exit_code == 2
    assert "none.log" in result.stderr
    assert "2 data" in result.stdout


def test_convert_says_what_it_wrote_on_stderr(tmp_path: Path) -> None:
    source, target = tmp_path / "a.log", tmp_path / "b.asc"
    source.write_text(CANDUMP, encoding="ascii")
    result = run(cli.convert, str(source), str(target))
    assert result.exit_code == 0, result.output
    assert result.stdout == ""
    assert "2 frames as asc" in result.stderr
    assert "70A" in target.read_text(encoding="ascii")


@pytest.mark.parametrize("name", ["analyze", "view", "convert", "info"])
def test_help_ends_with_two_examples(name: str) -> None:
    text = run(getattr(cli, name), "--help").stdout.rstrip()
    lines = text.splitlines()
    assert lines[-3].strip() == "Examples:"
    assert all(line.strip().startswith(f"syncline {name} ") for line in lines[-2:])


def test_a_disk_that_is_full_is_told_with_the_folder(
    session: FakeSession, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("syncline_analyzer.views.files.write_all", full)
    result = run(cli.analyze, "a.mcap", "--out", str(tmp_path))
    assert isinstance(result.exception, UsageError)
    assert str(result.exception) == f"--out {tmp_path}: cannot be written: No space left on device"
