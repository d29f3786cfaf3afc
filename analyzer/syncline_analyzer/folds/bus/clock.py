"""The stamps themselves: steps back of the clock, and stretches without any frame on a bus."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_schemas import native
from syncline_schemas.batch import Gap
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

MAX_STEPS = 1000
"""Steps back that are kept one by one; the rest is only counted."""
MAX_SILENCES = 1024
"""Longest silences that are kept per bus."""
_START, _END = 0, 1
_NO_SEQ = -1
_NO_SILENCES = np.zeros((3, 0), np.int64)


class ClockStep(NamedTuple):
    """Two frames of one bus whose stamps run backwards, by `back_ns` [ns]."""

    bus: str
    seq: int
    t_ns: int
    back_ns: int


class BusSilence(NamedTuple):
    """A stretch (start_ns, end_ns) without a frame of a bus; no frame ends it before a gap.

    The last one of a bus that was heard no more, while another was, lasts to the capture's end.
    """

    start_ns: int
    end_ns: int
    end_seq: int | None


@dataclass(frozen=True, slots=True)
class ClockTable:
    """Steps back in order of `seq`, and the longest silences by bus number.

    `ended_ns` holds when each bus was heard last, unless a gap came after that.
    """

    steps: list[ClockStep] = field(default_factory=list)
    silences: dict[int, list[BusSilence]] = field(default_factory=dict)
    ended_ns: dict[int, int] = field(default_factory=dict)

    def silence_within(self, bus: int, start_ns: int, end_ns: int) -> BusSilence | None:
        """The longest silence of the whole bus that overlaps a stretch, cut to it."""
        overlapping = [
            BusSilence(max(s.start_ns, start_ns), min(s.end_ns, end_ns), s.end_seq)
            for s in self.silences.get(bus, ())
            if s.start_ns < end_ns and s.end_ns > start_ns
        ]
        return max(overlapping, key=lambda s: s.end_ns - s.start_ns, default=None)


class ClockFold:
    """Follows the stamps of each bus; states follow `seq`, so nothing here changes an order."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._last: dict[int, int] = {}
        self._steps: list[ClockStep] = []
        self._silences: dict[int, NDArray[np.int64]] = {}
        """(3, k) start, end and `seq` of the frame that ends it."""

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        if not self._context.timed or not len(batch):
            return
        for bus in batch.buses:
            part = batch
            if len(batch.buses) > 1:
                part = batch.part(np.flatnonzero(batch.frames.bus == bus))
            self._follow(bus, part)

    def gap(self, gap: Gap) -> None:
        """Nothing follows from the time between the frames around a gap."""
        for bus in [bus for bus in self._last if gap.bus in (None, bus)]:
            last_ns = self._last.pop(bus)
            if gap.start_ns > last_ns:
                kept = self._silences.get(bus, _NO_SILENCES)
                last = np.array([[last_ns], [gap.start_ns], [_NO_SEQ]])
                self._silences[bus] = np.concatenate((kept, last), axis=1)

    def finish(self, end_ns: int) -> ClockTable:
        """Everything seen; `end_ns` is the end of the capture, of all buses."""
        silences = {bus: _told(kept) for bus, kept in self._silences.items()}
        for bus, last_ns in self._last.items():
            if end_ns > last_ns:
                silences.setdefault(bus, []).append(BusSilence(last_ns, end_ns, None))
        steps = sorted(self._steps, key=lambda step: step.seq)
        return ClockTable(steps, silences, dict(self._last))

    def _follow(self, bus: int, batch: IndexedBatch) -> None:
        t_ns = batch.frames.t_ns
        last = self._last.get(bus)
        first_ns = np.int64(0) if last is None else t_ns[0] - last
        self._last[bus] = int(t_ns[-1])
        if not batch.ascending or first_ns < 0:
            later = np.flatnonzero(batch.apart_ns < 0) + 1
            back = _rows(first_ns < 0, later)[: MAX_STEPS - len(self._steps)]
            for row, passed_ns in zip(back.tolist(), _passed(batch, back, first_ns), strict=True):
                name = self._context.bus_name(bus)
                self._steps.append(ClockStep(name, batch.seq(row), int(t_ns[row]), -int(passed_ns)))
        self._keep_longest(bus, batch, first_ns)

    def _keep_longest(self, bus: int, batch: IndexedBatch, first_ns: np.int64) -> None:
        kept = self._silences.get(bus, _NO_SILENCES)
        full = kept.shape[1] >= MAX_SILENCES
        shortest = int((kept[_END] - kept[_START]).min()) if full else 0
        rows = _rows(first_ns > shortest, _later(batch, shortest))
        passed = _passed(batch, rows, first_ns)
        if len(rows) > MAX_SILENCES:
            long = passed >= np.partition(passed, -MAX_SILENCES)[-MAX_SILENCES]
            rows, passed = rows[long], passed[long]
        if len(rows):
            t_ns = batch.frames.t_ns[rows]
            found = np.stack((t_ns - passed, t_ns, batch.seqs_at(rows)))
            self._silences[bus] = _longest(np.concatenate((kept, found), axis=1))


def _rows(first: bool | np.bool_, later: NDArray[np.intp]) -> NDArray[np.intp]:
    """Rows by whether it is the first one, and later ones."""
    return np.concatenate(([0], later)) if first else later


def _later(batch: IndexedBatch, limit_ns: int) -> NDArray[np.intp]:
    """Rows that come later than that after the one before."""
    if native.available():
        return native.later(batch.frames.t_ns, limit_ns)
    return np.flatnonzero(batch.apart_ns > limit_ns) + 1


def _passed(batch: IndexedBatch, rows: NDArray[np.intp], first_ns: np.int64) -> NDArray[np.int64]:
    """Time from the frame before to each of some rows."""
    t_ns = batch.frames.t_ns
    return np.where(rows > 0, t_ns[rows] - t_ns[rows - 1], first_ns)


def _longest(silences: NDArray[np.int64]) -> NDArray[np.int64]:
    """The longest ones, of equal ones the first, in order."""
    if silences.shape[1] <= MAX_SILENCES:
        return silences
    order = np.argsort(silences[_START] - silences[_END], kind="stable")
    return silences[:, np.sort(order[:MAX_SILENCES])]


def _told(silences: NDArray[np.int64]) -> list[BusSilence]:
    return [
        BusSilence(start_ns, end_ns, None if seq == _NO_SEQ else seq)
        for start_ns, end_ns, seq in silences.T.tolist()
    ]
