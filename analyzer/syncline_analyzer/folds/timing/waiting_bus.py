"""A block of one bus for the analysis of waiting: arbitration, and what went ahead of frames."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.senders import Sender, Senders
from syncline_analyzer.folds.timing.waiting import MASTER, UNKNOWN, Arbitration, Ready
from syncline_analyzer.results import Ahead
from syncline_schemas.batch import FrameFlag

_AT_ONCE = 1 << 13
"""Frames whose waiting is laid out at a time."""
_SHORT_KEYS = 1 << 12
_REMOTE_KEY = 1 << 29
_EXTENDED_KEY = 1 << 30
_NO_SERVICE = np.uint16(FrameFlag.EXTENDED | FrameFlag.ERROR | FrameFlag.REMOTE | FrameFlag.FD)

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """The frames of one bus in order of arrival, as far as arbitration is concerned.

    Attributes:
        seq: (n,) position in the capture.
        t_ns, can_id, flags: (n,) as in a frame batch.
        wire_ns: (n,) time on the wire with intermission, NaN where it is not known.
        rank: (n,) place in the arbitration.
        sender: (n,) node, or `MASTER`, or `UNKNOWN`.
    """

    seq: Ints
    t_ns: Ints
    can_id: NDArray[np.uint32]
    flags: NDArray[np.uint16]
    wire_ns: Floats
    rank: Ints
    sender: NDArray[np.int16]

    def after(self, before: "Carried | None") -> "Carried":
        """These frames behind others."""
        if before is None:
            return self
        joined = (
            np.concatenate((getattr(before, f.name), getattr(self, f.name))) for f in fields(self)
        )
        return Carried(*joined)

    def last(self, count: int) -> "Carried":
        """The last ones."""
        return Carried(*(getattr(self, f.name)[-count:].copy() for f in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class Blame:
    """Time that frames waited for those ahead of them.

    Attributes:
        waited: (v,) which of the frames waited.
        rows: (v,) their rows.
        victim: (a,) of each frame ahead, which of these it kept waiting; ascending.
        place: (a,) its identifier in the order of `BusBlock.keys`.
        ns: (a,) its time on the wire.
    """

    waited: Ints
    rows: Ints
    victim: Ints
    place: NDArray[np.intp]
    ns: Floats


@dataclass(eq=False)
class BusBlock:
    """The frames of a block on one bus, behind some of those before it, and their arbitration."""

    bus: int
    carried: Carried
    arbitration: Arbitration
    senders: Senders
    _identities: dict[int, tuple[int, Sender]] = field(default_factory=dict)

    @property
    def seq(self) -> Ints:
        """(n,) position in the capture."""
        return self.carried.seq

    @property
    def t_ns(self) -> Ints:
        """(n,) stamps."""
        return self.carried.t_ns

    @property
    def wire_ns(self) -> Floats:
        """(n,) time on the wire with intermission, NaN where it is not known."""
        return self.carried.wire_ns

    def rows(self, seq: Ints) -> Ints:
        """Rows of frames by their `seq`, -1 for those before the first one that is here."""
        first = int(self.seq[0])
        whole = int(self.seq[-1]) - first == len(self.seq) - 1
        place = seq - first if whole else np.searchsorted(self.seq, seq)
        found: Ints = np.where(seq >= first, place, -1)
        return found

    @cached_property
    def _ahead_ns(self) -> Floats:
        """(n,) how long each frame keeps others waiting; nothing where that is not known."""
        return np.nan_to_num(self.wire_ns)

    @cached_property
    def _frame(self) -> Bools:
        """(n,) False for errors."""
        frame: Bools = (self.carried.flags & FrameFlag.ERROR) == 0
        return frame

    @cached_property
    def _errors(self) -> bool:
        return not bool(self._frame.all())

    def idle_at(self, t_ns: Floats) -> Bools:
        """(r,) whether no frame was on the bus at each moment, as far as these frames show."""
        ends = self.t_ns - self.t_ns[0]
        place = np.searchsorted(ends, t_ns - self.t_ns[0])
        known = place < len(ends)
        place = np.minimum(place, len(ends) - 1)
        idle: Bools = known & (self.arbitration.start_ns[place] > t_ns - self.t_ns[0])
        return idle

    def sends_between(self, sender: int, first: Ints, stop: Ints) -> Bools:
        """(r,) whether a sender has frames from row `first` to before `stop`."""
        own = np.flatnonzero(self.carried.sender == sender)
        found: Bools = np.searchsorted(own, stop) > np.searchsorted(own, first)
        return found

    def last_sdo_ns(self, node: int, rows: Ints) -> Ints:
        """(r,) stamp of the last SDO frame with a node before each row, the smallest without any.

        Only by the predefined identifiers (CiA 301 7.3.5).
        """
        every, whose = self._sdo
        sdo = every[whose == node]
        if not len(sdo):
            return np.full(len(rows), np.iinfo(np.int64).min)
        place = np.searchsorted(sdo, rows) - 1
        return np.where(place >= 0, self.t_ns[sdo[place]], np.iinfo(np.int64).min)

    @cached_property
    def _sdo(self) -> tuple[NDArray[np.intp], Ints]:
        """(s,) rows of the SDO frames, and (s,) the node of each."""
        can_id = self.carried.can_id
        chosen = (can_id > 0x580) & (can_id < 0x680) & ((self.carried.flags & _NO_SERVICE) == 0)
        rows = np.flatnonzero(chosen)
        return rows, (can_id[rows] & 0x7F).astype(np.int64)

    @cached_property
    def _identified(self) -> tuple[Ints, NDArray[np.intp]]:
        """(b,) keys and (n,) the place of each frame's key among them."""
        flags = self.carried.flags
        remote = ((flags & FrameFlag.REMOTE) != 0).astype(np.int64)
        key = self.carried.can_id.astype(np.int64) & 0x7FF | remote << 11
        wide = np.flatnonzero((flags & FrameFlag.EXTENDED) != 0)
        key[wide] = _SHORT_KEYS
        seen = np.bincount(key, minlength=_SHORT_KEYS + 1)[:_SHORT_KEYS]
        short = np.flatnonzero(seen)
        table = np.zeros(_SHORT_KEYS + 1, np.intp)
        table[short] = np.arange(len(short))
        place = table[key]
        long = self.carried.can_id[wide] | remote[wide] << 29 | _EXTENDED_KEY
        others, places = np.unique(long, return_inverse=True)
        place[wide] = len(short) + places
        keys = (short & 0x7FF) | (short >> 11) << 29
        return np.concatenate((keys, others)).astype(np.int64), place

    @property
    def keys(self) -> Ints:
        """(b,) every identifier of the bus with its kind, see `sender_of`."""
        return self._identified[0]

    @cached_property
    def key_sender(self) -> NDArray[np.int16]:
        """(b,) sender of each."""
        sender = np.zeros(len(self.keys), np.int16)
        sender[self._identified[1]] = self.carried.sender
        return sender

    @cached_property
    def names(self) -> list[tuple[int, int]]:
        """(key, sender) of each."""
        return list(zip(self.keys.tolist(), self.key_sender.tolist(), strict=True))

    @cached_property
    def senders_by_key(self) -> tuple[NDArray[np.int16], NDArray[np.intp]]:
        """(s,) every sender, ascending, and (b,) the place of that of each key among them."""
        return np.unique(self.key_sender, return_inverse=True)

    def identity(self, at: int) -> tuple[int, Sender]:
        """Identifier and sender of the frames of `keys[at]`."""
        if at not in self._identities:
            self._identities[at] = self._identity(at)
        return self._identities[at]

    def named(self, at: int) -> Ahead:
        """The same without any frames yet."""
        can_id, sender = self.identity(at)
        return Ahead(
            can_id, sender.node if sender.node > MASTER else None, sender.service, 0, 0, []
        )

    def _identity(self, at: int) -> tuple[int, Sender]:
        key = int(self.keys[at])
        return key & (_REMOTE_KEY - 1), sender_of(self.senders, self.bus, key, int(self.seq[-1]))

    def ahead(self, first: int, row: int, most: int) -> list[Ahead]:
        """The frames from `first` to before `row` by identifier, the longest first; no errors."""
        columns = [each[first:row] for each in (self._identified[1], self._ahead_ns, self.seq)]
        if self._errors:
            columns = [each[self._frame[first:row]] for each in columns]
        by_place: dict[int, tuple[list[float], list[int]]] = {}
        for place, ns, seq in zip(*(column.tolist() for column in columns), strict=True):
            if place not in by_place:
                by_place[place] = [], []
            by_place[place][0].append(ns)
            by_place[place][1].append(seq)
        found = []
        for place, (times, seqs) in by_place.items():
            us = sum(times) / 1000
            found.append(replace(self.named(place), frames=len(times), us=us, seq=seqs[:most]))
        return sorted(found, key=lambda each: -each.us)

    def blame(self, rows: Ints, ready: Ready) -> Iterator[Blame]:
        """What the frames waited for, a part of them at a time; nothing of those that did not."""
        waited = np.flatnonzero((ready.first < rows) & (ready.first >= 0) & ready.known)
        for at in range(0, len(waited), _AT_ONCE):
            part = waited[at : at + _AT_ONCE]
            victim, ahead = _ahead(ready.first[part], rows[part])
            if self._errors:
                sent = self._frame[ahead]
                victim, ahead = victim[sent], ahead[sent]
            place = self._identified[1][ahead]
            yield Blame(part, rows[part], victim, place, self._ahead_ns[ahead])


def _ahead(first: Ints, stop: Ints) -> tuple[Ints, Ints]:
    """(victim, row) for every row from `first` to before `stop` of each victim.

    >>> [each.tolist() for each in _ahead(np.array([1, 4]), np.array([3, 5]))]
    [[0, 0, 1], [1, 2, 4]]
    """
    count = stop - first
    victim = np.repeat(np.arange(len(first)), count)
    before = np.cumsum(count) - count
    row = np.arange(int(count.sum())) - np.repeat(before - first, count)
    return victim, row


def sender_of(senders: Senders, bus: int, key: int, seq: int | None = None) -> Sender:
    """Sender of a key of `BusBlock.keys` as of `seq`, by default in the end."""
    if key & _EXTENDED_KEY:
        return Sender(UNKNOWN, "29-bit")
    return senders.of(bus, key & (_REMOTE_KEY - 1), seq, remote=bool(key & _REMOTE_KEY))
