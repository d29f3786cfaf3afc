"""Stretches in which nothing was heard of a whole bus: they accuse no single node."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distribution import Distribution
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.bundles import CLOSER_NS

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
_HEARTBEATS = range(0x701, 0x780)
_WITNESS = 0.05
"""A witness of a clock step keeps its period within this share of it."""
_MIN_STEP = 3.0
"""A step is at least so many times as long as the witnesses' uncertainty."""
_DRIFT = 2e-4
"""Two clocks of devices differ by less than this share of the time."""
_SURE_DRIFT = 1e-5
"""Two clocks of devices differ by at least this share of a long time."""
_STAMP_NS = 1_000_000
"""Stamps of a frame may be off by so much by arbitration and the recorder's own delay [ns]."""

Ints = NDArray[np.int64]


@dataclass(slots=True)
class Silence:
    """A stretch without frames: stamps and `seq` of the frames before and after.

    `heard_ns` holds when each heartbeat was heard last, `across` by identifier how much the stamps
    say passed between its last frame before and its first one after.
    """

    start_ns: int
    end_ns: int
    start_seq: int
    end_seq: int
    heard_ns: dict[int, int]
    stalled: bool = False
    """The recorder kept what came meanwhile and delivered it at once afterwards."""
    before_ns: dict[int, int] = field(default_factory=dict)
    across: dict[int, int] = field(default_factory=dict)


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
    apart: Distribution = field(default_factory=Distribution)
    heard_ns: dict[int, int] = field(default_factory=dict)
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
        state = self._buses.setdefault(bus, _Bus())
        rows = np.arange(len(block.frames))[block.by_bus[bus]]
        t_ns = block.frames.t_ns[rows]
        seq = block.batch.seq0 + rows
        if state.last_ns is not None:
            t_ns = np.concatenate(([state.last_ns], t_ns))
            seq = np.concatenate(([state.last_seq], seq))
        apart = np.diff(t_ns)
        state.apart.add(apart[apart >= 0])
        back = np.flatnonzero(apart < -_STAMP_NS)[: MAX_SILENCES - len(state.backs)].tolist()
        state.backs.extend(
            Silence(int(t_ns[k + 1]), int(t_ns[k]), int(seq[k]), int(seq[k + 1]), {}) for k in back
        )
        others = [i for b, i in block.batch.ids() if b == bus and i not in _HEARTBEATS]
        state.others.extend(
            [i for i in others if i not in state.others][: _OTHERS - len(state.others)]
        )
        stamps = {
            can_id: (
                block.batch.seq0 + block.batch.rows(bus, can_id),
                block.frames.t_ns[block.batch.rows(bus, can_id)],
            )
            for id_bus, can_id in block.batch.ids()
            if id_bus == bus and (can_id in _HEARTBEATS or can_id in state.others)
        }
        _add_across(state.waiting, stamps)
        state.waiting.clear()
        usual_ns = state.apart.quantile(0.98) if state.apart.count else 0.0
        for row in np.flatnonzero(apart > _BRIEF * usual_ns)[:MAX_SILENCES].tolist():
            kept = state.silences if apart[row] > _MANY * usual_ns else state.brief
            if usual_ns > 0 and len(kept) < MAX_SILENCES:
                end = int(seq[row + 1])
                before = state.heard_ns | _heard_until(stamps, end)
                heard = {can_id: ns for can_id, ns in before.items() if can_id in _HEARTBEATS}
                stalled = _stalled(apart, row, int(t_ns[-1] - t_ns[0]))
                silence = Silence(
                    int(t_ns[row]), int(t_ns[row + 1]), int(seq[row]), end, heard, stalled, before
                )
                kept.append(silence)
                _add_across([silence], stamps)
                state.waiting.append(silence)
        for can_id, (_, times) in stamps.items():
            _add_period(state, can_id, times)
        state.last_ns, state.last_seq = int(t_ns[-1]), int(seq[-1])

    def gap(self, bus: int | None) -> None:
        """A gap is no silence."""
        self._told.clear()
        for number, state in self._buses.items():
            if bus in (None, number):
                state.last_ns = None
                state.heard_ns.clear()
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
            if can_id in _HEARTBEATS
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
                silence.end_ns - last_ns > _OVERDUE * periods[can_id] >= silence.start_ns - last_ns
                and silence.end_ns - silence.start_ns > periods[can_id]
                for can_id, last_ns in silence.heard_ns.items()
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
        witnesses = _witnesses(state)
        found = [
            _forward_step(silence, witnesses)
            for silence in sorted([*state.silences, *state.brief], key=lambda each: each.end_seq)
            if not silence.stalled
        ]
        return [step for step in found if step is not None]


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


