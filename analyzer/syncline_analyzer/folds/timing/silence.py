"""Stretches in which nothing was heard of a whole bus: they accuse no single node."""

from collections.abc import Sequence
from dataclasses import field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distribution import Distribution
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.bundles import CLOSER_NS
from syncline_analyzer.folds.timing.clock_step import (
    HEARTBEATS,
    RUNNING,
    STAMP_NS,
    SYNC,
    Crossing,
    Witness,
    forward_step,
    witness,
)
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

MAX_SILENCES = 1000
_MANY = 10.0
"""So many times the usual distance between frames make a silence."""
_BRIEF = 3.0
"""So many times make a stretch that may be a step of the clock, if no silence."""
_OVERDUE = 1.5
"""A heartbeat is overdue after so many of its periods."""
_STEADY = 0.25
"""Interquartile range of a steady heartbeat, as a share of its period."""
_BURST = 1000
"""So many frames behind a silence are looked at."""
_LEARN = 4
_OTHERS = 8
"""So many identifiers beside the heartbeats are enough to witness a step of the clock."""
_PRE_OPERATIONAL = 0x7F
_NMT = 0x000
_NONE = np.zeros(0, np.intp)

Ints = NDArray[np.int64]


class Last(NamedTuple):
    """The last frame of an identifier: its stamp, the period before it (0: unknown), its state byte."""

    t_ns: int
    pace_ns: int
    state: int


@dataclass(slots=True)
class Silence:
    """A stretch without frames: stamps and `seq` of the frames before and after.

    `before` holds when each identifier was heard last, `across` how much the stamps say passed
    between that and its first frame after.
    """

    start_ns: int
    end_ns: int
    start_seq: int
    end_seq: int
    before: dict[int, Last]
    stalled: bool = False
    """The recorder kept what came meanwhile and delivered it at once afterwards."""
    across: dict[int, int] = field(default_factory=dict)
    until_ns: int = 0
    """So far frames were looked at after it."""
    anew: bool = False
    """A node started anew after it."""


class ForwardStep(NamedTuple):
    """The recorder's clock was set forward by `by_ns` in a silence that was none."""

    start_ns: int
    end_ns: int
    end_seq: int
    by_ns: int
    witnesses: int


@dataclass(slots=True)
class _Bus:
    last_ns: int | None = None
    last_seq: int = 0
    apart: Distribution = field(default_factory=lambda: Distribution(moments=False))
    heard: dict[int, Last] = field(default_factory=dict)
    period: dict[int, Distribution] = field(default_factory=dict)
    silences: list[Silence] = field(default_factory=list)
    others: list[int] = field(default_factory=list)
    """Identifiers beside the heartbeats that may witness a step of the clock."""
    brief: list[Silence] = field(default_factory=list)
    """Stretches too short for a silence, in which the clock may have been set."""
    waiting: list[Silence] = field(default_factory=list)
    """Silences that not every identifier has been heard after."""
    backs: list[Silence] = field(default_factory=list)
    """Times that the stamps go through twice."""


