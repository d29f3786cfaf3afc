"""Which SYNCs a PDO answers: the pattern, and the SYNCs that it missed."""

import math
from collections.abc import Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.extremes import limits_of
from syncline_analyzer.folds.timing.slips import Spared
from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

MAX_KEPT = 100_000
"""Missed moments kept one by one; beyond, only stretches of them."""
LEARN = 10
"""Answers from which a pattern is told."""
SAME_PATTERN = 0.95
"""Share of SYNC periods that must hold the pattern (analysis.md section 5)."""
AS_BY_DEFAULT = 0.6
"""The same where the device does so by default: a pattern that PDOs are missing from."""
_MAX_STEP = 256
_OUTAGE_STEPS = 8
"""A longer silence counts as this many periods of another pattern, as it is one event."""

_STRAY = 0.005
"""Share of steps that are no multiple of n: more of them, and a timer of its own sends the PDO."""
_STRAY_BY_DEFAULT = 0.1
"""The same where the device answers every n-th SYNC by default: it counted anew a few times."""
_QUEUED = 16
"""Answers that may wait in a node's queue, and follow one another by SYNC afterwards."""
UNSEEN_NS = 10_000_000_000
"""So long before it was seen to have left OPERATIONAL, a node's silence may be the leaving."""


class Operational(NamedTuple):
    """When a node was OPERATIONAL, half-open; `left` when another known state follows.

    `entered` when a known other state came before: its timers began anew with the frame `seq`.
    """

    start_ns: int
    end_ns: int
    left: bool
    entered: bool = False
    seq: int = -1


@dataclass(frozen=True, slots=True)
class MissedList:
    """Missed moments: (n,) t_ns and seq in order, and how many there were beyond these."""

    t_ns: NDArray[np.int64]
    seq: NDArray[np.int64]
    beyond: int = 0

    @property
    def count(self) -> int:
        """All of them."""
        return len(self.t_ns) + self.beyond

    def without(self, rows: NDArray[np.bool_]) -> "MissedList":
        """Those of which `rows` (n,) is False."""
        return MissedList(self.t_ns[~rows], self.seq[~rows], self.beyond)


class Missed:
    """Moments at which a frame was due and did not come."""

    def __init__(self) -> None:
        self._t_ns: list[NDArray[np.int64]] = []
        self._since_ns: list[NDArray[np.int64]] = []
        """From when on a node must have run to send at that moment."""
        self._seq: list[NDArray[np.int64]] = []
        self._kept = 0
        self._beyond: list[tuple[int, int, int]] = []

    def add(
        self,
        t_ns: NDArray[np.int64],
        seq: NDArray[np.int64],
        since_ns: NDArray[np.int64] | None = None,
    ) -> None:
        """Moments one by one, in order; `since_ns` is when the node began to wait for each."""
        room = MAX_KEPT - self._kept
        if len(t_ns) > room:
            self._beyond.append((int(t_ns[room]), int(t_ns[-1]), len(t_ns) - room))
        self._t_ns.append(t_ns[:room])
        self._since_ns.append((t_ns if since_ns is None else since_ns)[:room])
        self._seq.append(seq[:room])
        self._kept += min(len(t_ns), room)

    def add_evenly(self, last_ns: int, step_ns: int, count: int, seq: int) -> None:
        """`count` moments a step apart after a frame at `last_ns`, whose `seq` is the evidence."""
        due = np.arange(1, min(count, MAX_KEPT) + 1, dtype=np.int64)
        self.add(last_ns + due * step_ns, np.full(len(due), seq, np.int64))
        if count > MAX_KEPT:
            self._beyond.append(
                (last_ns + (MAX_KEPT + 1) * step_ns, last_ns + count * step_ns, count - MAX_KEPT)
            )

    def within(
        self,
        intervals: Sequence[Operational] | None,
        step_ns: float,
        settle_ns: float = 0.0,
        entered_ns: float = 0.0,
    ) -> MissedList:
        """Those that were due while the node was OPERATIONAL (None: all).

        A moment counts when the node was OPERATIONAL from `settle_ns` before it began to wait for
        it to `step_ns`, the time between two due moments, after it; at least `entered_ns` after it had
        entered that state, whose frame is the evidence of what never came since. A silence that lasts until the
        node is seen in another state is taken for the change itself.
        """
        t_ns = np.concatenate([np.zeros(0, np.int64), *self._t_ns])
        since_ns = np.concatenate([np.zeros(0, np.int64), *self._since_ns])
        seq = np.concatenate([np.zeros(0, np.int64), *self._seq])
        if intervals is None:
            return MissedList(t_ns, seq, sum(count for _, _, count in self._beyond))
        inside = np.zeros(len(t_ns), np.bool_)
        beyond = 0
        for interval in intervals:
            wait_ns = max(settle_ns, entered_ns) if interval.entered else settle_ns
            rows = _inside(t_ns, since_ns, interval, step_ns, wait_ns)
            inside[_without_leaving(rows, t_ns, interval, step_ns)] = True
            if interval.entered:
                seq[rows] = np.maximum(seq[rows], interval.seq)
            beyond += sum(_spread(each, interval, step_ns, wait_ns) for each in self._beyond)
        return MissedList(t_ns[inside], seq[inside], beyond)


