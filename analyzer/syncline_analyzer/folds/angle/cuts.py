"""What cuts the traces of a node: writes that its device names, new scales, resets, boot-ups."""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.folds.angle.samples import changes_within
from syncline_analyzer.folds.angle.scales import Scales, scale_objects
from syncline_analyzer.folds.angle.state import MOVES, Cut
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.results import TraceEventRow
from syncline_schemas.canopen.nmt import RESETS
from syncline_schemas.decoder import decode_nmt
from syncline_schemas.devices import Device, quirks, standard_jumps

WRITE_NS = 500_000_000
"""A jump this near to a write that explains it is the write's doing."""
_RECENT_WRITES = 1000


class Cuts:
    """Finds the cuts, and remembers the writes among them for the jumps they explain."""

    def __init__(self, context: Context, scales: Scales) -> None:
        self._context = context
        self._scales = scales
        self._writes: dict[tuple[int, int], deque[Cut]] = {}

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
        resets = list(_resets(block, bus, node))
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


def explained(event: TraceEventRow, writes: Sequence[Cut]) -> bool:
    """Whether a jump is the doing of a write near it."""
    return event.kind in MOVES and any(abs(w.t_ns - event.t_ns) <= WRITE_NS for w in writes)


def _resets(block: Block, bus: int, node: int) -> Iterator[Cut]:
    """Reset commands to a node, and boot-ups."""
    frames, batch = block.frames, block.batch
    rows = block.batch.rows(bus, 0)
    if len(rows):
        nmt = decode_nmt(frames.data[rows], frames.dlc[rows])
        to_node = nmt.valid & np.isin(nmt.command, RESETS) & np.isin(nmt.node, (0, node))
        for row in rows[to_node].tolist():
            yield Cut(batch.seq(row), int(frames.t_ns[row]), "reset command", False)
    rows = block.batch.rows(bus, 0x700 + node)
    if len(rows):
        state = np.where(frames.dlc[rows] == 1, frames.data[rows, 0], 0xFF)
        # Some devices go on with empty state bytes after a remote frame: only the first can be a boot-up.
        boots = (state == 0) & (np.concatenate(([0xFF], state[:-1])) != 0)
        for row in rows[boots].tolist():
            yield Cut(batch.seq(row), int(frames.t_ns[row]), "boot-up", False)
