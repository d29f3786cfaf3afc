"""Two SYNC producers on one identifier: a second rhythm between the beats of the first."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distribution import quantile_of
from syncline_analyzer.results import SyncDoubleRow
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

MIN_PAIRS = 20
"""So many pairs of SYNCs in a row make a second rhythm, so many single periods a first one."""
MAX_ROWS = 100
MAX_BEATS = 20_000
"""Beats of the first rhythm that are followed through one stretch."""
MAX_EVIDENCE = 20
_SAME = 0.05
"""Periods that differ by no more than this share are equal."""
_APART = 0.1
"""The second rhythm lies at least this share of the period off the first."""
_STEADY = 0.1
"""A period this close to the usual one is steady."""
_RESTLESS = 0.2
"""Share of the periods in a stretch of two rhythms that are not; a new period alone has none."""

Ints = NDArray[np.int64]


class _Run(NamedTuple):
    """Equal periods in a row, half-open, and their median."""

    first: int
    stop: int
    period_ns: float


@dataclass(slots=True)
class DoubleSync:
    """Finds stretches in which every second SYNC keeps the period that single ones keep elsewhere.

    One producer alone may alternate between two periods (a timer of coarse steps); only a rhythm
    that is also seen alone proves that another one joined it.
    """

    _found: list[SyncDoubleRow] = field(default_factory=list)
    _single: list[float] = field(default_factory=list)
    """Periods [ns] that single SYNCs kept for a while."""

    def add(self, t_ns: Ints, seq: Ints, periods: Ints, median: float) -> None:
        """Take in periods in order, each with the stamp and `seq` of its end, and their median."""
        if len(periods) < MIN_PAIRS:
            return
        least = int(periods.min())
        if int(periods.max()) - least <= _SAME * least:
            # Equal periods from end to end: nothing comes between the beats.
            if len(periods) > MIN_PAIRS:
                self._learn([_Run(0, len(periods), median)])
            return
        runs = self._runs(periods)
        self._learn(runs)
        pairs = periods[1:] + periods[:-1]
        even = np.abs(np.diff(pairs, append=pairs[-1])) <= _SAME * pairs
        doubled = even & (np.abs(periods[1:] - pairs / 2) > _APART * pairs)
        edges = np.flatnonzero(np.diff(np.concatenate(([0], doubled.astype(np.int8), [0]))))
        for start, stop in edges.reshape(-1, 2).tolist():
            if stop - start >= 2 * MIN_PAIRS and len(self._found) < MAX_ROWS:
                whole = float(np.median(pairs[start:stop]))
                self._add(_row(t_ns, seq, periods, whole, start, stop))
        self._find_combs(t_ns, seq, periods, runs)

    def _find_combs(self, t_ns: Ints, seq: Ints, periods: Ints, runs: list[_Run]) -> None:
        """Rhythms of single SYNCs that go on while others come between them, whatever their period."""
        # Each SYNC between two beats cuts one period, so without short ones there are none.
        shortest = float(np.partition(periods, MIN_PAIRS - 1)[MIN_PAIRS - 1])
        followed = 0
        for first, stop, period_ns in runs:
            if stop <= followed or shortest >= (1 - _APART) * period_ns:
                continue
            last = _comb_end(t_ns, stop - 1, period_ns)
            self._add_comb(t_ns[stop - 1 : last + 1], seq[stop - 1 : last + 1], period_ns)
            begin = len(t_ns) - 1 - _comb_end(-t_ns[::-1], len(t_ns) - 1 - first, period_ns)
            self._add_comb(t_ns[begin : first + 1], seq[begin : first + 1], period_ns)
            followed = last

    def _add_comb(self, t_ns: Ints, seq: Ints, period_ns: float) -> None:
        """What lies between the beats of a rhythm that is kept from the first SYNC to the last."""
        apart = np.diff(t_ns)
        short = np.flatnonzero(apart < (1 - _APART) * period_ns)
        if not len(short):
            return
        first, last = int(short[0]), int(short[-1]) + 1
        more = last - first - round(float(t_ns[last] - t_ns[first]) / period_ns)
        if more < MIN_PAIRS or not _restless(apart[first:last]):
            return
        offset = float(apart[first])
        self._add(
            SyncDoubleRow(
                "",
                0,
                int(t_ns[first]),
                int(t_ns[last]),
                period_ns / 1000,
                min(offset, period_ns - offset) / 1000,
                more,
                seq[first : min(last, first + MAX_EVIDENCE)].tolist(),
            )
        )

    def _runs(self, periods: Ints) -> list[_Run]:
        """Runs of at least `MIN_PAIRS` equal periods; only a few matter."""
        even = np.abs(periods[1:] - periods[:-1]) <= _SAME * periods[1:]
        if even.all():
            return [_run_of(periods, 0, len(periods))] if len(even) >= MIN_PAIRS else []
        edges = np.flatnonzero(np.diff(np.concatenate(([0], even.astype(np.int8), [0]))))
        runs = [(a, b + 1) for a, b in edges.reshape(-1, 2).tolist() if b - a >= MIN_PAIRS]
        return [_run_of(periods, first, stop) for first, stop in runs[:MAX_ROWS]]

    def _add(self, row: SyncDoubleRow) -> None:
        """Keep a stretch, or make one with the one it overlaps."""
        for at, known in enumerate(self._found):
            if known.start_ns < row.end_ns and row.start_ns < known.end_ns:
                longer = max(known, row, key=lambda each: each.end_ns - each.start_ns)
                self._found[at] = longer
                return
        if len(self._found) < MAX_ROWS:
            self._found.append(row)

    def within(self, t_ns: Ints) -> NDArray[np.bool_]:
        """(n,) which SYNCs lie in a stretch that is known by now to have two producers."""
        found = np.zeros(len(t_ns), np.bool_)
        for row in self._found:
            if self._seen_alone(row.period_us * 1000):
                found |= (t_ns >= row.start_ns) & (t_ns <= row.end_ns)
        return found

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

    def _learn(self, runs: list[_Run]) -> None:
        """Note runs of equal periods."""
        for _, _, period_ns in runs:
            if not self._seen_alone(period_ns) and len(self._single) < MAX_ROWS:
                self._single.append(period_ns)

    def _seen_alone(self, period_ns: float) -> bool:
        return any(abs(known - period_ns) <= _SAME * period_ns for known in self._single)


def _run_of(periods: Ints, first: int, stop: int) -> _Run:
    return _Run(first, stop, quantile_of(periods[first:stop], 0.5))


def _comb_end(t_ns: Ints, at: int, period_ns: float) -> int:
    """Where a rhythm that stands at `at` is last kept, each beat within a twentieth of a period."""
    for _ in range(MAX_BEATS):
        due = t_ns[at] + period_ns
        near = int(np.searchsorted(t_ns, due))
        best = min((near - 1, near), key=lambda k: abs(t_ns[k] - due) if k < len(t_ns) else np.inf)
        if best <= at or best >= len(t_ns) or abs(t_ns[best] - due) > _SAME * period_ns:
            break
        at = best
    return at


def _restless(periods: Ints) -> bool:
    """Whether the periods are not those of one producer that was set to another period."""
    usual = float(np.median(periods))
    return float(np.mean(np.abs(periods - usual) > _STEADY * usual)) >= _RESTLESS


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
