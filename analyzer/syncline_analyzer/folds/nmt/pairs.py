"""Heartbeats that come in pairs: two devices in step under one number."""

from dataclasses import field

import numpy as np

from syncline_analyzer.folds.nmt.cadence import KEPT_DOUBLES, Int64s, Mask
from syncline_schemas.records import dataclass

CLOSE_NS = 10_000_000
"""The two heartbeats of a pair are no further apart than this [ns]."""
IN_A_ROW = 6
"""So many pairs in a row, with no single heartbeat between them."""


@dataclass(slots=True)
class Pairs:
    """The first run of pairs of one node's heartbeat, and how many pairs there are in all."""

    count: int = 0
    at: list[int] = field(default_factory=list)
    """`seq` of the second ones of the first pairs in a row, as soon as there are enough."""
    span: tuple[int, int] = (0, 0)
    """Time of the first and of the last of the run."""
    _row: int = 0
    _run: Int64s = field(default_factory=lambda: np.zeros((3, 0), np.int64))
    """(row, seq, t_ns) of the last pairs in a row."""
    _over: bool = False
    """A single heartbeat came after the run."""

    @property
    def found(self) -> bool:
        """Whether enough pairs came in a row."""
        return bool(self.at)

    def note(self, seq: Int64s, t_ns: Int64s, passed: Int64s, steady: Mask) -> None:
        """Take in the intervals before some messages; `steady` ones are between heartbeats."""
        rows = np.flatnonzero(steady & (passed <= CLOSE_NS))
        self.count += len(rows)
        news = np.stack((rows + self._row, seq[rows], t_ns[rows]))
        self._row += len(seq)
        if self._over or not len(rows):
            return
        pairs = np.concatenate((self._run, news), axis=1)
        broken = np.flatnonzero(np.diff(pairs[0]) != 2) + 1
        edges = np.concatenate(([0], broken, [pairs.shape[1]]))
        long = np.flatnonzero(np.diff(edges) >= IN_A_ROW)
        run = 0 if self.found else int(long[0]) if len(long) else len(edges) - 2
        self._over = run < len(edges) - 2
        mine = pairs[:, edges[run] : edges[run + 1]]
        self._run = mine[:, -IN_A_ROW:]
        if self.found or len(long):
            first_ns = self.span[0] if self.found else int(mine[2, 0])
            self.span = (first_ns, int(mine[2, -1]))
            fresh = [seq for seq in mine[1].tolist() if not self.at or seq > self.at[-1]]
            self.at.extend(fresh[: KEPT_DOUBLES - len(self.at)])
