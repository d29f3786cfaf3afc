"""Error control of one node (700h + n) reduced to what changes its state, its periods and counts."""

from collections.abc import Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.extent import SET_BACK_NS
from syncline_analyzer.folds.nmt.cadence import (
    CANDIDATE_RATIO,
    MIN_PERIODS,
    Bins,
    Doubles,
    Int64s,
    Mask,
    Periods,
    Twins,
    longer_than_before,
)
from syncline_analyzer.folds.nmt.calm import QUEUED_NS, STATES, Steady, Waited
from syncline_analyzer.folds.nmt.columns import Columns, Life, no_columns
from syncline_analyzer.folds.nmt.events import (
    KEPT_AFTER_MARK,
    Beat,
    BeatKind,
    Counts,
    OddMessage,
    Repeated,
    Silence,
)
from syncline_analyzer.folds.nmt.guarding import Guarding
from syncline_analyzer.folds.nmt.kinds import (
    ANSWER,
    BOOT_UP,
    EMPTY,
    HEARTBEAT,
    ODD,
    REQUEST,
    Kinds,
)
from syncline_analyzer.folds.nmt.pace import HeartbeatPeriods
from syncline_analyzer.folds.nmt.pairs import Pairs
from syncline_analyzer.folds.nmt.restarts import STARTED, LastTold, Restart, restarts
from syncline_analyzer.median import median
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

WINDOW = 15
"""Periods whose median a silence is held against."""
MAX_EVENTS = 100_000
"""State changes kept per node; more than that is counted only."""
MAX_MARKS = 100
"""Commands to a node that is not heard, kept per node."""
MAX_HELD = 100_000
"""Frames of a node that wait for the next message of its error control to be understood."""
MAX_TOGGLES = 10_000
"""Repeated toggle bits kept one by one per node."""
MAX_ODD = 100
"""Messages that are no state, kept one by one per node."""
_FALLEN = 0x7F
"""Byte of the state into which a node falls that may have started anew."""
_NONE = np.zeros(0, np.int64)
_KINDS: tuple[BeatKind, ...] = ("heartbeat", "guard answer", "boot-up", "empty")


class _Fresh(NamedTuple):
    """Messages that are no requests, (n,) their kinds, and (r,) `seq` of the requests."""

    beats: Columns = no_columns()
    kinds: NDArray[np.int8] = np.zeros(0, np.int8)
    requests: Int64s = _NONE


