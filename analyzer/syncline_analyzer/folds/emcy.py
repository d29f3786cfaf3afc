"""EMCY messages, the transitions they make, and the errors they tell of (analysis.md section 6)."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.emcy_ids import SYNC_BYTES, EmcyIds, beats_like_sync
from syncline_analyzer.folds.nmt import BootUp
from syncline_analyzer.results import EmcyRow, ErrorRow
from syncline_schemas.devices import Device, emcy_details, emcy_meaning, register_bits

STORM_COUNT = 10
"""More EMCYs of one node than this within one second are a storm (analysis.md 6)."""
STORM_NS = 1_000_000_000
MAX_MESSAGES = 1_000_000
"""EMCY messages that become rows; the rest is only counted."""
MAX_EMPTY = 1000
"""Frames of a node without room for an error code that become rows; the rest is only counted."""
_EXTENDED = 0x20000000
_COMMUNICATION = (b"\x75", b"\x81")

Transition = Literal["raised", "further", "partly cleared", "all cleared", "reset", "malformed"]
NodeKey = tuple[int, int]
"""(bus number, node)."""


class Storm(NamedTuple):
    """A stretch with more than ten EMCYs of a node in every second of it."""

    bus: str
    node: int
    start_ns: int
    end_ns: int
    number: int
    first_seq: int


class TooSoon(NamedTuple):
    """Two EMCYs of a node closer than its inhibit time 1015h."""

    bus: str
    node: int
    seq: int
    t_ns: int
    passed_us: float
    inhibit_us: float


@dataclass(frozen=True, slots=True)
class EmcyTable:
    """Rows in order of `seq`, errors in order of their raise, and counts by (bus number, node).

    `counts` are messages of eight bytes; `before` holds the `seq` of partial clears that are the
    first EMCY of their node: an error was active before the capture began.
    """

    rows: list[EmcyRow] = field(default_factory=list)
    errors: list[ErrorRow] = field(default_factory=list)
    counts: dict[NodeKey, int] = field(default_factory=dict)
    malformed: dict[NodeKey, int] = field(default_factory=dict)
    storms: list[Storm] = field(default_factory=list)
    too_soon: list[TooSoon] = field(default_factory=list)
    before: list[int] = field(default_factory=list)
    dropped: int = 0


class _Message(NamedTuple):
    seq: int
    t_ns: int
    data: bytes


class EmcyFold:
    """Collects EMCY messages on 080h + n, or where 1014h says; the story is told at the end."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._messages: dict[NodeKey, list[_Message]] = {}
        self._ids = EmcyIds(context)
        self._empty: dict[NodeKey, int] = {}
        self._kept = 0
        self._dropped = 0

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        moved = self._moved()
        wanted = [batch.rows(bus, can_id) for bus, can_id in moved]
        rows = np.unique(np.concatenate([self._ids.rows(batch), *wanted]))
        rows = self._without_most_empty(batch, rows)
        frames = batch.frames
        self._dropped += max(0, len(rows) - (MAX_MESSAGES - self._kept))
        rows = rows[: MAX_MESSAGES - self._kept]
        self._kept += len(rows)
        for row in rows.tolist():
            bus, can_id = int(frames.bus[row]), int(frames.can_id[row])
            node = moved.get((bus, can_id), can_id & 0x7F)
            message = _Message(batch.seq(row), int(frames.t_ns[row]), frames.payload(row))
            self._messages.setdefault((bus, node), []).append(message)

    def _without_most_empty(self, batch: IndexedBatch, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Leave out frames without content beyond the first of each sender: most likely a SYNC."""
        frames = batch.frames
        keep = np.ones(len(rows), np.bool_)
        empty = np.flatnonzero(frames.dlc[rows] <= SYNC_BYTES)
        sender = frames.bus[rows[empty]].astype(np.int64) << 11 | frames.can_id[rows[empty]]
        for number in np.unique(sender).tolist():
            mine = empty[sender == number]
            key = (number >> 11, number & 0x7FF)
            seen = self._empty.get(key, 0)
            self._empty[key] = seen + len(mine)
            keep[mine[max(0, MAX_EMPTY - seen) :]] = False
        self._dropped += int(np.count_nonzero(~keep))
        return rows[keep]

    def communication_errors(self) -> dict[NodeKey, list[int]]:
        """Times of the EMCYs that tell of a communication error (75xxh, 81xxh) by node [ns]."""
        return {
            key: [m.t_ns for m in messages if len(m.data) >= 8 and m.data[1:2] in _COMMUNICATION]
            for key, messages in self._messages.items()
        }

    def finish(
        self,
        boot_ups: Sequence[BootUp],
        buses: Collection[int],
        alive: Collection[NodeKey] = frozenset(),
    ) -> EmcyTable:
        """All rows and errors on these buses; a boot-up ends what was active on its node.

        Frames without content in a steady rhythm are no EMCYs of a number that is not `alive`
        otherwise: most likely a SYNC that was moved before the capture.
        """
        table = EmcyTable(dropped=self._dropped)
        for (bus, node), messages in self._messages.items():
            if bus not in buses or ((bus, node) not in alive and _rhythmic(messages)):
                continue
            name = self._context.bus_name(bus)
            starts = [boot for boot in boot_ups if (boot.bus, boot.node) == (name, node)]
            story = _Story(name, node, self._context.shadow.device(bus, node))
            story.tell(messages, starts)
            table.rows.extend(story.rows)
            table.errors.extend(story.errors())
            table.before.extend(story.before)
            whole = [message for message in messages if len(message.data) >= 8]
            table.counts[bus, node] = len(whole)
            table.malformed[bus, node] = len(messages) - len(whole)
            if self._context.timed:
                table.storms.extend(_storms(name, node, whole))
                table.too_soon.extend(self._too_soon(bus, node, whole))
        table.rows.sort(key=lambda row: row.seq)
        table.errors.sort(key=lambda row: row.evidence[0])
        return table

    def _moved(self) -> dict[NodeKey, int]:
        """Node by (bus, identifier) of EMCYs that 1014h puts elsewhere."""
        shadow = self._context.shadow
        moved = {}
        for bus, node in shadow.nodes():
            known = shadow.number(bus, node, 0x1014)
            if (
                known is not None
                and not known & _EXTENDED
                and known & 0x7FF not in (0, 0x80 + node)
            ):
                moved[bus, known & 0x7FF] = node
        return moved

    def _too_soon(self, bus: int, node: int, messages: list[_Message]) -> list[TooSoon]:
        known = self._context.shadow.get(bus, node, 0x1015)
        if known is None or known.source == "eds-default" or not isinstance(known.value, int):
            return []
        inhibit_ns = known.value * 100_000
        slack_ns = self._context.resolution_ns + inhibit_ns // 100
        name = self._context.bus_name(bus)
        return [
            TooSoon(name, node, b.seq, b.t_ns, (b.t_ns - a.t_ns) / 1e3, inhibit_ns / 1e3)
            for a, b in pairwise(messages)
            if 0 <= b.t_ns - a.t_ns < inhibit_ns - slack_ns and b.seq > (known.seq or 0)
        ]


def _rhythmic(messages: list[_Message]) -> bool:
    return beats_like_sync([m.t_ns for m in messages], [len(m.data) for m in messages])


@dataclass(slots=True)
class _Active:
    """An error that is there."""

    code: int
    manufacturer: bytes
    raised_ns: int
    count: int = 1
    evidence: list[int] = field(default_factory=list)


_Keeps = Callable[[_Active], bool]


class _Story:
    """The error state machine of one node (CiA 301 7.2.7.2)."""

    def __init__(self, bus: str, node: int, device: Device | None) -> None:
        self._bus = bus
        self._node = node
        self._device = device
        self._active: list[_Active] = []
        self._over: list[ErrorRow] = []
        self.rows: list[EmcyRow] = []
        self.before: list[int] = []

    def tell(self, messages: list[_Message], boot_ups: list[BootUp]) -> None:
        """Run through messages and boot-ups in order of `seq`."""
        events: list[tuple[int, _Message | BootUp]] = [(m.seq, m) for m in messages]
        events += [(boot.seq, boot) for boot in boot_ups]
        for _, event in sorted(events, key=lambda entry: entry[0]):
            if isinstance(event, BootUp):
                self._boot_up(event)
            else:
                self._message(event)

    def errors(self) -> list[ErrorRow]:
        """All errors, also those that are still active."""
        return self._over + [self._row_of(error, None, "still active") for error in self._active]

    def _message(self, message: _Message) -> None:
        data = message.data
        code = int.from_bytes(data[:2], "little") if len(data) >= 2 else None
        if len(data) < 8 or code is None:
            meaning = f"EMCY with {len(data)} instead of 8 bytes"
            self._add(message, code, meaning, None, data[3:], "malformed")
            return
        transition = self._raise(message, code) if code >> 8 else self._clear(message)
        meaning = emcy_meaning(self._device, code)
        self._add(message, code, meaning, data[2], data[3:8], transition)

    def _raise(self, message: _Message, code: int) -> Transition:
        manufacturer = message.data[3:8]
        transition: Transition = "further" if self._active else "raised"
        for error in self._active:
            if error.code == code and (code & 0xFF or error.manufacturer == manufacturer):
                error.count += 1
                error.evidence.append(message.seq)
                return transition
        self._active.append(_Active(code, manufacturer, message.t_ns, evidence=[message.seq]))
        return transition

    def _clear(self, message: _Message) -> Transition:
        """A code 00xxh: what is left tells which errors it does not clear."""
        register, manufacturer = message.data[2], message.data[3:8]
        left = self._left(register, manufacturer)
        if left is None:
            self._end(self._active, message.t_ns, message.seq, "cleared")
            return "all cleared"
        if not self.rows:
            self.before.append(message.seq)
        gone = [error for error in self._active if not left(error)]
        self._end(gone, message.t_ns, message.seq, "cleared")
        return "partly cleared"

    def _left(self, register: int, manufacturer: bytes) -> _Keeps | None:
        """Which errors stay after a clear; None when nothing does."""
        details = emcy_details(self._device, manufacturer)
        bits = any(value for name, value in details.items() if not name.endswith("_bits"))
        if register or bits:
            return _keeps_by_bits(self._device, register, manufacturer)
        named = [e for e in self._active if any(manufacturer) and e.manufacturer == manufacturer]
        if self._device is None and named and len(self._active) > len(named):
            return lambda error: error not in named
        return None

    def _boot_up(self, boot: BootUp) -> None:
        if not self._active or boot.repeated:
            return
        meaning = "boot-up: the error list is gone, which clears nothing"
        self._end(self._active, boot.t_ns, boot.seq, "lost at reset")
        message = _Message(boot.seq, boot.t_ns, b"")
        self._add(message, None, meaning, None, b"", "reset")

    def _end(
        self,
        errors: Sequence[_Active],
        t_ns: int,
        seq: int,
        status: Literal["cleared", "lost at reset"],
    ) -> None:
        for error in list(errors):
            error.evidence.append(seq)
            self._over.append(self._row_of(error, t_ns, status))
            self._active.remove(error)

    def _row_of(
        self,
        error: _Active,
        cleared_ns: int | None,
        status: Literal["cleared", "still active", "lost at reset"],
    ) -> ErrorRow:
        return ErrorRow(
            self._bus,
            self._node,
            error.code,
            emcy_meaning(self._device, error.code),
            error.raised_ns,
            cleared_ns if status == "cleared" else None,
            status,
            error.count,
            error.evidence[:50],
        )

    def _add(
        self,
        message: _Message,
        code: int | None,
        meaning: str,
        register: int | None,
        manufacturer: bytes,
        transition: Transition,
    ) -> None:
        self.rows.append(
            EmcyRow(
                self._bus,
                self._node,
                message.seq,
                message.t_ns,
                code,
                meaning,
                register,
                register_bits(self._device, register) if register is not None else [],
                manufacturer.hex().upper(),
                transition,
                emcy_details(self._device, manufacturer) if register is not None else {},
            )
        )


def _keeps_by_bits(device: Device | None, register: int, manufacturer: bytes) -> _Keeps:
    """Which errors the bits left in the register and in the alarm words still stand for."""
    told: set[int] = set()
    still: set[int] = set()
    for bit, codes in (device.emcy_registers if device else {}).items():
        told.update(codes)
        still.update(codes if register >> bit & 1 else ())
    for part in device.emcy_fields if device else ():
        value = int.from_bytes(manufacturer[part.start : part.start + part.length], "little")
        for bit, code in part.codes.items():
            told.add(code)
            still.update([code] if value >> bit & 1 else [])
    return lambda error: error.code in still or error.code not in told


def _storms(bus: str, node: int, messages: list[_Message]) -> list[Storm]:
    """Runs of messages in which each one has ten others within the second before it."""
    times = np.array([message.t_ns for message in messages], np.int64)
    if len(times) <= STORM_COUNT:
        return []
    dense = times[STORM_COUNT:] - times[:-STORM_COUNT]
    ends = np.flatnonzero((dense >= 0) & (dense < STORM_NS)) + STORM_COUNT
    storms = []
    for run in np.split(ends, np.flatnonzero(np.diff(ends) > 1) + 1) if len(ends) else []:
        first, last = int(run[0]) - STORM_COUNT, int(run[-1])
        storms.append(
            Storm(
                bus,
                node,
                messages[first].t_ns,
                messages[last].t_ns,
                last - first + 1,
                messages[first].seq,
            )
        )
    return storms
