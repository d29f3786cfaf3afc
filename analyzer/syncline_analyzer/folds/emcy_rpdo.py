"""Which RPDO a node complained of with 8210h or 8220h (CiA 301 7.2.7.1: PDO length)."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.shadow import Shadow
from syncline_schemas.canopen.services import Service

LENGTH_CODES = (b"\x10\x82", b"\x20\x82")
"""First bytes of an EMCY that tells of a PDO of the wrong length: 8210h too short, 8220h too long."""
MAX_SUSPECTS = 1000
WITHIN_NS = 100_000_000
"""An RPDO longer before the EMCY is not the one [ns]."""
_OFF_OR_29_BIT = 0xA0000000
_PREDEFINED = 4
_ROWS_BACK = 64
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


def _last_pdo(batch: IndexedBatch, row: int, bus: int) -> Suspect | None:
    """The last PDO of the bus before a row, where no RPDO of the node is known."""
    frames, begin = batch.frames, max(0, row - _ROWS_BACK)
    before = slice(begin, row)
    rows = np.flatnonzero((batch.service[before] == Service.PDO) & (frames.bus[before] == bus))
    if not len(rows):
        return None
    last = begin + int(rows[-1])
    passed_ns = int(frames.t_ns[row]) - int(frames.t_ns[last])
    if not 0 <= passed_ns <= WITHIN_NS:
        return None
    can_id, dlc = int(frames.can_id[last]), int(frames.dlc[last])
    return Suspect(0, can_id, batch.seq(last), passed_ns, dlc, None, True)


class Suspects:
    """Finds the RPDO frames ahead of EMCYs; `found` holds them by `seq` of the EMCY."""

    def __init__(self, shadow: Shadow) -> None:
        self._shadow = shadow
        self.found: dict[int, Suspect] = {}

    def look(self, batch: IndexedBatch, row: int, bus: int, node: int, data: bytes) -> None:
        """Look for the RPDO that an EMCY in this row complains of, within its batch."""
        if data[:2] not in LENGTH_CODES or len(self.found) >= MAX_SUSPECTS:
            return
        fits = (each for each in self._near(batch, row, bus, node) if not each.fits)
        near = max(fits, key=lambda each: (each.wrong, each.seq), default=None)
        near = near or _last_pdo(batch, row, bus)
        if near is not None:
            self.found[batch.seq(row)] = near

    def _near(self, batch: IndexedBatch, row: int, bus: int, node: int) -> Iterator[Suspect]:
        """The last frame of each RPDO of the node before the row."""
        frames, seq = batch.frames, batch.seq(row)
        for number, can_id, guess in self._identifiers(bus, node, seq):
            rows = batch.rows(bus, can_id)
            place = int(np.searchsorted(rows, row))
            if not place:
                continue
            last = int(rows[place - 1])
            passed_ns = int(frames.t_ns[row]) - int(frames.t_ns[last])
            if 0 <= passed_ns <= WITHIN_NS:
                mapped, dlc = self._mapped(bus, node, number, seq), int(frames.dlc[last])
                yield Suspect(number, can_id, batch.seq(last), passed_ns, dlc, mapped, guess)

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

    def _mapped(self, bus: int, node: int, number: int, seq: int) -> int | None:
        """Bytes that the mapping of an RPDO takes."""
        index = 0x15FF + number
        count = self._shadow.number(bus, node, index, 0, seq)
        if not count or count > 64:
            return None
        entries = [self._shadow.number(bus, node, index, sub, seq) for sub in range(1, count + 1)]
        bits = [entry & 0xFF for entry in entries if entry is not None]
        return -(-sum(bits) // 8) if len(bits) == count else None
