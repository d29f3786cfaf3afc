"""Virtual time: a queue of events in integer nanoseconds."""

from collections.abc import Callable
from heapq import heappop, heappush
from typing import Any

_LATE = 1 << 62


class Simulation:
    """Runs actions in the order of their times; equal times run in the order of scheduling."""

    def __init__(self) -> None:
        self.now_ns = 0
        self._order = 0
        self._queue: list[tuple[int, int, Callable[..., None], tuple[Any, ...]]] = []

    def at(self, t_ns: int, action: Callable[..., None], *args: Any) -> None:
        """Run an action at a time, which must not lie in the past."""
        self._order += 1
        heappush(self._queue, (t_ns, self._order, action, args))

    def late_at(self, t_ns: int, action: Callable[..., None], *args: Any) -> None:
        """Run an action at a time, after everything else that happens at that time."""
        self._order += 1
        heappush(self._queue, (t_ns, _LATE + self._order, action, args))

    def run_until(self, end_ns: int) -> None:
        """Run all events before `end_ns` and set the time to it."""
        queue = self._queue
        while queue and queue[0][0] < end_ns:
            self.now_ns, _, action, args = heappop(queue)
            action(*args)
        self.now_ns = end_ns
