"""Two SYNC producers on one identifier: a second rhythm of the same period between the first."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import SyncDoubleRow

MIN_PAIRS = 20
"""So many pairs of SYNCs in a row make a second rhythm, so many single periods a first one."""
MAX_ROWS = 100
MAX_EVIDENCE = 20
_SAME = 0.05
"""Periods that differ by no more than this share are equal."""
_APART = 0.1
"""The second rhythm lies at least this share of the period off the first."""

Ints = NDArray[np.int64]


@dataclass(slots=True)
class DoubleSync:
    """Finds stretches in which every second SYNC keeps the period that single ones keep elsewhere.

    One producer alone may alternate between two periods (a timer of coarse steps); only a rhythm
    that is also seen alone proves that another one joined it.
    """

    _found: list[SyncDoubleRow] = field(default_factory=list)
    _single: dict[int, int] = field(default_factory=dict)
    """How many single periods in a row there were, by their length in steps of 5 %."""

    def add(self, t_ns: Ints, seq: Ints, periods: Ints) -> None:
        """Take in periods in order, each with the stamp and `seq` of its end."""
        if len(periods) < MIN_PAIRS:
            return
        self._learn(periods)
        pairs = periods[1:] + periods[:-1]
        even = np.abs(np.diff(pairs, append=pairs[-1])) <= _SAME * pairs
        doubled = even & (np.abs(periods[1:] - pairs / 2) > _APART * pairs)
        edges = np.flatnonzero(np.diff(np.concatenate(([0], doubled.astype(np.int8), [0]))))
        for start, stop in edges.reshape(-1, 2).tolist():
            if stop - start >= 2 * MIN_PAIRS and len(self._found) < MAX_ROWS:
                whole = float(np.median(pairs[start:stop]))
                self._found.append(_row(t_ns, seq, periods, whole, start, stop))

    def rows(self, bus: str, cob_id: int) -> list[SyncDoubleRow]:
        """The stretches whose period was also seen with one producer alone."""
        return [
            SyncDoubleRow(
                bus,
                cob_id,
                row.start_ns,
                row.end_ns,
                row.period_us,
                row.offset_us,
                row.pairs,
                row.evidence,
            )
            for row in self._found
            if self._seen_alone(row.period_us * 1000)
        ]

    def _learn(self, periods: Ints) -> None:
        """Note runs of equal periods."""
        step = np.rint(np.log(np.maximum(periods, 1)) / _SAME).astype(np.int64)
        edges = np.concatenate(([0], np.flatnonzero(np.diff(step)) + 1, [len(step)]))
        lengths = np.diff(edges)
        for at in np.flatnonzero(lengths >= MIN_PAIRS).tolist():
            key = int(step[edges[at]])
            self._single[key] = max(self._single.get(key, 0), int(lengths[at]))

    def _seen_alone(self, period_ns: float) -> bool:
        key = round(float(np.log(period_ns)) / _SAME)
        return any(self._single.get(key + off, 0) >= MIN_PAIRS for off in (-1, 0, 1))


def _row(
    t_ns: Ints, seq: Ints, periods: Ints, whole: float, start: int, stop: int
) -> SyncDoubleRow:
    shorter = np.minimum(periods[start : stop + 1], whole - periods[start : stop + 1])
    return SyncDoubleRow(
        "",
        0,
        int(t_ns[start] - periods[start]),
        int(t_ns[stop]),
        whole / 1000,
        float(np.median(np.abs(shorter))) / 1000,
        (stop - start) // 2,
        seq[start : min(stop, start + MAX_EVIDENCE)].tolist(),
    )
