"""SDO transfers, and what they teach the object-dictionary shadow."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.sdo_channel import SdoChannel, Strays, Transfer
from syncline_analyzer.results import SdoRow
from syncline_analyzer.shadow import Known
from syncline_schemas.batch import Gap
from syncline_schemas.canopen.datatypes import DATA_TYPES, decode_value
from syncline_schemas.canopen.sdo import LOAD_SIGNATURE, SAVE_SIGNATURE
from syncline_schemas.canopen.services import Service
from syncline_schemas.devices import Device

OBJECT_MISSING = 0x06020000
_EXTENDED_OR_OFF = 0xA0000000
_Handler = Callable[[int, int, bytes], None]


class Reset(NamedTuple):
    """A node starts anew at a row of the batch; node 0 means all of the bus."""

    row: int
    bus: int
    node: int


@dataclass(frozen=True, slots=True)
class SdoNodeCounts:
    """Counts of one node's server."""

    transfers: int = 0
    aborts: int = 0
    unanswered: int = 0
    answers: int = 0
    """Frames of the server, also those of no transfer that is seen whole."""
    confirmed: int = 0
    """Transfers with an answer of the server that fits the request."""


@dataclass(frozen=True, slots=True)
class SdoTable:
    """Transfers in order of `seq`, counts by (bus number, node), and what is no transfer.

    `bad_crc` holds the `end_seq` of block transfers whose CRC does not match their data.
    """

    rows: list[SdoRow] = field(default_factory=list)
    counts: dict[tuple[int, int], SdoNodeCounts] = field(default_factory=dict)
    strays: dict[tuple[int, int], Strays] = field(default_factory=dict)
    toggle_errors: dict[tuple[int, int], int] = field(default_factory=dict)
    bad_crc: list[int] = field(default_factory=list)
    aborted_by: dict[int, str] = field(default_factory=dict)
    """"client" or "server" by `seq` of an aborted transfer."""


