"""What the base install does without the analyzer extra."""

import importlib.util
import subprocess
import sys

import pytest

WITHOUT_EXTRA = importlib.util.find_spec("pandas") is None


def syncline(*arguments: str) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "syncline_logger", *arguments],
        check=False,
        capture_output=True,
        text=True,
    )


@pytest.mark.skipif(not WITHOUT_EXTRA, reason="the analyzer extra is installed")
@pytest.mark.parametrize("command", ["analyze", "view", "demo"])
def test_a_command_of_the_extra_says_what_to_install(command: str) -> None:
    done = syncline(command, "x.mcap") if command != "demo" else syncline(command)
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
