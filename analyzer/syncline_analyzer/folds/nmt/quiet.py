"""Stretches in which a whole bus was silent for clearly longer than it usually is."""

from collections.abc import Sequence

import numpy as np

from syncline_analyzer.folds.bus.clock import BusSilence
from syncline_analyzer.median import median

LONGER = 1.3
"""A silence of the bus so many times as long as its usual longest ones is none of these."""
ALIKE, COMMON = 0.8, 5
"""Where more silences than that are nearly as long, a silence is one that the bus often makes."""
OFF_NS = 1_000_000_000
"""Nobody switches a machine off and on in less [ns]."""


class Quiet:
    """Tells what part of a node's silence is the silence of everybody.

    The machine was off, the recorder deaf, or its clock stepped forward: none of it is the node's.
    """

    def __init__(self, silences: Sequence[BusSilence]) -> None:
        self._usual_ns = int(median(s.end_ns - s.start_ns for s in silences)) if silences else 0
        long = [s for s in silences if s.end_ns - s.start_ns > LONGER * self._usual_ns]
        self._starts = np.array([s.start_ns for s in long], np.int64)
        self._ends = np.array([s.end_ns for s in long], np.int64)

    def within(self, start_ns: int, end_ns: int) -> int:
        """The longest such silence that overlaps a stretch, less the usual one [ns]."""
        if not len(self._starts) or end_ns <= start_ns:
            return 0
        overlap = np.minimum(self._ends, end_ns) - np.maximum(self._starts, start_ns)
        return max(0, int(overlap.max()) - self._usual_ns)

    def unusual(self, start_ns: int, end_ns: int) -> int:
        """As `within`, but 0 where the bus is silent for about as long again and again [ns]."""
        found = self.within(start_ns, end_ns)
        longer = self._ends - self._starts >= ALIKE * (found + self._usual_ns)
        return found if int(np.count_nonzero(longer)) <= COMMON else 0

    def off(self, start_ns: int, end_ns: int) -> int | None:
        """When the first such silence in a stretch began that is long enough for a power cycle."""
        begins, ends = np.maximum(self._starts, start_ns), np.minimum(self._ends, end_ns)
        found = begins[ends - begins >= OFF_NS]
        return int(found.min()) if len(found) else None
