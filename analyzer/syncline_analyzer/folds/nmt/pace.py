"""How a node's heartbeat period went over the capture: stretches of one pace, and late ones."""

from collections.abc import Iterable
from dataclasses import field

import numpy as np

from syncline_analyzer.folds.nmt.cadence import MIN_PERIODS, Bins, Int64s, Mask, Periods
from syncline_analyzer.results import Quantiles
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

WINDOW = 8
"""Periods whose median is looked at."""
ALIKE = 1.25
"""Windows whose medians differ by less are of one pace."""
MAX_PACES = 1000
MAX_LATE = 10_000
"""Late heartbeats kept one by one; further ones only count in the statistics."""
ENOUGH = 6
"""Periods in a row of one length that are a stretch, however short beside the others."""
GRID_TOLERANCE = 0.06
"""Part of the period by which a heartbeat may be off the grid of those before."""


class Late(NamedTuple):
    """A period longer than those before it: from the last heartbeat to the one with `seq`."""

    seq: int
    start_ns: int
    end_ns: int


@dataclass(slots=True)
class Pace:
    """A stretch of one period: `seq` and time of its first and last heartbeat, and its periods.

    `anchor_ns` is a heartbeat near its end that the next pace does not reach into.
    """

    first_seq: int
    last_seq: int
    first_ns: int
    last_ns: int
    anchor_ns: int
    number: int
    total_ns: int

    @property
    def median_ns(self) -> int:
        """Mean of the medians of its windows; each of them is a period that was seen."""
        return self.total_ns // self.number


class Even(NamedTuple):
    """Periods in a row of about one length, from heartbeat to heartbeat; their mean `period_ns`."""

    first_ns: int
    last_ns: int
    period_ns: int


class Halved(NamedTuple):
    """Heartbeats that came twice as often from one moment on, in time with those before."""

    first_seq: int
    seq: int
    t_ns: int
    period_ns: int


@dataclass(slots=True)
class _Run:
    """Periods in a row of about one length, the last of them `length_ns`.

    The first of them begins at `begin_ns` and ends at `first_ns`.
    """

    begin_ns: int
    first_seq: int
    first_ns: int
    last_seq: int = 0
    last_ns: int = 0
    length_ns: int = 0
    number: int = 0
    total_ns: int = 0


