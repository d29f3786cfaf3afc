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
from syncline_schemas.named_tuples import NamedTuple

WRITE_NS = 500_000_000
"""A jump this near to a write that explains it is the write's doing."""
_RECENT_WRITES = 1000
_HEARTBEAT = 0x1017
_STATES_SINCE = 2
"""States told since a remote frame that show that it has not emptied the heartbeats, or no longer."""

Integers = NDArray[np.int64]


class _TalkEnd(NamedTuple):
    """What is kept of a node's error control from block to block.

    asked, commanded: `seq` of the last remote frame and of the last reset command. state: the last
    byte. told: states other than 00h since that remote frame.
    """

    asked: int
    commanded: int
    state: int
    told: int


_NO_TALK = _TalkEnd(-1, -1, 0xFF, 0)


class _Talk(NamedTuple):
    """A node's error control in a block: `seq` of remote frames, of reset commands, of states."""

    asked: Integers
    commanded: Integers
    seq: Integers
    state: Integers

    def told_since(self, asked: int, stop: int, before: _TalkEnd) -> int:
        """States other than 00h after a remote frame, before a row."""
        first = int(np.searchsorted(self.seq, asked))
        earlier = before.told if asked == before.asked else 0
        return int(np.count_nonzero(self.state[first:stop])) + earlier

    def end(self, before: _TalkEnd) -> _TalkEnd:
        """Where it stands at the end of the block."""
        asked = _last_before(self.asked, None, before.asked)
        return _TalkEnd(
            asked,
            _last_before(self.commanded, None, before.commanded),
            int(self.state[-1]) if len(self.state) else before.state,
            self.told_since(asked, len(self.state), before),
        )


class Cuts:
    """Finds the cuts, and remembers the writes among them for the jumps they explain."""

    def __init__(self, context: Context, scales: Scales) -> None:
        self._context = context
        self._scales = scales
        self._writes: dict[tuple[int, int], deque[Cut]] = {}
        self._talks: dict[tuple[int, int], _TalkEnd] = {}
        """Where the error control of a node stood, by (bus, node)."""

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
        before = self._talks.get((bus, node), _NO_TALK)
        talk = _Talk(
            _asked(block, bus, node) if empties else np.zeros(0, np.int64),
            np.array([cut.seq for cut in commands], np.int64),
            *_states(block, bus, node),
        )
        for row in _boot_ups(before, talk):
            seq = int(talk.seq[row])
            if not (self._sends_heartbeats(bus, node, seq) and _is_empty(before, talk, row)):
                t_ns = int(block.frames.t_ns[block.batch.row_at(seq)])
                yield Cut(seq, t_ns, "boot-up", False)
        self._talks[bus, node] = talk.end(before)

    def _sends_heartbeats(self, bus: int, node: int, seq: int) -> bool:
        return bool(self._context.shadow.number(bus, node, _HEARTBEAT, 0, seq))


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


def _states(block: Block, bus: int, node: int) -> tuple[Integers, Integers]:
    """`seq` and state byte of the data frames of a node's error control; FFh: not one byte."""
    frames, rows = block.frames, block.batch.rows(bus, 0x700 + node)
    state = np.where(frames.dlc[rows] == 1, frames.data[rows, 0], 0xFF)
    return block.batch.seqs_at(rows), state.astype(np.int64)


def _boot_ups(before: _TalkEnd, talk: _Talk) -> list[int]:
    """Rows of bytes 00h that may be boot-ups: of several in a row the first."""
    # Empty state bytes after a remote frame that is not in the log are no boot-ups either.
    last = np.concatenate(([before.state], talk.state[:-1]))
    return np.flatnonzero((talk.state == 0) & (last != 0)).tolist() if len(talk.state) else []


def _is_empty(before: _TalkEnd, talk: _Talk, row: int) -> bool:
    """Whether a byte 00h is a heartbeat that a remote frame emptied: some devices send them so.

    They do so at once and until they start anew. So it is a boot-up where states came since that
    frame, or where it stands alone between states.
    """
    seq = int(talk.seq[row])
    asked = _last_before(talk.asked, seq, before.asked)
    if asked <= _last_before(talk.commanded, seq, before.commanded):
        return False
    alone = row + 1 < len(talk.state) and talk.state[row + 1] != 0
    return not alone and talk.told_since(asked, row, before) < _STATES_SINCE


def _last_before(seqs: Integers, seq: int | None, earlier: int) -> int:
    """The last of some frames before another one (all: None); else the one before them all."""
    at = len(seqs) if seq is None else int(np.searchsorted(seqs, seq))
    return int(seqs[at - 1]) if at else earlier


def _asked(block: Block, bus: int, node: int) -> Integers:
    """`seq` of the remote frames to the error control of a node."""
    rows = block.batch.rows_of(Service.ERROR_CONTROL, remote=True)
    own = (block.frames.can_id[rows] == 0x700 + node) & (block.frames.bus[rows] == bus)
    return block.batch.seqs_at(rows[own])
