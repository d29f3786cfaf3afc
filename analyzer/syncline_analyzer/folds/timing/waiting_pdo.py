"""What one synchronous PDO waited for, and whether bus or device made it late."""

import math
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distribution import Distribution
from syncline_analyzer.folds.timing.late_behind import LateBehind
from syncline_analyzer.folds.timing.waiting import Most, Ready
from syncline_analyzer.folds.timing.waiting_bus import Blame, BusBlock, Span
from syncline_analyzer.results import Ahead, LatenessRow, PdoRow, WaitRow
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

WORST = 10
MAX_EVIDENCE = 20
MAX_IDS = 256
"""Identifiers ahead of late answers that are followed one by one."""
MAX_UNANSWERED = 10_000
"""SYNCs without an answer of which it is kept when the bus was free."""
_ENOUGH = 20
"""Answers on an idle bus from which it is known how long the device takes."""
_CHANCE = 0.05
"""Risk that more slow answers of the device than allowed for all met a busy bus."""

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def _no_moments() -> Distribution:
    return Distribution(moments=False)


@dataclass(frozen=True, eq=False)
class Answers:
    """Answers of a PDO in one block of its bus.

    Attributes:
        rows: (r,) rows on the bus.
        sync_seq: (m,) `seq` of the SYNCs.
        position: (r,) of the one that each answers.
        response_ns: (r,) response.
        most_ns: (r,) the device took no longer than this.
        ready: when they can have been ready.
        beside_sdo: (r,) whether there was SDO traffic with the node; None for none at all.
        window_ns: 1007h, None where it is not known.
        own_ns: (r,) time on the wire without intermission; None without a window.
        shown: (r,) whether the bus was idle when the frame had to start to be in time: a device that
            was slower would have been seen. None without a window.
        most: of the whole of them.
    """

    rows: Ints
    sync_seq: Ints
    position: Ints
    response_ns: Ints
    most_ns: Floats
    ready: Ready
    beside_sdo: Bools | None
    window_ns: int | None
    own_ns: Floats | None
    shown: Bools | None
    most: Most

    @cached_property
    def late(self) -> Bools:
        """(r,) which answers of a known time are later than the window."""
        if self.window_ns is None:
            return np.zeros(len(self.rows), np.bool_)
        late: Bools = (self.response_ns > self.window_ns) & self.ready.known
        return late

    @cached_property
    def device_late(self) -> Bools:
        """(r,) whether an answer would have been late on an idle bus."""
        if self.window_ns is None or self.own_ns is None:
            return np.zeros(len(self.rows), np.bool_)
        late: Bools = self.ready.least_ns + self.own_ns > self.window_ns
        return late


@dataclass(slots=True)
class _Late:
    """Answers after the synchronous window."""

    count: int = 0
    by_device: int = 0
    by_device_beside_sdo: int = 0
    behind: LateBehind = field(default_factory=LateBehind)
    """In time without the frames of others ahead of them, as far as these show."""
    beside_sdo: int = 0
    seq: list[int] = field(default_factory=list)
    first_ns: int | None = None
    last_ns: int | None = None
    blockers: dict[tuple[int, int | None, str], Ahead] = field(default_factory=dict)


class _Worst(NamedTuple):
    """One of the worst answers, and the frames ahead of it."""

    row: WaitRow
    span: Span


