"""Peak memory of a process and of all that it starts, sampled while it runs; Linux tells it only."""

import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

INTERVAL_S = 0.05
"""More often, it would take a noticeable part of a processor from what is measured."""


class PeakMemory:
    """The most that processes held at one time; pages that two of them share count twice.

    Attributes:
        whole_mb: this process and its descendants; None where the system does not tell.
        started_mb: its descendants alone.
    """

    def __init__(self) -> None:
        self.whole_mb: float | None = None
        self.started_mb: float | None = None

    @contextmanager
    def sampled(self) -> Iterator["PeakMemory"]:
        """Look every 50 ms, in a thread, until the context is left."""
        stop = threading.Event()
        thread = threading.Thread(target=self._sample_until, args=(stop,), daemon=True)
        thread.start()
        try:
            yield self
        finally:
            stop.set()
            thread.join()

    def _sample_until(self, stop: threading.Event) -> None:
        while True:
            self._sample()
            if stop.wait(INTERVAL_S):
                return

    def _sample(self) -> None:
        try:
            own = _resident_mb(os.getpid())
        except OSError:
            return
        started = sum(_resident_or_none_mb(pid) for pid in _descendants(os.getpid()))
        self.whole_mb = max(self.whole_mb or 0.0, own + started)
        self.started_mb = max(self.started_mb or 0.0, started)


def _descendants(pid: int) -> Iterator[int]:
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children = [int(number) for number in task.read_text(encoding="ascii").split()]
        except OSError:  # it ended meanwhile
            continue
        for child in children:
            yield child
            yield from _descendants(child)


def peak_mb() -> float | None:
    """Peak memory of this process alone; None where the system does not tell (only Linux does)."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return None
    found = re.search(r"VmHWM:\s+(\d+) kB", status)
    return int(found[1]) / 1024 if found else None


def _resident_or_none_mb(pid: int) -> float:
    try:
        return _resident_mb(pid)
    except OSError:  # it ended meanwhile
        return 0.0


def _resident_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / (1 << 20)
