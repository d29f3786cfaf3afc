"""What the PDOs of one bus waited for, summed up block by block for all of them at once."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.delays import MAX_IDS, Delay, Delays
from syncline_analyzer.folds.timing.senders import Sender
from syncline_analyzer.folds.timing.waiting import UNKNOWN, Asked, Ready
from syncline_analyzer.folds.timing.waiting_bus import Bools, BusBlock, Floats, Ints, laid_out
from syncline_schemas import native
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

_AT_ONCE = 1 << 12
"""Answers whose waiting is laid out at a time."""
_NEVER = np.iinfo(np.int64).max

Places = NDArray[np.intp]


class Victims(NamedTuple):
    """Answers that waited, in order; all (v,).

    Attributes:
        pdo: number of the PDO of each.
        rows: their rows.
        first: rows of the first frames that they waited for.
    """

    pdo: Ints
    rows: Ints
    first: Ints

    def chosen(self, which: slice | Places) -> "Victims":
        """Some of them."""
        return Victims(self.pdo[which], self.rows[which], self.first[which])

    def parts(self) -> Iterator["Victims"]:
        """All of them, a part at a time."""
        for at in range(0, len(self.rows), _AT_ONCE):
            yield self.chosen(slice(at, at + _AT_ONCE))


@dataclass(slots=True)
class _Cells:
    """Sums by PDO and what was ahead of it: (p, g) of frames, of answers, and times [ns]."""

    frames: Ints
    delayed: Ints
    ns: Floats
    worst_ns: Floats
    worst_seq: Ints

    @classmethod
    def empty(cls, pdos: int, groups: int) -> "_Cells":
        frames, delayed, worst_seq = np.zeros((3, pdos, groups), np.int64)
        ns, worst_ns = np.zeros((2, pdos, groups))
        return cls(frames, delayed, ns, worst_ns, worst_seq)

    def grown(self, pdos: int, groups: int) -> "_Cells":
        """The same with room for more."""
        if self.frames.shape == (pdos, groups):
            return self
        grown = _Cells.empty(pdos, groups)
        grown.add(np.arange(self.frames.shape[0]), np.arange(self.frames.shape[1]), self)
        return grown

    def add(self, pdos: Ints, groups: Ints, more: "_Cells") -> None:
        """Add up later cells at these rows and columns."""
        place = np.ix_(pdos, groups)
        self.frames[place] += more.frames
        self.delayed[place] += more.delayed
        self.ns[place] += more.ns
        worse = more.worst_ns > self.worst_ns[place]
        self.worst_ns[place] = np.where(worse, more.worst_ns, self.worst_ns[place])
        self.worst_seq[place] = np.where(worse, more.worst_seq, self.worst_seq[place])

    def columns(self, chosen: Places) -> "_Cells":
        """Some of the groups."""
        return _Cells(
            self.frames[:, chosen],
            self.delayed[:, chosen],
            self.ns[:, chosen],
            self.worst_ns[:, chosen],
            self.worst_seq[:, chosen],
        )

    def without(self, cells: Bools) -> "_Cells":
        """The same with nothing in some of the cells."""
        kept = ~cells
        return _Cells(
            self.frames * kept,
            self.delayed * kept,
            self.ns * kept,
            self.worst_ns * kept,
            self.worst_seq * kept,
        )

    def single(self) -> "_Cells":
        """The same as if no answer had waited for several frames of a group."""
        return replace(self, delayed=self.frames)

    def joined(self, group: Places, groups: int) -> "_Cells":
        """The sums of larger groups: (g,) `group` of each column; every one has some."""
        order = np.argsort(group, kind="stable")
        starts = np.searchsorted(group[order], np.arange(groups))
        frames, delayed, ns, worst_ns = (
            how.reduceat(column[:, order], starts, axis=1)
            for how, column in (
                (np.add, self.frames),
                (np.add, self.delayed),
                (np.add, self.ns),
                (np.maximum, self.worst_ns),
            )
        )
        first = np.where(self.worst_ns == worst_ns[:, group], self.worst_seq, _NEVER)
        worst_seq = np.minimum.reduceat(first[:, order], starts, axis=1)
        return _Cells(frames, delayed, ns, worst_ns, worst_seq)

    def note_worst(self, ns: Floats, seq: Ints) -> None:
        """Take in more worst cases (p, g); of equal ones the earliest stays."""
        worse = (ns > self.worst_ns) | ((ns == self.worst_ns) & (seq < self.worst_seq))
        self.worst_ns[worse], self.worst_seq[worse] = ns[worse], seq[worse]


class DelaySums:
    """The sums by PDO and identifier ahead of it, and by PDO and sender."""

    def __init__(self) -> None:
        self._pdos: dict[int, int] = {}
        self._keys: dict[tuple[int, int], int] = {}
        self._named: list[tuple[int, Sender]] = []
        self._senders: dict[int, int] = {}
        self._by_key, self._by_sender = _Cells.empty(0, 0), _Cells.empty(0, 0)

    def add(self, block: BusBlock, cob_ids: Sequence[int], asked: Asked, ready: Ready) -> None:
        """Take in the answers of a block.

        Args:
            block: its frames.
            cob_ids: identifiers of the PDOs by their numbers. Frames of their own senders delay
                nobody.
            asked, ready: the answers.
        """
        found = (
            _compiled(block, asked, ready) if native.available() else _plain(block, asked, ready)
        )
        if found is None:
            return
        keys, sums = found
        senders, sender = block.senders_by_key[0], asked.senders[:, None]
        keys = keys.without(block.key_sender == sender)
        sums = sums.without((senders == sender) | (senders == UNKNOWN))
        pdos = np.array([self._pdos.setdefault(each, len(self._pdos)) for each in cob_ids])
        ahead, columns = self._columns(block, keys)
        self._by_key = self._by_key.grown(len(self._pdos), len(self._keys))
        self._by_key.add(pdos, columns, keys.columns(ahead))
        ahead = np.flatnonzero(sums.frames.any(axis=0))
        nodes = senders[ahead].tolist()
        columns = np.array([self._senders.setdefault(n, len(self._senders)) for n in nodes], int)
        self._by_sender = self._by_sender.grown(len(self._pdos), len(self._senders))
        self._by_sender.add(pdos, columns, sums.columns(ahead))

    def of(self, cob_id: int) -> Delays:
        """The sums of one PDO."""
        found = Delays()
        pdo = self._pdos.get(cob_id)
        if pdo is None:
            return found
        for key, at in self._keys.items():
            if self._by_key.frames[pdo, at]:
                found.by_key[key] = _delay(self._by_key, pdo, at, cob_id, *self._named[at])
        for node, at in self._senders.items():
            if self._by_sender.frames[pdo, at]:
                sender = Sender(node, "all")
                found.by_sender[node] = _delay(self._by_sender, pdo, at, cob_id, None, sender)
        return found

    def _columns(self, block: BusBlock, cells: _Cells) -> tuple[Places, Ints]:
        """Keys of a block that were ahead of any PDO, by their places, and their columns."""
        places, columns = [], []
        for at in np.flatnonzero(cells.frames.any(axis=0)).tolist():
            name = block.names[at]
            if name not in self._keys:
                if len(self._keys) >= MAX_IDS:
                    continue
                self._keys[name] = len(self._keys)
                self._named.append(block.identity(at))
            places.append(at)
            columns.append(self._keys[name])
        return np.array(places, np.intp), np.array(columns, np.int64)


def _delay(
    cells: _Cells, pdo: int, at: int, pdo_id: int, cob_id: int | None, sender: Sender
) -> Delay:
    return Delay(
        cob_id,
        sender,
        int(cells.frames[pdo, at]),
        int(cells.delayed[pdo, at]),
        float(cells.ns[pdo, at]),
        float(cells.worst_ns[pdo, at]),
        pdo_id,
        int(cells.worst_seq[pdo, at]),
    )


def _compiled(block: BusBlock, asked: Asked, ready: Ready) -> tuple[_Cells, _Cells] | None:
    """What they waited for by identifier and by sender, None where none of them did."""
    senders, of_key = block.senders_by_key
    sums = native.delays(
        (block.places, block.wire_ns, block.carried.sender, block.seq),
        of_key,
        len(senders),
        asked.starts,
        (asked.rows, ready.first, ready.known),
        _AT_ONCE,
    )
    if not sums.waited:
        return None
    delayed = sums.frames - sums.again
    keys = _Cells(sums.frames, delayed, sums.ns, sums.worst_ns, sums.worst_seq)
    cells = keys.single().joined(of_key, len(senders))
    cells.delayed -= sums.group_again
    cells.note_worst(sums.group_worst_ns, sums.group_worst_seq)
    return keys, cells


def _plain(block: BusBlock, asked: Asked, ready: Ready) -> tuple[_Cells, _Cells] | None:
    """The same by numpy."""
    waited = np.flatnonzero((ready.first < asked.rows) & (ready.first >= 0) & ready.known)
    if not len(waited):
        return None
    # In order of arrival, what they waited for lies close together.
    waited = waited.take(np.argsort(asked.rows.take(waited), kind="stable"))
    pdo = asked.each(np.arange(len(asked.starts)))
    victims = Victims(pdo.take(waited), asked.rows.take(waited), ready.first.take(waited))
    several = block.same_sender_within(victims.first, victims.rows)
    again = victims.chosen(np.flatnonzero(several))
    keys = _by_key(block, len(asked.starts), victims, again)
    return keys, _by_sender(block, keys, again)


def _by_key(block: BusBlock, pdos: int, victims: Victims, again: Victims) -> _Cells:
    """What they waited for by identifier, in the order of `BusBlock.keys`.

    `again` are those that waited for several frames of a sender.
    """
    groups = len(block.keys) + 1
    frames, ns = np.zeros(pdos * groups, np.int64), np.zeros(pdos * groups)
    worst_ns, worst_seq = np.zeros(pdos * groups), np.full(pdos * groups, _NEVER)
    for part in victims.parts():
        count, ahead = laid_out(part.first, part.rows)
        cell = np.repeat(part.pdo * groups, count)
        cell += block.places.take(ahead)
        took = block.ahead_ns.take(ahead)
        frames += np.bincount(cell, minlength=len(frames))
        ns += np.bincount(cell, took, minlength=len(frames))
        worse = np.flatnonzero(took > worst_ns.take(cell))
        if len(worse):
            cell, took = cell[worse], took[worse]
            np.maximum.at(worst_ns, cell, took)
            worst = np.flatnonzero(took == worst_ns.take(cell))[::-1]
            victim = np.searchsorted(np.cumsum(count), worse[worst], "right")
            # The first one of a cell is the last that is written.
            worst_seq[cell[worst]] = block.seq[part.rows[victim]]
    # The last column is that of errors.
    shape, kept = (pdos, groups), np.s_[:, :-1]
    cells = _Cells(
        frames.reshape(shape)[kept],
        frames.reshape(shape)[kept].copy(),
        ns.reshape(shape)[kept],
        worst_ns.reshape(shape)[kept],
        worst_seq.reshape(shape)[kept],
    )
    if len(again.rows):
        same = block.same_key_within(again.first, again.rows)
        _join_again(block, cells, block.places, again.chosen(np.flatnonzero(same)))
    return cells


def _by_sender(block: BusBlock, keys: _Cells, again: Victims) -> _Cells:
    """The same by sender, in the order of `BusBlock.senders_by_key`."""
    senders, of_key = block.senders_by_key
    cells = keys.single().joined(of_key, len(senders))
    if len(again.rows):
        place = np.append(of_key, len(senders)).take(block.places)
        _join_again(block, cells, place, again)
    return cells


def _join_again(block: BusBlock, cells: _Cells, place: Places, victims: Victims) -> None:
    """Count answers once that waited for several frames of a group, and add these frames up."""
    pdos, groups = cells.frames.shape
    for part in victims.chosen(np.argsort(victims.pdo, kind="stable")).parts():
        count, ahead = laid_out(part.first, part.rows)
        cell = np.repeat(np.arange(len(count)) * (groups + 1), count)
        cell += place.take(ahead)
        shape, size = (len(count), groups + 1), len(count) * (groups + 1)
        frames = np.bincount(cell, minlength=size).reshape(shape)[:, :-1]
        ns = np.bincount(cell, block.ahead_ns.take(ahead), minlength=size).reshape(shape)[:, :-1]
        starts = np.flatnonzero(np.diff(part.pdo, prepend=-1))
        pdo = part.pdo[starts]
        cells.delayed[pdo] -= np.add.reduceat(np.maximum(frames - 1, 0), starts, axis=0)
        most = np.maximum.reduceat(ns, starts, axis=0)
        earlier = cells.worst_seq[pdo] > block.seq[part.rows[starts]][:, None]
        more = most > cells.worst_ns[pdo]
        if (more | (earlier & (most == cells.worst_ns[pdo]) & (most > 0))).any():
            which = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(count))))
            seq = np.where(ns == most[which], block.seq[part.rows][:, None], _NEVER)
            worst_ns, worst_seq = np.zeros((pdos, groups)), np.full((pdos, groups), _NEVER)
            worst_ns[pdo], worst_seq[pdo] = most, np.minimum.reduceat(seq, starts, axis=0)
            cells.note_worst(worst_ns, worst_seq)