def _inside(
    t_ns: NDArray[np.int64],
    since_ns: NDArray[np.int64],
    interval: Operational,
    step_ns: float,
    settle_ns: float,
) -> NDArray[np.intp]:
    after = since_ns - settle_ns >= interval.start_ns
    return np.flatnonzero(after & (t_ns + step_ns <= interval.end_ns))


def _spread(
    stretch: tuple[int, int, int], interval: Operational, step_ns: float, settle_ns: float
) -> int:
    """How many of `count` moments from `start` to `end` are inside; there may be any number of them."""
    start, end, count = stretch
    between = (end - start) / (count - 1) if count > 1 else 0.0
    after, left = interval.start_ns - start + settle_ns, interval.end_ns - start - step_ns
    if between <= 0:
        return count if after <= 0 <= left else 0
    first, last = math.ceil(after / between), math.floor(left / between)
    return max(min(last, count - 1) - max(first, 0) + 1, 0)


def _without_leaving(
    rows: NDArray[np.intp], t_ns: NDArray[np.int64], interval: Operational, step_ns: float
) -> NDArray[np.intp]:
    """The rows without the silence at the end that is the node leaving OPERATIONAL."""
    if not interval.left or not len(rows):
        return rows
    if interval.end_ns - t_ns[rows[-1]] > 3 * step_ns:
        return rows
    breaks = np.flatnonzero(np.diff(t_ns[rows]) > 1.5 * step_ns)
    first = int(breaks[-1]) + 1 if len(breaks) else 0
    return rows[:first] if t_ns[rows[first]] >= interval.end_ns - UNSEEN_NS else rows


