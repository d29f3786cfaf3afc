"""The recorder's clock: UTC that never steps back, and what the machine's clocks did meanwhile."""

import time
from collections.abc import Callable
from dataclasses import dataclass

STEP_THRESHOLD_NS = 1_000_000
"""Smaller differences between UTC and the monotonic clock are slewing and reading noise."""


@dataclass(frozen=True, slots=True)
class ClockReading:
    """UTC and the monotonic clock read together [ns].

    `step_ns` is how far UTC moved against the monotonic clock since the reading before; 0 when
    that is less than the threshold.
    """

    utc_ns: int
    monotonic_ns: int
    step_ns: int


class RecorderClock:
    """UTC for `log_time`: follows the system clock forward, never back.

    It runs on the monotonic clock plus an offset to UTC. `sample` raises the offset when UTC has
    moved forward (a gateway without a battery clock gets its date after the start); when UTC
    steps back the offset stays, so that log times keep their order, and the reading tells.
    """

    def __init__(
        self,
        utc_ns: Callable[[], int] = time.time_ns,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._utc_ns = utc_ns
        self._monotonic_ns = monotonic_ns
        self._seen_offset_ns = self._offset_ns = utc_ns() - monotonic_ns()

    def now_ns(self) -> int:
        """The time for `log_time` [ns]; never less than before."""
        return self._monotonic_ns() + self._offset_ns

    def sample(self) -> ClockReading:
        """Read both clocks and follow UTC forward."""
        monotonic, utc = self._monotonic_ns(), self._utc_ns()
        offset = utc - monotonic
        step = offset - self._seen_offset_ns
        self._seen_offset_ns = offset
        self._offset_ns = max(self._offset_ns, offset)
        return ClockReading(utc, monotonic, step if abs(step) >= STEP_THRESHOLD_NS else 0)
