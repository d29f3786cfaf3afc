"""Decoding beside the recording: a thread behind a bounded queue that can never hold it up."""

import queue
import threading
import time

import numpy as np
from numpy.typing import NDArray

from syncline_logger.decoding import Decoded, LiveDecoder
from syncline_schemas.batch import FrameBatch

QUEUED_BATCHES = 4


class DecodeWorker:
    """Runs a LiveDecoder in its own thread.

    Attributes:
        dropped_frames: frames that were not decoded because the thread was behind.
    """

    def __init__(self, decoder: LiveDecoder) -> None:
        self._decoder = decoder
        self._tasks: queue.Queue[tuple[FrameBatch, NDArray[np.int64]] | None] = queue.Queue(
            QUEUED_BATCHES
        )
        self._results: queue.SimpleQueue[Decoded] = queue.SimpleQueue()
        self._pending = 0
        self.dropped_frames = 0
        self._thread = threading.Thread(target=self._run, name="syncline decode", daemon=True)
        self._thread.start()

    def submit(self, frames: FrameBatch, log_ns: NDArray[np.int64]) -> bool:
        """Queue a batch; False when there was no room for it."""
        try:
            self._tasks.put_nowait((frames, log_ns))
        except queue.Full:
            self.dropped_frames += len(frames)
            return False
        self._pending += 1
        return True

    def results(self, wait_s: float) -> list[Decoded]:
        """What is ready; waits up to `wait_s` for what is still being decoded."""
        ready: list[Decoded] = []
        until = time.monotonic() + wait_s
        while self._pending:
            try:
                ready.append(self._results.get(timeout=max(until - time.monotonic(), 0)))
            except queue.Empty:
                break
            self._pending -= 1
        return ready

    def finish(self, wait_s: float) -> list[Decoded]:
        """The last results; the thread ends when its queue is empty."""
        ready = self.results(wait_s)
        try:
            self._tasks.put(None, timeout=wait_s)
        except queue.Full:
            return ready
        return ready + self.results(0)

    def _run(self) -> None:
        broken = False
        while (task := self._tasks.get()) is not None:
            decoded = Decoded()
            try:
                if not broken:
                    decoded = self._decoder.decode(*task)
            except Exception as error:  # noqa: BLE001 - a bug here must not cost the recording
                broken = True
                decoded.problems.append((0, f"decoding is off: {type(error).__name__}: {error}"))
            self._results.put(decoded)
