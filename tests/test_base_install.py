"""What the base install does without the analyzer extra."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

WITHOUT_EXTRA = importlib.util.find_spec("pandas") is None


def syncline(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "syncline_logger", *arguments],
        check=False,
        capture_output=True,
        text=True,
        cwd=cwd,
    )


@pytest.mark.skipif(not WITHOUT_EXTRA, reason="the analyzer extra is installed")
@pytest.mark.parametrize("words", [("analyze", "--out", "report"), ("view",), ("demo",)])
def test_what_needs_the_extra_says_what_to_install(words: tuple[str, ...], tmp_path: Path) -> None:
    log = tmp_path / "line.log"
    log.write_text("(1700000000.000000) can0 705#05\n", encoding="ascii")
    capture = () if words == ("demo",) else (str(log),)
    done = syncline(*words, *capture, cwd=tmp_path)
    assert done.returncode == 2
    assert 'pip install "syncline[analyzer]"' in done.stderr
    assert "Traceback" not in done.stderr


def test_help_lists_every_command() -> None:
    done = syncline("--help")
    assert done.returncode == 0
    for command in ("analyze", "convert", "demo", "devices", "info", "record", "recover", "view"):
        assert command in done.stdout


def test_devices_needs_no_extra() -> None:
    done = syncline("devices")
    assert done.returncode == 0
    assert "haomiao-38" in done.stdout
