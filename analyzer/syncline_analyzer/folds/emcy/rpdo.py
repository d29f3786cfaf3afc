"""Which RPDO a node complained of with 8210h or 8220h (CiA 301 7.2.7.1: PDO length)."""

from collections.abc import Iterator

import numpy as np

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.shadow import Shadow
from syncline_schemas.named_tuples import NamedTuple

LENGTH_CODES = (b"\x10\x82", b"\x20\x82")
"""First bytes of an EMCY that tells of a PDO of the wrong length: 8210h too short, 8220h too long."""
MAX_SUSPECTS = 1000
WITHIN_NS = 100_000_000
"""An RPDO longer before the EMCY is not the one [ns]."""
FRAMES_BACK = 1000
"""Nor is one with more frames than this between, which decides in a log without times."""
_OFF_OR_29_BIT = 0xA0000000
_PREDEFINED = 4
_PDO_IDS = range(0x181, 0x580)
_RPDO_COUNT = 512


class Suspect(NamedTuple):
    """The RPDO frame of a node just before its EMCY; `number` is 0 for a PDO of whomever.

    `mapped` is the number of bytes that the node's mapping takes, None where it is not known;
    `guess` says that only the predefined identifier makes it that node's RPDO.
    """

    number: int
    can_id: int
    seq: int
    before_ns: int
    dlc: int
    mapped: int | None
    guess: bool

    @property
    def wrong(self) -> bool:
        """Whether its length is known not to fit."""
        return self.mapped is not None and self.mapped != self.dlc

    @property
    def fits(self) -> bool:
        """Whether its length is known to fit."""
        return self.mapped == self.dlc


class _Seen(NamedTuple):
    """The last frame of an identifier."""

    seq: int
    t_ns: int
    dlc: int


class Suspects:
    """Finds the RPDO frames ahead of EMCYs; `found` holds them by `seq` of the EMCY."""

    def __init__(self, shadow: Shadow) -> None:
        self._shadow = shadow
        self._last: dict[tuple[int, int], _Seen] = {}
        self.found: dict[int, Suspect] = {}

    def look(self, batch: IndexedBatch, row: int, bus: int, node: int, data: bytes) -> None:
        """Look for the RPDO that an EMCY in this row complains of."""
        if data[:2] not in LENGTH_CODES or len(self.found) >= MAX_SUSPECTS:
            return
        near = (each for each in self._near(batch, row, bus, node) if not each.fits)
        best = max(near, key=lambda each: (each.wrong, each.seq), default=None)
        best = best or self._last_pdo(batch, row, bus, node)
        if best is not None:
            self.found[batch.seq(row)] = best

    def remember(self, batch: IndexedBatch) -> None:
        """Keep the last frames of a batch for the EMCYs of the next one."""
        for bus, can_id in batch.ids():
            if can_id in _PDO_IDS:
                self._last[bus, can_id] = _seen(batch, int(batch.rows(bus, can_id)[-1]))

    def _before(self, batch: IndexedBatch, row: int, bus: int, can_id: int) -> _Seen | None:
        """The last frame of an identifier before a row, if it is near."""
        rows = batch.rows(bus, can_id)
        place = int(np.searchsorted(rows, row))
        seen = _seen(batch, int(rows[place - 1])) if place else self._last.get((bus, can_id))
        if seen is None or batch.seq(row) - seen.seq > FRAMES_BACK:
            return None
        return seen if 0 <= int(batch.frames.t_ns[row]) - seen.t_ns <= WITHIN_NS else None

    def _near(self, batch: IndexedBatch, row: int, bus: int, node: int) -> Iterator[Suspect]:
        """The last frame of each RPDO of the node before the row."""
        seq, t_ns = batch.seq(row), int(batch.frames.t_ns[row])
        for number, can_id, guess in self._identifiers(bus, node, seq):
            seen = self._before(batch, row, bus, can_id)
            if seen is not None:
                mapped = self._mapped(bus, node, number, seq)
                passed_ns = t_ns - seen.t_ns
                yield Suspect(number, can_id, seen.seq, passed_ns, seen.dlc, mapped, guess)

    def _last_pdo(self, batch: IndexedBatch, row: int, bus: int, node: int) -> Suspect | None:
        """The last PDO of others before a row, for a node of which no RPDO is known."""
        ids = {can_id for on, can_id in (*batch.ids(), *self._last) if on == bus}
        ids -= set(self._sent(bus, node, batch.seq(row)))
        seen = {i: self._before(batch, row, bus, i) for i in ids if i in _PDO_IDS}
        near = {can_id: last for can_id, last in seen.items() if last is not None}
        if not near:
            return None
        can_id, last = max(near.items(), key=lambda entry: entry[1].seq)
        passed_ns = int(batch.frames.t_ns[row]) - last.t_ns
        return Suspect(0, can_id, last.seq, passed_ns, last.dlc, None, True)

    def _identifiers(self, bus: int, node: int, seq: int) -> Iterator[tuple[int, int, bool]]:
        """(number, identifier, only guessed) of the RPDOs of a node."""
        indexes = {0x1400 + k for k in range(_PREDEFINED)}
        indexes |= {
            index
            for index, sub in self._shadow.learned(bus, node)
            if 0x1400 <= index < 0x1400 + _RPDO_COUNT and sub == 1
        }
        for index in sorted(indexes):
            number = index - 0x13FF
            value = self._shadow.number(bus, node, index, 1, seq)
            if value is None and number <= _PREDEFINED:
                yield number, 0x100 + 0x100 * number + node, True
            elif value is not None and not value & _OFF_OR_29_BIT:
                yield number, value & 0x7FF, False

    def _sent(self, bus: int, node: int, seq: int) -> Iterator[int]:
        """Identifiers of the TPDOs of a node: it does not receive them."""
        indexes = {0x1800 + k for k in range(_PREDEFINED)}
        indexes |= {
            index
            for index, sub in self._shadow.learned(bus, node)
            if 0x1800 <= index < 0x1800 + _RPDO_COUNT and sub == 1
        }
        for index in indexes:
            value = self._shadow.number(bus, node, index, 1, seq)
            if value is not None and not value & _OFF_OR_29_BIT:
                yield value & 0x7FF
            elif value is None and index < 0x1800 + _PREDEFINED:
                yield 0x180 + 0x100 * (index - 0x1800) + node

    def _mapped(self, bus: int, node: int, number: int, seq: int) -> int | None:
        """Bytes that the mapping of an RPDO takes."""
        index = 0x15FF + number
        count = self._shadow.number(bus, node, index, 0, seq)
        if not count or count > 64:
            return None
        entries = [self._shadow.number(bus, node, index, sub, seq) for sub in range(1, count + 1)]
        bits = [entry & 0xFF for entry in entries if entry is not None]
        return -(-sum(bits) // 8) if len(bits) == count else None


def _seen(batch: IndexedBatch, row: int) -> _Seen:
    return _Seen(batch.seq(row), int(batch.frames.t_ns[row]), int(batch.frames.dlc[row]))