@dataclass(slots=True)
class ErrorControl:
    """Follows one node's error control; `beats` and `silences` are the reduced history."""

    timed: bool = True
    counts: Counts = field(default_factory=Counts)
    beats: list[Beat] = field(default_factory=list)
    silences: list[Silence] = field(default_factory=list)
    guarding: Guarding = field(default_factory=Guarding)
    paces: HeartbeatPeriods = field(default_factory=HeartbeatPeriods)
    odd: list[OddMessage] = field(default_factory=list)
    """Data frames on 700h + n that are no error control, the first of them."""
    doubles: Doubles = field(default_factory=Doubles)
    """Heartbeats of one period in two interleaved cadences."""
    twins: Twins = field(default_factory=Twins)
    """The same with two periods."""
    pairs: Pairs = field(default_factory=Pairs)
    """The same in step with one another."""
    toggles: list[Repeated] = field(default_factory=list)
    """Guard answers with the toggle bit of the one before, the first of them."""
    last_beat_ns: int | None = None
    heard_last_ns: int | None = None
    """Time of the node's last frame of any kind."""
    booted_again_seq: int | None = None
    """`seq` of the second boot-up."""
    _fresh: _Fresh = field(default_factory=_Fresh)
    """What `hear` took in, for `live`."""
    _before: LastTold | None = None
    _held: Columns | None = None
    """Rows whose meaning depends on what follows, ..."""
    _held_life: tuple[Int64s, Int64s] = (_NONE, _NONE)
    """... and the signs of life from it on."""
    _life: Life | None = None
    _last: tuple[int, int, int] | None = None
    """(seq, t_ns, kind) of the last beat."""
    _state: int = -1
    _toggle: int = -1
    _toggle_seq: int = -1
    _marks: list[list[int]] = field(default_factory=lambda: [[-1, KEPT_AFTER_MARK]])
    """[`seq`, messages still to keep] of commands, gaps and the beginning."""
    _waiting: int = 0
    _recent: Int64s = field(default_factory=lambda: np.zeros(0, np.int64))
    _silences_told: int = 0
    _heard: int | None = None
    """Time of the node's last frame ahead of the row that is held back, if there is one."""
    _periods: Periods = field(default_factory=Periods)
    _classifier: Kinds = field(init=False)

    def __post_init__(self) -> None:
        self.guarding.timed = self.timed
        self._classifier = Kinds(self.guarding, self.counts, self.timed)

    def hear(self, rows: Columns, marks: list[int]) -> list[Restart]:
        """Take in the messages of a batch; `live` has to follow.

        Args:
            rows: data and remote frames of 700h + n.
            marks: `seq` of NMT commands to the node, ascending; of resets as `reset_mark(seq)`.

        Returns: what may be restarts of the node, those of earlier batches that are understood only
            now among them.
        """
        rows = rows if self._held is None else rows.after(self._held)
        self._note_marks(marks)
        cut = len(rows.seq) - self._classifier.undecided(rows)
        self._held = rows.rows(slice(cut, None)) if cut < len(rows.seq) else None
        rows = rows.rows(slice(0, cut))
        before = self._before
        self._fresh = self._classified(rows)
        beats, kinds, _ = self._fresh
        return list(restarts(before, beats, kinds))

    def live(self, life: tuple[Int64s, Int64s]) -> None:
        """Take in when the node was heard in the batch whose messages `hear` took in.

        Args:
            life: (seq, t_ns) of every data frame of the node, its error control included.
        """
        before = self._held_life
        if len(before[0]):
            life = (np.concatenate((before[0], life[0])), np.concatenate((before[1], life[1])))
        if len(life[0]):
            self.heard_last_ns = int(life[1][-1])
        self._held_life = (_NONE, _NONE)
        if self._held is not None:
            at = int(np.searchsorted(life[0], self._held.seq[0]))
            self._held_life = (life[0][at:], life[1][at:])
            life = (life[0][:at], life[1][:at])
        self._follow(life)
        if self._held is not None and max(len(self._held_life[0]), len(self._held.seq)) > MAX_HELD:
            self._take_held()

    def live_otherwise(self, t_ns: int) -> None:
        """Take in when a node that is `unheard` sent other frames than error control last."""
        self.heard_last_ns = self._heard = t_ns

    def go_on(self, waited: Waited) -> None:
        """Take in heartbeats of a node that was `steady`, which only went on: none came late."""
        assert self._last is not None
        seq, t_ns, life = waited
        self.counts.heartbeats += len(seq)
        self._classifier.go_on(t_ns)
        self._before = LastTold(int(seq[-1]), HEARTBEAT, self._state)
        passed = np.empty_like(t_ns)
        passed[0] = t_ns[0] - self._last[1]
        np.subtract(t_ns[1:], t_ns[:-1], out=passed[1:])
        every, bins = np.ones(len(seq), np.bool_), Bins.of(passed)
        self._note_cadence(seq, t_ns, passed, every)
        self.paces.go_on(seq, t_ns, passed, bins)
        self._periods.take(bins)
        self._recent = np.concatenate((self._recent, passed[-WINDOW:]))[-WINDOW:]
        self._end_at(int(seq[-1]), int(t_ns[-1]), HEARTBEAT)
        self._hear_rest(life, _NONE)
        self.heard_last_ns = self._heard = int(life[1][-1])

    def gap(self, start_ns: int, next_seq: int) -> None:
        """Nothing follows from the time between the frames around a gap."""
        self.finish(start_ns, next_seq)
        self._life = self._last = None
        self._classifier.gap()
        self._heard = None
        self.twins.cut()
        self._state = self._toggle = -1
        self._marks.append([next_seq - 1, KEPT_AFTER_MARK])
        self._waiting = 0

    def finish(self, end_ns: int, next_seq: int) -> None:
        """Decide what was held back, and look at the silence up to the end or a gap."""
        self._take_held()
        self.guarding.gap()
        self.paces.cut()
        if self._life is None or self._last is None or not self.timed:
            return
        self._life.hear(np.array([-1]), np.array([end_ns]))
        self._add_silence(self._last[2], self._median(self._recent[-WINDOW:]), next_seq)

    def tell_anew(self, beats: Sequence[Beat]) -> None:
        """Take some messages for another kind than they were counted as."""
        told = {beat.seq: beat for beat in beats}
        changed = [(beat, told[beat.seq]) for beat in self.beats if beat.seq in told]
        self.beats = [told.get(beat.seq, beat) for beat in self.beats]
        boots = {beat.seq for beat in beats if beat.kind == "boot-up"}
        self.silences = [
            silence._replace(kind="boot-up") if silence.start_seq in boots else silence
            for silence in self.silences
        ]
        for old, new in changed:
            for beat, number in ((old, -1), (new, 1)):
                self.counts.boot_ups += number * (beat.kind == "boot-up")
                self.counts.empty += number * (beat.kind == "empty")
                self.counts.heartbeats += number * (beat.kind == "heartbeat")
            if new.kind == "empty":
                self._classifier.zero_seq = new.seq

    def median_ns(self) -> int | None:
        """Median of all regular periods [ns], to one part in a thousand."""
        return self._periods.median_ns()

    def slowest_ns(self) -> int | None:
        """The same, but the longer one of two periods or intervals that alternate [ns]."""
        if self.twins.periods_ns:
            return self.twins.periods_ns[1]
        if self.doubles.count:
            doubles = self.doubles
            return doubles.pair_ns - (doubles.short_ns if doubles.stepped else 0)
        return self.paces.halved.period_ns if self.paces.halved else self.median_ns()

    def slowest_since_ns(self) -> int:
        """From when on `slowest_ns` holds: the first sign of a second cadence, 0 without one."""
        if self.twins.periods_ns:
            return self.twins.span[0]
        if self.doubles.count:
            return self.doubles.span[0]
        return self.paces.halved.t_ns if self.paces.halved else 0

    @property
    def zeros(self) -> bool:
        """Whether empty heartbeats carried a byte 00h, as a boot-up does."""
        return self._classifier.zero_seq >= 0

    @property
    def alive(self) -> bool:
        """Whether the node itself ever sent error control."""
        counts = self.counts
        return counts.boot_ups + counts.heartbeats + counts.guard_answers + counts.empty > 0

    @property
    def unheard(self) -> bool:
        """Whether no message came since the beginning or a gap, so that no silence can be told."""
        return self._life is None and self._held is None

    @property
    def held_seq(self) -> int | None:
        """`seq` of the message that is held back, None without one."""
        return int(self._held.seq[0]) if self._held is not None else None

    def _note_marks(self, marks: list[int]) -> None:
        """Note the commands of a batch."""
        # The marks before these have no message behind them yet: the last ones say it all.
        del self._marks[:-MAX_MARKS]
        self._marks.extend([_seq_of(mark), KEPT_AFTER_MARK] for mark in marks)
        self._classifier.resets.extend(_seq_of(mark) for mark in marks if mark < 0)

    @property
    def steady(self) -> Steady | None:
        """What further heartbeats go on from; None where more than them decides what they are."""
        last = self._last
        if not self.timed or last is None or last[2] != HEARTBEAT or self._state not in STATES:
            return None
        waiting = self._held is not None or self._marks or self._classifier.resets
        if waiting or not self.guarding.idle or len(self._recent) < MIN_PERIODS:
            return None
        return Steady(self._state, int(self._recent[-MIN_PERIODS:].min()), last[1])

    def _take_held(self) -> None:
        if self._held is not None:
            held, self._held = self._held, None
            life, self._held_life = self._held_life, (_NONE, _NONE)
            self._fresh = self._classified(held)
            self._follow(life)

    def _classified(self, rows: Columns) -> _Fresh:
        """What each row is; counts them."""
        kinds = self._classifier.classify(rows, self.held_seq)
        self._keep_odd(rows, kinds)
        told = np.flatnonzero(kinds < REQUEST)
        beats, beat_kinds = rows.rows(told), kinds[told]
        self._count(kinds, beats, beat_kinds)
        if len(told):
            state = int(beats.byte[-1]) & 0x7F
            self._before = LastTold(int(beats.seq[-1]), int(beat_kinds[-1]), state)
        return _Fresh(beats, beat_kinds, rows.seq[kinds == REQUEST])

    def _follow(self, life: tuple[Int64s, Int64s]) -> None:
        """Take in the fresh messages, and the signs of life from the first of them on."""
        (beats, kinds, requests), self._fresh = self._fresh, _Fresh()
        heard_ns, beat_ns = self._heard, self._last[1] if self._last else None
        self._follow_periods(beats, kinds, life, requests)
        self._keep_beats(beats, kinds, life, heard_ns, beat_ns)
        if len(life[0]):
            self._heard = int(life[1][-1])

    def _keep_odd(self, rows: Columns, kinds: NDArray[np.int8]) -> None:
        for row in np.flatnonzero(kinds == ODD)[: MAX_ODD - len(self.odd)].tolist():
            length = int(rows.dlc[row])
            what = (
                f"state byte {int(rows.byte[row]):02X}h"
                if length == 1
                else f"{length} instead of 1 byte"
            )
            self.odd.append(OddMessage(int(rows.seq[row]), int(rows.t_ns[row]), what))

    def _count(self, kinds: NDArray[np.int8], beats: Columns, beat_kinds: NDArray[np.int8]) -> None:
        number = np.bincount(kinds, minlength=6)
        counts = self.counts
        counts.heartbeats += int(number[HEARTBEAT])
        counts.guard_answers += int(number[ANSWER])
        if counts.boot_ups < 2 <= counts.boot_ups + number[BOOT_UP]:
            second = np.flatnonzero(beat_kinds == BOOT_UP)[1 - counts.boot_ups]
            self.booted_again_seq = int(beats.seq[second])
        counts.boot_ups += int(number[BOOT_UP])
        counts.empty += int(number[EMPTY])
        counts.guard_requests += int(number[REQUEST])
        counts.odd += int(number[ODD])
        telling = np.flatnonzero((beat_kinds == ANSWER) | (beat_kinds == BOOT_UP))
        if not len(telling):
            return
        toggle = (beats.byte[telling] >> 7).astype(np.int8)
        toggles = np.where(beat_kinds[telling] == ANSWER, toggle, np.int8(-1))
        before = np.concatenate(([self._toggle], toggles[:-1]))
        wrong = np.flatnonzero((toggles == before) & (toggles >= 0))
        counts.toggle_errors += len(wrong)
        seqs = np.concatenate(([self._toggle_seq], beats.seq[telling])).tolist()
        for row in wrong[: MAX_TOGGLES - len(self.toggles)].tolist():
            t_ns = int(beats.t_ns[telling[row]])
            self.toggles.append(Repeated(seqs[row], seqs[row + 1], t_ns))
        self._toggle, self._toggle_seq = int(toggles[-1]), seqs[-1]

    def _follow_periods(
        self,
        beats: Columns,
        kinds: NDArray[np.int8],
        life: tuple[Int64s, Int64s],
        requests: Int64s,
    ) -> None:
        """Collect periods, and the silences among them that may be too long."""
        if not self.timed:
            return
        n = len(beats.seq)
        first = np.array([self._last[1]] if self._last else [], np.int64)
        kind0 = np.array([self._last[2]] if self._last else [], np.int8)
        times = np.concatenate((first, beats.t_ns))
        passed: Int64s = times[1:] - times[:-1]
        all_kinds = np.concatenate((kind0, kinds))
        regular = (all_kinds[1:] == all_kinds[:-1]) & (all_kinds[1:] != BOOT_UP) & (passed > 0)
        steady = regular & (all_kinds[1:] == HEARTBEAT)
        regular &= passed >= QUEUED_NS
        recent = np.concatenate((self._recent, passed[regular]))
        known = len(self._recent) + np.cumsum(regular) - regular
        ends = slice(n - len(passed), None)
        rows = longer_than_before(passed, recent, known)
        rows = rows[~_within_usual(passed[rows], recent, known[rows])]
        late = np.zeros(len(passed), np.bool_)
        late[rows] = known[rows] >= MIN_PERIODS
        self._note_cadence(beats.seq[ends], beats.t_ns[ends], passed, steady)
        self.paces.note(beats.seq[ends], beats.t_ns[ends], passed, steady, late)
        offset = n - len(passed)
        done = 0
        life_seq, life_ns = life
        for row in rows.tolist():
            before = recent[max(0, known[row] - WINDOW) : known[row]]
            period = self._median(before)
            if period is not None and passed[row] <= CANDIDATE_RATIO * period:
                continue
            done = self._silence_before(
                beats, kinds, row + offset, life_seq, life_ns, requests, period, done
            )
        if n:
            self._end_at(int(beats.seq[-1]), int(beats.t_ns[-1]), int(kinds[-1]))
        self._hear_rest(life, requests)
        self._periods.add(passed[regular])
        self._recent = recent[-WINDOW:]

    def _note_cadence(self, seq: Int64s, t_ns: Int64s, passed: Int64s, steady: Mask) -> None:
        """Look for a second producer in intervals; `steady` ones are between heartbeats."""
        self.doubles.note(seq, t_ns, passed, steady)
        self.twins.note(seq, t_ns, steady)
        self.pairs.note(seq, t_ns, passed, steady)

    def _silence_before(
        self,
        beats: Columns,
        kinds: NDArray[np.int8],
        row: int,
        life_seq: Int64s,
        life_ns: Int64s,
        requests: Int64s,
        period: int | None,
        done: int,
    ) -> int:
        """Look for the longest silence between a beat and the one before it."""
        if row > 0:
            self._life = Life(int(beats.seq[row - 1]), int(beats.t_ns[row - 1]))
            self._waiting = 0
            self._last = (self._life.last_seq, self._life.last_ns, int(kinds[row - 1]))
        if self._life is None or self._last is None:
            return done
        begin, stop = life_seq.searchsorted((self._life.last_seq, beats.seq[row]), "right").tolist()
        self._life.hear(life_seq[begin:stop], life_ns[begin:stop])
        if self._life.last_seq < beats.seq[row]:
            self._life.hear(beats.seq[row : row + 1], beats.t_ns[row : row + 1])
        self._waiting -= int(kinds[row] == ANSWER)
        if len(requests):
            between = (requests > self._last[0]) & (requests < beats.seq[row])
            self._waiting += int(np.count_nonzero(between))
        self._add_silence(self._last[2], period, int(beats.seq[row]))
        return row

    def _end_at(self, seq: int, t_ns: int, kind: int) -> None:
        """Go on from the last message of a batch."""
        self._last = (seq, t_ns, kind)
        self.last_beat_ns = t_ns
        self._life = Life(seq, t_ns)
        self._waiting = 0

    def _hear_rest(self, life: tuple[Int64s, Int64s], requests: Int64s) -> None:
        """Keep the signs of life after the last beat for the next batch."""
        if self._life is None or self._last is None:
            return
        begin = int(np.searchsorted(life[0], self._life.last_seq, "right"))
        self._life.hear(life[0][begin:], life[1][begin:])
        self._waiting += int(np.count_nonzero(requests > self._last[0]))

    def _add_silence(self, kind: int, period: int | None, order: int) -> None:
        life = self._life
        if life is None or life.longest_ns <= 0 or len(self.silences) >= MAX_EVENTS:
            return
        heard = life.end[0] >= 0
        self.silences.append(
            Silence(
                *life.start,
                life.end[0] if heard else None,
                life.end[1],
                period,
                max(0, self._waiting),
                _KINDS[kind],
                life.end[0] if heard else order,
            )
        )

    def _keep_beats(
        self,
        beats: Columns,
        kinds: NDArray[np.int8],
        life: tuple[Int64s, Int64s],
        heard_ns: int | None,
        beat_ns: int | None,
    ) -> None:
        """Keep the beats that change the state, and the first ones after each command.

        The one after a fall tells whether the heartbeat kept its rhythm; the first one after a step
        back of the clock, since when it is heard again.
        """
        n = len(beats.seq)
        if not n:
            return
        heard = (beats.byte & 0x7F).astype(np.int64)
        states = np.where(kinds == EMPTY, -2, np.where(kinds == BOOT_UP, -3, heard))
        before = np.concatenate(([self._state], states[:-1]))
        keep = states != before
        keep |= kinds == BOOT_UP
        fell = np.isin(before, STARTED) & (states == _FALLEN) & (kinds == HEARTBEAT)
        keep[1:] |= fell[:-1]
        if fell[-1]:
            self._marks.append([int(beats.seq[-1]), 1])
        keep[:-1] |= (kinds[:-1] == EMPTY) & (kinds[1:] == HEARTBEAT)
        previous_ns = np.concatenate(([beats.t_ns[0] if beat_ns is None else beat_ns], beats.t_ns))
        keep |= beats.t_ns - previous_ns[:-1] <= -SET_BACK_NS
        for silence in self.silences[self._silences_told :]:
            at = int(np.searchsorted(beats.seq, silence.order))
            keep[at : at + 1] = True
        self._silences_told = len(self.silences)
        for mark in self._marks:
            at = int(np.searchsorted(beats.seq, mark[0], "right"))
            keep[at : at + mark[1]] = True
            mark[1] -= min(mark[1], n - at)
        self._marks = [mark for mark in self._marks if mark[1]]
        self._state = int(states[-1])
        life_seq, life_ns = life
        for row in np.flatnonzero(keep)[: max(0, MAX_EVENTS - len(self.beats))].tolist():
            at = int(np.searchsorted(life_seq, beats.seq[row]))
            previous = int(life_ns[at - 1]) if at else heard_ns
            self.beats.append(
                Beat(
                    int(beats.seq[row]),
                    int(beats.t_ns[row]),
                    _KINDS[int(kinds[row])],
                    int(beats.byte[row] & 0x7F),
                    int(beats.t_ns[row]) if previous is None else previous,
                    int(beats.t_ns[row - 1]) if row else beat_ns,
                )
            )

    @staticmethod
    def _median(periods: Int64s) -> int | None:
        return int(median(periods.tolist())) if len(periods) >= MIN_PERIODS else None


def _within_usual(passed: Int64s, recent: Int64s, known: Int64s) -> Mask:
    """Which intervals are hardly longer than the median of the last periods ahead of each."""
    full = known >= WINDOW
    within = np.zeros(len(passed), np.bool_)
    before = known[full][:, None] - 1 - np.arange(WINDOW)
    within[full] = passed[full] <= CANDIDATE_RATIO * np.median(recent[before], axis=1)
    return within


def reset_mark(seq: int) -> int:
    """The mark of a reset command, told from those of other commands by its sign."""
    return -seq - 1


def _seq_of(mark: int) -> int:
    return mark if mark >= 0 else -mark - 1
