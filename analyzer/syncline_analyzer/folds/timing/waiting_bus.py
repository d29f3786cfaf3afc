"""A block of one bus for the analysis of waiting: arbitration, and what went ahead of frames."""

from collections.abc import Iterator, Mapping
from dataclasses import field, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.senders import Sender, Senders
from syncline_analyzer.folds.timing.waiting import MASTER, UNKNOWN, Arbitration, Ready
from syncline_analyzer.results import Ahead
from syncline_schemas import native
from syncline_schemas.batch import FrameFlag
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

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
    rank: NDArray[np.uint32]
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


class Span(NamedTuple):
    """Frames ahead of one; all (a,).

    Attributes:
        names: by their places.
        places: of their identifiers, in the order of `BusBlock.keys`.
        ns: their times on the wire.
        seq: their positions in the capture.
    """

    names: dict[int, Ahead]
    places: NDArray[np.intp]
    ns: Floats
    seq: Ints

    def ahead(self, most: int) -> list[Ahead]:
        """The frames by identifier, the longest first, with so many positions `most`."""
        by_place: dict[int, tuple[list[float], list[int]]] = {}
        columns = self.places.tolist(), self.ns.tolist(), self.seq.tolist()
        for place, ns, seq in zip(*columns, strict=True):
            times, seqs = by_place.setdefault(place, ([], []))
            times.append(ns)
            seqs.append(seq)
        found = []
        for place, (times, seqs) in by_place.items():
            name, us = self.names[place], sum(times) / 1000
            found.append(Ahead(name.cob_id, name.node, name.service, len(times), us, seqs[:most]))
        return sorted(found, key=lambda each: -each.us)


@dataclass(eq=False)
class BusBlock:
    """The frames of a block on one bus, behind some of those before it, and their arbitration."""

    bus: int
    carried: Carried
    arbitration: Arbitration
    senders: Senders
    told: Mapping[tuple[int, bool], Sender]
    """Senders of the identifiers of the block itself."""
    shift: int | None = None
    """So many rows further on than in the block stands each frame; None where some are left out."""
    _identities: dict[int, tuple[int, Sender]] = field(default_factory=dict)
    _named: dict[int, Ahead] = field(default_factory=dict)

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
        found: Ints = seq - first if whole else np.searchsorted(self.seq, seq)
        if int(np.minimum.reduce(seq, initial=first)) < first:
            found[seq < first] = -1
        return found

    @cached_property
    def ahead_ns(self) -> Floats:
        """(n,) how long each frame keeps others waiting; nothing where that is not known."""
        return np.where(np.isnan(self.wire_ns), 0.0, self.wire_ns)

    @cached_property
    def _frame(self) -> Bools:
        """(n,) False for errors."""
        frame: Bools = (self.carried.flags & FrameFlag.ERROR) == 0
        return frame

    @cached_property
    def _errors(self) -> bool:
        return bool(np.bitwise_or.reduce(self.carried.flags, initial=0) & FrameFlag.ERROR)

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

    def sdo_since(self, node: int, rows: Ints, since_ns: Ints) -> Bools:
        """(r,) whether the last SDO frame with a node before each row came from a moment on.

        Only by the predefined identifiers (CiA 301 7.3.5).
        """
        every, whose = self._sdo
        sdo = every[whose == node]
        stamps = self.t_ns.take(sdo)
        if native.available():
            return native.marked(rows, since_ns, sdo, stamps)
        # The stamp of each holds for the rows from the first one behind it on.
        behind = np.searchsorted(rows, sdo, "right")
        stamps = np.append(np.iinfo(np.int64).min, stamps)
        last: Ints = np.repeat(stamps, np.diff(behind, prepend=0, append=len(rows)))
        return last >= since_ns

    @cached_property
    def sdo_nodes(self) -> set[int]:
        """Nodes with SDO traffic."""
        return set(np.flatnonzero(np.bincount(self._sdo[1])).tolist())

    @cached_property
    def _sdo(self) -> tuple[NDArray[np.intp], Ints]:
        """(s,) rows of the SDO frames, and (s,) the node of each."""
        can_id = self.carried.can_id
        chosen = (can_id > 0x580) & (can_id < 0x680) & ((self.carried.flags & _NO_SERVICE) == 0)
        rows = np.flatnonzero(chosen)
        return rows, (can_id[rows] & 0x7F).astype(np.int64)

    @cached_property
    def _identified(self) -> tuple[Ints, NDArray[np.int16], NDArray[np.intp]]:
        """(b,) keys, (b,) the sender of the last frame of each, (n,) the place of each frame's."""
        can_id, flags, sender = self.carried.can_id, self.carried.flags, self.carried.sender
        if native.available():
            found = native.short_keys(can_id, flags, sender)
            if found is not None:
                return found
        keys, place = _keyed(can_id, flags)
        senders = np.zeros(len(keys), np.int16)
        senders[place] = sender
        return keys, senders, place

    @property
    def keys(self) -> Ints:
        """(b,) every identifier of the bus with its kind, see `sender_of`."""
        return self._identified[0]

    @property
    def key_sender(self) -> NDArray[np.int16]:
        """(b,) sender of each."""
        return self._identified[1]

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
        can_id = key & (_REMOTE_KEY - 1)
        told = self.told.get((can_id, bool(key & _REMOTE_KEY))) if key < _EXTENDED_KEY else None
        return can_id, told or sender_of(self.senders, self.bus, key, int(self.seq[-1]))

    def span(self, first: int, row: int) -> "Span":
        """The frames from `first` to before `row`, without errors."""
        rows = np.arange(first, row)
        if self._errors:
            rows = rows[self._frame[first:row]]
        places = self._identified[2].take(rows)
        for at in places.tolist():
            if at not in self._named:
                self._named[at] = self.named(at)
        return Span(self._named, places, self.ahead_ns.take(rows), self.seq.take(rows))

    @cached_property
    def places(self) -> NDArray[np.intp]:
        """(n,) place of each frame's key among `keys`, behind all of them for errors."""
        place = self._identified[2]
        return np.where(self._frame, place, len(self.keys)) if self._errors else place

    def same_sender_within(self, first: Ints, stop: Ints) -> Bools:
        """(v,) whether any sender has two frames from row `first` to before `stop`."""
        found: Bools = self._same_sender.take(stop - 1) >= first
        return found

    def same_key_within(self, first: Ints, stop: Ints) -> Bools:
        """(v,) the same of identifiers."""
        found: Bools = self._same_key.take(stop - 1) >= first
        return found

    @cached_property
    def _same_sender(self) -> Ints:
        return _last_pair(self.carried.sender.view(np.uint16))

    @cached_property
    def _same_key(self) -> Ints:
        return _last_pair(self.places)

    def blame(self, rows: Ints, ready: Ready, late: Bools) -> Iterator[Blame]:
        """What the late frames waited for, a part of them at a time; nothing of those that did not."""
        waited = np.flatnonzero((ready.first < rows) & (ready.first >= 0) & ready.known & late)
        for at in range(0, len(waited), _AT_ONCE):
            part = waited[at : at + _AT_ONCE]
            count, ahead = laid_out(ready.first[part], rows[part])
            victim = np.repeat(np.arange(len(part)), count)
            if self._errors:
                sent = self._frame[ahead]
                victim, ahead = victim[sent], ahead[sent]
            place = self._identified[2][ahead]
            yield Blame(part, rows[part], victim, place, self.ahead_ns[ahead])


