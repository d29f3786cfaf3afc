"""NMT commands of each bus, and the frames on 000h and 080h that are not CANopen's."""

from bisect import bisect_left
from collections import Counter
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.nmt.events import Command, OddCommand
from syncline_analyzer.folds.sdo.fold import Reset
from syncline_schemas.canopen.nmt import COMMANDS, RESETS
from syncline_schemas.records import dataclass

SYNC_ID = 0x080
MAX_NODE = 127
MAX_ODD = 1000
"""Frames on 000h that are no NMT commands and are kept one by one."""


@dataclass(slots=True)
class Commands:
    """Collects the commands."""

    by_bus: dict[int, list[Command]] = field(default_factory=dict)
    malformed: int = 0
    """Frames on 000h that are no command."""
    odd: list[OddCommand] = field(default_factory=list)
    """The first of them."""
    _syncs: Counter[int] = field(default_factory=Counter)
    """By bus number: frames on 080h that may be SYNCs, less those that have another length."""
    foreign: Counter[int] = field(default_factory=Counter)
    """By bus number: frames on 000h and 080h that have another length than CANopen's."""

    def take(self, batch: IndexedBatch) -> list[Reset]:
        """Take in the next frames; tells the resets among them."""
        resets = []
        for bus in batch.buses:
            self._take_syncs(batch, bus)
            rows = batch.rows(bus, 0)
            if not len(rows):
                continue
            good = rows[batch.frames.dlc[rows] == 2]
            self._take_odd(batch, bus, rows)
            self.foreign[bus] += len(rows) - len(good)
            kept = self.by_bus.setdefault(bus, [])
            for row in good.tolist():
                specifier, node = batch.frames.data[row, :2].tolist()
                seq, t_ns = batch.seq(row), int(batch.frames.t_ns[row])
                kept.append(Command(seq, t_ns, specifier, node))
                if specifier in RESETS:
                    resets.append(Reset(seq, t_ns, bus, node, specifier))
        return resets

    @property
    def synced(self) -> set[int]:
        """Buses with SYNC: most frames on its identifier are as long as one."""
        return {bus for bus, more in self._syncs.items() if more > 0}

    def _take_syncs(self, batch: IndexedBatch, bus: int) -> None:
        rows = batch.rows(bus, SYNC_ID)
        if not len(rows):
            return
        longest = batch.lengths[bus, SYNC_ID][1]
        long = int(np.count_nonzero(batch.frames.dlc[rows] > 1)) if longest > 1 else 0
        self.foreign[bus] += long
        self._syncs[bus] += len(rows) - 2 * long

    def since(self, bus: int, seq: int) -> list[Command]:
        """The commands of a bus from a `seq` on, in order."""
        commands = self.by_bus.get(bus, [])
        return commands[bisect_left(commands, seq, key=lambda command: command.seq) :]

    def _take_odd(self, batch: IndexedBatch, bus: int, rows: NDArray[np.intp]) -> None:
        """Note the frames on 000h that no node can follow (CiA 301 7.2.8.3.1)."""
        frames = batch.frames
        length, data = frames.dlc[rows], frames.data[rows]
        known = np.isin(data[:, 0], list(COMMANDS)) & (data[:, 1] <= MAX_NODE)
        odd = rows[(length != 2) | ~known]
        self.malformed += len(odd)
        for row in odd[: MAX_ODD - len(self.odd)].tolist():
            what = _wrong_with(frames.payload(row))
            self.odd.append(OddCommand(bus, batch.seq(row), int(frames.t_ns[row]), what))

    def buses(self) -> set[int]:
        """Buses with commands that a node can follow."""
        return {
            bus
            for bus, commands in self.by_bus.items()
            if any(c.specifier in COMMANDS and c.node <= MAX_NODE for c in commands)
        }


def _wrong_with(data: bytes) -> str:
    """What keeps two bytes on 000h from being an NMT command.

    >>> _wrong_with(b""), _wrong_with(bytes((0x99, 5))), _wrong_with(bytes((1, 255)))
    ('0 instead of 2 bytes', 'unknown command specifier 99h', 'node number 255')
    """
    if len(data) != 2:
        return f"{len(data)} instead of 2 bytes"
    wrong = [f"unknown command specifier {data[0]:02X}h"] if data[0] not in COMMANDS else []
    wrong += [f"node number {data[1]}"] if data[1] > MAX_NODE else []
    return ", ".join(wrong)
