"""The mean SYNC period by the recorder's clock, and how far it is off the one that was set."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass

_SHORT, _LONG = 0.5, 1.5
"""A single period is between these shares of the usual one."""
_OTHER = 0.01
"""A mean that is further off the setting is no drift: the producer keeps another period."""


@dataclass(slots=True)
class SyncPace:
    """Sum of the single periods since the setting last changed."""

    expected_us: int | None = None
    _sum_ns: int = 0
    _count: int = 0
    _pieces: int = 1
    """Stretches without a break; each has a first and a last stamp of its own."""

    def expect(self, period_us: int | None) -> None:
        """Take in 1006h as it is told by now; another value begins anew."""
        if period_us is None or period_us == self.expected_us:
            return
        if self.expected_us is not None:
            self._sum_ns, self._count, self._pieces = 0, 0, 1
        self.expected_us = period_us

    def add(self, periods: NDArray[np.int64], usual_ns: NDArray[np.float64] | float) -> None:
        """Take in periods, (n,), each with the usual one around it, or the one of all of them."""
        single = (periods > _SHORT * usual_ns) & (periods < _LONG * usual_ns)
        count = int(np.count_nonzero(single))
        self._sum_ns += int(periods.sum() if count == len(periods) else periods[single].sum())
        self._count += count
        self._pieces += len(periods) - count

    def cut(self) -> None:
        """A gap: the next stamp begins anew."""
        self._pieces += 1

    def mean_us(self) -> float | None:
        """Mean of the single periods."""
        return self._sum_ns / self._count / 1000 if self._count else None

    def drift_ppm(self, resolution_ns: int) -> tuple[float | None, float | None]:
        """(drift, what the stamps hide of it) [1e-6]; the drift is None below that."""
        mean_us = self.mean_us()
        if mean_us is None or not self.expected_us or not self._sum_ns:
            return None, None
        hidden = 1e6 * resolution_ns * self._pieces / self._sum_ns
        off = mean_us / self.expected_us - 1
        told = hidden <= abs(1e6 * off) <= 1e6 * _OTHER
        return (1e6 * off if told else None), hidden