class SilenceFold:
    """Follows the distance between frames of each bus, and the heartbeats due meanwhile.

    SYNC and the PDOs that answer it fall silent together when the producer stops; heartbeats do
    not follow SYNC, so only an overdue one proves that the whole bus was not heard.
    """

    def __init__(self) -> None:
        self._buses: dict[int, _Bus] = {}
        self._told: dict[int, list[Silence]] = {}

    def update(self, block: Block, bus: int) -> None:
        """Take in the frames of one bus of a block."""
        self._told.clear()
        state = self._buses.get(bus) or self._buses.setdefault(bus, _Bus())
        apart = _apart(block.frames.t_ns[block.by_bus[bus]], state.last_ns)
        least_ns, most_ns = (int(apart.min()), int(apart.max())) if len(apart) else (0, 0)
        if least_ns >= 0:
            state.apart.add(apart, (least_ns, most_ns))
        else:
            state.apart.add(apart[apart >= 0])
        ids = [can_id for on, can_id in block.batch.ids() if on == bus]
        others = [i for i in ids if i not in HEARTBEATS and i not in state.others]
        state.others.extend(others[: _OTHERS - len(state.others)])
        followed = {_NMT, *state.others}
        lines = {i: _Line(block, bus, i) for i in ids if i in HEARTBEATS or i in followed}
        last_ns, last_seq = _last_frame(block, bus)
        _follow(state.waiting, lines, last_ns)
        state.waiting.clear()
        usual_ns = state.apart.quantile(0.98) if state.apart.count else 0.0
        brief_ns = _BRIEF * usual_ns
        long = np.flatnonzero(apart > brief_ns)[:MAX_SILENCES] if most_ns > brief_ns else _NONE
        if least_ns < -STAMP_NS or len(long):
            self._add_silences(block, bus, state, apart, usual_ns, long, lines)
            _follow(state.waiting, lines, last_ns)
        for can_id, line in lines.items():
            _add_period(state, can_id, line)
        state.last_ns, state.last_seq = last_ns, last_seq

    @staticmethod
    def _add_silences(
        block: Block,
        bus: int,
        state: _Bus,
        apart: Ints,
        usual_ns: float,
        long: NDArray[np.intp],
        lines: dict[int, "_Line"],
    ) -> None:
        """Keep steps back of the stamps, and the `long` ones of the (n,) times between frames."""
        rows = np.arange(len(block.frames))[block.by_bus[bus]]
        t_ns, seq = block.frames.t_ns[rows], block.batch.seqs[rows]
        if state.last_ns is not None:
            t_ns = np.concatenate(([state.last_ns], t_ns))
            seq = np.concatenate(([state.last_seq], seq))
        back = np.flatnonzero(apart < -STAMP_NS)[: MAX_SILENCES - len(state.backs)].tolist()
        state.backs.extend(
            Silence(int(t_ns[k + 1]), int(t_ns[k]), int(seq[k]), int(seq[k + 1]), {}) for k in back
        )
        for row in long.tolist():
            kept = state.silences if apart[row] > _MANY * usual_ns else state.brief
            if usual_ns > 0 and len(kept) < MAX_SILENCES:
                end = int(seq[row + 1])
                before = _heard_until(state.heard, lines, end)
                stalled = _stalled(apart, row, int(t_ns[-1] - t_ns[0]))
                kept.append(
                    Silence(int(t_ns[row]), int(t_ns[row + 1]), int(seq[row]), end, before, stalled)
                )
                state.waiting.append(kept[-1])

    def gap(self, bus: int | None) -> None:
        """A gap is no silence."""
        self._told.clear()
        for number, state in self._buses.items():
            if bus in (None, number):
                state.last_ns = None
                state.heard.clear()
                state.waiting.clear()

    def of(self, bus: int) -> list[Silence]:
        """Silences of a bus in which a heartbeat became overdue, and steps of the clock.

        One that was overdue before is its node's own affair.
        """
        if bus not in self._told:
            self._told[bus] = self._overdue(bus)
        return self._told[bus]

    def _overdue(self, bus: int) -> list[Silence]:
        state = self._buses.get(bus)
        if state is None:
            return []
        periods = {
            can_id: period.quantile(0.5)
            for can_id, period in state.period.items()
            if can_id in HEARTBEATS
            and period.count >= _LEARN
            and period.quantile(0.75) - period.quantile(0.25) <= _STEADY * period.quantile(0.5)
        }
        stepped = {step.end_seq for step in self.steps(bus)}
        brief = [silence for silence in state.brief if silence.end_seq in stepped]
        return brief + [
            silence
            for silence in state.silences
            if silence.end_seq in stepped
            or any(
                silence.end_ns - last.t_ns > _OVERDUE * periods[can_id]
                and _OVERDUE * periods[can_id] >= silence.start_ns - last.t_ns
                and silence.end_ns - silence.start_ns > periods[can_id]
                for can_id, last in silence.before.items()
                if can_id in periods
            )
        ]

    def backs(self, bus: int) -> list[Silence]:
        """Times that the stamps of a bus go through twice: the clock was set back."""
        state = self._buses.get(bus)
        return state.backs if state is not None else []

    def steps(self, bus: int) -> list[ForwardStep]:
        """Silences in which every period is too long by the same time: the clock was set."""
        state = self._buses.get(bus)
        if state is None or not (state.silences or state.brief):
            return []
        told = {can_id: witness(periods) for can_id, periods in state.period.items()}
        witnesses = {can_id: each for can_id, each in told.items() if each is not None}
        found = []
        for silence in sorted([*state.silences, *state.brief], key=lambda each: each.end_seq):
            if silence.stalled or silence.anew:
                continue
            step = forward_step(_crossings(silence, witnesses))
            if step is not None:
                found.append(ForwardStep(silence.start_ns, silence.end_ns, silence.end_seq, *step))
        return found


def _apart(t_ns: Ints, last_ns: int | None) -> Ints:
    """Time from each stamp to the next, the first one counted from the last before, if any."""
    if last_ns is None:
        return t_ns[1:] - t_ns[:-1]
    apart = np.empty(len(t_ns), np.int64)
    apart[:1] = t_ns[:1] - last_ns
    np.subtract(t_ns[1:], t_ns[:-1], out=apart[1:])
    return apart


def _stalled(apart: Ints, row: int, span_ns: int) -> bool:
    """Whether at least half of what comes in the time before a frame came at once behind it."""
    behind = apart[row + 1 : row + 1 + _BURST]
    close = (behind >= 0) & (behind < CLOSER_NS)
    count = int(np.argmin(close)) if not close.all() else len(close)
    due = len(apart) * int(apart[row]) / max(span_ns, 1)
    return count > 0 and 2 * (count + 1) >= min(due, _BURST)


def within_silence(
    t_ns: NDArray[np.int64], silences: Sequence[Silence], before_ns: float, after_ns: float = 0.0
) -> NDArray[np.bool_]:
    """(n,) which moments lie in a silence, or less than `before_ns` before or `after_ns` after."""
    inside = np.zeros(len(t_ns), np.bool_)
    for silence in silences:
        inside |= (t_ns > silence.start_ns - before_ns) & (t_ns < silence.end_ns + after_ns)
    return inside


