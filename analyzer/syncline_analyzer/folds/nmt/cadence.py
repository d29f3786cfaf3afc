"""Periods of a node's error control: their median, and two cadences under one number."""

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import field
from operator import sub
from typing import Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from syncline_analyzer.median import median
from syncline_analyzer.results import Quantiles
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

MIN_PERIODS = 3
"""Periods that must have been seen before silence means anything (analysis.md 4)."""
CANDIDATE_RATIO = 1.2
"""Intervals this much longer than the median are looked at again at the end."""
DOUBLE_WINDOW, DOUBLES_IN_WINDOW = 30, 28
"""So many of so many intervals in a row alternate: of one producer that jitters, few do."""
KEPT_DOUBLES = 10
"""Heartbeats in two interleaved cadences whose `seq` is kept."""
STEP_TOLERANCE = 0.01
"""Part of a pair of intervals by which a stepped one may be off."""
SLOWEST_TASK_NS = 250_000_000
"""No task that sends heartbeats runs less often than this [ns]."""
EVEN_SHARE = 0.445
"""Intervals this alike may be any task's: k and k + 1 of its many steps."""
TWIN_WINDOWS = (36, 96)
"""Heartbeats in a row that must part into two regular series: soon, and for unlike periods."""
TWIN_SERIES = 5
"""Heartbeats that the slower series has at least among them."""
TWIN_TOLERANCE = 0.045
"""Part of its period by which an interval of such a series may be off: at 100 kbit/s a heartbeat of
200 ms waits 8 ms behind the PDOs of a few nodes."""
_EVEN = (1 + 2 * TWIN_TOLERANCE) / (1 - 2 * TWIN_TOLERANCE)
"""Intervals of which the longest is so many times the shortest are no such series."""
TWIN_RATIO = 16
"""The slower period is at most about so many of the faster one."""
TWIN_TRIES = 2000
"""Irregular windows that are looked at; a node that is still undecided then is let be."""
_ALIKE = 0.02
"""Two intervals that differ by less of their sum do not alternate."""
_SHORT = 0.8
"""An interval that is shorter than that part of the median is not of the one series there is."""
_LONGER_PAIR = 1.25
"""Two intervals in a row that are this much longer than the two before are no pair of two devices."""
_BIN = 1e-3
"""Relative width of a bin of the period statistics."""
_DENSE = 4
"""With no more bins than so many for each period, they are counted in place."""

Int64s = NDArray[np.int64]
Mask = NDArray[np.bool_]


class Bins(NamedTuple):
    """Periods counted in bins: the shortest, the longest, and (number of the bin, count, sum)."""

    shortest: int
    longest: int
    filled: list[tuple[int, int, float]]

    @classmethod
    def of(cls, periods: Int64s) -> Self:
        """At least one period, all above 0."""
        numbers = np.floor(np.log(periods) / _BIN).astype(np.int64)
        lowest = int(numbers.min())
        within = numbers - lowest
        if int(within.max()) > _DENSE * len(periods):
            bins, within = np.unique(within, return_inverse=True)
        else:
            bins = np.arange(int(within.max()) + 1)
        counts, sums = np.bincount(within), np.bincount(within, weights=periods)
        used = np.flatnonzero(counts)
        columns = ((bins[used] + lowest), counts[used], sums[used])
        filled = zip(*(column.tolist() for column in columns), strict=True)
        return cls(int(periods.min()), int(periods.max()), list(filled))


