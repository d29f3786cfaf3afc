"""TPDOs of unknown mapping whose frames have several lengths."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.pdo_binding import Pdo
from syncline_schemas.records import dataclass

MAX_CHANGES = 10_000
"""Changes of the length that are kept one by one."""


@dataclass(slots=True)
class MixedLengths:
    """How long the frames of one TPDO are while nothing that the bus shows changes its mapping.

    Attributes:
        counts: frames by their length [bytes]; empty ones, which may be remote frames, are none.
        changes: (t_ns, seq) of the first frames that are not as long as the one before.
        changed: how many there are.
    """

    pdo: Pdo
    can_id: int
    counts: dict[int, int] = field(default_factory=dict)
    changes: list[tuple[int, int]] = field(default_factory=list)
    changed: int = 0
    _last: int = 0

    def add(self, batch: IndexedBatch, rows: NDArray[np.intp]) -> bool:
        """Take in the next frames; whether they show the first change."""
        low, high = batch.lengths[self.pdo.bus, self.can_id]
        if 0 < low == high == self._last:
            self.counts[low] += len(rows)
            return False
        rows = rows[batch.frames.dlc[rows] > 0]
        if not len(rows):
            return False
        length = batch.frames.dlc[rows]
        for bytes_ in np.flatnonzero(np.bincount(length)).tolist():
            count = int(np.count_nonzero(length == bytes_))
            self.counts[bytes_] = self.counts.get(bytes_, 0) + count
        before, self._last = self._last or int(length[0]), int(length[-1])
        at = rows[np.flatnonzero(np.diff(length.astype(np.int16), prepend=before))]
        first, self.changed = not self.changed, self.changed + len(at)
        kept = at[: MAX_CHANGES - len(self.changes)]
        stamps, seqs = batch.frames.t_ns[kept].tolist(), batch.seqs_at(kept).tolist()
        self.changes += zip(stamps, seqs, strict=True)
        return first and bool(len(at))