@dataclass(slots=True)
class Waits:
    """A PDO from block to block."""

    bus: str
    cob_id: int
    least: Distribution = field(default_factory=_no_moments)
    waiting: Distribution = field(default_factory=_no_moments)
    free: Distribution = field(default_factory=_no_moments)
    beside_sdo: Distribution = field(default_factory=_no_moments)
    without_sdo: Distribution | None = None
    """None while there was no SDO traffic: then it is `least`."""
    waited: int = 0
    shown: int = 0
    """Answers at whose SYNCs a slow device would have been seen."""
    window_ns: int | None = None
    own_ns: float = 0.0
    """Longest frame."""
    most_ns: float = 0.0
    """Latest that it can have been ready when it answered, after the SYNC."""
    late: _Late = field(default_factory=_Late)
    unanswered: dict[int, float] = field(default_factory=dict)
    """By the `seq` of the SYNC: when the bus was last free for the PDO before the next one [ns]."""
    slowest: list[_Worst] = field(default_factory=list)
    longest: list[_Worst] = field(default_factory=list)

    def add(self, block: BusBlock, answers: Answers) -> None:
        """Take in the answers of a block."""
        ready, most = answers.ready, answers.most
        least_ns, waiting_ns, free = ready.least_ns, ready.waiting_ns, ready.free
        known = None
        if not ready.known.all():
            known = ready.known
            least_ns, waiting_ns, free = least_ns[known], waiting_ns[known], free[known]
        self._add_beside_sdo(answers.beside_sdo, known, least_ns)
        if len(least_ns):
            self.least.add(least_ns, most.least_ns)
            self.waiting.add(waiting_ns, most.waiting_ns)
        self.free.add(np.compress(free, least_ns))
        self.waited += most.waited
        if answers.shown is not None:
            self.shown += int(np.count_nonzero(ready.known & answers.shown))
        self.own_ns = max(self.own_ns, most.own_ns)
        self.most_ns = max(self.most_ns, most.most_ns)
        self.window_ns = answers.window_ns
        if answers.window_ns is not None:
            self._add_late(block, answers)
        self._add_worst(block, answers)

    def add_blame(self, block: BusBlock, blame: Blame, answers: Answers, sender: int) -> None:
        """Sum up what late answers waited for."""
        late = answers.late[blame.waited]
        if answers.window_ns is None or not late.any():
            return
        self._add_behind(block, blame, answers, late, sender)
        chosen = late[blame.victim]
        place = blame.place[chosen]
        ns = np.bincount(place, blame.ns[chosen]).astype(np.float64)
        self._add_blockers(block, ns, np.bincount(place))

    def _add_behind(
        self, block: BusBlock, blame: Blame, answers: Answers, late: Bools, sender: int
    ) -> None:
        """Sum up those late answers that the frames of others explain."""
        others = (block.key_sender != sender)[blame.place]
        others_ns = np.bincount(blame.victim, blame.ns * others, minlength=len(late))
        over_ns: Floats = answers.response_ns[blame.waited] - np.float64(answers.window_ns or 0)
        explained = late & (others_ns >= over_ns) & ~answers.device_late[blame.waited]
        chosen = np.flatnonzero(others & explained[blame.victim])
        number = np.cumsum(explained) - 1
        self.late.behind.add(
            over_ns[explained],
            number[blame.victim[chosen]],
            blame.place[chosen],
            blame.ns[chosen],
            block.named,
        )

    def _add_blockers(self, block: BusBlock, ns: Floats, frames: Ints) -> None:
        for at in np.flatnonzero(frames).tolist():
            name = block.named(at)
            key = (name.cob_id, name.node, name.service)
            count, us = int(frames[at]), float(ns[at]) / 1000
            old = self.late.blockers.get(key)
            if old is not None:
                count, us = old.frames + count, old.us + us
            if old is not None or len(self.late.blockers) < MAX_IDS:
                self.late.blockers[key] = replace(name, frames=count, us=us)

    def add_unanswered(self, sync_seq: Ints, free_ns: Floats) -> None:
        """Keep when the bus was last free for the PDO after SYNCs that it did not answer."""
        room = MAX_UNANSWERED - len(self.unanswered)
        self.unanswered.update(zip(sync_seq[:room].tolist(), free_ns[:room].tolist(), strict=True))

    def worst(self) -> list[WaitRow]:
        """The slowest answers and those that waited longest, in order of time."""
        found = {each.row.seq: each for each in [*self.slowest, *self.longest]}
        return [
            replace(found[seq].row, ahead=found[seq].span.ahead(MAX_EVIDENCE))
            for seq in sorted(found)
        ]

    def measured(self, pdo: PdoRow) -> PdoRow:
        """The row of the PDO with what arbitration tells of its device and its waiting."""
        return replace(
            pdo,
            device_us_least=self.least.quantiles(1000),
            device_us_free=self.free.quantiles(1000),
            waiting_us=self.waiting.quantiles(1000),
        )

    @property
    def late_behind(self) -> LateBehind:
        """The late answers that the frames of others explain."""
        return self.late.behind

    def row(self, pdo: PdoRow, missed_seq: Ints) -> LatenessRow:
        """The causes, given the SYNCs that were missed in the end."""
        missed = [seq for seq in missed_seq.tolist() if seq in self.unanswered]
        free_ns = np.array([self.unanswered[seq] for seq in missed], np.float64)
        by_device, by_bus = self._missed_by(free_ns)
        sure = np.flatnonzero(by_device | by_bus)[:MAX_EVIDENCE]
        late = self.late
        return LatenessRow(
            bus=self.bus,
            cob_id=self.cob_id,
            node=pdo.node,
            pdo=pdo.pdo,
            answers=self.least.count,
            waited=self.waited,
            free=self.free.count,
            window_us=None if self.window_ns is None else self.window_ns // 1000,
            late=late.count,
            late_by_device=late.by_device,
            late_by_bus=self._late_by_bus(),
            missed=pdo.missed,
            missed_by_device=int(np.count_nonzero(by_device)),
            missed_by_bus=int(np.count_nonzero(by_bus)),
            beside_sdo=self.beside_sdo.count,
            late_beside_sdo=late.beside_sdo,
            late_by_device_beside_sdo=late.by_device_beside_sdo,
            device_us_beside_sdo=self.beside_sdo.quantiles(1000),
            device_us_without_sdo=(self.without_sdo or self.least).quantiles(1000),
            blockers=sorted(late.blockers.values(), key=lambda each: -each.us),
            late_seq=late.seq,
            late_first_ns=late.first_ns,
            late_last_ns=late.last_ns,
            missed_seq=[missed[at] for at in sure.tolist()],
        )

    def _add_beside_sdo(self, beside: Bools | None, known: Bools | None, least_ns: Floats) -> None:
        """Tell the (k,) times of the answers that are `known` apart by SDO traffic beside them."""
        if beside is not None and known is not None:
            beside = beside[known]
        if beside is not None and not beside.any():
            beside = None
        if self.without_sdo is None and beside is not None:
            self.without_sdo = deepcopy(self.least)
        if self.without_sdo is None:
            return
        if beside is None:
            self.without_sdo.add(least_ns)
            return
        self.beside_sdo.add(least_ns[beside])
        self.without_sdo.add(least_ns[~beside])

    def _late_by_bus(self) -> int:
        """Late answers that were the bus's doing: none while the device may have been slow itself.

        It must have been in time whenever it found the bus idle, and that has to be no rare case.
        That a device was slow only when a busy bus would hide it is chance: as many answers as may
        be such ones are left out.
        """
        if self.late.by_device or self.window_ns is None or self.free.count < _ENOUGH:
            return 0
        if self.free.maximum + self.own_ns > self.window_ns:
            return 0
        idle = self.free.count if self.free.count >= self.late.count else 0
        hidden = 1 - max(self.shown, idle) / self.least.count
        if hidden in (0, 1):
            return 0 if hidden else self.late.behind.total
        return max(self.late.behind.total - int(math.log(_CHANCE) / math.log(hidden)), 0)

    def _missed_by(self, free_ns: Floats) -> tuple[Bools, Bools]:
        """(device, bus) which of the SYNCs that got no answer did so because of it.

        The device was not ready when the bus was free for its PDO, later than it ever was when it
        answered; or from the soonest that it gets ready on, the bus was never free for it.
        """
        by_device = free_ns > self.most_ns
        if self.free.count < _ENOUGH:
            return by_device, np.zeros(len(free_ns), np.bool_)
        return by_device, free_ns < self.free.quantile(0.01)

    def _add_late(self, block: BusBlock, answers: Answers) -> None:
        rows = np.flatnonzero(answers.late)
        if not len(rows):
            return
        late = self.late
        late.count += len(rows)
        by_device = answers.device_late[rows]
        late.by_device += int(np.count_nonzero(by_device))
        if answers.beside_sdo is not None:
            beside = answers.beside_sdo[rows]
            late.by_device_beside_sdo += int(np.count_nonzero(by_device & beside))
            late.beside_sdo += int(np.count_nonzero(beside))
        seq = block.seq[answers.rows[rows]]
        late.seq.extend(seq[: MAX_EVIDENCE - len(late.seq)].tolist())
        t_ns = block.t_ns[answers.rows[rows]]
        late.first_ns = int(t_ns[0]) if late.first_ns is None else late.first_ns
        late.last_ns = int(t_ns[-1])

    def _add_worst(self, block: BusBlock, answers: Answers) -> None:
        responses = answers.response_ns
        for column, most, kept, key in (
            (responses, np.maximum.reduce(responses), self.slowest, "response_us"),
            (answers.ready.waiting_ns, answers.most.waiting_ns[1], self.longest, "waiting_us"),
        ):
            least = getattr(kept[-1].row, key) * 1000 if len(kept) == WORST else 0.0
            if not float(most) > least:
                continue
            better = np.flatnonzero(column > least)
            better = better[answers.ready.known[better]]
            better = better[np.argsort(-column[better], kind="stable")[:WORST]]
            made = {each.row.seq: each for each in (*self.slowest, *self.longest)}
            before = [getattr(each.row, key) for each in kept]
            for place, at in enumerate(better.tolist()):
                value = float(column[at]) / 1000
                if place + sum(each >= value for each in before) >= WORST:
                    break
                worst = made.get(int(block.seq[answers.rows[at]]))
                kept.append(worst or self._worst(block, answers, at))
            kept.sort(key=lambda each: -getattr(each.row, key))
            del kept[WORST:]

    def _worst(self, block: BusBlock, answers: Answers, at: int) -> _Worst:
        row, ready = int(answers.rows[at]), answers.ready
        told = WaitRow(
            self.bus,
            self.cob_id,
            None,
            None,
            int(block.seq[row]),
            int(block.t_ns[row]),
            int(answers.sync_seq[answers.position[at]]),
            float(answers.response_ns[at]) / 1000,
            float(ready.least_ns[at]) / 1000,
            float(answers.most_ns[at]) / 1000,
            float(ready.waiting_ns[at]) / 1000,
            [],
        )
        return _Worst(told, block.span(max(int(ready.first[at]), 0), row))


def named(rows: Sequence[WaitRow], pdo: PdoRow) -> list[WaitRow]:
    """The rows with node and name of their PDO."""
    return [replace(row, node=pdo.node, pdo=pdo.pdo) for row in rows]
