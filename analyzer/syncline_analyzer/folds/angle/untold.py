"""Samples after which a shaft may as well have turned the other way, by how far apart they are."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass

_SEVERAL = 3
"""Samples that make a rhythm."""
_FILLS = 0.5
"""Share of the time from the first to the last that samples of a rhythm take."""


@dataclass(slots=True)
class Apart:
    """Samples of about one time after the one before, far enough apart to leave a direction open.

    Attributes:
        seq, t_ns: of the first one that does; `untold` counts these, `count` all.
        span_ns: sum of the times after the sample before.
        first_ns, last_ns: stamps of all.
    """

    first_ns: int
    last_ns: int = 0
    count: int = 0
    span_ns: int = 0
    untold: int = 0
    seq: int = 0
    t_ns: int = 0

    @property
    def spacing_ns(self) -> float:
        """Mean time after the sample before."""
        return self.span_ns / self.count

    @property
    def regular(self) -> bool:
        """Whether they come in a rhythm, and not after pauses of a faster one."""
        lasted = self.last_ns - self.first_ns + self.spacing_ns
        return self.untold >= _SEVERAL and self.span_ns >= _FILLS * lasted


@dataclass(slots=True)
class Untold:
    """Counts them by the octave of that time: a device may have sent faster before a reset."""

    _octaves: dict[int, Apart] = field(default_factory=dict)

    def add(
        self,
        seq: NDArray[np.int64],
        t_ns: NDArray[np.int64],
        span_ns: NDArray[np.int64],
        untold: NDArray[np.bool_],
    ) -> None:
        """Take in such samples, each with the time since the one before; all (n,)."""
        octave = np.rint(np.log2(np.maximum(span_ns, 1))).astype(np.int64)
        for number in np.flatnonzero(np.bincount(octave)).tolist():
            rows = np.flatnonzero(octave == number)
            apart = self._octaves.setdefault(number, Apart(int(t_ns[rows[0]])))
            apart.last_ns = int(t_ns[rows[-1]])
            apart.count += len(rows)
            apart.span_ns += int(span_ns[rows].sum())
            open_ = rows[untold[rows]]
            if len(open_) and not apart.untold:
                apart.seq, apart.t_ns = int(seq[open_[0]]), int(t_ns[open_[0]])
            apart.untold += len(open_)

    def most(self) -> Apart | None:
        """Those of the rhythm that leaves most directions open; None without any."""
        regular = [each for each in self._octaves.values() if each.regular]
        return max(regular, key=lambda each: each.untold, default=None)
