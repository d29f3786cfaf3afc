"""SYNCs that a PDO left out although its frames came as often as ever: a timer of its own sent them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.sync import SyncIndex

_SINGLE = 1.25
"""Frames no further apart than this many SYNC periods have none missing between them."""

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(slots=True)
class Slips:
    """Follows a PDO that is only seen to come once per SYNC.

    Frames of a timer as long as the SYNC period come now just before a SYNC, now just after it: then
    two of them lie in one SYNC period and none in the next, but they are no further apart than ever.
    A device that leaves out an answer leaves two periods between its frames.
    """

    spans: list[tuple[int, int]] = field(default_factory=list)
    """First and last stamp of such periods that began in an earlier block than they ended in."""
    _last_ns: int | None = None
    _open: bool = False
    """A SYNC after the last frame was followed by another one."""

    def restart(self) -> None:
        """Nothing is known of the frame before, as after a gap."""
        self._last_ns, self._open = None, False

    def spared(self, rows: NDArray[np.intp], t_ns: Ints, sync: SyncIndex) -> Bools:
        """(m + 1,) SYNCs, by their position, around which the frames came as often as ever.

        Args:
            rows: (k,) rows of the PDO in the block.
            t_ns: (n,) stamps of the block.
            sync: the m SYNCs of the block and the one before.
        """
        known = self._last_ns is not None
        line = np.concatenate((np.array([self._last_ns or 0]), t_ns[rows]))
        most_ns = _SINGLE * sync.cycle_ns
        if self._open and len(rows) and line[1] - line[0] <= most_ns:
            self.spans.append((int(line[0]), int(line[1])))
        place = np.concatenate(([0], np.searchsorted(rows, sync.rows)))
        between = (place < len(rows)) & (known | (place > 0))
        after = line[np.minimum(place + 1, len(line) - 1)]
        self._open = (len(rows) == 0 and self._open) or int((place == len(rows)).sum()) > 1
        self._last_ns = int(line[-1]) if len(rows) else self._last_ns
        found: Bools = between & (after - line[place] <= most_ns)
        return found

    def within(self, t_ns: Ints) -> Bools:
        """(n,) which SYNCs, by their stamps, lie in one of the spans."""
        inside = np.zeros(len(t_ns), np.bool_)
        for start_ns, end_ns in self.spans:
            inside |= (t_ns >= start_ns) & (t_ns <= end_ns)
        return inside
