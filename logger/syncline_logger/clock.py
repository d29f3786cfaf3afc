"""The recorder's clock: UTC that never steps back, and what the machine's clocks did meanwhile."""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

STEP_THRESHOLD_NS = 1_000_000
"""Smaller differences between UTC and the elapsed time are slewing and reading noise."""

READ_TRIES = 5
"""A sample is read again while something came between the readings of its clocks."""
CLOSE_ENOUGH_NS = 2_000


@dataclass(frozen=True, slots=True)
class ClockReading:
    """The machine's clocks read together [ns].

    Attributes:
        monotonic_ns: stands still while the machine sleeps, where `boot_ns` is told.
        step_ns: how far UTC was set since the reading before; 0 below the threshold.
        boot_ns: goes on while the machine sleeps; None where the system has no such clock.
        slept_ns: how long the machine slept since the reading before.
        uncertainty_ns: what passed between the first and the last of the readings.
        offset_ns: log time minus elapsed time after this reading.
    """

    utc_ns: int
    monotonic_ns: int
    step_ns: int
    boot_ns: int | None = None
    slept_ns: int = 0
    uncertainty_ns: int = 0
    offset_ns: int = 0

    @property
    def elapsed_ns(self) -> int:
        """Time since some start that no setting of the date moves."""
        return self.monotonic_ns if self.boot_ns is None else self.boot_ns


class RecorderClock:
    """UTC for `log_time`: follows the system clock forward, never back.

    It runs on elapsed time (CLOCK_BOOTTIME, else the monotonic clock) plus an offset to UTC.
    `sample` raises the offset when UTC has moved forward (a gateway without a battery clock gets
    its date after the start); when UTC steps back the offset stays, so that log times keep their
    order, and the reading tells.

    Args:
        utc_ns, monotonic_ns, boot_ns: the clocks; without any the machine's own, with one's own
            monotonic clock and no `boot_ns` the machine never sleeps.
    """

    def __init__(
        self,
        utc_ns: Callable[[], int] = time.time_ns,
        monotonic_ns: Callable[[], int] | None = None,
        boot_ns: Callable[[], int] | None = None,
    ) -> None:
        if monotonic_ns is None:
            monotonic_ns, boot_ns = time.monotonic_ns, _machine_boot_ns()
        self._utc_ns = utc_ns
        self._monotonic_ns = monotonic_ns
        self._boot_ns = boot_ns
        self.elapsed_ns: Callable[[], int] = boot_ns or monotonic_ns
        self._seen = self._read()
        self.offset_ns = self._utc_offset(self._seen)

    def now_ns(self) -> int:
        """The time for `log_time` [ns]; never less than before."""
        return self.elapsed_ns() + self.offset_ns

    def sample(self) -> ClockReading:
        """Read all clocks and follow UTC forward."""
        before, now = self._seen, self._read()
        self._seen = now
        utc_offset = self._utc_offset(now)
        self.offset_ns = max(self.offset_ns, utc_offset)
        step = utc_offset - self._utc_offset(before)
        noise = before.uncertainty_ns + now.uncertainty_ns
        slept = 0
        if now.boot_ns is not None and before.boot_ns is not None:
            slept = now.boot_ns - before.boot_ns - (now.monotonic_ns - before.monotonic_ns)
        least = STEP_THRESHOLD_NS + noise
        return ClockReading(
            now.utc_ns,
            now.monotonic_ns,
            step if abs(step) >= least else 0,
            now.boot_ns,
            slept if slept >= least else 0,
            now.uncertainty_ns,
            self.offset_ns,
        )

    def _read(self) -> ClockReading:
        """The clocks, with as little as can be had between their readings."""
        best = self._read_once()
        for _ in range(READ_TRIES - 1):
            if best.uncertainty_ns <= CLOSE_ENOUGH_NS:
                break
            again = self._read_once()
            best = min(best, again, key=lambda reading: reading.uncertainty_ns)
        return best

    def _read_once(self) -> ClockReading:
        begin_ns = self.elapsed_ns()
        monotonic_ns = self._monotonic_ns()
        utc_ns = self._utc_ns()
        end_ns = self.elapsed_ns()
        boot_ns = None if self._boot_ns is None else (begin_ns + end_ns) // 2
        return ClockReading(utc_ns, monotonic_ns, 0, boot_ns, 0, end_ns - begin_ns)

    @staticmethod
    def _utc_offset(reading: ClockReading) -> int:
        return reading.utc_ns - reading.elapsed_ns


def _machine_boot_ns() -> Callable[[], int] | None:
    """A clock that counts sleep too, where Python's monotonic clock does not."""
    names = {"linux": "CLOCK_BOOTTIME", "darwin": "CLOCK_MONOTONIC"}
    number: int | None = getattr(time, names.get(sys.platform, ""), None)
    return None if number is None else partial(time.clock_gettime_ns, number)
