"""Stretches in which nothing was heard of a whole bus: they accuse no single node."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distribution import Distribution
from syncline_analyzer.folds.block import Block

MAX_SILENCES = 1000
_MANY = 10.0
"""So many times the usual distance between frames make a silence."""
_OVERDUE = 1.5
"""A heartbeat is overdue after so many of its periods."""
_STEADY = 0.25
"""Interquartile range of a steady heartbeat, as a share of its period."""
_LEARN = 4
_HEARTBEATS = range(0x701, 0x780)


class Silence(NamedTuple):
    """Stamps of the frames before and after, and when each heartbeat was heard last."""

    start_ns: int
    end_ns: int
    heard_ns: dict[int, int]


@dataclass(slots=True)
class _Bus:
    last_ns: int | None = None
    apart: Distribution = field(default_factory=Distribution)
    heard_ns: dict[int, int] = field(default_factory=dict)
    period: dict[int, Distribution] = field(default_factory=dict)
    silences: list[Silence] = field(default_factory=list)


class SilenceFold:
    """Follows the distance between frames of each bus, and the heartbeats due meanwhile.

    SYNC and the PDOs that answer it fall silent together when the producer stops; heartbeats do
    not follow SYNC, so only an overdue one proves that the whole bus was not heard.
    """

    def __init__(self) -> None:
        self._buses: dict[int, _Bus] = {}

    def update(self, block: Block, bus: int) -> None:
        """Take in the frames of one bus of a block."""
        state = self._buses.setdefault(bus, _Bus())
        t_ns = block.frames.t_ns[block.by_bus[bus]]
        if state.last_ns is not None:
            t_ns = np.concatenate(([state.last_ns], t_ns))
        apart = np.diff(t_ns)
        state.apart.add(apart[apart >= 0])
        beats = {
            can_id: block.frames.t_ns[block.batch.rows(bus, can_id)]
            for id_bus, can_id in block.batch.ids()
            if id_bus == bus and can_id in _HEARTBEATS
        }
        usual_ns = state.apart.quantile(0.98) if state.apart.count else 0.0
        for row in np.flatnonzero(apart > _MANY * usual_ns)[:MAX_SILENCES].tolist():
            start_ns = int(t_ns[row])
            heard = state.heard_ns | _heard_until(beats, start_ns)
            if usual_ns > 0 and len(state.silences) < MAX_SILENCES:
                state.silences.append(Silence(start_ns, int(t_ns[row + 1]), heard))
        for can_id, stamps in beats.items():
            _add_beats(state, can_id, stamps)
        state.last_ns = int(t_ns[-1])

    def gap(self, bus: int | None) -> None:
        """A gap is no silence."""
        for number, state in self._buses.items():
            if bus in (None, number):
                state.last_ns = None
                state.heard_ns.clear()

    def of(self, bus: int) -> list[Silence]:
        """Silences of a bus in which at least one heartbeat was overdue."""
        state = self._buses.get(bus)
        if state is None:
            return []
        periods = {
            can_id: period.quantile(0.5)
            for can_id, period in state.period.items()
            if period.count >= _LEARN
            and period.quantile(0.75) - period.quantile(0.25) <= _STEADY * period.quantile(0.5)
        }
        return [
            silence
            for silence in state.silences
            if any(
                silence.end_ns - last_ns > _OVERDUE * periods[can_id]
                and silence.end_ns - silence.start_ns > periods[can_id]
                for can_id, last_ns in silence.heard_ns.items()
                if can_id in periods
            )
        ]


def within_silence(
    t_ns: NDArray[np.int64], silences: Sequence[Silence], before_ns: float, after_ns: float = 0.0
) -> NDArray[np.bool_]:
    """(n,) which moments lie in a silence, or less than `before_ns` before or `after_ns` after."""
    inside = np.zeros(len(t_ns), np.bool_)
    for silence in silences:
        inside |= (t_ns > silence.start_ns - before_ns) & (t_ns < silence.end_ns + after_ns)
    return inside


def _heard_until(beats: dict[int, NDArray[np.int64]], t_ns: int) -> dict[int, int]:
    """Stamp of the last heartbeat of each node up to a moment."""
    found = {}
    for can_id, stamps in beats.items():
        before = stamps[stamps <= t_ns]
        if len(before):
            found[can_id] = int(before[-1])
    return found


def _add_beats(state: _Bus, can_id: int, stamps: NDArray[np.int64]) -> None:
    if can_id in state.heard_ns:
        stamps = np.concatenate(([state.heard_ns[can_id]], stamps))
    periods = np.diff(stamps)
    state.period.setdefault(can_id, Distribution()).add(periods[periods > 0])
    if len(stamps):
        state.heard_ns[can_id] = int(stamps[-1])