def _heard_until(stamps: dict[int, tuple[Ints, Ints]], seq: int) -> dict[int, int]:
    """Stamp of the last frame of each identifier before a `seq`."""
    found = {}
    for can_id, (numbers, times) in stamps.items():
        count = int(np.searchsorted(numbers, seq))
        if count:
            found[can_id] = int(times[count - 1])
    return found


def _add_across(silences: list[Silence], stamps: dict[int, tuple[Ints, Ints]]) -> None:
    """Note the first frame of each identifier after these silences, where it is not noted yet."""
    for silence in silences:
        for can_id, before_ns in silence.before_ns.items():
            if can_id in silence.across or can_id not in stamps:
                continue
            numbers, times = stamps[can_id]
            at = int(np.searchsorted(numbers, silence.end_seq))
            if at < len(times):
                silence.across[can_id] = int(times[at]) - before_ns


def _add_period(state: _Bus, can_id: int, times: Ints) -> None:
    if can_id in state.heard_ns:
        times = np.concatenate(([state.heard_ns[can_id]], times))
    periods = np.diff(times)
    state.period.setdefault(can_id, Distribution()).add(periods[periods > 0])
    state.heard_ns[can_id] = int(times[-1])


def _witnesses(state: _Bus) -> dict[int, tuple[float, float]]:
    """(period, uncertainty) [ns] of every identifier that comes steadily."""
    found = {}
    for can_id, period in state.period.items():
        median = period.quantile(0.5)
        spread = max(period.quantile(0.95) - period.quantile(0.05), _STAMP_NS)
        if period.count >= 2 * _LEARN and spread <= max(_WITNESS * median, _STAMP_NS):
            found[can_id] = (median, spread)
    return found


def _forward_step(
    silence: Silence, witnesses: dict[int, tuple[float, float]]
) -> ForwardStep | None:
    """The step that explains a silence, unless it may as well have been one.

    When the clock is set, each identifier goes on after one period, so that all stamps between two
    of its frames are too long by the same time. In a true silence they are whole multiples of each
    period instead; where both hold, only a silence so long that no two devices would keep their
    phase over it is taken for a step.
    """
    known = {
        can_id: (across, *witnesses[can_id])
        for can_id, across in silence.across.items()
        if can_id in witnesses
    }
    if len(known) < 3 or len(known) < len(witnesses.keys() & silence.before_ns.keys()) / 2:
        return None
    excess = {can_id: across - period for can_id, (across, period, _) in known.items()}
    by_ns = float(np.median(list(excess.values())))
    if by_ns < _MIN_STEP * min(spread for _, _, spread in known.values()):
        return None
    agree = {
        can_id
        for can_id, (_, _, spread) in known.items()
        if abs(excess[can_id] - by_ns) <= 2 * spread
    }
    beats = known.keys() & set(_HEARTBEATS)
    if len(agree) < 0.9 * len(known) or not beats <= agree:
        return None
    if not _excludes_silence(list(known.values()), by_ns, len(beats)):
        return None
    return ForwardStep(silence.start_ns, silence.end_ns, silence.end_seq, round(by_ns), len(agree))


def _excludes_silence(known: list[tuple[int, float, float]], by_ns: float, heartbeats: int) -> bool:
    """Whether the devices cannot have gone on unheard for that long."""
    tightest = min(spread for _, _, spread in known)
    if heartbeats >= 2 and _SURE_DRIFT * by_ns > 4 * tightest:
        return True
    misses = 0
    for across, period, spread in known:
        off = abs(across / period - round(across / period)) * period
        misses += off > 2 * spread + _DRIFT * across
    return misses >= max(2, len(known) / 3)
