"""SYNCs that a PDO left out although its frames came as often as ever: a timer of its own sent them."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

_SINGLE = 1.25
"""Frames no further apart than this many SYNC periods have none missing between them."""

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Spared(NamedTuple):
    """SYNCs around which a PDO's frames came as often as ever, found when asked for."""

    at: Ints
    t_ns: Ints
    before_ns: int | None
    most_ns: float
    sync: SyncIndex

    def mask(self) -> Bools:
        """(m + 1,) which SYNCs, by their position, lie between two frames no further apart."""
        line = np.concatenate(([self.before_ns or 0], self.t_ns))
        place = np.concatenate(
            ([0], np.cumsum(np.bincount(self.at, minlength=len(self.sync.rows) + 1))[:-1])
        )
        between = (place < len(self.at)) & ((self.before_ns is not None) | (place > 0))
        after = line[np.minimum(place + 1, len(line) - 1)]
        found: Bools = between & (after - line[place] <= self.most_ns)
        return found


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

    def follow(self, at: Ints, t_ns: Ints, sync: SyncIndex) -> "Spared":
        """Take in the frames of a block.

        Args:
            at: (k,) position of the SYNC before each frame of the PDO.
            t_ns: (k,) stamps of these frames.
            sync: the m SYNCs of the block and the one before.
        """
        before_ns, most_ns = self._last_ns, _SINGLE * sync.cycle_ns
        if not len(at):
            self._open = self._open or len(sync.rows) > 0
            return Spared(at, t_ns, before_ns, most_ns, sync)
        if self._open and t_ns[0] - (before_ns or 0) <= most_ns:
            self.spans.append((before_ns or 0, int(t_ns[0])))
        self._open = len(sync.rows) - int(at[-1]) > 1
        self._last_ns = int(t_ns[-1])
        return Spared(at, t_ns, before_ns, most_ns, sync)

    def within(self, t_ns: Ints) -> Bools:
        """(n,) which SYNCs, by their stamps, lie in one of the spans."""
        inside = np.zeros(len(t_ns), np.bool_)
        for start_ns, end_ns in self.spans:
            inside |= (t_ns >= start_ns) & (t_ns <= end_ns)
        return inside