@dataclass(slots=True)
class HeartbeatPeriods:
    """Collects the periods of one node's heartbeat."""

    paces: list[Pace] = field(default_factory=list)
    late: list[Late] = field(default_factory=list)
    halved: Halved | None = None
    stretches: list[Pace] = field(default_factory=list)
    """Runs of periods of one length, the first of each length unlike the one before: short ones,
    which the windows may miss, are among them."""
    even: list[Even] = field(default_factory=list)
    """All runs of periods of one length, the first of them."""
    _usual: Periods = field(default_factory=Periods)
    _seq: Int64s = field(default_factory=lambda: np.zeros(0, np.int64))
    _t_ns: Int64s = field(default_factory=lambda: np.zeros(0, np.int64))
    _passed: Int64s = field(default_factory=lambda: np.zeros(0, np.int64))
    _last_median: int = 0
    _run: _Run | None = None

    def note(self, seq: Int64s, t_ns: Int64s, passed: Int64s, steady: Mask, late: Mask) -> None:
        """Take in the intervals before some messages; (n,) each.

        Args:
            seq: of the messages.
            t_ns: of the messages.
            passed: the intervals [ns].
            steady: intervals between two heartbeats.
            late: intervals clearly longer than those before.
        """
        held = steady & late
        room = max(0, MAX_LATE - len(self.late))
        rows = np.flatnonzero(held)
        for row in rows[:room].tolist():
            end_ns = int(t_ns[row])
            self.late.append(Late(int(seq[row]), end_ns - int(passed[row]), end_ns))
        usual = steady.copy()
        usual[rows[:room]] = False
        self._usual.add(passed[usual])
        self._follow(seq, t_ns, passed, steady)

    def go_on(self, seq: Int64s, t_ns: Int64s, passed: Int64s, bins: Bins) -> None:
        """Take in intervals between heartbeats, none of them late; `bins` are theirs."""
        self._usual.take(bins)
        self._take_in(seq, t_ns, passed)

    def cut(self) -> None:
        """What follows is not one pace with what was before, as after a gap."""
        self._end_window()

    def finish(self) -> None:
        """Nothing more comes."""
        self._end_window()

    def quantiles(self, late: Iterable[Late]) -> Quantiles | None:
        """All usual periods [us] and those of some late heartbeats; None without any."""
        return self._usual.quantiles(entry.end_ns - entry.start_ns for entry in late)

    @property
    def count(self) -> int:
        """Number of periods."""
        return self._usual.count + len(self.late)

    def _follow(self, seq: Int64s, t_ns: Int64s, passed: Int64s, steady: Mask) -> None:
        rows = np.flatnonzero(steady)
        following = 0
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else ():
            if run[0] != following:
                self._end_window()
            self._take_in(seq[run], t_ns[run], passed[run])
            following = int(run[-1]) + 1
        if following != len(seq):
            self._end_window()

    def _take_in(self, seq: Int64s, t_ns: Int64s, passed: Int64s) -> None:
        """Take in intervals between heartbeats, each begins where the one before ended."""
        self._seq = np.concatenate((self._seq, seq))
        self._t_ns = np.concatenate((self._t_ns, t_ns))
        self._passed = np.concatenate((self._passed, passed))
        self._take_windows()
        self._take_runs(seq, t_ns, passed)

    def _take_windows(self) -> None:
        number = len(self._seq) // WINDOW
        if not number:
            return
        used = number * WINDOW
        columns = (self._seq[:used], self._t_ns[:used], self._passed[:used])
        seqs, times, lengths = (column.reshape(number, WINDOW) for column in columns)
        medians = np.sort(lengths, axis=1)[:, WINDOW // 2]
        shorter = np.minimum(medians[1:], medians[:-1])
        changes = np.flatnonzero(np.maximum(medians[1:], medians[:-1]) >= ALIKE * shorter) + 1
        for rows in np.split(np.arange(number), changes):
            first, last = int(rows[0]), int(rows[-1])
            ends = (int(seqs[first, 0]), int(seqs[last, -1]))
            stamps = (int(times[first, 0]), int(times[last, -1]), int(times[last, 0]))
            total = WINDOW * int(medians[rows].sum())
            pace = Pace(*ends, *stamps, len(rows) * WINDOW, total)
            self._add(pace, int(medians[first]), int(medians[last]), times[first])
        self._seq, self._t_ns = self._seq[used:], self._t_ns[used:]
        self._passed = self._passed[used:]

    def _take_runs(self, seq: Int64s, t_ns: Int64s, passed: Int64s) -> None:
        """Follow runs of periods of about one length."""
        before = self._run.length_ns if self._run else int(passed[0])
        lengths = np.concatenate(([before], passed))
        longer = np.maximum(lengths[1:], lengths[:-1])
        cuts = np.flatnonzero(longer >= ALIKE * np.minimum(lengths[1:], lengths[:-1]))
        edges = np.concatenate(([0], cuts[cuts > 0], [len(passed)]))
        if len(cuts) and cuts[0] == 0:
            self._end_run()
        for begin, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            if begin:
                self._end_run()
            if begin and stop - begin < MIN_PERIODS and stop < len(passed):
                continue
            begin_ns = int(t_ns[begin]) - int(passed[begin])
            run = self._run = self._run or _Run(begin_ns, int(seq[begin]), int(t_ns[begin]))
            run.last_seq, run.last_ns = int(seq[stop - 1]), int(t_ns[stop - 1])
            run.length_ns = int(passed[stop - 1])
            run.number += stop - begin
            run.total_ns += int(passed[begin:stop].sum())

    def _end_run(self) -> None:
        run, self._run = self._run, None
        if run is None or run.number < MIN_PERIODS:
            return
        mean = run.total_ns // run.number
        if len(self.even) < MAX_PACES:
            self.even.append(Even(run.begin_ns, run.last_ns, mean))
        if run.number < ENOUGH or len(self.stretches) >= MAX_PACES:
            return
        last = self.stretches[-1].median_ns if self.stretches else 0
        if max(last, mean) >= ALIKE * min(last, mean):
            ends = (run.first_seq, run.last_seq, run.first_ns, run.last_ns)
            self.stretches.append(Pace(*ends, run.first_ns, run.number, run.total_ns))

    def _end_window(self) -> None:
        self._end_run()
        if not len(self._seq):
            return
        if len(self._seq) >= MIN_PERIODS:
            ends = (int(self._seq[0]), int(self._seq[-1]))
            stamps = (int(self._t_ns[0]), int(self._t_ns[-1]), int(self._t_ns[0]))
            median, number = int(np.median(self._passed)), len(self._seq)
            self._add(Pace(*ends, *stamps, number, number * median), median, median, self._t_ns)
        self._seq = self._t_ns = self._passed = np.zeros(0, np.int64)

    def _complete(self) -> list[Pace]:
        """The last stretch, and the one before where that is only the change between two."""
        last = self.paces[-1:]
        return self.paces[-2:] if last and last[0].number <= WINDOW else last

    def _add(self, pace: Pace, begins: int, ends: int, times: Int64s) -> None:
        """Append a stretch, or join it with the last one; `begins` and `ends` are its medians."""
        median, self._last_median = self._last_median, ends
        last = self.paces[-1] if self.paces else None
        if last is not None and max(median, begins) < ALIKE * min(median, begins):
            last.last_seq, last.last_ns, last.anchor_ns = (
                pace.last_seq,
                pace.last_ns,
                pace.anchor_ns,
            )
            last.number += pace.number
            last.total_ns += pace.total_ns
            return
        for before in self._complete():
            if self.halved is None and _halves(before, begins, times):
                self.halved = Halved(
                    before.first_seq, pace.first_seq, pace.first_ns, before.median_ns
                )
        if len(self.paces) < MAX_PACES:
            self.paces.append(pace)


def _halves(before: Pace, median_ns: int, times: Int64s) -> bool:
    """Whether every second heartbeat comes when one was due before, and the others in between.

    `median_ns` and `times` are of the first window after the stretch before.
    """
    period = before.median_ns
    if before.number < WINDOW or not 0.45 <= median_ns / period <= 0.55:
        return False
    phase = (times - before.anchor_ns) % period / period
    at_grid = np.minimum(phase, 1 - phase) <= GRID_TOLERANCE
    between = np.abs(phase - 0.5) <= 2 * GRID_TOLERANCE
    turns = bool((at_grid[1:] != at_grid[:-1]).all()) if len(at_grid) else False
    return turns and bool((at_grid | between).all())
