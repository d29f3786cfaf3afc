"""Who delayed whom: the time that synchronous PDOs waited, by the frames ahead of them."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from syncline_analyzer.folds.timing.senders import Sender
from syncline_analyzer.folds.timing.waiting import MASTER, UNKNOWN
from syncline_analyzer.results import DelayRow
from syncline_schemas.records import dataclass

_Key = TypeVar("_Key")

MAX_IDS = 1024
"""Identifiers ahead of the PDOs of one bus that are followed one by one."""


@dataclass(slots=True)
class Delay:
    """What answers waited for one identifier, or for all of a sender (`cob_id` None)."""

    cob_id: int | None
    sender: Sender
    frames: int = 0
    delayed: int = 0
    ns: float = 0.0
    worst_ns: float = 0.0
    worst_cob_id: int = 0
    worst_seq: int = 0

    def add(self, more: "Delay") -> None:
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
        self.by_key: dict[tuple[int, int], Delay] = {}
        """By key of `BusBlock.keys` and its sender."""
        self.by_sender: dict[int, Delay] = {}

    def told(self, sender_of: Callable[[int], Sender], own: int) -> "Delays":
        """The sums by what is known in the end; frames that prove to be the PDO's own left out.

        Args:
            sender_of: sender of a key, see `BusBlock.keys`.
            own: sender of the PDO itself.
        """
        told = Delays()
        moved: set[int] = set()
        for (key, before), delay in self.by_key.items():
            sender = sender_of(key)
            if sender.node != before:
                moved |= {before, sender.node}
            if sender.node != own or own == UNKNOWN:
                known = replace(delay, sender=sender)
                _join(told.by_key, {(key, sender.node): known})
        for node, delay in self.by_sender.items():
            if node not in moved:
                told.by_sender[node] = delay
        for (_, node), delay in told.by_key.items():
            if node in moved - {UNKNOWN}:
                # How many answers waited for several of its identifiers is not known: the least.
                whole = told.by_sender.setdefault(node, Delay(None, Sender(node, "all")))
                delayed = max(whole.delayed, delay.delayed)
                whole.add(delay)
                whole.delayed = delayed
        return told

    def join(self, other: "Delays") -> None:
        """Take in the sums of another PDO."""
        _join(self.by_key, other.by_key)
        _join(self.by_sender, other.by_sender)

    def rows(self, bus: str) -> list[DelayRow]:
        """One row per sender and one per identifier, those that were waited for longest first."""
        delays = [*self.by_sender.values(), *self.by_key.values()]
        rows = [_row(bus, delay) for delay in delays]
        return sorted(rows, key=lambda row: (row.cob_id is not None, -row.us))


def _join(mine: dict[_Key, Delay], theirs: dict[_Key, Delay]) -> None:
    for key, delay in theirs.items():
        found = mine.setdefault(key, Delay(delay.cob_id, delay.sender))
        found.add(delay)


def _row(bus: str, delay: Delay) -> DelayRow:
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
