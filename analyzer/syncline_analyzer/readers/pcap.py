"""Network captures: pcap in both byte orders and resolutions, and pcapng.

Source: the IETF drafts "PCAP Capture File Format" and "PCAP Now Generic (pcapng) Capture File
Format".
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from dataclasses import field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.capture import CaptureFacts, Unread
from syncline_analyzer.readers.can_packets import can_packets
from syncline_analyzer.readers.chain import chained
from syncline_analyzer.readers.magic import PCAP_MAGIC
from syncline_analyzer.readers.resolution import Resolution
from syncline_analyzer.readers.source import CaptureSource
from syncline_analyzer.readers.times import FIRST_UTC_NS, SECOND_NS
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.byte_columns import ByteColumns, ByteOrder, Places
from syncline_schemas.errors import CaptureError
from syncline_schemas.records import dataclass

MAX_PACKET: Final = 1 << 20
"""A record that claims more is none."""
MAX_BUSES: Final = 256
_MAX_T_NS: Final = 1 << 62
_BLOCK_BYTES: Final = 1 << 20
_HEADER: Final = 24
_RECORD: Final = 16
_DROPPED: Final = "frames dropped by the capture tool"


@dataclass(slots=True)
class Packets:
    """Packets of one interface, in file order.

    Attributes:
        at, size: where each begins in `view`, and how many bytes of it are there.
        order: byte order of the machine that captured.
        interface: its name; "" where the file gives none.
        tx: whether the packet was sent by that machine.
        lost: how many packets were lost before each.
        rows: place of each among the packets of the block.
    """

    view: ByteColumns
    at: Places
    size: NDArray[np.int64]
    t_ns: NDArray[np.int64]
    link_type: int
    order: ByteOrder
    interface: str
    rows: Places
    tx: NDArray[np.bool_] | None = None
    lost: NDArray[np.int64] | None = None


@dataclass(slots=True)
class _Frames:
    """Frames of a block and what was said between them."""

    batch: list[FrameBatch] = field(default_factory=list)
    rows: list[Places] = field(default_factory=list)
    lost: list[tuple[int, int, int]] = field(default_factory=list)
    """Row, number of packets lost before it, bus."""


class PacketReader(ABC):
    """What both formats have in common: packets in, frames out."""

    def __init__(self, path: Path, form: str) -> None:
        self.facts = CaptureFacts(path, form, time_base="utc")
        self.resolution = Resolution()
        self._foreign: Counter[int] = Counter()
        self._last_ns: int | None = None
        self._timed = False

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in file order, with a Gap between them where the tool says it lost frames."""
        source = CaptureSource(self.facts.path)
        rest = b""
        try:
            while data := source.read(_BLOCK_BYTES):
                data = rest + data
                parts, used = self._packets(data)
                yield from self._deliver(parts)
                rest = data[used:]
                if used < 0:
                    rest = b""
                    break
        finally:
            source.close()
        self._finish(source.damage, rest)

    @abstractmethod
    def _packets(self, data: bytes) -> tuple[list[Packets], int]:
        """Packets of all whole records, and the bytes they take; -1 when nothing more can be read."""

    def harm(self, what: str) -> None:
        """Say what cannot be read; the first of it counts."""
        self.facts.damage = self.facts.damage or what

    def _finish(self, damage: str | None, rest: bytes) -> None:
        if damage:
            self.harm(damage)
        elif rest:
            self.harm("the file ends within a packet")
        self.facts.resolution_ns = self.resolution.step_ns
        for link_type, count in self._foreign.most_common(5):
            self.facts.notes.append(f"{count} packet(s) of link type {link_type} are no CAN frames")

    def _deliver(self, parts: list[Packets]) -> Iterator[FrameBatch | Gap]:
        found = _Frames()
        for part in parts:
            self._take(part, found)
        if not found.batch:
            return
        rows = np.concatenate(found.rows)
        order = np.argsort(rows, kind="stable")
        frames = FrameBatch.concat(found.batch)[order]
        self._time_base(frames)
        self.resolution.sample(frames.t_ns, frames.bus, frames.can_id)
        self.facts.resolution_ns = self.resolution.step_ns
        ordered, place = rows[order], 0
        for row, count, bus in sorted(found.lost):
            until = int(np.searchsorted(ordered, row))
            yield from self._part(frames[place:until])
            if until < len(frames):
                end_ns = int(frames.t_ns[until])
                start_ns = end_ns if self._last_ns is None else min(self._last_ns, end_ns)
                yield Gap(start_ns, end_ns, _DROPPED, count, bus)
            place = until
        yield from self._part(frames[place:])

    def _part(self, frames: FrameBatch) -> Iterator[FrameBatch]:
        if len(frames):
            self._last_ns = int(frames.t_ns[-1])
            yield frames

    def _time_base(self, frames: FrameBatch) -> None:
        if not self._timed:
            self._timed = True
            if int(frames.t_ns[0]) < FIRST_UTC_NS:
                self.facts.time_base = "relative"
                self.facts.notes.append("the times are no dates; they count from something else")

    def _take(self, part: Packets, found: _Frames) -> None:
        packets = can_packets(part.view, part.at, part.size, part.link_type, part.order)
        foreign = int(np.count_nonzero(~packets.can))
        if foreign:
            self._foreign[part.link_type] += foreign
        unread = packets.can & (~packets.whole | (part.t_ns < 0))
        if unread.any():
            self._unread(part, np.flatnonzero(unread))
        keep = np.flatnonzero(packets.whole & ~unread)
        if not len(keep):
            return
        flags = packets.flags[keep]
        if part.tx is not None:
            flags |= np.where(part.tx[keep], FrameFlag.TX, 0).astype(np.uint16)
        bus = self._buses(part.interface, packets.interface[keep])
        batch = FrameBatch(
            part.t_ns[keep],
            bus,
            packets.can_id[keep],
            flags,
            packets.dlc[keep],
            packets.data[keep],
        )
        found.batch.append(batch)
        found.rows.append(part.rows[keep])
        if part.lost is not None:
            for at in np.flatnonzero(part.lost[keep]).tolist():
                place = keep[at]
                found.lost.append((int(part.rows[place]), int(part.lost[place]), int(bus[at])))

    def _unread(self, part: Packets, rows: Places) -> None:
        for row in rows[:100].tolist():
            self.facts.add_unparsed(0, "a CAN packet that holds no whole classic or FD frame")
            t_ns = max(0, int(part.t_ns[row]))
            self.facts.add_unread(Unread(t_ns, t_ns, 1))
        self.facts.unparsed_count += max(0, len(rows) - 100)

    def _buses(self, interface: str, numbers: NDArray[np.int64]) -> NDArray[np.uint8]:
        out = np.zeros(len(numbers), np.uint8)
        found, first = np.unique(numbers, return_index=True)
        for number in found[np.argsort(first)].tolist():
            name = interface or ("can0" if number < 0 else f"interface {number}")
            if interface and number >= 0:
                name = f"{interface} {number}"
            full = len(self.facts.buses) >= MAX_BUSES and name not in self.facts.buses
            out[numbers == number] = MAX_BUSES - 1 if full else self.facts.bus_number(name)
        return out


