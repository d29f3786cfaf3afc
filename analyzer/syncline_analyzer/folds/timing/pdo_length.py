"""PDOs whose frames are not as long as the mapping that their node confirmed, or cannot change.

Of a TPDO whose mapping nobody told the frames must at least be as long as one another.
"""

from dataclasses import field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.timing.mixed_length import MixedLengths
from syncline_analyzer.pdo_binding import Pdo, PdoBindings
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.records import dataclass

_SERVICES: list[int] = SERVICE_OF_ID.tolist()
SETTLE_NS = 100_000_000
"""Frames this soon after a change of the mapping may still have the old length [ns]."""
MAX_FOUND = 1000
SETTLE_FRAMES = 5
"""The same for a log without times."""


@dataclass(slots=True)
class WrongLength:
    """Frames of one PDO that do not fit its mapping.

    `lengths` counts them by their length [bytes]; `mapped` is the length that the mapping asks for,
    `mapping_seq` the frame that confirmed it; None where it is the only one that the device has.
    """

    pdo: Pdo
    can_id: int
    mapped: int
    mapping_seq: int | None
    first_seq: int
    first_ns: int
    last_ns: int = 0
    lengths: dict[int, int] = field(default_factory=dict)
    fitting: int = 0
    """Frames of the right length under the same mapping."""

    @property
    def frames(self) -> int:
        """How many frames do not fit."""
        return sum(self.lengths.values())


@dataclass(slots=True)
class _Expected:
    """What a PDO's frames must be like from a moment on; `pdo` is None where nobody said it."""

    version: int
    pdo: Pdo | None = None
    length: int = 0
    mapping_seq: int | None = 0
    since_ns: int | None = None
    seen: int = 0
    wrong: WrongLength | None = None
    mixed: MixedLengths | None = None
    """Of a TPDO that nobody told the mapping of."""


class PdoLengthFold:
    """Holds every PDO against its mapping, where the node told or acknowledged it, or it is fixed.

    A TPDO has exactly the mapped length; an RPDO may be longer (CiA 301 7.2.2). Comes after the
    fold that fills the shadow.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._bindings = PdoBindings(context.shadow)
        self._expected: dict[tuple[int, int], _Expected] = {}
        self._bound: dict[int, tuple[int, set[int]]] = {}
        self._found: list[WrongLength] = []
        self._mixed: list[MixedLengths] = []

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        version = self._context.shadow.version
        for bus, can_id in batch.ids():
            if not self._may_be_pdo(bus, can_id, version):
                continue
            now = self._expected.get((bus, can_id))
            rows = batch.rows(bus, can_id)
            if now is None or now.version != version:
                self._look_again(batch, bus, can_id, rows, now, version)
            else:
                self._hold(batch, can_id, rows, now)

    def mixed(self) -> list[MixedLengths]:
        """Every TPDO of unknown mapping whose frames have several lengths."""
        return self._mixed

    def finish(self) -> list[WrongLength]:
        """Every PDO that did not fit, in order of `seq`."""
        return sorted(self._found, key=lambda wrong: wrong.first_seq)

    def _may_be_pdo(self, bus: int, can_id: int, version: int) -> bool:
        if self._bound.get(bus, (-1, set()))[0] != version:
            self._bindings.refresh(bus)
            self._bound[bus] = version, set(self._bindings.identifiers(bus))
        return _SERVICES[can_id] == Service.PDO or can_id in self._bound[bus][1]

    def _look_again(
        self,
        batch: IndexedBatch,
        bus: int,
        can_id: int,
        rows: NDArray[np.intp],
        before: _Expected | None,
        version: int,
    ) -> None:
        """Follow the changes within a batch in which the shadow learned something."""
        first, last = batch.seq0, batch.last_seq
        edges = [first, *self._bindings.cuts(bus, can_id, first, last), last + 1]
        seqs = batch.seqs_at(rows)
        for begin, stop in pairwise(edges):
            part = rows[np.searchsorted(seqs, begin) : np.searchsorted(seqs, stop)]
            now = self._expect(bus, can_id, begin, version)
            new = begin > first and now.pdo is None
            if before is not None and _same(before, now) and not new:
                before.version, now = version, before
            elif begin > first or before is not None:
                now.since_ns = int(batch.frames.t_ns[batch.row_at(begin)])
            self._expected[bus, can_id] = before = now
            self._hold(batch, can_id, part, now)

    def _expect(self, bus: int, can_id: int, seq: int, version: int) -> _Expected:
        pdo = self._bindings.owner(bus, can_id, seq)
        if pdo is None or pdo.guess:
            return _Expected(version)
        confirmed = self._bindings.mapping_confirmed(pdo, seq)
        mapping = self._bindings.mapping(pdo, seq)
        if mapping is None or not (confirmed or self._bindings.mapping_fixed(pdo)):
            mixed = MixedLengths(pdo, can_id) if pdo.kind == "tpdo" else None
            return _Expected(version, mixed=mixed)
        if not confirmed:
            return _Expected(version, pdo, mapping.length, None)
        count = self._context.shadow.get(bus, pdo.node, pdo.mapping, 0, seq)
        return _Expected(version, pdo, mapping.length, (count.seq if count else None) or 0)

    def _hold(
        self, batch: IndexedBatch, can_id: int, rows: NDArray[np.intp], now: _Expected
    ) -> None:
        """Count the frames that do not fit."""
        if not len(rows):
            return
        if now.mixed is not None:
            fresh = now.mixed.add(batch, rows)
            if fresh and len(self._mixed) < MAX_FOUND:
                self._mixed.append(now.mixed)
        if now.pdo is None:
            return
        length, t_ns = batch.frames.dlc[rows], batch.frames.t_ns[rows]
        off = length != now.length if now.pdo.kind == "tpdo" else length < now.length
        if now.since_ns is not None and self._context.timed:
            off &= t_ns >= now.since_ns + SETTLE_NS
        elif now.since_ns is not None:
            off &= np.arange(now.seen, now.seen + len(rows)) >= SETTLE_FRAMES
        now.seen += len(rows)
        if off.any() and now.wrong is None and len(self._found) < MAX_FOUND:
            row = rows[int(np.argmax(off))]
            seq, at_ns = batch.seq(row), int(batch.frames.t_ns[row])
            now.wrong = WrongLength(now.pdo, can_id, now.length, now.mapping_seq, seq, at_ns)
            self._found.append(now.wrong)
        if now.wrong is not None:
            now.wrong.fitting += int(np.count_nonzero(length == now.length))
            for bytes_, count in zip(*np.unique(length[off], return_counts=True), strict=True):
                found = now.wrong.lengths
                found[int(bytes_)] = found.get(int(bytes_), 0) + int(count)
            if off.any():
                now.wrong.last_ns = int(t_ns[off][-1])


def _same(before: _Expected, now: _Expected) -> bool:
    """Whether the same PDO has the same length; a mapping read once more changes nothing."""
    if before.pdo is None or now.pdo is None:
        told = [each.mixed and replace(each.mixed.pdo, source="") for each in (before, now)]
        return before.pdo is now.pdo and told[0] == told[1]
    return before.length == now.length and replace(before.pdo, source="") == replace(
        now.pdo, source=""
    )