def _keyed(can_id: NDArray[np.uint32], flags: NDArray[np.uint16]) -> tuple[Ints, NDArray[np.intp]]:
    """(b,) keys of frames, and (n,) the place of each frame's among them."""
    remote = ((flags & FrameFlag.REMOTE) != 0).astype(np.int64)
    key = can_id.astype(np.int64) & 0x7FF | remote << 11
    wide = np.flatnonzero((flags & FrameFlag.EXTENDED) != 0)
    key[wide] = _SHORT_KEYS
    seen = np.bincount(key, minlength=_SHORT_KEYS + 1)[:_SHORT_KEYS]
    short = np.flatnonzero(seen)
    table = np.zeros(_SHORT_KEYS + 1, np.intp)
    table[short] = np.arange(len(short))
    place = table[key]
    long = can_id[wide] | remote[wide] << 29 | _EXTENDED_KEY
    others, places = np.unique(long, return_inverse=True)
    place[wide] = len(short) + places
    keys = (short & 0x7FF) | (short >> 11) << 29
    return np.concatenate((keys, others)).astype(np.int64), place


def laid_out(first: Ints, stop: Ints) -> tuple[Ints, Ints]:
    """How many rows lie from `first` to before each `stop`, at least one, and all of these.

    >>> [each.tolist() for each in laid_out(np.array([1, 4]), np.array([3, 5]))]
    [[2, 1], [1, 2, 4]]
    """
    count = stop - first
    ends = np.cumsum(count)
    steps = np.ones(int(ends[-1]) if len(ends) else 0, np.int64)
    if len(ends):
        steps[0] = first[0]
        steps[ends[:-1]] = first[1:] - stop[:-1] + 1
    return count, np.cumsum(steps, out=steps)


def _last_pair(group: NDArray[np.integer[Any]]) -> Ints:
    """(n,) the latest row up to each one that another one of its group follows, -1 without any."""
    # Numbers of 16 bits are sorted in linear time.
    small = int(group.max(initial=0)) < 1 << 16
    group = group.astype(np.uint16) if small else group
    order = np.argsort(group, kind="stable")
    ordered = group.take(order)
    before = np.empty(len(group), np.int64)
    before[order[:1]] = -1
    before[order[1:]] = np.where(ordered[1:] == ordered[:-1], order[:-1], -1)
    return np.maximum.accumulate(before, out=before)


def sender_of(senders: Senders, bus: int, key: int, seq: int | None = None) -> Sender:
    """Sender of a key of `BusBlock.keys` as of `seq`, by default in the end."""
    if key & _EXTENDED_KEY:
        return Sender(UNKNOWN, "29-bit")
    return senders.of(bus, key & (_REMOTE_KEY - 1), seq, remote=bool(key & _REMOTE_KEY))
