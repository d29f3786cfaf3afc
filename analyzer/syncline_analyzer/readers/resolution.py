"""The step of the times in a log, from the stamps themselves and the digits they are written in."""

import math
from collections import defaultdict
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distinct import distinct
from syncline_analyzer.readers.layout import Span

_SAMPLE = 512
_FEWEST = 4
_DISTANCES = 20
"""So many different distances are no rhythm: all of them are whole steps of the clock."""
_MANY = 200
"""So many frames on whole steps are no chance: no two oscillators agree for so long."""
_SHARED = 3
"""So many frames that come sooner than the wire allows are not told apart by the clock."""
_SOONER_NS = 25_000
"""Less than the shortest frame takes, of whatever kind [ns]."""
_FINE_NS = 1_000
_RHYTHM_NS = 1_000_000
"""A rhythm of frames hides whether the clock is coarser than this [ns]."""
_SHARED_NS = 10_000_000
"""The same where frames share their stamps [ns]."""
_VARIED_NS = 10**9

Ints = NDArray[np.int64]


class _Clock:
    """What the stamps of one bus are whole numbers of."""

    def __init__(self) -> None:
        self._divisor = 0
        self._count = 0
        self._distances: set[int] = set()
        self._shared = 0

    def sample(self, t_ns: Ints, can_id: NDArray[np.uint32]) -> None:
        """Look at up to 512 of the stamps, and at all distances between them."""
        some = t_ns[:: max(1, len(t_ns) // _SAMPLE)]
        self._count += len(some)
        self._divisor = math.gcd(self._divisor, int(np.gcd.reduce(some)))
        distances = np.diff(t_ns)
        if self._shared < _SHARED:
            # A recorder may write down the same frame twice.
            # A negative distance is a large unsigned one.
            soon = np.flatnonzero(distances.view(np.uint64) < _SOONER_NS)
            self._shared += int(np.count_nonzero(can_id[soon + 1] != can_id[soon]))
        if len(self._distances) < _DISTANCES:
            self._distances.update(distinct(distances, _DISTANCES))

    @property
    def step_ns(self) -> int:
        """The step that is proven [ns], 1 where nothing is."""
        step_ns = 1
        while step_ns < self._coarsest_ns and self._divisor % (10 * step_ns) == 0:
            step_ns *= 10
        return step_ns

    @property
    def _coarsest_ns(self) -> int:
        if self._count < _FEWEST or not self._divisor:
            return 1
        if len(self._distances) >= _DISTANCES:
            return _VARIED_NS
        if self._shared >= _SHARED:
            return _SHARED_NS
        return _RHYTHM_NS if self._count >= _MANY else _FINE_NS


class Resolution:
    """The step of a log's times: the largest power of ten ns that divides those of a bus.

    A bus with a steady rhythm looks like a coarse clock, so a step above a microsecond needs a
    proof: many different distances between frames are whole numbers of it, or frames share a time,
    which no wire lets them, or hundreds of frames lie on it. Where the buses of a log differ, and
    in doubt, it is the coarser one.
    """

    def __init__(self) -> None:
        self._clocks: defaultdict[int, _Clock] = defaultdict(_Clock)
        self._written_ns: int | None = None

    def written(self, times: Iterable[tuple[Span, int]]) -> None:
        """Take note of the fields of a time, of which the last digit is worth the least."""
        least_ns = min((worth for _, worth in times), default=None)
        if least_ns is not None:
            self._written_ns = min(least_ns, self._written_ns or least_ns)

    def sample(self, t_ns: Ints, bus: NDArray[np.uint8], can_id: NDArray[np.uint32]) -> None:
        """Look at some of the times, with the bus and the identifier of each frame."""
        if len(bus) and bool((bus == bus[0]).all()):
            self._clocks[int(bus[0])].sample(t_ns, can_id)
            return
        for number in np.flatnonzero(np.bincount(bus)).tolist():
            rows = bus == number
            self._clocks[number].sample(t_ns[rows], can_id[rows])

    @property
    def step_ns(self) -> int:
        """The step [ns]: that of the last digit where there were too few times to tell."""
        proven_ns = max((clock.step_ns for clock in self._clocks.values()), default=1)
        return max(proven_ns, self._written_ns or 1)
