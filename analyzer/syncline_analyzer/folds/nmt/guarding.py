"""Node guarding of one node: the master's requests, and which of them the node answered."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.nmt.cadence import (
    MIN_PERIODS,
    Int64s,
    Mask,
    Periods,
    longer_than_before,
)
from syncline_analyzer.folds.nmt.events import Pause, Unanswered
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

GUARD_ANSWER_NS = 100_000_000
"""A guard answer follows its request within this time; a later frame is a heartbeat [ns]."""
PROMPT_NS = 10_000_000
"""A message so soon after a request hardly comes there by chance [ns]."""
HURRIED_NS = 20_000_000
"""A request this soon after another is no new one: the node had no time to answer [ns]."""
MAX_EVENTS = 100_000
KEPT_DOUBLES = 10
KNOWN_AGAIN = 2
"""Unasked messages after a gap that show a node to send heartbeats as it did before."""

_NONE = np.zeros(0, np.int64)


class Talk(NamedTuple):
    """Requests and state messages of one node in order of `seq`; all (n,)."""

    seq: Int64s
    t_ns: Int64s
    request: Mask
    remote: Mask
    """Requests that the log holds as remote frames."""
    toggled: Mask
    """Messages with bit 7 set, which no heartbeat has."""

    def rows(self, chosen: slice) -> "Talk":
        """Some of the messages."""
        return Talk(
            self.seq[chosen],
            self.t_ns[chosen],
            self.request[chosen],
            self.remote[chosen],
            self.toggled[chosen],
        )

    def after(self, held: "Talk") -> "Talk":
        """These after others."""
        return Talk(
            np.concatenate((held.seq, self.seq)),
            np.concatenate((held.t_ns, self.t_ns)),
            np.concatenate((held.request, self.request)),
            np.concatenate((held.remote, self.remote)),
            np.concatenate((held.toggled, self.toggled)),
        )


def _no_talk() -> Talk:
    none = np.zeros(0, np.bool_)
    return Talk(_NONE, _NONE, none, none, none)


@dataclass(slots=True)
class Guarding:
    """Tells guard answers from heartbeats, and counts the requests that got none."""

    timed: bool = True
    missed: int = 0
    """Requests without an answer, after the first answer of all."""
    unanswered: list[Unanswered] = field(default_factory=list)
    """Them in runs."""
    doubled: int = 0
    """Requests that were answered twice."""
    doubled_at: list[int] = field(default_factory=list)
    doubled_span: tuple[int, int] = (0, 0)
    both_at: tuple[int, int] | None = None
    """(seq, t_ns) of the first remote frame to a node that sends heartbeats ..."""
    both_last: tuple[int, int] = (0, 0)
    """... and of the last one."""
    prompt: int = 0
    """Messages without a toggle bit at once after a request."""
    answers_seen: bool = False
    periods: Periods = field(default_factory=Periods)
    """Between requests."""
    pauses: list[Pause] = field(default_factory=list)
    """Stretches without a request that are longer than usual."""
    in_row: int = 0
    """State messages in a row that nobody asked for."""
    _before: Talk = field(default_factory=_no_talk)
    _accepted: Mask = field(default_factory=lambda: np.zeros(0, np.bool_))
    _run: Unanswered | None = None
    _asked: tuple[Int64s, Int64s] = (_NONE, _NONE)

    @property
    def idle(self) -> bool:
        """Whether none of the last messages was a request."""
        return not len(self._before.seq)

    def follow(self, talk: Talk) -> Mask:
        """Take in further messages; tells which of them are guard answers."""
        if not len(talk.seq):
            return talk.request
        if not (talk.request.any() or self._before.request.any()):
            self.in_row += len(talk.seq)
            self._before = self._before.rows(slice(0))
            self._accepted = self._accepted[:0]
            return np.zeros(len(talk.seq), np.bool_)
        held = len(self._before.seq)
        whole = talk.after(self._before)
        accepted = self._accept(whole, held)
        self._note_both(whole, accepted, held)
        self._note_missed(whole, accepted, held)
        self._note_doubled(whole, accepted, held)
        self._note_requests(talk)
        self.answers_seen = self.answers_seen or bool(accepted[held:].any())
        self._before, self._accepted = (
            whole.rows(slice(max(0, len(whole.seq) - 3), None)),
            accepted[-3:],
        )
        return accepted[held:]

    def gap(self) -> None:
        """Nothing follows from the time between the frames around a gap."""
        if len(self._asked[0]):
            self.pauses.append(Pause(int(self._asked[0][-1]), int(self._asked[1][-1]), None))
        self._asked = (_NONE, _NONE)
        self._close_run()
        self._before, self._accepted = self._before.rows(slice(0)), self._accepted[:0]
        # Of a guarded node one answer may follow whose request lies in the gap.
        self.in_row = MIN_PERIODS - KNOWN_AGAIN if self.in_row >= MIN_PERIODS else 0

    def _accept(self, talk: Talk, held: int) -> Mask:
        """The message right after a request, soon enough; a heartbeat may come there by chance.

        Two requests at nearly the same time may have two answers.
        Without bit 7 it is believed only where the node did not send three messages by itself
        since its last answer.
        """
        n = len(talk.seq)
        asked = np.concatenate(([False], talk.request[:-1]))
        if self.timed:
            asked |= self._asked_twice(talk)
        passed = np.diff(talk.t_ns, prepend=talk.t_ns[:1])
        soon = ~talk.request & asked & ((passed <= GUARD_ANSWER_NS) | (not self.timed))
        fresh = np.arange(n) >= held
        unasked = np.cumsum(fresh & ~talk.request & ~soon) + self.in_row
        rows = np.flatnonzero(soon & fresh)
        since = np.diff(unasked[rows], prepend=0)
        doubts = np.cumsum(since >= MIN_PERIODS)
        sure = talk.toggled[rows]
        settled = np.maximum.accumulate(np.where(sure, doubts, 0)) if len(rows) else doubts
        accepted = np.zeros(n, np.bool_)
        accepted[:held] = self._accepted
        accepted[rows] = sure | (doubts == settled)
        self.prompt += int(np.count_nonzero(~sure & (passed[rows] <= PROMPT_NS)))
        return accepted

    @staticmethod
    def _asked_twice(talk: Talk) -> Mask:
        """The second message after two requests that came too soon after one another."""
        second = np.zeros(len(talk.seq), np.bool_)
        asks = talk.request
        second[3:] = asks[:-3] & asks[1:-2] & ~asks[2:-1] & ~asks[3:]
        second[3:] &= talk.t_ns[1:-2] - talk.t_ns[:-3] <= HURRIED_NS
        return second

    def _note_both(self, talk: Talk, accepted: Mask, held: int) -> None:
        fresh = np.arange(len(talk.seq)) >= held
        alone = np.cumsum(fresh & ~talk.request & ~accepted) + self.in_row
        at_answer = np.maximum.accumulate(np.where(accepted & fresh, alone, 0))
        in_row = alone - at_answer
        both = np.flatnonzero(talk.remote & fresh & (in_row >= MIN_PERIODS))
        if len(both):
            first, last = both[[0, -1]].tolist()
            self.both_at = self.both_at or (int(talk.seq[first]), int(talk.t_ns[first]))
            self.both_last = (int(talk.seq[last]), int(talk.t_ns[last]))
        if len(in_row):
            self.in_row = int(in_row[-1])

    def _note_missed(self, talk: Talk, accepted: Mask, held: int) -> None:
        """Requests that the next request follows, once the node is known to answer any."""
        known = np.cumsum(accepted) > 0 if not self.answers_seen else np.ones(len(accepted), bool)
        following = np.arange(1, len(talk.seq))
        new = following[following >= held]
        request, again = talk.request[new - 1] & known[new - 1], talk.request[new]
        waited = (talk.t_ns[new] - talk.t_ns[new - 1] > HURRIED_NS) | (not self.timed)
        missing = request & again & waited
        self.missed += int(np.count_nonzero(missing))
        answers = np.cumsum(accepted[new])
        rows = new[missing]
        run_of = answers[missing]
        for part in np.split(rows, np.flatnonzero(np.diff(run_of)) + 1):
            if len(part):
                if answers[part[0] - new[0]]:
                    self._close_run()
                self._miss(talk, part)
        if len(new) and answers[-1] > (run_of[-1] if len(run_of) else 0):
            self._close_run()

    def _miss(self, talk: Talk, rows: NDArray[np.int64]) -> None:
        """The requests before these rows, with no answer in between."""
        first, last = int(rows[0]) - 1, int(rows[-1])
        seq, t_ns, number = int(talk.seq[first]), int(talk.t_ns[first]), len(rows)
        if self._run is not None:
            seq, t_ns, number = self._run.seq, self._run.start_ns, self._run.number + number
        self._run = Unanswered(seq, t_ns, int(talk.t_ns[last]), number)

    def _close_run(self) -> None:
        if self._run is not None and len(self.unanswered) < MAX_EVENTS:
            self.unanswered.append(self._run)
        self._run = None

    def _note_doubled(self, talk: Talk, accepted: Mask, held: int) -> None:
        """A second message soon after an answer, where the request itself came only once."""
        rows = np.arange(2, len(talk.seq))
        rows = rows[rows >= held]
        if not len(rows) or not self.timed:
            return
        twice = accepted[rows - 1] & ~talk.request[rows] & talk.request[rows - 2]
        twice &= talk.t_ns[rows] - talk.t_ns[rows - 2] <= GUARD_ANSWER_NS
        before = np.maximum(rows - 3, 0)
        repeated = talk.request[before] & (before == rows - 3)
        twice &= ~(repeated & (talk.t_ns[rows - 2] - talk.t_ns[before] <= HURRIED_NS))
        found = rows[twice]
        if not len(found):
            return
        begin = self.doubled_span[0] if self.doubled else int(talk.t_ns[found[0]])
        self.doubled += len(found)
        room = max(0, KEPT_DOUBLES - len(self.doubled_at))
        self.doubled_at.extend(talk.seq[found[:room]].tolist())
        self.doubled_span = (begin, int(talk.t_ns[found[-1]]))

    def _note_requests(self, talk: Talk) -> None:
        """Note how often the master asks, and where it paused."""
        seq, t_ns = talk.seq[talk.request], talk.t_ns[talk.request]
        if not self.timed or not len(seq):
            return
        seqs, times = (np.concatenate(pair) for pair in zip(self._asked, (seq, t_ns), strict=True))
        passed = np.diff(times)
        known = np.arange(len(passed))
        fresh = known >= len(self._asked[0]) - 1
        self.periods.add(passed[fresh & (passed > HURRIED_NS)])
        for row in longer_than_before(passed, passed, known).tolist():
            if fresh[row] and row >= MIN_PERIODS and len(self.pauses) < MAX_EVENTS:
                self.pauses.append(Pause(int(seqs[row]), int(times[row]), int(times[row + 1])))
        self._asked = (seqs[-MIN_PERIODS - 1 :], times[-MIN_PERIODS - 1 :])
