"""A recording that runs while a test does things to its buses."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from syncline_logger.bus_options import BusOptions
from syncline_logger.live_status import StatusSnapshot
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder import record
from syncline_logger.recording import RecordResult
from syncline_logger.sources.socketcan import SocketCanSource
from tests.logger.capture_contents import Contents, read_capture

PATIENCE_S = 60


class LiveRecording:
    """A recorder in a thread of its own.

    Attributes:
        result: when it has ended.
        contents: what is in the file.
    """

    def __init__(self, target: Path, buses: Sequence[BusOptions]) -> None:
        self._target = target
        self._sources = [SocketCanSource(bus) for bus in buses]
        self._stop = threading.Event()
        self._started = threading.Event()
        self._snapshot: StatusSnapshot | None = None
        self._thread = threading.Thread(target=self._run)
        self.result: RecordResult
        self.contents: Contents
        self.threads: list[str] = []

    def _run(self) -> None:
        self.result = record(
            self._sources,
            self._target,
            RecordOptions(decode=False, flush_ns=200_000_000),
            stop=self._stop,
            on_start=lambda _: self._started.set(),
            on_status=self._see,
            status_period_ns=50_000_000,
        )

    def _see(self, snapshot: StatusSnapshot) -> None:
        self._snapshot = snapshot

    def start(self) -> None:
        """Return when it listens."""
        self._thread.start()
        assert self._started.wait(PATIENCE_S)
        self.wait_for(lambda _: True)
        self.threads = [each.name for each in threading.enumerate()]

    def wait_for(self, condition: Callable[[StatusSnapshot], bool]) -> None:
        """Wait until the status is so."""
        end_s = time.monotonic() + PATIENCE_S
        while self._snapshot is None or not condition(self._snapshot):
            assert time.monotonic() < end_s, self._snapshot
            assert self._thread.is_alive()
            time.sleep(0.02)

    def wait_for_frames(self, count: int) -> None:
        """Wait until so many frames have been taken."""
        self.wait_for(lambda snapshot: snapshot.frames >= count)

    def wait_for_presence(self, present: bool, bus: int = 0) -> None:
        """Wait until the recorder knows that a bus is there, or not."""
        self.wait_for(lambda snapshot: snapshot.buses[bus].adapter_present == present)

    def stop(self) -> None:
        """End the recording and read its file."""
        self._stop.set()
        self._thread.join(PATIENCE_S)
        self.contents = read_capture(self.result.path)


@contextmanager
def recording_of(target: Path, *channels: str, **options: object) -> Iterator[LiveRecording]:
    """Record interfaces while the block runs."""
    buses = [BusOptions(channel, "socketcan", channel, **options) for channel in channels]  # type: ignore[arg-type]
    running = LiveRecording(target, buses)
    running.start()
    try:
        yield running
    finally:
        running.stop()
