"""Where the SYNCs of a block stand between its other frames."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.extremes import limits_of
from syncline_analyzer.folds.timing.usual import MISSING
from syncline_schemas import native
from syncline_schemas.records import dataclass


@dataclass(frozen=True, eq=False)
class SyncIndex:
    """SYNCs of a block; position 0 stands for the last one before it.

    Attributes:
        rows: (m,) rows in the block.
        first_ordinal: number of the SYNC at position 0, counted over the capture.
        known: whether there is a SYNC at position 0 (not at the start, nor after a gap).
        t_ns, seq, bits: (m + 1,) stamp, `seq`, and the bits sent on the bus up to its end.
        usable: (m + 1,) False where nothing follows from silence: the next SYNC came at once (stamps
            of a backlog), or stayed away for long.
        cycle_ns: median of the periods, 0 when there is none.
        bundled: (m + 1,) True from a SYNC to the next where the stamps are those of a backlog, or the
            clock was set.
        counter: (m + 1,) their counters, 0 for those without one.
        frames: how many the block has.
    """

    rows: NDArray[np.intp]
    first_ordinal: int
    known: bool
    t_ns: NDArray[np.int64]
    seq: NDArray[np.int64]
    bits: NDArray[np.int64]
    usable: NDArray[np.bool_]
    bundled: NDArray[np.bool_]
    cycle_ns: float
    counter: NDArray[np.int64]
    frames: int

    @cached_property
    def before(self) -> NDArray[np.int64]:
        """(n,) position of the last SYNC at or before each row of the block."""
        if native.available():
            return native.before(self.rows, self.frames)
        is_one = np.zeros(self.frames, np.int64)
        is_one[self.rows] = 1
        return np.cumsum(is_one)

    @cached_property
    def all_usable(self) -> bool:
        """Whether silence tells something throughout the block."""
        return bool(self.usable.all())

    @cached_property
    def counted(self) -> bool:
        """Whether any of the SYNCs has a counter."""
        return bool(self.counter.any())

    @property
    def first(self) -> int:
        """Position of the first SYNC that there is."""
        return 0 if self.known else 1

    def lossless(self, rows: NDArray[np.intp], t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(k,) which rows follow their SYNC with none lost in between, as far as known.

        Args:
            rows: (k,) rows of the block.
            t_ns: (n,) stamps of the block.
        """
        position = self.before[rows]
        found: NDArray[np.bool_] = self.usable[position]
        if self.cycle_ns > 0:
            # After the last one, the next was due a cycle later and may be the one that was lost.
            soon = t_ns[rows] - self.t_ns[position] <= self.cycle_ns
            found = found & (self._whole[position] | (soon & (position == len(self.rows))))
        return found

    @cached_property
    def _whole(self) -> NDArray[np.bool_]:
        """(m + 1,) which periods are no longer than one that none is missing from."""
        return np.append(np.diff(self.t_ns) <= MISSING * self.cycle_ns, False)

    @cached_property
    def any_bundled(self) -> bool:
        """Whether there is anything of a backlog in the block."""
        return bool(self.bundled.any())

    @cached_property
    def periods(self) -> NDArray[np.int64]:
        """Times between one SYNC and the next, from position `first` on."""
        return self.t_ns[self.first + 1 :] - self.t_ns[self.first : -1]

    @cached_property
    def limits(self) -> tuple[int, int]:
        """The shortest and the longest of the periods, of which there is one at least."""
        return limits_of(self.periods)

    @cached_property
    def steady(self) -> bool:
        """Whether nothing can be missing in any of the periods, nor come at once."""
        if not len(self.periods) or self.any_bundled:
            return False
        shortest, longest = self.limits
        return shortest > 0 and longest <= MISSING * shortest

    @property
    def last_closed(self) -> int:
        """Number of the last SYNC that another one follows."""
        return self.first_ordinal + len(self.rows) - 1
