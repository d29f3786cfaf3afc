"""Periods of heartbeats and of the requests that guard a node (CiA 301 7.2.8.3)."""

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.distinct import distinct
from syncline_analyzer.distribution import Distribution, quantile_of
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.nmt.events import Counts
from syncline_analyzer.folds.nmt.table import NodeNmt
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.extremes import limits_of
from syncline_analyzer.folds.timing.overdue import LATE, Overdue
from syncline_analyzer.folds.timing.periods import Periods
from syncline_analyzer.folds.timing.request_answers import RequestAnswers
from syncline_analyzer.folds.timing.silence import Silence, within_silence
from syncline_analyzer.results import ErrorControlRow, NmtStateRow, WorstRow
from syncline_analyzer.shadow import Known
from syncline_schemas.batch import FrameFlag
from syncline_schemas.records import dataclass

HEARTBEAT_TIME, GUARD_TIME = 0x1017, 0x100C
FIRST_ID = 0x700
MAX_NODE = 127
MAX_EVIDENCE = 20
MS = 1_000_000
_ANSWER_NS = 100_000_000
"""A guard answer follows its request within this time; a later message is a heartbeat."""
_LEARN = 8
_REGIME = 4
"""So many long periods in a row are the rhythm."""
_AS_TOLD = 0.25
"""Where the periods are further off the setting, the node keeps one of its own."""

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(slots=True)
class _Rhythm:
    """Periods of one kind of message."""

    count: int = 0
    periods: Periods = field(default_factory=Periods)
    last_ns: int | None = None
    last_seq: int = 0

    def add(self, seq: Ints, t_ns: Ints, follows: Mask | None) -> tuple[Ints, Ints, Ints]:
        """Take in messages in order; (periods, stamp and `seq` of the message before each).

        `follows` tells which of them come after one of their kind with nothing in between (None:
        all).
        """
        self.count += len(seq)
        if self.last_ns is not None:
            seq = np.concatenate(([self.last_seq], seq))
            t_ns = np.concatenate(([self.last_ns], t_ns))
        elif follows is not None:
            follows = follows[1:]
        if len(seq):
            self.last_ns, self.last_seq = int(t_ns[-1]), int(seq[-1])
        periods = t_ns[1:] - t_ns[:-1]
        true = periods >= 0 if follows is None else follows & (periods >= 0)
        if true.all():
            self.periods.add(periods, seq[1:], t_ns[1:])
            return periods, t_ns[:-1], seq[:-1]
        self.periods.add(periods[true], seq[1:][true], t_ns[1:][true])
        return periods[true], t_ns[:-1][true], seq[:-1][true]


@dataclass(slots=True)
class _State:
    """Error control of one node from block to block."""

    beats: _Rhythm = field(default_factory=_Rhythm)
    requests: _Rhythm = field(default_factory=_Rhythm)
    answers: RequestAnswers = field(default_factory=RequestAnswers)
    missing: Overdue = field(default_factory=Overdue)
    remote_seen: bool = False
    asked_ns: int | None = None
    """Time of the last frame, if it was a request."""
    broken: bool = True
    """The next heartbeat does not follow one: after a gap, a boot-up, another setting."""
    told_ns: int | None = None
    """1017h as it held for the heartbeats so far."""
    settled: Distribution | None = None
    """Periods since 1017h changed among the heartbeats; None where it never did."""

    def settle(self, periods: Ints, told_ns: int | None) -> None:
        """Keep what came since the last change of 1017h, which earlier periods do not tell of."""
        if told_ns != self.told_ns:
            earlier = self.beats.periods.spread.count > len(periods)
            self.told_ns, self.settled = told_ns, Distribution() if earlier else None
        if self.settled is not None and len(periods):
            self.settled.add(periods, limits_of(periods))


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Frames of one node's error control in order; all (n,)."""

    rows: NDArray[np.intp]
    t_ns: Ints
    asks: Mask
    starts: Mask
    """Boot-ups."""
    beats: Mask


