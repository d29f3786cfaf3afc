"""What each message of a node's error control is: boot-up, state, guard answer or request."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.nmt.cadence import MIN_PERIODS, Int64s, Mask
from syncline_analyzer.folds.nmt.columns import Columns
from syncline_analyzer.folds.nmt.events import Counts
from syncline_analyzer.folds.nmt.guarding import GUARD_ANSWER_NS, Guarding, Talk
from syncline_schemas.records import dataclass

STATES_SINCE = 2
"""States told since a remote frame that show that it has not emptied the heartbeats."""
TOGGLED_IN = 3
"""Among so many states in a row one has another bit 7 than the state before it: they answer requests."""
ON_TIME = 0.15
"""Part of its period by which an empty heartbeat may come early or late."""

HEARTBEAT, ANSWER, BOOT_UP, EMPTY, REQUEST, ODD = range(6)
_STATE_BYTES = np.isin(np.arange(256), (0x04, 0x05, 0x7F, 0x80, 0x84, 0x85, 0xFF))
"""State bytes of heartbeats and guard answers (CiA 301 7.2.8.3.2); 00h is looked at apart."""


@dataclass(slots=True)
class Kinds:
    """Tells them apart, in order of `seq`."""

    guarding: Guarding
    counts: Counts
    """So far, of the rows before."""
    timed: bool = True
    reset_seq: int = -1
    """`seq` of the last reset or boot-up."""
    resets: list[int] = field(default_factory=list)
    """`seq` of resets that the rows taken in may not have reached yet."""
    zero_seq: int = -1
    """`seq` of the last empty heartbeat that carried a byte 00h, ..."""
    _empty_seq: int = -1
    """... and of the last empty one of all."""
    _remote_seq: int = -1
    _since_remote: int = 0
    """States told since the last remote frame."""
    _bits: Mask = field(default_factory=lambda: np.zeros(0, np.bool_))
    """Bit 7 of the last states."""
    _spoke: bool = False
    """Whether the last data frame told a byte."""
    _spoken: tuple[Int64s, int] = field(default_factory=lambda: (np.zeros(0, np.int64), 0))
    """Times of the last states (-1 for one that was asked for), and of the last empty heartbeat."""

    def gap(self) -> None:
        """Nothing follows from the time between the frames around a gap."""
        self._spoken = (np.zeros(0, np.int64), 0)
        self._spoke = False

    def undecided(self, rows: Columns) -> int:
        """Rows at the end whose meaning depends on what follows.

        That is the last data frame, if it has no byte or a suspicious 00h, and what asks after it.
        """
        data = np.flatnonzero(~rows.remote)
        if not len(data):
            return 0
        blank = (rows.dlc[data] == 0) | ((rows.dlc[data] == 1) & (rows.byte[data] == 0))
        if not blank[-1]:
            return 0
        sure = rows.dlc[data[-1]] == 1 and self._boots(rows, others=bool(blank[:-1].any()))
        return 0 if sure else len(rows.seq) - int(data[-1])

    def _boots(self, rows: Columns, *, others: bool) -> bool:
        """Whether a byte 00h at the end is a boot-up, whatever follows."""
        if self._remote_seq <= self.reset_seq and not rows.remote.any():
            return True
        return self.guarding.answers_seen and not self.counts.empty and not others

    def go_on(self, t_ns: Int64s) -> None:
        """Take in plain heartbeats between which nothing else came."""
        self.guarding.in_row += len(t_ns)
        self._since_remote += len(t_ns)
        self._spoke = True
        self._bits = np.zeros(TOGGLED_IN, np.bool_)
        spoken = np.concatenate((self._spoken[0], t_ns[-MIN_PERIODS - 1 :]))
        self._spoken = (spoken[-MIN_PERIODS - 1 :], self._spoken[1])

    def classify(self, rows: Columns, stop_seq: int | None) -> NDArray[np.int8]:
        """Kind of each row; requests that a logger stored as empty data frames are recognised.

        Args:
            rows: the frames.
            stop_seq: of a row behind these that is held back, None without one.
        """
        n = len(rows.seq)
        if not n:
            self.pass_resets(stop_seq)
            return np.zeros(0, np.int8)
        one_byte = (rows.dlc == 1) & ~rows.remote
        speaks = one_byte & _STATE_BYTES[rows.byte]
        bare = (rows.dlc == 0) & ~rows.remote
        empty = self._empty(rows, speaks, bare)
        request = rows.remote | (bare & ~empty)
        kinds = np.full(n, ODD, np.int8)
        kinds[request] = REQUEST
        kinds[empty] = EMPTY
        kinds[speaks] = HEARTBEAT
        talk = np.flatnonzero(request | speaks)
        toggled = (rows.byte[talk] & 0x80) != 0
        said = Talk(rows.seq[talk], rows.t_ns[talk], request[talk], rows.remote[talk], toggled)
        kinds[talk[self.guarding.follow(said)]] = ANSWER
        kinds[self._toggling(rows, speaks, request)] = ANSWER
        since = self._told_since_remote(rows, kinds)
        zeros = np.flatnonzero(one_byte & (rows.byte == 0))
        self._tell_zeros(rows, kinds, zeros, since)
        if rows.remote.any():
            self._remote_seq = max(self._remote_seq, int(rows.seq[rows.remote][-1]))
        if (blank := np.flatnonzero(kinds == EMPTY)).size:
            self._empty_seq = max(self._empty_seq, int(rows.seq[blank[-1]]))
        self._since_remote = int(since[-1])
        if (data := np.flatnonzero(~rows.remote)).size:
            self._spoke = bool(rows.byte[data[-1]] != 0)
        self.pass_resets(stop_seq)
        return kinds

    def pass_resets(self, stop_seq: int | None) -> None:
        """Take resets over that lie before the row that is held back, if there is one."""
        passed = [seq for seq in self.resets if stop_seq is None or seq < stop_seq]
        self.reset_seq = max([self.reset_seq, *passed])
        self.resets = self.resets[len(passed) :]

    def _toggling(self, rows: Columns, speaks: Mask, request: Mask) -> Int64s:
        """Rows of states whose bit 7 alternates: answers to requests that the log does not hold."""
        told = np.flatnonzero(speaks)
        held = len(self._bits)
        bits = np.concatenate((self._bits, (rows.byte[told] & 0x80) != 0))
        changes = np.concatenate(([0], np.cumsum(bits[1:] != bits[:-1]), [0]))[: len(bits)]
        before = np.concatenate((np.zeros(TOGGLED_IN, np.int64), changes))[: len(bits)]
        unseen = (np.cumsum(request) + self.counts.guard_requests == 0)[told]
        self._bits = bits[-TOGGLED_IN:]
        found: Int64s = told[(changes > before)[held:] & unseen]
        return found

    def _told_since_remote(self, rows: Columns, kinds: NDArray[np.int8]) -> Int64s:
        """(n,) states told since the last remote frame, that of the row included."""
        told = np.cumsum(kinds == HEARTBEAT) + self._since_remote
        at_remote: Int64s = np.maximum.accumulate(np.where(rows.remote, told, 0))
        since: Int64s = told - at_remote
        return since

    def _empty(self, rows: Columns, speaks: Mask, bare: Mask) -> Mask:
        """Frames without data that are heartbeats; the others are requests, stored without RTR.

        Once a log holds a remote frame it does not store others as data frames: a frame without
        data is an empty heartbeat, also where a state follows at once, which then is another
        device's. Where it holds none, the empty ones are those that come just when heartbeats were
        due that do not come.
        """
        waited = np.diff(rows.t_ns, append=rows.t_ns[-1:])
        soon = (waited <= GUARD_ANSWER_NS) | (not self.timed)
        answered = bare & np.concatenate((speaks[1:], [False])) & soon
        marked = (np.cumsum(rows.remote) > 0) | (self._remote_seq >= 0)
        return (bare & marked) | self._in_place(rows, speaks, bare & ~marked, answered)

    def _in_place(self, rows: Columns, speaks: Mask, bare: Mask, answered: Mask) -> Mask:
        """Frames without data in the place of heartbeats, whose period they keep."""
        found = np.zeros(len(bare), np.bool_)
        asked = np.concatenate(([False], answered[:-1]))[speaks]
        unasked = np.concatenate((self._spoken[0], np.where(asked, -1, rows.t_ns[speaks])))
        held = len(self._spoken[0])
        before = np.cumsum(speaks) + held
        last_found = self._spoken[1]
        for row in np.flatnonzero(bare & ~answered).tolist() if self.timed else ():
            last = unasked[max(0, before[row] - MIN_PERIODS - 1) : before[row]]
            if len(last) <= MIN_PERIODS or (last < 0).any():
                continue
            period = int(np.median(np.diff(last)))
            due = max(int(last[-1]), last_found) + period
            if abs(int(rows.t_ns[row]) - due) <= ON_TIME * period:
                found[row], last_found = True, int(rows.t_ns[row])
        self._spoken = (unasked[-MIN_PERIODS - 1 :], last_found)
        return found

    def _tell_zeros(
        self,
        rows: Columns,
        kinds: NDArray[np.int8],
        zeros: NDArray[np.intp],
        since: Int64s,
    ) -> None:
        """A byte 00h: a boot-up, unless a remote frame has emptied the heartbeats of the node.

        Where these come without any byte, one with 00h is a boot-up. One after others that came with a state since that frame, or a single one between others,
        is a boot-up all the same: the effect begins at once and lasts until a reset. Once it is
        there, states in between are those of another device.
        """
        if not len(zeros):
            return
        asked = np.maximum.accumulate(np.where(rows.remote, rows.seq, self._remote_seq))
        talked = np.cumsum(kinds == HEARTBEAT) + self.counts.heartbeats
        data = np.flatnonzero(~rows.remote)
        byte = rows.byte[data]
        answers = np.cumsum(kinds == ANSWER) + self.counts.guard_answers
        empties = np.cumsum(kinds == EMPTY) + self.counts.empty
        last_empty = np.maximum.accumulate(np.where(kinds == EMPTY, rows.seq, self._empty_seq))
        for row, at in zip(zeros.tolist(), np.searchsorted(data, zeros).tolist(), strict=True):
            seq = int(rows.seq[row])
            last_reset = max([self.reset_seq, *(r for r in self.resets if r < seq)])
            last_empty[row] = max(last_empty[row], self._empty_seq)
            silent = answers[row] and not empties[row] and last_empty[row] < 0
            spoiled = last_empty[row] > last_reset
            single = at + 1 < len(byte) and byte[at + 1] != 0
            single = single and (bool(byte[at - 1] != 0) if at else self._spoke)
            single = (single or since[row] >= STATES_SINCE) and not spoiled
            plain = spoiled and self.zero_seq <= last_reset
            if asked[row] <= last_reset or silent or not talked[row] or single or plain:
                self.reset_seq = seq
                kinds[row] = BOOT_UP
            else:
                kinds[row] = EMPTY
                self._empty_seq = self.zero_seq = seq
