"""The frames of one PDO in a block."""

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.block import Block
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class PdoFrames:
    """Frames of one PDO in a block: (n,) rows, `seq` and stamps, and where they stand.

    `place` is that in the columns by identifier; views of these are all that a plain block needs.
    """

    place: slice | NDArray[np.intp]
    rows: NDArray[np.intp]
    seq: NDArray[np.int64]
    t_ns: NDArray[np.int64]

    @classmethod
    def in_block(cls, block: Block, bus: int, can_id: int) -> "PdoFrames":
        """All of them, as views."""
        batch, place = block.batch, block.batch.place(bus, can_id)
        rows, seq, t_ns = batch.rows_by_id, batch.seqs_by_id, batch.t_ns_by_id
        return cls(place, rows[place], seq[place], t_ns[place])

    def of(self, column: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n,) a column by identifier."""
        return column[self.place]

    def since(self, first: int) -> "PdoFrames":
        """All but the first ones of a whole block."""
        assert isinstance(self.place, slice)
        if not first:
            return self
        place = slice(self.place.start + first, self.place.stop)
        return PdoFrames(place, self.rows[first:], self.seq[first:], self.t_ns[first:])

    def chosen(self, which: NDArray[np.intp]) -> "PdoFrames":
        """Some of them."""
        place = self.place
        chosen = which + place.start if isinstance(place, slice) else place[which]
        return PdoFrames(chosen, self.rows[which], self.seq[which], self.t_ns[which])
