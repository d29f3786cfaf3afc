"""What cuts the traces of a node: writes that its device names, new scales, resets, boot-ups."""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.angle.samples import changes_within
from syncline_analyzer.folds.angle.scales import Scales, scale_objects
from syncline_analyzer.folds.angle.state import MOVES, Cut
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.results import TraceEventRow
from syncline_schemas.canopen.nmt import RESETS
from syncline_schemas.canopen.services import Service
from syncline_schemas.decoder import decode_nmt
from syncline_schemas.devices import Device, quirks, standard_jumps

WRITE_NS = 500_000_000
"""A jump this near to a write that explains it is the write's doing."""
_RECENT_WRITES = 1000
_HEARTBEAT = 0x1017

Integers = NDArray[np.int64]


class Cuts:
    """Finds the cuts, and remembers the writes among them for the jumps they explain."""

    def __init__(self, context: Context, scales: Scales) -> None:
        self._context = context
        self._scales = scales
        self._writes: dict[tuple[int, int], deque[Cut]] = {}
        self._asked: dict[tuple[int, int], int] = {}
        """`seq` of the last remote frame to the error control of a node, by (bus, node)."""
        self._commanded: dict[tuple[int, int], int] = {}
        """`seq` of the last reset command to it."""

    def writes(self, bus: int, node: int) -> list[Cut]:
        """The last writes to a node that move what it measures."""
        return list(self._writes.get((bus, node), ()))

    def within(self, block: Block, bus: int, node: int, first: int) -> list[Cut]:
        """Everything after `first` up to the end of a block, in order of `seq`."""
        last = block.batch.last_seq
        device = self._context.shadow.device(bus, node)
        writes = list(self._explaining_writes(bus, node, device, first, last))
        kept = self._writes.setdefault((bus, node), deque(maxlen=_RECENT_WRITES))
        kept.extend(writes)
        shadow = self._context.shadow
        news = (
            Cut(seq, 0, "", False)
            for key in scale_objects(device)
            for seq in (*shadow.changes(bus, node, *key), *shadow.read_again(bus, node, *key))
            if first < seq <= last
        )
        resets = list(self._resets(block, bus, node))
        self._scales.reset(bus, node, [cut.seq for cut in resets])
        return sorted([*writes, *news, *resets])

    def _explaining_writes(
        self, bus: int, node: int, device: Device | None, first: int, last: int
    ) -> Iterator[Cut]:
        shadow = self._context.shadow
        device_type = shadow.number(bus, node, 0x1000) or 0
        for jump in quirks(device).jumps or standard_jumps(device_type & 0xFFFF):
            key = (jump.index, jump.sub)
            for known in changes_within(shadow, bus, node, key, first, last):
                fits = jump.values is None or known.value in jump.values
                if known.source == "sdo-write" and fits:
                    text = f"{jump.text} ({jump.index:04X}h written)"
                    yield Cut(known.seq or 0, known.t_ns or 0, text, True)

    def _resets(self, block: Block, bus: int, node: int) -> Iterator[Cut]:
        """Reset commands to a node, and boot-ups; not the heartbeats that a remote frame emptied."""
        commands = list(_commands(block, bus, node))
        yield from commands
        empties = quirks(self._context.shadow.device(bus, node)).empty_heartbeat_after_rtr
        asked = _asked(block, bus, node) if empties else np.zeros(0, np.int64)
        commanded = np.array([cut.seq for cut in commands], np.int64)
        for cut in _boot_ups(block, bus, node):
            if not self._is_empty(bus, node, cut.seq, asked, commanded):
                yield cut
        key = bus, node
        self._asked[key] = _last_before(asked, None, self._asked.get(key, -1))
        self._commanded[key] = _last_before(commanded, None, self._commanded.get(key, -1))

    def _is_empty(
        self, bus: int, node: int, seq: int, asked: Integers, commanded: Integers
    ) -> bool:
        """Whether heartbeats are empty: some devices send them so after a remote frame.

        They do so until they start anew, and only while the heartbeat is on.
        """
        shadow, key = self._context.shadow, (bus, node)
        last = _last_before(asked, seq, self._asked.get(key, -1))
        reset = _last_before(commanded, seq, self._commanded.get(key, -1))
        return last > reset and bool(shadow.number(bus, node, _HEARTBEAT, 0, seq))


def explained(event: TraceEventRow, writes: Sequence[Cut]) -> bool:
    """Whether a jump is the doing of a write near it."""
    return event.kind in MOVES and any(abs(w.t_ns - event.t_ns) <= WRITE_NS for w in writes)


def _commands(block: Block, bus: int, node: int) -> Iterator[Cut]:
    """Reset commands to a node."""
    frames, batch = block.frames, block.batch
    rows = batch.rows(bus, 0)
    if len(rows):
        nmt = decode_nmt(frames.data[rows], frames.dlc[rows])
        to_node = nmt.valid & np.isin(nmt.command, RESETS) & np.isin(nmt.node, (0, node))
        for row in rows[to_node].tolist():
            yield Cut(batch.seq(row), int(frames.t_ns[row]), "reset command", False)


def _boot_ups(block: Block, bus: int, node: int) -> Iterator[Cut]:
    """Bytes 00h that may be boot-ups: of several in a row the first."""
    frames, batch = block.frames, block.batch
    rows = batch.rows(bus, 0x700 + node)
    if len(rows):
        state = np.where(frames.dlc[rows] == 1, frames.data[rows, 0], 0xFF)
        # Empty state bytes after a remote frame that is not in the log are no boot-ups either.
        boots = (state == 0) & (np.concatenate(([0xFF], state[:-1])) != 0)
        for row in rows[boots].tolist():
            yield Cut(batch.seq(row), int(frames.t_ns[row]), "boot-up", False)


def _last_before(seqs: Integers, seq: int | None, earlier: int) -> int:
    """The last of some frames before another one (all: None); else the one before them all."""
    at = len(seqs) if seq is None else int(np.searchsorted(seqs, seq))
    return int(seqs[at - 1]) if at else earlier


def _asked(block: Block, bus: int, node: int) -> Integers:
    """`seq` of the remote frames to the error control of a node."""
    rows = block.batch.rows_of(Service.ERROR_CONTROL, remote=True)
    own = (block.frames.can_id[rows] == 0x700 + node) & (block.frames.bus[rows] == bus)
    return block.batch.seqs_at(rows[own])
