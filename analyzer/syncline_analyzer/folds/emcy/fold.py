"""EMCY messages, the transitions they make, and the errors they tell of (analysis.md section 6)."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.distinct import distinct
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.emcy.ids import SYNC_BYTES, EmcyIds, beats_like_sync
from syncline_analyzer.folds.emcy.rates import (
    INHIBIT_UNIT_NS,
    Inhibit,
    Storm,
    TooSoon,
    storms,
    too_soon,
)
from syncline_analyzer.folds.emcy.reads import NoError
from syncline_analyzer.folds.emcy.rpdo import Suspect, Suspects
from syncline_analyzer.folds.emcy.story import Before, Message, Story
from syncline_analyzer.folds.nmt.events import MissedMaster
from syncline_analyzer.folds.nmt.table import BootUp
from syncline_analyzer.results import EmcyRow, ErrorRow
from syncline_schemas.records import dataclass

MAX_MESSAGES = 1_000_000
"""EMCY messages that become rows; the rest is only counted."""
MAX_EMPTY = 1000
"""Frames of a node without room for an error code that become rows; the rest is only counted."""
_COMMUNICATION = (b"\x75", b"\x81")
_LIFE = b"\x30\x81"
_NO_ERROR = b"\x00\x00"
_INHIBIT_TIME = 0x1015

NodeKey = tuple[int, int]
"""(bus number, node)."""


@dataclass(frozen=True, slots=True)
class EmcyTable:
    """Rows in order of `seq`, errors in order of their raise, and counts by (bus number, node).

    `counts` are messages of eight bytes; `before` tells, by (bus, node), of errors that were active
    before the capture began; `suspects` are the RPDOs that came before an 8210h or 8220h, by the
    `seq` of the EMCY.
    """

    rows: list[EmcyRow] = field(default_factory=list)
    errors: list[ErrorRow] = field(default_factory=list)
    counts: dict[NodeKey, int] = field(default_factory=dict)
    malformed: dict[NodeKey, int] = field(default_factory=dict)
    storms: list[Storm] = field(default_factory=list)
    too_soon: list[TooSoon] = field(default_factory=list)
    before: list[Before] = field(default_factory=list)
    suspects: dict[int, Suspect] = field(default_factory=dict)
    dropped: int = 0


class EmcyFold:
    """Collects EMCY messages on 080h + n, or where 1014h says; the story is told at the end."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._messages: dict[NodeKey, list[Message]] = {}
        self._ids = EmcyIds(context)
        self._suspects = Suspects(context.shadow)
        self._empty: dict[NodeKey, int] = {}
        self._kept = 0
        self._dropped = 0

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        rows, nodes = self._ids.frames(batch)
        frames = batch.frames
        keep = self._without_most_empty(batch, rows)
        rows, nodes = rows[keep], nodes[keep]
        self._dropped += max(0, len(rows) - (MAX_MESSAGES - self._kept))
        rows = rows[: MAX_MESSAGES - self._kept]
        self._kept += len(rows)
        for row, node in zip(rows.tolist(), nodes.tolist(), strict=False):
            bus, payload = int(frames.bus[row]), frames.payload(row)
            message = Message(batch.seq(row), int(frames.t_ns[row]), payload)
            self._messages.setdefault((bus, node), []).append(message)
            self._suspects.look(batch, row, bus, node, payload)
        self._suspects.remember(batch)

    def _without_most_empty(self, batch: IndexedBatch, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
        """(n,) False for frames without content beyond the first of each sender: a SYNC, likely."""
        frames = batch.frames
        keep = np.ones(len(rows), np.bool_)
        empty = np.flatnonzero(frames.dlc[rows] <= SYNC_BYTES)
        sender = frames.bus[rows[empty]].astype(np.int64) << 11 | frames.can_id[rows[empty]]
        for number in distinct(sender):
            mine = empty[sender == number]
            key = (number >> 11, number & 0x7FF)
            seen = self._empty.get(key, 0)
            self._empty[key] = seen + len(mine)
            keep[mine[max(0, MAX_EMPTY - seen) :]] = False
        self._dropped += int(np.count_nonzero(~keep))
        return keep

    def communication_errors(self) -> dict[NodeKey, list[int]]:
        """Times of the EMCYs that tell of a communication error (75xxh, 81xxh) by node [ns]."""
        return {
            key: [m.t_ns for m in messages if m.whole and m.data[1:2] in _COMMUNICATION]
            for key, messages in self._messages.items()
        }

    def missed_masters(self) -> dict[NodeKey, list[MissedMaster]]:
        """When each node told that it misses its master (8130h)."""
        return {
            key: [MissedMaster(m.seq, m.t_ns) for m in messages if m.whole and m.data[:2] == _LIFE]
            for key, messages in self._messages.items()
        }

    def no_errors(self) -> dict[NodeKey, list[tuple[int, int]]]:
        """(seq, t_ns) of each node's EMCYs that are empty, or whose code is that of no error."""
        return {
            key: [(m.seq, m.t_ns) for m in messages if m.data[:2] in (b"", _NO_ERROR)]
            for key, messages in self._messages.items()
        }

    def finish(
        self,
        boot_ups: Sequence[BootUp],
        buses: Collection[int],
        alive: Collection[NodeKey] = frozenset(),
        reads: Mapping[tuple[str, int], Sequence[NoError]] = MappingProxyType({}),
    ) -> EmcyTable:
        """All rows and errors on these buses; a boot-up ends what was active on its node,
        and so does a read of it that says so (`reads`, by bus name and node).

        Frames without content in a steady rhythm are no EMCYs of a number that is not `alive`
        otherwise: most likely a SYNC that was moved before the capture.
        """
        table = EmcyTable(dropped=self._dropped, suspects=self._suspects.found)
        starts: dict[tuple[str, int], list[BootUp]] = {}
        for boot in boot_ups:
            starts.setdefault((boot.bus, boot.node), []).append(boot)
        for (bus, node), messages in self._messages.items():
            if bus in buses and ((bus, node) in alive or not _rhythmic(messages)):
                name = self._context.bus_name(bus)
                device = self._context.shadow.device(bus, node)
                story = Story(name, node, device, reads.get((name, node), ()))
                story.tell(messages, starts.get((name, node), []))
                self._add(table, bus, node, story, messages)
        table.rows.sort(key=lambda row: row.seq)
        table.errors.sort(key=lambda row: row.evidence[0])
        return table

    def _add(
        self, table: EmcyTable, bus: int, node: int, story: Story, messages: list[Message]
    ) -> None:
        table.rows.extend(story.rows)
        table.errors.extend(story.errors())
        table.before.extend(story.before)
        whole = [message for message in messages if message.whole]
        table.counts[bus, node] = len(whole)
        table.malformed[bus, node] = len(messages) - len(whole)
        if self._context.timed:
            name = self._context.bus_name(bus)
            seqs, times = [m.seq for m in whole], [m.t_ns for m in whole]
            table.storms.extend(storms(name, node, seqs, times))
            known = self._inhibits(bus, node)
            step_ns = self._context.resolution_ns
            table.too_soon.extend(too_soon(name, node, seqs, times, known, step_ns))

    def _inhibits(self, bus: int, node: int) -> list[Inhibit]:
        """The inhibit time over the capture; what only an EDS gives binds no device."""
        shadow = self._context.shadow
        moments = [-1, *shadow.changes(bus, node, _INHIBIT_TIME)]
        found = []
        for seq in moments:
            known = shadow.get(bus, node, _INHIBIT_TIME, 0, seq)
            sure = known is not None and known.source != "eds-default"
            value = known.value if known is not None and sure else 0
            source = known.source if known is not None else ""
            number = value if isinstance(value, int) else int.from_bytes(value, "little")
            found.append(Inhibit(seq, number * INHIBIT_UNIT_NS, source))
        return found


def _rhythmic(messages: list[Message]) -> bool:
    return beats_like_sync([m.t_ns for m in messages], [len(m.data) for m in messages])
