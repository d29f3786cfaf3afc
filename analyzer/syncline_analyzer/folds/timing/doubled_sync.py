"""SYNCs that come a second time within one period, now and then."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass

MAX_EVIDENCE = 20
MAX_RUNS = 1000
"""Places in one block that are looked at."""
_ONE = 1.25
"""Two periods that together are no longer than this many usual ones have a SYNC too many."""
_REGIME = 8
"""So many in a row are another period, or a second producer."""
_BESIDE = 8
"""Periods on either side in which there must be more SYNCs than they have room for."""

Ints = NDArray[np.int64]


@dataclass(slots=True)
class Doubled:
    """Counts them: where a SYNC is only late, the periods around it have no room for one more."""

    count: int = 0
    seq: list[int] = field(default_factory=list)

    def add(self, seq: Ints, periods: Ints, usual_ns: NDArray[np.float64]) -> None:
        """Take in periods in order, each with the `seq` of its end and the usual one; (n,)."""
        if len(periods) < 2:
            return
        pairs = periods[1:] + periods[:-1]
        close = (pairs <= _ONE * usual_ns[1:]) & (periods[1:] >= 0) & (periods[:-1] >= 0)
        close &= usual_ns[:-1] > 0
        if not close.any():
            return
        total = np.concatenate(([0], np.cumsum(periods)))
        edges = np.flatnonzero(np.diff(np.concatenate(([0], close.astype(np.int8), [0]))))
        for start, stop in edges.reshape(-1, 2)[:MAX_RUNS].tolist():
            if stop - start >= _REGIME:
                continue
            usual = float(usual_ns[start])
            within = stop - start + 1 - max(1, round(float(total[stop + 1] - total[start]) / usual))
            first, last = max(start - _BESIDE, 0), min(stop + 1 + _BESIDE, len(periods))
            around = last - first - round(float(total[last] - total[first]) / usual)
            found = max(0, min(within, around))
            self.count += found
            closest = start + np.sort(np.argsort(periods[start : stop + 1], kind="stable")[:found])
            self.seq.extend(seq[closest[: MAX_EVIDENCE - len(self.seq)]].tolist())