class PcapReader(PacketReader):
    """A pcap file: one link type, stamps in us or ns."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "pcap")
        source = CaptureSource(path)
        header = source.read(_HEADER)
        source.close()
        if len(header) < _HEADER:
            raise CaptureError(f"{path}: the pcap file header is cut off")
        self._order, self._unit_ns = PCAP_MAGIC[header[:4]]
        little = self._order == "<"
        self._link_type = int.from_bytes(header[20:24], "little" if little else "big") & 0xFFFF
        self.resolution.written([((0, 0), self._unit_ns)])
        self._begun = False
        self._step = 4

    def _packets(self, data: bytes) -> tuple[list[Packets], int]:
        start = 0 if self._begun else _HEADER
        if len(data) < start:
            return [], 0
        self._begun = True
        view = ByteColumns(data, self._order)
        places, used = self._places(view, start, len(data))
        seconds, fraction = view.u32(places, 0), view.u32(places, 4)
        t_ns = seconds.astype(np.int64) * SECOND_NS + fraction.astype(np.int64) * self._unit_ns
        size = view.u32(places, 8).astype(np.int64)
        rows = np.arange(len(places))
        at = places + _RECORD
        part = Packets(view, at, size, t_ns, self._link_type, self._order, "", rows)
        here = np.array([used], np.intp)
        if len(data) - used >= _RECORD and int(view.u32(here, 8)[0]) > MAX_PACKET:
            self.harm("a packet does not start where the one before it ends")
            return [part], -1
        return [part], used

    def _places(self, view: ByteColumns, start: int, end: int) -> tuple[Places, int]:
        places, used = self._chain(view, start, end)
        odd = end - used >= _RECORD and int(view.u32(np.array([used], np.intp), 8)[0]) % 4
        if self._step == 4 and odd:
            # Packets of odd length are rare, so whole words are tried first.
            self._step = 1
            more, used = self._chain(view, used, end)
            places = np.concatenate((places, more))
        return places, used

    def _chain(self, view: ByteColumns, start: int, end: int) -> tuple[Places, int]:
        sizes = view.words(start, end, 8, self._step)
        lengths = np.where(sizes <= MAX_PACKET, sizes + _RECORD, 0)
        places, used = chained(lengths, self._step, end - start)
        return places + start, used + start