@dataclass(slots=True)
class Periods:
    """Counts periods in bins of one part in a thousand."""

    _bins: dict[int, tuple[int, float]] = field(default_factory=dict)
    """Number and sum of the periods in each bin."""
    _edges: tuple[int, int] | None = None
    """The shortest and the longest."""

    def add(self, periods: Int64s) -> None:
        """Take in further periods, all above 0."""
        if len(periods):
            self.take(Bins.of(periods))

    def take(self, bins: Bins) -> None:
        """Take in further periods by their bins."""
        low, high = self._edges or (bins.shortest, bins.longest)
        self._edges = (min(low, bins.shortest), max(high, bins.longest))
        for number, count, length in bins.filled:
            before = self._bins.get(number, (0, 0.0))
            self._bins[number] = (before[0] + count, before[1] + length)

    @property
    def count(self) -> int:
        """Number of periods."""
        return sum(count for count, _ in self._bins.values())

    def median_ns(self) -> int | None:
        """Median of all periods [ns], None without any."""
        return self.quantile_ns(0.5)

    def quantile_ns(self, share: float) -> int | None:
        """Period that a share (0..1) of all does not exceed [ns], None without any."""
        total, seen = self.count, 0
        for _, (count, length) in sorted(self._bins.items()):
            seen += count
            if seen >= share * total:
                return round(length / count)
        return None

    def quantiles(self, further: Iterable[int] = ()) -> Quantiles | None:
        """Row of the tables [us], with some further periods [ns]; None without any."""
        merged = Periods(dict(self._bins), self._edges)
        merged.add(np.fromiter(further, np.int64))
        median, p99 = merged.quantile_ns(0.5), merged.quantile_ns(0.99)
        if median is None or p99 is None or merged._edges is None:
            return None
        low, high = merged._edges
        return Quantiles(low / 1e3, median / 1e3, min(p99, high) / 1e3, high / 1e3)


@dataclass(slots=True)
class Doubles:
    """Two producers of one period under one number: short and long intervals alternate."""

    count: int = 0
    at: list[int] = field(default_factory=list)
    """`seq` of the first of them."""
    span: tuple[int, int] = (0, 0)
    """Time of the first and the last of them."""
    first_shares: list[float] = field(default_factory=list)
    """Part that the short interval has of a pair, for the first of them ..."""
    last_shares: list[float] = field(default_factory=list)
    """... and for the last."""
    pair_ns: int = 0
    """Length of the last pair."""
    _trail: Int64s = field(default_factory=lambda: np.zeros((4, 0), np.int64))
    """(length, regular, seq, t_ns) of the last intervals."""

    def note(self, seq: Int64s, t_ns: Int64s, passed: Int64s, regular: Mask) -> None:
        """Take in the intervals before some messages; `regular` ones are between like messages."""
        before, held = self._trail, self._trail.shape[1]
        last = slice(-DOUBLE_WINDOW - 2, None)
        news = np.stack((passed[last], regular[last].astype(np.int64), seq[last], t_ns[last]))
        self._trail = np.concatenate((before, news), axis=1)[:, last]
        length = np.concatenate((before[0], passed))
        if len(length) < 3 or int(np.ptp(length)) <= 2 * _ALIKE * int(length.min()):
            return
        columns = ((before[1] != 0, regular), (before[2], seq), (before[3], t_ns))
        even, seqs, times = (np.concatenate(pair) for pair in columns)
        pair = (length[:-2] + length[1:-1]).astype(np.float64)
        # One long interval between others, as where the clock was set, is no second producer.
        usual = pair <= _LONGER_PAIR * np.concatenate((pair[:1], pair[:-1]))
        off, differ = np.abs(length[2:] - length[:-2]), np.abs(length[1:-1] - length[:-2])
        alternating = (
            even[:-2]
            & even[1:-1]
            & even[2:]
            & usual
            & (off < 0.05 * pair)
            & ((differ > 0.1 * pair) | ((differ > _ALIKE * pair) & (differ > 2 * off)))
        )
        window = np.ones(DOUBLE_WINDOW, np.int64)
        sums = np.convolve(alternating.astype(np.int64), window)[: len(alternating)]
        steady = alternating & (sums >= DOUBLES_IN_WINDOW)
        steady[: max(0, held - 2)] = False
        if not steady.any():
            return
        found, found_ns = seqs[2:][steady], times[2:][steady]
        first = int(np.flatnonzero(steady)[0])
        if not self.count:
            self.count = int(sums[first]) - 1
            self.span = (int(times[max(0, first - DOUBLE_WINDOW + 3)]), 0)
        self.count += len(found)
        self.at.extend(found[: max(0, KEPT_DOUBLES - len(self.at))].tolist())
        self.span = (self.span[0], int(found_ns[-1]))
        pairs = pair[steady]
        shares = (np.minimum(length[:-2], length[1:-1])[steady] / pairs).tolist()
        self.first_shares.extend(shares[: max(0, KEPT_DOUBLES - len(self.first_shares))])
        self.last_shares = [*self.last_shares, *shares][-KEPT_DOUBLES:]
        self.pair_ns = int(pairs[-1])

    @property
    def short_ns(self) -> int:
        """The short intervals at the end [ns]."""
        shares = self.last_shares or [0.0]
        return round(sum(shares) / len(shares) * self.pair_ns)

    @property
    def stepped(self) -> bool:
        """Whether one producer that a slow task serves would do: long = short + one step.

        Such intervals are k and k + 1 steps long for ever, while two devices drift apart.
        """
        if not self.first_shares:
            return False
        first, last = (sum(s) / len(s) for s in (self.first_shares, self.last_shares))
        if abs(first - last) > STEP_TOLERANCE:
            return False
        return last > EVEN_SHARE or any(
            abs(last - k / (2 * k + 1)) <= STEP_TOLERANCE
            and self.pair_ns <= (2 * k + 1) * SLOWEST_TASK_NS
            for k in range(1, 5)
        )