class SdoFold:
    """Follows every SDO server: 600h + n and 580h + n, or where 1200h says.

    Confirmed transfers go into the shadow in the order in which they end. A moved server
    (1200h:1, :2) is followed from the batch after the one that tells it.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._channels: dict[tuple[int, int], SdoChannel] = {}
        self._handlers: dict[int, _Handler] = {}
        self._answers: dict[tuple[int, int], int] = {}
        self._objects: dict[tuple[int, int, int, int], tuple[int | None, str | None]] = {}
        self._ended: list[tuple[int, int, Transfer]] = []

    def update(self, batch: IndexedBatch, resets: Iterable[Reset] = ()) -> None:
        """Take in the next frames; `resets` in order of their rows."""
        rows = self._rows(batch)
        begin = 0
        for reset in resets:
            stop = int(np.searchsorted(rows, reset.row))
            self._feed(batch, rows[begin:stop])
            begin = stop
            self._reset(reset, batch.seq(reset.row), int(batch.frames.t_ns[reset.row]))
        self._feed(batch, rows[begin:])

    def gap(self, gap: Gap) -> None:
        """Transfers that run into a gap end as interrupted."""
        for (bus, _), channel in self._channels.items():
            if gap.bus in (None, bus):
                channel.cut()

    def finish(self, end_ns: int) -> SdoTable:
        """All transfers; those still running end with the capture."""
        for channel in self._channels.values():
            channel.finish(end_ns, self._context.timed)
        self._ended.sort(key=lambda entry: entry[2].seq)
        table = SdoTable(
            [self._row(*entry) for entry in self._ended],
            strays={key: channel.strays for key, channel in self._channels.items()},
            bad_crc=[t.end_seq for _, _, t in self._ended if t.crc_good is False],
            aborted_by={t.seq: t.abort_by for _, _, t in self._ended if t.abort_by},
        )
        self._count(table)
        return table

    def _rows(self, batch: IndexedBatch) -> NDArray[np.intp]:
        usual = batch.rows_of(Service.SDO_REQUEST, Service.SDO_ANSWER)
        moved = [batch.rows(*pair) for pair in self._moved(batch)]
        return np.unique(np.concatenate([usual, *moved])) if moved else usual

    def _moved(self, batch: IndexedBatch) -> list[tuple[int, int]]:
        """(bus, identifier) of servers that 1200h puts elsewhere; their handlers are set up."""
        shadow = self._context.shadow
        pairs = []
        for bus, node in shadow.nodes():
            for sub, base in ((1, 0x600), (2, 0x580)):
                known = shadow.number(bus, node, 0x1200, sub)
                if known is None or known & _EXTENDED_OR_OFF or known & 0x7FF == base + node:
                    continue
                channel = self._channel(bus, node)
                pairs.append((bus, known & 0x7FF))
                self._handlers[bus << 11 | known & 0x7FF] = self._handler(channel, sub == 1)
        return pairs

    def _channel(self, bus: int, node: int) -> SdoChannel:
        if (bus, node) not in self._channels:
            self._channels[bus, node] = SdoChannel(bus, node, self._done)
        return self._channels[bus, node]

    def _handler(self, channel: SdoChannel, request: bool) -> _Handler:
        if request:
            return channel.request
        key = (channel.bus, channel.node)

        def answer(seq: int, t_ns: int, data: bytes) -> None:
            self._answers[key] = self._answers.get(key, 0) + 1
            channel.answer(seq, t_ns, data)

        return answer

    def _feed(self, batch: IndexedBatch, rows: NDArray[np.intp]) -> None:
        """Hand frames to their channels; SDO frames are rare enough for a loop."""
        if not len(rows):
            return
        frames, handlers = batch.frames, self._handlers
        keys = frames.bus[rows].astype(np.uint32) << 11 | frames.can_id[rows]
        for key in np.unique(keys).tolist():
            if key not in handlers:
                channel = self._channel(key >> 11, key & 0x7F)
                handlers[key] = self._handler(channel, key & 0x780 == 0x600)
        data = np.ascontiguousarray(frames.data[rows, :8]).tobytes()
        lengths = np.minimum(frames.dlc[rows], 8)
        columns = (keys, rows + batch.seq0, frames.t_ns[rows], lengths, np.arange(len(rows)) * 8)
        for key, seq, t_ns, length, at in zip(*(c.tolist() for c in columns), strict=True):
            handlers[key](seq, t_ns, data[at : at + length])

    def _reset(self, reset: Reset, seq: int, t_ns: int) -> None:
        shadow = self._context.shadow
        nodes = [node for bus, node in shadow.nodes() if bus == reset.bus]
        for node in nodes if reset.node == 0 else [reset.node]:
            shadow.reset(reset.bus, node, seq)
        for (bus, node), channel in self._channels.items():
            if bus == reset.bus and reset.node in (0, node):
                channel.interrupt(t_ns)

    def _done(self, channel: SdoChannel, transfer: Transfer) -> None:
        self._ended.append((channel.bus, channel.node, transfer))
        if transfer.result == "ok" and transfer.whole:
            self._learn(channel.bus, channel.node, transfer)
        elif transfer.abort_code == OBJECT_MISSING and transfer.abort_by == "server":
            self._context.shadow.refuse(channel.bus, channel.node, transfer.index, transfer.sub)

    def _learn(self, bus: int, node: int, transfer: Transfer) -> None:
        shadow = self._context.shadow
        value = _shadow_value(shadow.device(bus, node), transfer)
        write = transfer.direction == "download"
        if write and transfer.index == 0x1010 and value == SAVE_SIGNATURE:
            shadow.save(bus, node, transfer.sub)
        elif write and transfer.index == 0x1011 and value == LOAD_SIGNATURE:
            shadow.restore(bus, node, transfer.sub)
        else:
            source = "sdo-write" if write else "sdo-read"
            known = Known(value, source, transfer.end_seq, transfer.end_ns)  # type: ignore[arg-type]
            shadow.learn(bus, node, transfer.index, transfer.sub, known)

    def _row(self, bus: int, node: int, transfer: Transfer) -> SdoRow:
        data = bytes(transfer.data)
        code, name = self._object(bus, node, transfer.index, transfer.sub)
        answer_us = None
        if self._context.timed and transfer.answered_ns is not None:
            answer_us = max(0, transfer.answered_ns - transfer.start_ns) / 1000
        return SdoRow(
            bus=self._context.bus_name(bus),
            node=node,
            seq=transfer.seq,
            start_ns=transfer.start_ns,
            end_ns=max(transfer.end_ns, transfer.start_ns),
            index=transfer.index,
            sub=transfer.sub,
            direction=transfer.direction,
            kind=transfer.kind,
            size=_size(transfer, code),
            value=_row_value(code, data) if data and transfer.whole else None,
            result=transfer.result,
            abort_code=transfer.abort_code,
            answer_us=answer_us,
            name=name,
            data=data,
            end_seq=transfer.end_seq,
        )

    def _object(self, bus: int, node: int, index: int, sub: int) -> tuple[int | None, str | None]:
        """Data type and name of an object, as they are known at the end."""
        key = (bus, node, index, sub)
        if key not in self._objects:
            device = self._context.shadow.device(bus, node)
            name = device.object_name(index, sub) if device else None
            self._objects[key] = (_type_code(device, index, sub), name)
        return self._objects[key]

    def _count(self, table: SdoTable) -> None:
        results: dict[tuple[int, int], list[str]] = {}
        confirmed: dict[tuple[int, int], int] = {}
        for bus, node, transfer in self._ended:
            results.setdefault((bus, node), []).append(transfer.result)
            answered = transfer.answered_ns is not None
            confirmed[bus, node] = confirmed.get((bus, node), 0) + answered
            if transfer.toggle_errors:
                errors = table.toggle_errors.get((bus, node), 0)
                table.toggle_errors[bus, node] = errors + transfer.toggle_errors
        for key in self._channels:
            seen = results.get(key, [])
            table.counts[key] = SdoNodeCounts(
                len(seen),
                seen.count("abort"),
                seen.count("no answer"),
                self._answers.get(key, 0),
                confirmed.get(key, 0),
            )


def _standard_types() -> dict[tuple[int, int], int]:
    """Data types of the communication objects (CiA 301 7.5.2) by (index, sub)."""
    u8, u16, u32, text = 0x05, 0x06, 0x07, 0x09
    types = dict.fromkeys(
        [(i, 0) for i in (0x1000, 0x1002, 0x1005, 0x1006, 0x1007, 0x1012, 0x1013, 0x1014)], u32
    )
    types |= dict.fromkeys([(i, 0) for i in (0x100C, 0x1015, 0x1017)], u16)
    types |= dict.fromkeys([(i, 0) for i in (0x1001, 0x100D, 0x1019)], u8)
    types |= dict.fromkeys([(i, 0) for i in (0x1008, 0x1009, 0x100A)], text)
    for index in (0x1003, 0x1010, 0x1011, 0x1016, 0x1018, 0x1200):
        types |= {(index, 0): u8} | {(index, sub): u32 for sub in range(1, 0x80)}
    types |= {(0x1029, sub): u8 for sub in range(8)}
    return types


_STANDARD_TYPES = _standard_types()
_PDO_PARAMETER_TYPES = {0: 0x05, 1: 0x07, 2: 0x05, 3: 0x06, 5: 0x06, 6: 0x05}


def _type_code(device: Device | None, index: int, sub: int) -> int | None:
    """Data type of an object by the device's dictionary, else by CiA 301."""
    facts = device.object(index, sub) if device else None
    if facts is not None and facts.data_type is not None:
        return facts.data_type
    if 0x1400 <= index < 0x1600 or 0x1800 <= index < 0x1A00:
        return _PDO_PARAMETER_TYPES.get(sub)
    if 0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00:
        return 0x07 if sub else 0x05
    return _STANDARD_TYPES.get((index, sub))


def _shadow_value(device: Device | None, transfer: Transfer) -> int | bytes:
    """Value as the shadow keeps it: numbers as int, everything else as bytes."""
    data = bytes(transfer.data)
    code = _type_code(device, transfer.index, transfer.sub)
    known = DATA_TYPES.get(code) if code is not None else None
    if known is not None and known.kind in ("signed", "unsigned", "bool"):
        value = decode_value(code, data)
        return value if isinstance(value, int) else int.from_bytes(data, "little")
    if known is not None or not 0 < len(data) <= 8:
        return data
    return int.from_bytes(data, "little")


def _row_value(code: int | None, data: bytes) -> int | float | str:
    value = decode_value(code, data)
    return value.hex().upper() if isinstance(value, bytes) else value


def _size(transfer: Transfer, code: int | None) -> int | None:
    """Bytes of the value: as received, as announced, or as the type says for size-less frames."""
    if transfer.kind == "expedited" and transfer.data:
        if transfer.announced is not None:
            return transfer.announced
        known = DATA_TYPES.get(code) if code is not None else None
        return (known.bits + 7) // 8 if known is not None and known.bits else None
    return len(transfer.data) if transfer.result == "ok" else transfer.announced
