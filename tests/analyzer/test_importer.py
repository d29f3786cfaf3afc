"""`rerun-importer-syncline`, as the Rerun viewer starts it."""

import subprocess
import sys
from pathlib import Path

import pytest

from syncline_analyzer.importer import INCOMPATIBLE, main

SAMPLES = Path(__file__).parents[2] / "samples"


def started(*arguments: str) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "syncline_analyzer.importer", *arguments]
    return subprocess.run(command, capture_output=True, check=False)


def test_a_log_becomes_a_recording_with_our_layout(tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    settings = ["--application-id", "x", "--recording-id", "y", "--opened-recording-id", "z"]
    done = started(str(SAMPLES / "jittery_sync.log"), *settings)
    assert (done.returncode, done.stderr) == (0, b"")
    path = tmp_path / "piped.rrd"
    path.write_bytes(done.stdout)
    reader = RrdReader(path)
    found = {chunk.entity_path for chunk in reader.stream()}
    assert {"/findings", "/nmt/can0/003_lir-ma158k", "/log/frames"} <= found
    assert len(reader.blueprints()) == 1


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("notes.md", b"# notes"),
        ("server.log", b"2026-03-01 12:00:00 started\n2026-03-01 12:00:01 ready\n"),
        ("other.mcap", b"\x89MCAP0\r\n\x01\x0c\0\0\0\0\0\0\0\x04\0\0\0ros2\0\0\0\0"),
        ("broken.mcap", b"\x89MC"),
        ("empty.blf", b""),
    ],
)
def test_what_is_not_ours_is_left_to_others(
    name: str, content: bytes, tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert main([str(path), "--application-id", "x"]) == INCOMPATIBLE
    assert capfdbinary.readouterr().out == b""


def test_exit_code_is_the_one_that_rerun_asks_for() -> None:
    import rerun

    assert rerun.EXTERNAL_IMPORTER_INCOMPATIBLE_EXIT_CODE == INCOMPATIBLE
