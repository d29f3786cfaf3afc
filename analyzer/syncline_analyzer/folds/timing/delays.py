"""Who delayed whom: the time that synchronous PDOs waited, by the frames ahead of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np

from syncline_analyzer.folds.timing.senders import Sender
from syncline_analyzer.folds.timing.waiting import MASTER, UNKNOWN
from syncline_analyzer.folds.timing.waiting_bus import Blame, BusBlock, Floats, Ints
from syncline_analyzer.results import DelayRow

_Key = TypeVar("_Key")

MAX_IDS = 256
"""Identifiers ahead of one PDO that are followed one by one."""


class _Sums(NamedTuple):
    """What answers waited for: how many frames and answers, and the worst of these [ns]."""

    frames: int
    delayed: int
    ns: float
    worst_ns: float
    worst_cob_id: int
    worst_seq: int


_NOTHING = _Sums(0, 0, 0.0, 0.0, 0, 0)


@dataclass(slots=True)
class _Delay:
    """What answers waited for one identifier, or for all of a sender (`cob_id` None)."""

    cob_id: int | None
    sender: Sender
    sums: _Sums = _NOTHING

    def add(self, more: _Sums) -> None:
        """Take in more answers."""
        worst = more if more.worst_ns > self.sums.worst_ns else self.sums
        self.sums = _Sums(
            self.sums.frames + more.frames,
            self.sums.delayed + more.delayed,
            self.sums.ns + more.ns,
            *worst[3:],
        )


class Delays:
    """Sums of one PDO, or of all of a bus."""

    def __init__(self) -> None:
        self._by_key: dict[tuple[int, int], _Delay] = {}
        self._by_sender: dict[int, _Delay] = {}

    def add(self, block: BusBlock, blame: Blame, can_id: int, sender: int) -> None:
        """Take in what answers of one PDO waited for; not its own sender's frames."""
        others = np.flatnonzero((block.key_sender != sender) & blame.frames.any(axis=0))
        if not len(others):
            return
        ns, frames = blame.ns[:, others], blame.frames[:, others]
        senders, whose = np.unique(block.key_sender[others], return_inverse=True)
        for at, sums in zip(others.tolist(), _sums(block, blame, ns, frames, can_id), strict=True):
            key = int(block.keys[at]), int(block.key_sender[at])
            if key in self._by_key or len(self._by_key) < MAX_IDS:
                if key not in self._by_key:
                    self._by_key[key] = _Delay(*block.identity(at))
                self._by_key[key].add(sums)
        member = whose[:, np.newaxis] == np.arange(len(senders))
        summed = _sums(block, blame, ns @ member, frames @ member, can_id)
        for node, sums in zip(senders.tolist(), summed, strict=True):
            if node != UNKNOWN:
                self._by_sender.setdefault(node, _Delay(None, Sender(node, "all"))).add(sums)

    def join(self, other: "Delays") -> None:
        """Take in the sums of another PDO."""
        _join(self._by_key, other._by_key)
        _join(self._by_sender, other._by_sender)

    def rows(self, bus: str) -> list[DelayRow]:
        """One row per sender and one per identifier, those that were waited for longest first."""
        delays = [*self._by_sender.values(), *self._by_key.values()]
        rows = [_row(bus, delay) for delay in delays]
        return sorted(rows, key=lambda row: (row.cob_id is not None, -row.us))


def _sums(block: BusBlock, blame: Blame, ns: Floats, frames: Ints, can_id: int) -> Iterator[_Sums]:
    """Of each column: what the answers of one PDO waited for."""
    worst = ns.argmax(axis=0)
    columns = (
        frames.sum(axis=0),
        np.count_nonzero(frames, axis=0),
        ns.sum(axis=0),
        ns.max(axis=0),
        block.seq[blame.rows[worst]],
    )
    for count, delayed, total, most, seq in zip(*(each.tolist() for each in columns), strict=True):
        yield _Sums(count, delayed, total, most, can_id, seq)


def _join(mine: dict[_Key, _Delay], theirs: dict[_Key, _Delay]) -> None:
    for key, delay in theirs.items():
        found = mine.setdefault(key, _Delay(delay.cob_id, delay.sender))
        found.add(delay.sums)


def _row(bus: str, delay: _Delay) -> DelayRow:
    return DelayRow(
        bus,
        delay.cob_id,
        delay.sender.node if delay.sender.node > MASTER else None,
        delay.sender.service,
        delay.sums.frames,
        delay.sums.delayed,
        delay.sums.ns / 1000,
        delay.sums.worst_ns / 1000,
        delay.sums.worst_cob_id,
        delay.sums.worst_seq,
    )
