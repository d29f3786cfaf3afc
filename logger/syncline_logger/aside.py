"""A thread for what must not hold up the recording: a terminal may stand still, a disk may hang."""

import logging
import threading
from collections.abc import Callable
from queue import Full, Queue

from syncline_logger.guard import Guard

LOG = logging.getLogger("syncline.outputs")

MOST_WAITING = 1000
"""What does not fit is left out."""


class Aside:
    """Does things one after another in a thread; what they raise is logged once for each name."""

    def __init__(self, most: int = MOST_WAITING) -> None:
        self._waiting: Queue[tuple[str, Callable[[], object]] | None] = Queue(most)
        self._left_out = 0
        self._guard = Guard(LOG.warning)
        self._thread = threading.Thread(target=self._run, name="syncline outputs", daemon=True)
        self._thread.start()

    def do(self, name: str, act: Callable[[], object], *, wait_s: float = 0.0) -> None:
        """Have something done soon; never raises, waits for room only where that is wanted."""
        try:
            self._waiting.put((name, act), wait_s > 0, wait_s)
        except Full:
            self._left_out += 1

    def close(self, timeout_s: float) -> bool:
        """Do the rest, for at most so long; whether all was done. What stands still is left alone."""
        try:
            self._waiting.put(None, timeout=timeout_s)
        except Full:
            return False
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (todo := self._waiting.get()) is not None:
            self._guard.call(*todo)
            if self._left_out and self._waiting.empty():
                LOG.warning("%d outputs were left out: one of them stood still", self._left_out)
                self._left_out = 0