@dataclass(slots=True)
class Rhythm:
    """The SYNCs, by their number, that one PDO answers.

    `answered` and then `evaluate` are called once per block. A SYNC counts as missed when it was
    due, another SYNC followed it, and no PDO came between the two.
    """

    missed: Missed = field(default_factory=Missed)
    steps: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_MAX_STEP + 1, np.int64))
    """How often n SYNCs lay between two answers, by n; the last one holds all longer ones."""
    crowded: int = 0
    """SYNC periods with more than one frame."""
    last: int | None = None
    """The last SYNC that was answered."""
    _due: int | None = None
    """The last SYNC that was answered, or found missed."""
    _fresh: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    _kept: tuple[int | None, int, int] | None = None
    """(default, crowded, n) while all further steps are n: then n stays what was told last."""
    _longest: tuple[int, int] | None = None
    """(SYNC from which the fresh ones were counted, longest step among them)."""

    def restart(self) -> None:
        """Forget where the pattern stands, not what it was."""
        self.last = self._due = None

    def relearn(self) -> None:
        """Forget the pattern too."""
        self.restart()
        self._kept = None
        self.steps[:] = 0
        self.crowded = 0

    def first_of_period(self, ordinal: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which frames are the first after their SYNC, by the SYNC's number."""
        if not len(ordinal):
            return np.zeros(0, np.bool_)
        first = np.empty(len(ordinal), np.bool_)
        first[0] = ordinal[0] != (-1 if self.last is None else self.last)
        np.not_equal(ordinal[1:], ordinal[:-1], out=first[1:])
        return first

    def beside_answers(
        self, answered: NDArray[np.int64], extra: NDArray[np.int64], every: int
    ) -> NDArray[np.bool_]:
        """(m,) beside which second frames the due SYNCs before and after were answered, too.

        After SYNCs without an answer, these may come late, one behind the other, for as long as the
        silence was.

        Args:
            answered: (n,) numbers of the SYNCs that the next call of `answered` takes in.
            extra: (m,) number of the SYNC that each second frame follows.
            every: that many SYNCs lie between two answers.
        """
        line = answered if self.last is None else np.concatenate(([self.last], answered))
        if not len(line):
            return np.ones(len(extra), np.bool_)
        place = np.searchsorted(line, extra)
        before, after = line[np.maximum(place - 1, 0)], line[np.minimum(place + 1, len(line) - 1)]
        near: NDArray[np.bool_] = (extra - before <= every) & (after - extra <= every)
        return near & ~_soon_after_silence(line, extra, every)

    def answered(self, ordinal: NDArray[np.int64], limits: tuple[int, int] | None = None) -> None:
        """Take in the numbers of the SYNCs that were answered, each once; (n,).

        `limits` are the least and the largest step from one answer to the next, where they are
        known, that from the last one before included.
        """
        self._fresh, self._longest = ordinal, None
        if not len(ordinal):
            return
        if limits is not None and limits[0] == limits[1]:
            self.steps[min(limits[0], _MAX_STEP)] += len(ordinal)
        else:
            line = ordinal if self.last is None else np.concatenate(([self.last], ordinal))
            steps = line[1:] - line[:-1]
            self.steps += np.bincount(np.minimum(steps, _MAX_STEP), minlength=_MAX_STEP + 1)
            limits = limits_of(steps) if len(steps) else None
        if limits is not None:
            self._note_limits(*limits)
        self.last = int(ordinal[-1])

    def _note_limits(self, least: int, most: int) -> None:
        """Note the least and the largest step from one answer to the next."""
        if self._kept is not None and (least, most) != (self._kept[2], self._kept[2]):
            self._kept = None
        self._longest = (self.last, most) if self.last is not None else None

    def every(self, default: int | None = None) -> int | None:
        """n when at least 95 % of the SYNC periods fit "one PDO on every n-th SYNC".

        Fewer do where n is the device's `default`. A period that holds two frames fits none.
        """
        if self._kept is None or self._kept[:2] != (default, self.crowded):
            n = self._told_every(default)
            self._kept = None if n is None else (default, self.crowded, n)
        return self._kept[2] if self._kept is not None else None

    def _told_every(self, default: int | None) -> int | None:
        seen = np.flatnonzero(self.steps)
        counts = dict(zip(seen.tolist(), self.steps[seen].tolist(), strict=True))
        total = sum(counts.values())
        n = max(counts, key=lambda step: (counts[step], -step), default=0)
        if total < LEARN - 1 or not n:
            return None
        periods = sum(count * min(step, n * _OUTAGE_STEPS) for step, count in counts.items())
        share = (counts[n] * n) / periods
        stray = 1.0 - sum(count for step, count in counts.items() if step % n == 0) / total
        least, most = (SAME_PATTERN, _STRAY) if n != default else (AS_BY_DEFAULT, _STRAY_BY_DEFAULT)
        share -= self.crowded / periods
        return n if n < _MAX_STEP and share >= least and stray <= most else None

    def strays(self, every: int) -> int:
        """Steps between two answers that are no multiple of n; those of 256 SYNCs and more aside."""
        known = self.steps[:_MAX_STEP]
        return int(known.sum() - known[::every].sum())

    def evaluate(
        self, every: int | None, index: SyncIndex, spared: Spared | None = None
    ) -> NDArray[np.int64]:
        """Positions of the SYNCs of the block that were due (every n-th) and not answered.

        Those that are `spared` owe nothing.
        """
        fresh, self._fresh = self._fresh, np.zeros(0, np.int64)
        if every is None:
            self._due = int(fresh[-1]) if len(fresh) else self._due
            return np.zeros(0, np.int64)
        start = self._due
        if start is None:
            if not len(fresh):
                return fresh
            start, fresh = int(fresh[0]), fresh[1:]
        if len(fresh) and self._longest is not None and self._longest[0] == start:
            whole = self._longest[1] <= every
        else:
            line = np.concatenate(([start], fresh))
            whole = not len(fresh) or int((line[1:] - line[:-1]).max()) <= every
        if whole:
            # Nothing is missing between the answers.
            last = int(fresh[-1]) if len(fresh) else start
            if index.last_closed - last < every:
                self._due = last
                return np.zeros(0, np.int64)
            line = np.array([last])
        else:
            line = np.concatenate(([start], fresh))
        ends = np.append(line[1:], max(int(line[-1]), index.last_closed) + 1)
        counts = (ends - line - 1) // every
        hit = counts > 0
        if not hit.any():
            self._due = int(line[-1])
            return np.zeros(0, np.int64)
        missed = np.repeat(line[hit], counts[hit]) + every * _one_based(counts[hit])
        position = missed - index.first_ordinal
        known = position >= index.first
        usable = index.usable if spared is None else index.usable & ~spared.mask()
        known[known] = usable[position[known]]
        position = position[known]
        since_ns = _syncs_before(index, position, every) if every > 1 else None
        self.missed.add(index.t_ns[position], index.seq[position], since_ns)
        self._due = int(line[-1]) + every * int(counts[-1])
        return position


def _syncs_before(index: SyncIndex, position: NDArray[np.int64], every: int) -> NDArray[np.int64]:
    """Stamps of the SYNCs `every` before: a node that starts after them counts from another one."""
    before = position - every
    if not len(position):
        return before
    # Those before the first one that is known are estimated from it: a pause may follow it.
    cycle_ns = index.cycle_ns if index.cycle_ns > 0 else 0.0
    estimate = index.t_ns[index.first] - np.rint((index.first - before) * cycle_ns).astype(np.int64)
    return np.where(before >= index.first, index.t_ns[np.maximum(before, 0)], estimate)


def _soon_after_silence(
    answered: NDArray[np.int64], extra: NDArray[np.int64], every: int
) -> NDArray[np.bool_]:
    """(m,) which frames come no later after unanswered SYNCs than these lasted, by SYNC numbers.

    A queue is short, and what waits in it comes as soon as it can: after a long silence, too.

    >>> _soon_after_silence(np.array([0, 1, 6, 7, 8, 9, 10, 11]), np.array([1, 9, 11]), 1).tolist()
    [False, True, False]
    """
    steps = np.diff(answered)
    silent = np.flatnonzero(steps > every)
    if not len(silent):
        return np.zeros(len(extra), np.bool_)
    last = np.searchsorted(answered[silent + 1], extra, side="right") - 1
    until = answered[silent + 1] + np.minimum(steps[silent] - every, _QUEUED * every)
    soon: NDArray[np.bool_] = (last >= 0) & (extra < until[np.maximum(last, 0)])
    return soon


def _one_based(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """1..c for each count, in a row.

    >>> _one_based(np.array([2, 3])).tolist()
    [1, 2, 1, 2, 3]
    """
    total = int(counts.sum())
    starts = np.repeat(np.cumsum(counts) - counts, counts)
    return np.arange(total, dtype=np.int64) - starts + 1
