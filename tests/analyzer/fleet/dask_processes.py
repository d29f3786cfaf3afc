"""A Dask cluster of separate processes that talk over TCP on loopback."""

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from distributed import Client

VERSION = "of the test"
"""Version of Syncline on all workers: the source may be edited while a test runs."""
_PRELOAD = """
import os, signal, time
from syncline_analyzer.fleet import identity, work

identity.code_version = lambda: {version!r}
# Dask loads this file twice.
real = getattr(work, "real_publish", work.publish)
work.real_publish = real


def slow(storage, staged, entry):
    if "poison" in entry.files[0].url:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep({pause_s})
    real(storage, staged, entry)


work.publish = slow
"""


def preload(folder: Path, pause_s: float = 0.0) -> Path:
    """A file that workers load first: they pause before a capture stands, or die of `poison`."""
    path = folder / "preload.py"
    path.write_text(_PRELOAD.format(version=VERSION, pause_s=pause_s), encoding="utf-8")
    return path


class Cluster:
    """A scheduler and workers, each a process; any of them may be killed."""

    def __init__(self, folder: Path, preload: Path) -> None:
        self._folder = folder
        self._preload = preload
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.scheduler = self._scheduler()
        self.workers: list[subprocess.Popen[bytes]] = []

    @property
    def address(self) -> str:
        """Of the scheduler."""
        return f"tcp://127.0.0.1:{self.port}"

    def _scheduler(self) -> "subprocess.Popen[bytes]":
        where = ("--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard", "--no-show")
        return self._started("scheduler", *where)

    def add_worker(self) -> None:
        """Start a worker of one thread."""
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")
        more = ("--preload", str(self._preload), "--local-directory", str(self._folder))
        self.workers.append(self._started("worker", self.address, *options, *more))

    def wait_for(self, workers: int) -> None:
        """Wait until so many workers are there."""
        with Client(self.address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60)

    def restart_scheduler(self) -> None:
        """Kill the scheduler and all workers; start a scheduler that knows nothing, and a worker."""
        for process in (self.scheduler, *self.workers):
            kill(process)
        self.scheduler = self._scheduler()
        self.workers = []
        self.add_worker()

    def end(self) -> None:
        """End all processes."""
        for process in (*self.workers, self.scheduler):
            kill(process)

    def _started(self, kind: str, *options: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *options]
        return subprocess.Popen(
            command, cwd=self._folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )


def kill(process: "subprocess.Popen[bytes]") -> None:
    """Kill a process at once, as a power cut does."""
    process.kill()
    process.wait()


@contextmanager
def cluster(folder: Path, workers: int = 2, pause_s: float = 0.0) -> Iterator[Cluster]:
    """A cluster with so many workers, which are there."""
    started = Cluster(folder, preload(folder, pause_s))
    try:
        for _ in range(workers):
            started.add_worker()
        started.wait_for(workers)
        yield started
    finally:
        started.end()