class ErrorControlPeriods:
    """Follows 701h to 77Fh; which node is guarded, and which sends heartbeats, NMT tells in the end."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._states: dict[tuple[int, int], _State] = {}

    def update(self, block: Block, bus: int) -> None:
        """Take in the frames of one bus of a block."""
        if not self._context.timed:
            return
        remote = self._remote(block, bus)
        nodes = {can_id - FIRST_ID for on, can_id in block.batch.ids() if on == bus}
        for node in sorted(n for n in nodes | remote.keys() if 1 <= n <= MAX_NODE):
            state = self._state(bus, node)
            asked = remote.get(node, np.zeros(0, np.intp))
            data = block.batch.rows(bus, FIRST_ID + node)
            if not len(asked) and self._only_beats(block, bus, node, state, data):
                self._take_beats(block, bus, node, state)
            elif len(asked) or len(data):
                self._take(block, bus, node, state, data, asked)

    def gap(self, bus: int | None) -> None:
        """No period goes over a gap."""
        for (on, _), state in self._states.items():
            if bus in (None, on):
                state.beats.last_ns = state.requests.last_ns = None
                state.broken, state.asked_ns = True, None
                state.missing.flush()
                state.answers.restart()

    def finish(
        self,
        nodes: Mapping[tuple[int, int], NodeNmt] | None,
        nmt_states: Sequence[NmtStateRow],
        silences: Mapping[int, Sequence[Silence]],
    ) -> tuple[list[ErrorControlRow], list[WorstRow]]:
        """(rows, worst periods).

        Args:
            nodes: what NMT found; None tells of every node by its frames alone.
            nmt_states: a heartbeat is not missing while its node starts.
            silences: of each bus, in which nothing is missing.
        """
        rows: list[ErrorControlRow] = []
        worst: list[WorstRow] = []
        for (bus, node), state in sorted(self._states.items()):
            nmt = nodes.get((bus, node)) if nodes is not None else None
            if nodes is not None and nmt is None:
                continue
            guarded = nmt.counts.guard_answers if nmt else state.answers.answered
            beating = _by_itself(nmt.counts) if nmt else state.beats.count
            name, can_id = self._context.bus_name(bus), FIRST_ID + node
            if beating > 1 and state.beats.periods.spread.count:
                starts = [
                    Silence(row.start_ns, row.end_ns, 0, 0, {})
                    for row in nmt_states
                    if (row.bus, row.node, row.state) == (name, node, "INITIALISING")
                ]
                rows.append(self._heartbeat(bus, node, state, [*silences.get(bus, ()), *starts]))
                worst += state.beats.periods.extremes.rows(name, can_id, node, "heartbeat period")
            if guarded > 1 and state.requests.periods.spread.count:
                rows.append(self._guarding(bus, node, state))
                worst += state.requests.periods.extremes.rows(name, can_id, node, "guard period")
                worst += state.answers.slowest.rows(name, can_id, node, "guard answer")
        return rows, worst

    def _remote(self, block: Block, bus: int) -> dict[int, NDArray[np.intp]]:
        """Rows of the remote frames to each node."""
        if not block.batch.flags_seen & FrameFlag.REMOTE:
            return {}
        rows = np.flatnonzero(block.batch.remote)
        short = (block.frames.flags[rows] & FrameFlag.EXTENDED) == 0
        rows = rows[short & (block.frames.bus[rows] == bus)]
        rows = rows[block.frames.can_id[rows] >> 7 == FIRST_ID >> 7]
        node = block.frames.can_id[rows] - FIRST_ID
        return {one: rows[node == one] for one in distinct(node)}

    def _state(self, bus: int, node: int) -> _State:
        if (bus, node) not in self._states:
            self._states[bus, node] = _State()
        return self._states[bus, node]

    def _only_beats(
        self, block: Block, bus: int, node: int, state: _State, rows: NDArray[np.intp]
    ) -> bool:
        """Whether a node sent heartbeats and nothing else, and nothing asked it for anything."""
        if not len(rows) or state.asked_ns is not None or state.broken:
            return False
        plain = block.batch.lengths[bus, FIRST_ID + node] == (1, 1)
        return plain and bool(block.frames.data[rows, 0].all()) and not self._cuts(block, bus, node)

    def _take_beats(self, block: Block, bus: int, node: int, state: _State) -> None:
        """Take in heartbeats alone, under one setting."""
        batch, can_id = block.batch, FIRST_ID + node
        rows, seq, t_ns = (each(bus, can_id) for each in (batch.rows, batch.seqs_of, batch.t_ns_of))
        state.answers.add(batch, rows, rows[:0], timed=True)
        told_ns = self._told_ns(bus, node, int(seq[0]))
        self._judge(state, state.beats.add(seq, t_ns, None), told_ns)

    def _cuts(self, block: Block, bus: int, node: int) -> list[int]:
        """`seq` at which 1017h of a node changed within a block."""
        first, last = block.batch.seq0, block.batch.last_seq
        changes = self._context.shadow.changes(bus, node, HEARTBEAT_TIME)
        return [seq for seq in changes if first < seq <= last]

    def _told_ns(self, bus: int, node: int, seq: int) -> int | None:
        """1017h as the bus or the user told it, None where it is off or not known [ns]."""
        told = _told(self._context.shadow.get(bus, node, HEARTBEAT_TIME, 0, seq))
        return told * 1_000_000 if told else None

    def _take(
        self,
        block: Block,
        bus: int,
        node: int,
        state: _State,
        data: NDArray[np.intp],
        remote: NDArray[np.intp],
    ) -> None:
        part = _part(block, state, data, remote)
        state.remote_seen |= bool(len(remote))
        asked = part.rows[part.asks]
        answering = part.rows[~part.asks]
        if len(asked):
            follows = np.ones(len(asked), np.bool_)
            state.requests.add(block.batch.seqs_at(asked), block.frames.t_ns[asked], follows)
        state.answers.add(block.batch, answering, asked, timed=True)
        for piece, told_ns in self._pieces(block, bus, node, part):
            self._beat(block.batch, state, piece, told_ns)

    def _pieces(
        self, block: Block, bus: int, node: int, part: _Part
    ) -> list[tuple[_Part, int | None]]:
        """The frames between two settings of 1017h, with the setting [ns]."""
        edges = np.searchsorted(
            block.batch.seqs_at(part.rows), self._cuts(block, bus, node)
        ).tolist()
        found = []
        for begin, stop in pairwise([0, *edges, len(part.rows)]):
            if stop > begin:
                at = block.batch.seq(part.rows[begin])
                piece = _Part(
                    part.rows[begin:stop],
                    part.t_ns[begin:stop],
                    part.asks[begin:stop],
                    part.starts[begin:stop],
                    part.beats[begin:stop],
                )
                found.append((piece, self._told_ns(bus, node, at)))
        return found

    @classmethod
    def _beat(cls, batch: IndexedBatch, state: _State, part: _Part, told_ns: int | None) -> None:
        """Periods of the heartbeats; what else comes in between breaks them."""
        breaks = np.cumsum(part.starts | (~part.beats & ~part.asks))
        rows = np.flatnonzero(part.beats)
        if not len(rows):
            state.broken |= bool(breaks[-1])
            return
        follows = np.diff(breaks[rows], prepend=0) == 0
        follows[0] &= not state.broken
        state.broken = bool(breaks[-1] > breaks[rows[-1]])
        seq, t_ns = batch.seqs_at(part.rows[rows]), part.t_ns[rows]
        cls._judge(state, state.beats.add(seq, t_ns, follows), told_ns)

    @staticmethod
    def _judge(state: _State, found: tuple[Ints, Ints, Ints], told_ns: int | None) -> None:
        """Find missing heartbeats by the periods, and the stamp and `seq` that each began with."""
        periods, before_ns, before_seq = found
        state.settle(periods, told_ns)
        timer_ns = _timer(periods, state.beats.periods.spread, told_ns)
        if timer_ns:
            late = periods > LATE * timer_ns
            judged = ~_sustained(late) if late.any() else ~late
            state.missing.add(timer_ns, periods, before_ns, before_seq, judged)

    def _heartbeat(
        self, bus: int, node: int, state: _State, silences: Sequence[Silence]
    ) -> ErrorControlRow:
        state.missing.flush()
        missing = state.missing.missed.within(None, 0.0)
        quiet = within_silence(
            missing.t_ns, silences, float(state.beats.periods.spread.quantile(0.5))
        )
        missing = missing.without(quiet)
        known = self._context.shadow.get(bus, node, HEARTBEAT_TIME)
        if known and known.source == "sdo-write" and state.told_ns != (_told(known) or 0) * MS:
            known = None  # no heartbeat followed the write
        seqs = list(dict.fromkeys(missing.seq.tolist()))[:MAX_EVIDENCE]
        row = self._row(bus, node, "heartbeat", state.beats, known, missing.count, seqs)
        if state.settled is None or not row.expected_us:
            return row
        step_ns = self._context.resolution_ns
        return replace(row, deviation_us=state.settled.off(row.expected_us * 1e3, 1000, step_ns))

    def _guarding(self, bus: int, node: int, state: _State) -> ErrorControlRow:
        known = self._context.shadow.get(bus, node, GUARD_TIME)
        answers = state.answers
        missed = answers.missed.within(None, 0.0)
        return self._row(
            bus,
            node,
            "guarding",
            state.requests,
            known,
            missed.count,
            missed.seq[:MAX_EVIDENCE].tolist(),
            answers.time,
        )

    def _row(
        self,
        bus: int,
        node: int,
        kind: str,
        rhythm: _Rhythm,
        known: Known | None,
        missing: int,
        missing_seq: list[int],
        answer: Distribution | None = None,
    ) -> ErrorControlRow:
        step_ns = self._context.resolution_ns
        expected_ms = known.value if known and isinstance(known.value, int) else None
        longest = rhythm.periods.extremes.longest
        return ErrorControlRow(
            bus=self._context.bus_name(bus),
            node=node,
            kind="heartbeat" if kind == "heartbeat" else "guarding",
            count=rhythm.count,
            period_us=rhythm.periods.spread.quantiles(1000),
            jitter_us=rhythm.periods.jitter_us(step_ns),
            expected_us=expected_ms * 1000 if expected_ms else None,
            expected_source=known.source if known and expected_ms else None,
            deviation_us=rhythm.periods.spread.off(expected_ms * 1e6, 1000, step_ns)
            if expected_ms
            else None,
            missing=missing,
            missing_seq=missing_seq,
            answer_us=answer.quantiles(1000) if answer else None,
            worst_us=int(longest.key[0]) / 1000 if len(longest.key) else None,
            worst_seq=int(longest.seq[0]) if len(longest.seq) else None,
            resolution_us=step_ns / 1000,
            quantile_error=rhythm.periods.spread.relative_error,
        )


def _part(block: Block, state: _State, data: NDArray[np.intp], remote: NDArray[np.intp]) -> _Part:
    """All frames of a node's error control in order, and what each of them is."""
    rows = np.sort(np.concatenate((data, remote))) if len(remote) else data
    t_ns, dlc = block.frames.t_ns[rows], block.frames.dlc[rows]
    byte = block.frames.data[rows, 0]
    asks = block.batch.remote[rows]
    message = ~asks & (dlc <= 1)
    after = np.diff(t_ns, append=t_ns[-1:] + 2 * _ANSWER_NS) <= _ANSWER_NS
    empty = message & (dlc == 0)
    if empty.any():
        answered = np.append((message & (dlc == 1))[1:], False) & after
        marked = (np.cumsum(asks) > 0) | state.remote_seen
        asks = asks | (empty & ~marked & answered)
        message &= ~asks
    starts = message & (dlc == 1) & (byte == 0)
    begun = state.asked_ns is not None and int(t_ns[0]) - state.asked_ns <= _ANSWER_NS
    answers = message & np.concatenate(([begun], (asks & after)[:-1]))
    state.asked_ns = int(t_ns[-1]) if asks[-1] else None
    return _Part(rows, t_ns, asks, starts, message & ~starts & ~answers)


def _timer(periods: Ints, spread: Distribution, told_ns: int | None) -> int | None:
    """The period that is due: as told where the node keeps it, else the usual one."""
    if len(periods) >= _LEARN:
        usual = round(quantile_of(periods, 0.5))
    else:
        usual = round(spread.quantile(0.5)) if spread.count >= _LEARN else 0
    if told_ns and (not usual or abs(usual - told_ns) <= _AS_TOLD * told_ns):
        return told_ns
    return usual or None


def _sustained(long: Mask) -> Mask:
    """(n,) True where so many follow one another that they are the rhythm."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], long.astype(np.int8), [0]))))
    found = np.zeros(len(long), np.bool_)
    for start, stop in edges.reshape(-1, 2).tolist():
        found[start:stop] = stop - start >= _REGIME
    return found


def _told(known: Known | None) -> int | None:
    """A setting that the bus or the user told; 0 where it is off."""
    if known is None or known.source == "eds-default" or not isinstance(known.value, int):
        return None
    return known.value


def _by_itself(counts: Counts) -> int:
    """Messages of a node that nobody is seen to have asked for."""
    return counts.heartbeats + counts.empty + (counts.guard_answers if counts.unseen else 0)
