"""What the stamps of a serial adapter count, proven by the arrivals, and t from them."""

import numpy as np
from numpy.typing import NDArray

from syncline_logger.adapter_clock import AdapterClock, Knot, Unwrapped
from syncline_logger.clock import RecorderClock

MILLISECOND_NS, MICROSECOND_NS = 1_000_000, 1_000
MINUTE_WRAP, WORD_WRAP, LONG_WRAP = 60_000, 1 << 16, 1 << 32
"""Milliseconds of LAWICEL's adapters start again after a minute, those of some others later."""
UNITS_NS = {4: (MILLISECOND_NS,), 8: (MICROSECOND_NS, MILLISECOND_NS)}
"""What a step of a stamp of so many digits can be."""
PROVEN_AFTER_NS = 500_000_000
PROVEN_WITHIN_NS = 25_000_000_000
"""In a longer silence before the proof a counter may have wrapped; the proof begins anew."""
AS_FAST = (0.5, 2.0)
"""A counter that runs so much slower or faster than time is no clock of that unit."""


class StampClock:
    """t of stamps of four or eight digits; until their unit is proven there is none.

    Attributes:
        unit_ns: step of the stamps; None while it is not known.
        is_clock: False when the stamps turned out to be no clock.
    """

    def __init__(self, clock: RecorderClock, digits: int) -> None:
        self.digits = digits
        self.unit_ns: int | None = None
        self.is_clock = True
        self._clock = clock
        self._first: tuple[int, int] | None = None
        self._wrap = MINUTE_WRAP if digits == 4 else LONG_WRAP
        self._unwrapped: Unwrapped | None = None
        self._adapter: AdapterClock | None = None

    def t_ns(self, counts: NDArray[np.int64], arrival_ns: int) -> NDArray[np.int64] | None:
        """Log time of stamps that arrived together; None while it cannot be told.

        counts: (n,) int64, n > 0. arrival_ns: elapsed time of the recorder's clock.
        """
        if self._wrap == MINUTE_WRAP and int(counts.max()) >= MINUTE_WRAP:
            self._wrap, self.unit_ns, self._first = WORD_WRAP, None, None
        if self.unit_ns is None and not self._proven(int(counts[-1]), arrival_ns):
            return None
        assert self._unwrapped is not None
        assert self._adapter is not None
        return self._adapter.t_ns(self._unwrapped.stamps_ns(counts, arrival_ns), arrival_ns)

    def take_knots(self) -> list[Knot]:
        """How stamps became t since the last call."""
        return self._adapter.take_knots() if self._adapter else []

    def _proven(self, count: int, arrival_ns: int) -> bool:
        """Whether the counter is seen to run as fast as one of the units."""
        if not self.is_clock:
            return False
        if self._first is None or arrival_ns - self._first[1] > PROVEN_WITHIN_NS:
            self._first = count, arrival_ns
        first, since_ns = self._first
        passed_ns = arrival_ns - since_ns
        if passed_ns < PROVEN_AFTER_NS:
            return False
        for unit_ns in UNITS_NS[self.digits]:
            if AS_FAST[0] < (count - first) % self._wrap * unit_ns / passed_ns < AS_FAST[1]:
                self.unit_ns = unit_ns
                self._unwrapped = Unwrapped(self._wrap, unit_ns)
                self._adapter = AdapterClock(self._clock, unit_ns)
                return True
        self.is_clock = False
        return False
