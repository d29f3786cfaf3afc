"""Who delayed whom: the time that synchronous PDOs waited, by the frames ahead of them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from syncline_analyzer.folds.timing.senders import Sender
from syncline_analyzer.folds.timing.waiting import MASTER, UNKNOWN
from syncline_analyzer.folds.timing.waiting_bus import Blame, BusBlock, Ints
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


@dataclass(slots=True)
class _Delay:
    """What answers waited for one identifier, or for all of a sender (`cob_id` None)."""

    cob_id: int | None
    sender: Sender
    frames: int = 0
    delayed: int = 0
    ns: float = 0.0
    worst_ns: float = 0.0
    worst_cob_id: int = 0
    worst_seq: int = 0

    def add(self, more: "_Sums | _Delay") -> None:
        """Take in more answers."""
        self.frames += more.frames
        self.delayed += more.delayed
        self.ns += more.ns
        if more.worst_ns > self.worst_ns:
            self.worst_ns = more.worst_ns
            self.worst_cob_id, self.worst_seq = more.worst_cob_id, more.worst_seq


class Delays:
    """Sums of one PDO, or of all of a bus."""

    def __init__(self) -> None:
        self._by_key: dict[tuple[int, int], _Delay] = {}
        self._by_sender: dict[int, _Delay] = {}

    def add(self, block: BusBlock, blame: Blame, can_id: int, sender: int) -> None:
        """Take in what answers of one PDO waited for; not its own sender's frames."""
        others = np.flatnonzero((block.key_sender != sender)[blame.place])
        if not len(others):
            return
        place, senders = blame.place[others], block.senders_by_key
        for at, sums in _sums(block, blame, others, place, len(block.keys), can_id):
            key = block.names[at]
            delay = self._by_key.get(key)
            if delay is None and len(self._by_key) < MAX_IDS:
                delay = self._by_key[key] = _Delay(*block.identity(at))
            if delay is not None:
                delay.add(sums)
        whose = senders[1][place]
        for at, sums in _sums(block, blame, others, whose, len(senders[0]), can_id):
            node = int(senders[0][at])
            if node != UNKNOWN:
                if node not in self._by_sender:
                    self._by_sender[node] = _Delay(None, Sender(node, "all"))
                self._by_sender[node].add(sums)

    def told(self, sender_of: Callable[[int], Sender], own: int) -> "Delays":
        """The sums by what is known in the end; frames that prove to be the PDO's own left out.

        Args:
            sender_of: sender of a key, see `BusBlock.keys`.
            own: sender of the PDO itself.
        """
        told = Delays()
        moved: set[int] = set()
        for (key, before), delay in self._by_key.items():
            sender = sender_of(key)
            if sender.node != before:
                moved |= {before, sender.node}
            if sender.node != own or own == UNKNOWN:
                known = replace(delay, sender=sender)
                _join(told._by_key, {(key, sender.node): known})
        for node, delay in self._by_sender.items():
            if node not in moved:
                told._by_sender[node] = delay
        for (_, node), delay in told._by_key.items():
            if node in moved - {UNKNOWN}:
                # How many answers waited for several of its identifiers is not known: the least.
                whole = told._by_sender.setdefault(node, _Delay(None, Sender(node, "all")))
                delayed = max(whole.delayed, delay.delayed)
                whole.add(delay)
                whole.delayed = delayed
        return told

    def join(self, other: "Delays") -> None:
        """Take in the sums of another PDO."""
        _join(self._by_key, other._by_key)
        _join(self._by_sender, other._by_sender)

    def rows(self, bus: str) -> list[DelayRow]:
        """One row per sender and one per identifier, those that were waited for longest first."""
        delays = [*self._by_sender.values(), *self._by_key.values()]
        rows = [_row(bus, delay) for delay in delays]
        return sorted(rows, key=lambda row: (row.cob_id is not None, -row.us))


def _sums(
    block: BusBlock, blame: Blame, chosen: Ints, group: Ints, groups: int, can_id: int
) -> Iterator[tuple[int, _Sums]]:
    """What the answers of one PDO waited for, by the (a,) `group` of the `chosen` frames ahead."""
    # Numbers of 16 bits are sorted in linear time.
    order = np.argsort(group.astype(np.uint16) if groups <= 1 << 16 else group, kind="stable")
    group, victim, ns = group[order], blame.victim[chosen[order]], blame.ns[chosen[order]]
    # One answer may have waited for several frames of a group: these are one cell.
    apart = np.ones(len(group), np.bool_)
    apart[1:] = (group[1:] != group[:-1]) | (victim[1:] != victim[:-1])
    cell = np.flatnonzero(apart)
    cell_ns, cell_group = np.add.reduceat(ns, cell), group[cell]
    edge = np.concatenate(([0], np.flatnonzero(cell_group[1:] != cell_group[:-1]) + 1, [len(cell)]))
    first, delayed = edge[:-1], edge[1:] - edge[:-1]
    frames = np.append(cell[first], len(group))
    most = np.maximum.reduceat(cell_ns, first)
    longest = np.flatnonzero(cell_ns == np.repeat(most, delayed))
    worst = longest[np.searchsorted(longest, first)]
    columns = (
        cell_group[first],
        frames[1:] - frames[:-1],
        delayed,
        np.add.reduceat(cell_ns, first),
        most,
        block.seq[blame.rows[victim[cell[worst]]]],
    )
    for at, count, answers, total, most_ns, seq in zip(
        *(each.tolist() for each in columns), strict=True
    ):
        yield at, _Sums(count, answers, total, most_ns, can_id, seq)


def _join(mine: dict[_Key, _Delay], theirs: dict[_Key, _Delay]) -> None:
    for key, delay in theirs.items():
        found = mine.setdefault(key, _Delay(delay.cob_id, delay.sender))
        found.add(delay)


def _row(bus: str, delay: _Delay) -> DelayRow:
    return DelayRow(
        bus,
        delay.cob_id,
        delay.sender.node if delay.sender.node > MASTER else None,
        delay.sender.service,
        delay.frames,
        delay.delayed,
        delay.ns / 1000,
        delay.worst_ns / 1000,
        delay.worst_cob_id,
        delay.worst_seq,
    )