@dataclass(slots=True)
class _TwoSeries:
    """What windows of one length show: the periods, the first heartbeats, and their time."""

    periods_ns: tuple[int, int]
    at: list[int]
    first_ns: int
    last_ns: int


@dataclass(slots=True)
class Twins:
    """Two producers of different periods under one number: two regular series, interleaved."""

    _found: dict[int, _TwoSeries] = field(default_factory=dict)
    """By length of the window."""
    _rows: dict[int, Int64s] = field(default_factory=dict)
    """(seq, t_ns) of heartbeats that are not decided yet, by length of the window."""
    _tries: dict[int, int] = field(default_factory=dict)

    @property
    def periods_ns(self) -> tuple[int, int] | None:
        """Of the two series, once they were found."""
        return self._first.periods_ns if self._first else None

    @property
    def at(self) -> list[int]:
        """`seq` of the first heartbeats found so."""
        return self._first.at if self._first else []

    @property
    def span(self) -> tuple[int, int]:
        """Time of the first and the last of them."""
        found = self._found.values()
        return min(f.first_ns for f in found), max(f.last_ns for f in found)

    @property
    def _first(self) -> _TwoSeries | None:
        return next((self._found[n] for n in TWIN_WINDOWS if n in self._found), None)

    def note(self, seq: Int64s, t_ns: Int64s, regular: Mask) -> None:
        """Take in further heartbeats; one that is not `regular` begins anew."""
        rows = np.stack((seq, t_ns))
        edges = np.concatenate(([0], np.flatnonzero(~regular), [len(seq)]))
        long = np.flatnonzero(np.diff(edges) >= TWIN_WINDOWS[0])
        for run in sorted({0, *long.tolist(), len(edges) - 2}):
            if run:
                self.cut()
            self._follow(rows[:, edges[run] : edges[run + 1]])

    def cut(self) -> None:
        """Begin anew, as after a gap."""
        self._rows.clear()

    def _follow(self, rows: Int64s) -> None:
        for length in TWIN_WINDOWS:
            if self._tries.get(length, 0) >= TWIN_TRIES:
                continue
            held = self._rows.get(length, rows[:, :0])
            self._rows[length] = self._slide(np.concatenate((held, rows), axis=1), length)

    def _slide(self, rows: Int64s, length: int) -> Int64s:
        """Look at the windows that are not plainly regular; gives the rows still to decide."""
        if rows.shape[1] < length:
            return rows
        begins = np.arange(0, rows.shape[1] - length + 1, length // 3)
        passed = np.diff(rows[1])
        if passed.min() < _SHORT * passed.max():
            windows = sliding_window_view(passed, length - 1)[begins]
            short = windows < _SHORT * np.median(windows, axis=1, keepdims=True)
            found = np.count_nonzero(short, axis=1) >= TWIN_SERIES
            room = TWIN_TRIES - self._tries.get(length, 0)
            for begin in begins[found][: max(0, room)].tolist():
                self._look(rows[:, begin : begin + length])
        return rows[:, begins[-1] + length // 3 :]

    def _look(self, window: Int64s) -> None:
        length = window.shape[1]
        self._tries[length] = self._tries.get(length, 0) + 1
        periods = _two_series(window[1])
        if periods is None:
            return
        first_ns, last_ns = int(window[1, 0]), int(window[1, -1])
        if length not in self._found:
            at = window[0, :KEPT_DOUBLES].tolist()
            self._found[length] = _TwoSeries(periods, at, first_ns, last_ns)
        self._found[length].last_ns = last_ns


def _two_series(t_ns: Int64s) -> tuple[int, int] | None:
    """The two different periods into whose gapless series all these moments part, if they do."""
    # A few dozen numbers in a list are walked through faster than numpy begins a call.
    times = t_ns.tolist()
    for other in range(1, TWIN_RATIO + 1):
        period = times[other] - times[0]
        mine = _series(times, period)
        if mine is None or len(mine) < TWIN_SERIES or len(times) - len(mine) < TWIN_SERIES:
            continue
        taken = set(mine)
        rest = [moment for row, moment in enumerate(times) if row not in taken]
        lengths = list(map(sub, rest[1:], rest))
        shortest, longest = min(lengths), max(lengths)
        if longest > _EVEN * shortest:
            continue
        second = int(median(lengths))
        tolerance_ns = TWIN_TOLERANCE * second
        even = max(second - shortest, longest - second) <= tolerance_ns
        whole = max(rest[0] - times[0], times[-1] - rest[-1]) <= second + tolerance_ns
        differ = abs(second - period) > 2 * TWIN_TOLERANCE * max(second, period)
        if even and whole and differ:
            return min(period, second), max(period, second)
    return None


def _series(times: list[int], period_ns: int) -> list[int] | None:
    """Rows of the regular series that begins with the first of ascending moments.

    None if it has a hole. Of two moments that are as near to where one is due the earlier counts.
    """
    mine = [0]
    tolerance_ns = TWIN_TOLERANCE * period_ns
    while True:
        due = times[mine[-1]] + period_ns
        if due > times[-1] + tolerance_ns:
            return mine
        row = bisect_left(times, due)
        if row == len(times) or due - times[row - 1] <= times[row] - due:
            row -= 1
        if row <= mine[-1] or abs(times[row] - due) > tolerance_ns:
            return None
        mine.append(row)


def longer_than_before(passed: Int64s, recent: Int64s, known: Int64s) -> NDArray[np.intp]:
    """Rows whose interval is clearly longer than the shortest of the three periods before.

    Args:
        passed: (n,) intervals [ns].
        recent: (m,) regular periods, those of `passed` among them [ns].
        known: (n,) number of regular periods ahead of each interval.
    """
    early = known < MIN_PERIODS
    if not len(recent):
        return np.flatnonzero(early)
    before = np.stack(
        [recent[np.maximum(known - back, 0).clip(max=len(recent) - 1)] for back in (1, 2, 3)]
    )
    return np.flatnonzero(early | (passed > CANDIDATE_RATIO * before.min(axis=0)))
