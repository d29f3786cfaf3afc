"""Progress: what it says, that it is for terminals only, and that nothing of it is left."""

import io
import sys
from collections.abc import Callable
from pathlib import Path

import click
import pytest

from syncline_analyzer import cli
from syncline_analyzer.bundle_command import bundle
from syncline_analyzer.compare_command import compare
from syncline_analyzer.convert import convert
from syncline_analyzer.decode_command import decode
from syncline_analyzer.frame_estimate import frames_expected
from syncline_logger.recover_command import recover
from syncline_schemas import progress_line
from syncline_schemas.progress_line import ProgressLine

SAMPLES = Path(__file__).parents[2] / "samples"
BAD_DAY = SAMPLES / "bad_day.mcap"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True

    def screen(self) -> list[str]:
        """What is seen in the end, with every carriage return obeyed."""
        lines = []
        for line in self.getvalue().split("\n"):
            shown = ""
            for piece in line.split("\r"):
                shown = piece + shown[len(piece) :]
            lines.append(shown.rstrip())
        return lines


class Watch:
    """A clock that is set by the test."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_line_comes_after_a_second_and_goes_when_the_job_is_done() -> None:
    watch, terminal = Watch(), Terminal()
    line = ProgressLine(terminal, 1_000_000, watch)
    line(1000)
    watch.now = 0.9
    line(90_000)
    assert terminal.getvalue() == ""
    watch.now = 2.0
    line(200_000)
    assert terminal.screen() == ["200,000 frames   100,000 frames/s   20 %   8 s left"]
    watch.now = 2.1
    line(210_000)
    assert "210,000" not in terminal.getvalue(), "five times a second are enough"
    line.clear()
    assert terminal.screen() == [""]
    assert terminal.getvalue().endswith("\r")


def test_a_shorter_line_leaves_nothing_of_a_longer_one() -> None:
    watch, terminal = Watch(), Terminal()
    line = ProgressLine(terminal, 300, watch)
    watch.now = 10.0
    line(299)
    watch.now = 20.0
    line(400)
    assert terminal.screen() == ["400 frames   20 frames/s"]


def test_a_narrow_terminal_is_not_wrapped_and_a_broken_one_ends_nothing() -> None:
    watch, terminal = Watch(), Terminal()
    line = ProgressLine(terminal, 10**9, watch, columns=40)
    watch.now = 10.0
    line(10**8)
    assert max(map(len, terminal.screen())) < 40
    terminal.close()
    watch.now = 20.0
    line(2 * 10**8)
    line.clear()


@pytest.mark.parametrize(
    "ending", [".log", ".log.gz", ".log.zst", ".asc", ".trc", ".blf", ".pcapng", ".csv", ".mcap"]
)
def test_the_number_of_frames_is_known_about(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a{ending}"
    frames = convert([BAD_DAY], path).frames
    expected = frames_expected([path, BAD_DAY])
    if ending == ".pcapng":
        assert expected is None
    else:
        assert expected == pytest.approx(2 * frames, rel=0.35 if "." in ending[1:] else 0.12)


def test_files_that_cannot_be_read_tell_nothing(tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.write_bytes(b"")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(BAD_DAY.read_bytes()[:9000])
    for path in (empty, cut, tmp_path / "missing"):
        assert frames_expected([path]) is None


Words = Callable[[Path], list[object]]
COMMANDS: list[tuple[click.Command, Words]] = [
    (cli.analyze, lambda folder: [BAD_DAY]),
    (cli.analyze, lambda folder: [BAD_DAY, "--out", folder / "report"]),
    (cli.convert, lambda folder: [BAD_DAY, folder / "a.log"]),
    (cli.info, lambda folder: [BAD_DAY]),
    (compare, lambda folder: [BAD_DAY, BAD_DAY]),
    (bundle, lambda folder: [BAD_DAY, "-o", folder / "case.zip"]),
    (decode, lambda folder: [BAD_DAY]),
    (recover, lambda folder: [BAD_DAY, "-o", folder / "b.mcap"]),
]


@pytest.mark.parametrize(("command", "words"), COMMANDS)
@pytest.mark.parametrize("on_terminal", [True, False])
def test_every_command_that_reads_captures_tells_how_far_it_is(
    command: click.Command,
    words: Words,
    on_terminal: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = Terminal() if on_terminal else io.StringIO()
    monkeypatch.setattr(progress_line, "QUIET_S", 0.0)
    monkeypatch.setattr(progress_line, "PERIOD_S", 0.0)
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    command.main([str(word) for word in words(tmp_path)], standalone_mode=False)
    assert ("frames/s" in terminal.getvalue()) == on_terminal
    if isinstance(terminal, Terminal):
        assert "11,545 frames   " in terminal.getvalue()
        assert not [text for text in terminal.screen() if "frames/s" in text or "writing" in text]
