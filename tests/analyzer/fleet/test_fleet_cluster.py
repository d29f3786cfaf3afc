"""Runs on real parts: processes over TCP, an S3 server, and what happens to them meanwhile."""

import gc
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("distributed")

import dask
from click.testing import CliRunner

from syncline_analyzer.fleet import identity
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.progress import Silent
from syncline_analyzer.fleet.run import run
from syncline_analyzer.fleet.task import Outcome, Task
from syncline_analyzer.fleet_command import fleet
from syncline_samples.fleet import Planted
from syncline_schemas.errors import SourceError, UsageError
from tests.analyzer.fleet.dask_processes import VERSION, cluster, kill, preload
from tests.analyzer.fleet.fleet_builder import analyze, capture, content, order, small_mcap

CAPTURES = 5


@pytest.fixture(autouse=True)
def same_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identity, "code_version", lambda: VERSION)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Captures of two machines, one file that is none."""
    folder = tmp_path / "in"
    for number in range(CAPTURES):
        capture(folder, number % 2, number // 2, Planted(emcys=number % 3))
    (folder / "machine-000" / "broken.mcap").write_bytes(b"\x89MCAP but no more")
    return folder


class Meddler(Silent):
    """Does things once so many tasks are done."""

    def __init__(self, actions: dict[int, Callable[[], None]]) -> None:
        self.actions, self.done_tasks, self.losses = actions, 0, 0

    def done(self, task: Task, outcome: Outcome) -> None:
        self.done_tasks += 1
        self.actions.get(self.done_tasks, lambda: None)()

    def lost(self, reason: str) -> None:
        self.losses += 1


def test_killed_worker_and_restarted_scheduler_leave_no_trace(source: Path, tmp_path: Path) -> None:
    analyze(source, tmp_path / "quiet")
    out = tmp_path / "out"
    with cluster(tmp_path, workers=2, pause_s=0.3) as started:

        def kill_worker() -> None:
            kill(started.workers[0])

        meddler = Meddler({1: kill_worker, 3: started.restart_scheduler})
        summary = run(order(source, out), meddler, scheduler=started.address)
    assert meddler.losses >= 1
    assert (summary.analyzed, summary.failed) == (CAPTURES, 1), summary.failures
    assert content(out) == content(tmp_path / "quiet")
    assert not (out / ".staging").exists()


def test_a_capture_that_kills_its_worker_is_a_failure(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    small_mcap(source / "good.mcap", recording_id="good")
    small_mcap(source / "poison.mcap", recording_id="bad")
    with dask.config.set({"distributed.worker.preload": [str(preload(tmp_path))]}):
        words = ["analyze", str(source), "--out", str(out), "--workers", "1", "--check"]
        result = CliRunner().invoke(fleet, words)
    assert result.exit_code == 1, result.output
    assert result.stdout.startswith("2 recordings: 1 analyzed, 0 unchanged, 1 failed\n20 frames in")
    assert f"failed: {(source / 'poison.mcap').as_posix()}: a worker died" in result.stdout
    (failure,) = Dataset.open(str(out)).failures
    assert failure.kind == "worker died"
    assert "died" in failure.reason
    assert not (out / ".staging").exists()


def test_a_scheduler_that_is_not_there_is_said(tmp_path: Path) -> None:
    small_mcap(tmp_path / "in" / "a.mcap")
    asked = order(tmp_path / "in", tmp_path / "out")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(SourceError, match="no Dask scheduler"):
            run(asked, Silent(), scheduler=address)


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("address", ["nonsense", "foo://host:1", "tcp://host"])
def test_what_is_no_address_is_said(tmp_path: Path, address: str) -> None:
    small_mcap(tmp_path / "in" / "a.mcap")
    with pytest.raises(UsageError, match="is no address"):
        run(order(tmp_path / "in", tmp_path / "out"), Silent(), scheduler=address)
    gc.collect()


def test_ctrl_c_ends_a_run_and_keeps_what_stands(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    for number in range(20):
        small_mcap(source / f"{number}.mcap", recording_id=str(number))
    # Where the tests run in the background, SIGINT is ignored and would stay so.
    heeds = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    program = f"{heeds}; from syncline_logger.cli import main; main()"
    command = (sys.executable, "-c", program, "fleet", "analyze", str(source))
    options = ("--out", str(out), "--workers", "1", "--format", "json")
    environment = {**os.environ, "DASK_DISTRIBUTED__WORKER__PRELOAD": str(preload(tmp_path, 0.5))}
    process = subprocess.Popen(
        [*command, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        start_new_session=True,
    )
    assert process.stdout is not None
    first = json.loads(process.stdout.readline())
    assert first["status"] == "analyzed"
    # As a terminal does: to all processes of the group.
    os.killpg(process.pid, signal.SIGINT)
    _, words = process.communicate(timeout=60)
    assert process.returncode == 130
    assert b"Traceback" not in words
    captures = Dataset.open(str(out)).captures
    assert 1 <= len(captures) < 20
    assert not (out / ".staging").exists()
