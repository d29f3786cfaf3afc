"""Stretches in which a whole bus was silent: what happens in them accuses no node."""

from statistics import median

import numpy as np
from numpy.typing import NDArray

KEPT = 256
"""Longest silences that are kept."""
LONGER = 1.3
"""A silence so many times as long as the usual longest ones is none of these."""
OFF_NS = 1_000_000_000
"""Nobody switches a machine off and on in less [ns]."""
SHARE = 0.8
"""Part of a node's silence that makes it the bus's."""


class BusQuiet:
    """Follows when a bus was heard; the same terms as the analyzer's."""

    def __init__(self) -> None:
        self.last_ns: int | None = None
        self._kept: list[tuple[int, int]] = []

    def hear(self, t_ns: NDArray[np.int64]) -> None:
        """Take in the times of all frames of the bus."""
        if not len(t_ns):
            return
        before = np.concatenate(([t_ns[0] if self.last_ns is None else self.last_ns], t_ns[:-1]))
        passed = t_ns - before
        shortest = min((end - start for start, end in self._kept), default=0)
        rows = np.flatnonzero(passed > (shortest if len(self._kept) == KEPT else 0))
        if len(rows) > KEPT:
            rows = rows[np.argpartition(passed[rows], -KEPT)[-KEPT:]]
        self._kept += [(int(before[row]), int(t_ns[row])) for row in rows.tolist()]
        if len(self._kept) > KEPT:
            self._kept.sort(key=lambda each: each[0] - each[1])
            del self._kept[KEPT:]
        self.last_ns = int(t_ns[-1])

    def gap(self) -> None:
        """Nothing follows from the time between the frames around a gap."""
        self.last_ns = None

    def whole_bus(self, start_ns: int, end_ns: int, limit_ns: int) -> bool:
        """Whether a silence of a node is that of everybody."""
        passed = end_ns - start_ns
        longest = max((_overlap(each, start_ns, end_ns) for each in self._kept), default=0)
        if longest >= SHARE * passed:
            return True
        nobody = self.within(start_ns, end_ns)
        return nobody > 0 and passed - nobody <= limit_ns

    def within(self, start_ns: int, end_ns: int) -> int:
        """The longest silence of the bus in a stretch that is none of the usual ones [ns]."""
        if not self._kept or end_ns <= start_ns:
            return 0
        usual, long = self._unusual()
        longest = max((_overlap(each, start_ns, end_ns) for each in long), default=0)
        return max(0, longest - usual)

    def switched_off(self, start_ns: int, end_ns: int) -> bool:
        """Whether the machine may have been off in a stretch."""
        _, long = self._unusual()
        return any(_overlap(each, start_ns, end_ns) >= OFF_NS for each in long)

    def _unusual(self) -> tuple[int, list[tuple[int, int]]]:
        lengths = [end - start for start, end in self._kept]
        usual = int(median(lengths)) if lengths else 0
        return usual, [each for each in self._kept if each[1] - each[0] > LONGER * usual]


def _overlap(silence: tuple[int, int], start_ns: int, end_ns: int) -> int:
    return min(silence[1], end_ns) - max(silence[0], start_ns)