class _Line:
    """The frames of an identifier in a block: (n,) stamps and `seq`, and their first bytes.

    Without remote frames that a logger wrote down as empty data frames of error control.
    """

    def __init__(self, block: Block, bus: int, can_id: int) -> None:
        batch = block.batch
        rows = batch.rows(bus, can_id)
        self.t_ns = batch.t_ns_of(bus, can_id)
        if can_id in HEARTBEATS:
            sent = block.frames.dlc[rows] > 0
            if not sent.all():
                rows, self.t_ns = rows[sent], self.t_ns[sent]
        self._rows, self._batch = rows, batch

    @cached_property
    def seq(self) -> Ints:
        """Position of each frame in the capture."""
        return self._batch.seqs_at(self._rows)

    def state(self, at: int) -> int:
        """First byte of a frame without its highest bit."""
        return int(self._batch.frames.data[self._rows[at], 0]) & 0x7F


def _last_frame(block: Block, bus: int) -> tuple[int, int]:
    """(stamp, `seq`) of the last frame of a bus."""
    places = block.by_bus[bus]
    row = -1 if isinstance(places, slice) else int(places[-1])
    return int(block.frames.t_ns[row]), block.batch.seq(row)


def _heard_until(heard: dict[int, Last], lines: dict[int, _Line], seq: int) -> dict[int, Last]:
    """The last frame of each identifier before a `seq`."""
    found = dict(heard)
    for can_id, line in lines.items():
        last = _last(heard.get(can_id), line, int(np.searchsorted(line.seq, seq)))
        if last is not None:
            found[can_id] = last
    return found


def _last(before: Last | None, line: _Line, count: int) -> Last | None:
    """The last of the first `count` frames of a line, which goes on after `before`."""
    if not count:
        return before
    t_ns = int(line.t_ns[count - 1])
    previous = before.t_ns if before is not None else t_ns
    if count > 1:
        previous = int(line.t_ns[count - 2])
    return Last(t_ns, t_ns - previous, line.state(count - 1))


def _follow(silences: list[Silence], lines: dict[int, _Line], until_ns: int) -> None:
    """Note the first frame of each identifier after these silences, where it is not noted yet."""
    for silence in silences:
        silence.until_ns = until_ns
        for can_id, last in silence.before.items():
            if can_id in silence.across or can_id not in lines:
                continue
            line = lines[can_id]
            at = int(np.searchsorted(line.seq, silence.end_seq))
            if at < len(line.seq):
                silence.across[can_id] = int(line.t_ns[at]) - last.t_ns
                if can_id in HEARTBEATS:
                    silence.anew |= _starts_anew(silence, last, line.state(at))


def _starts_anew(silence: Silence, last: Last, state: int) -> bool:
    """Whether the first error control of a node after a silence tells of a start.

    That is a boot-up (CiA 301 7.2.8.3), or PRE-OPERATIONAL where nobody had commanded it.
    """
    if state != _PRE_OPERATIONAL or last.state == state:
        return state == 0
    command = silence.before.get(_NMT)
    return command is None or command.t_ns < last.t_ns


def _add_period(state: _Bus, can_id: int, line: _Line) -> None:
    times, before = line.t_ns, state.heard.get(can_id)
    periods = _apart(times, before.t_ns if before is not None else None)
    if can_id not in state.period:
        state.period[can_id] = Distribution(moments=False)
    least_ns, most_ns = (int(periods.min()), int(periods.max())) if len(periods) else (0, 0)
    if least_ns > 0:
        state.period[can_id].add(periods, (least_ns, most_ns))
    else:
        state.period[can_id].add(periods[periods > 0])
    last = _last(before, line, len(times))
    if last is not None:
        state.heard[can_id] = last


def _crossings(silence: Silence, witnesses: dict[int, Witness]) -> list[Crossing]:
    """How those went on that came steadily up to a silence.

    A PDO that comes no more because the master switched its node just then tells nothing.
    """
    found = []
    command = silence.before.get(_NMT)
    for can_id, last in silence.before.items():
        each = witnesses.get(can_id)
        if each is None:
            continue
        switched = command is not None and command.t_ns >= last.t_ns
        if switched and can_id not in HEARTBEATS and can_id != SYNC:
            continue
        steady = abs(last.pace_ns - each.period_ns) <= 2 * each.spread_ns
        if steady and silence.start_ns - last.t_ns <= RUNNING * each.period_ns + each.spread_ns:
            across = silence.across.get(can_id)
            left_ns = silence.until_ns - last.t_ns
            pending = can_id != SYNC and _between_syncs(silence, can_id)
            found.append(Crossing(can_id, each, across, left_ns, pending))
    return found


def _between_syncs(silence: Silence, can_id: int) -> bool:
    """Whether a silence parts a SYNC from a frame that came before the next SYNC."""
    last, sync = silence.before[can_id], silence.before.get(SYNC)
    if sync is None or can_id not in silence.across or SYNC not in silence.across:
        return False
    again_ns, next_ns = last.t_ns + silence.across[can_id], sync.t_ns + silence.across[SYNC]
    return last.t_ns < sync.t_ns and again_ns < next_ns
