"""pcapng: sections, interfaces with their own resolution, packets, counts of dropped frames."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.readers.chain import chained
from syncline_analyzer.readers.magic import PCAPNG_MAGIC
from syncline_analyzer.readers.pcap import MAX_PACKET, PacketReader, Packets
from syncline_analyzer.readers.times import SECOND_NS
from syncline_schemas.byte_columns import ByteColumns, ByteOrder, Column, Places
from syncline_schemas.records import dataclass

SECTION, INTERFACE, OLD_PACKET, SIMPLE_PACKET, STATISTICS, PACKET = 0x0A0D0D0A, 1, 2, 3, 5, 6
BYTE_ORDER_MAGIC: Final = 0x1A2B3C4D
_ORDER_OF_MAGIC: Final[dict[bytes, ByteOrder]] = {
    b"\x4d\x3c\x2b\x1a": "<",
    b"\x1a\x2b\x3c\x4d": ">",
}
_OPTION_NAME, _OPTION_SPEED, _OPTION_RESOLUTION, _OPTION_OFFSET = 2, 8, 9, 14
_OPTION_IF_DROP, _OPTION_OS_DROP = 5, 7
_OPTION_FLAGS, _OPTION_DROPCOUNT = 2, 4
_UNKNOWN_DROPS: Final = 0xFFFF
_MAX_OPTIONS: Final = 8
"""Options of a packet that are looked at."""
_MAX_T: Final = 1 << 62
_MAX_RESTARTS: Final = 1000
"""Changes of the byte order and damaged places; a file with more is not worth the time."""


@dataclass(frozen=True, slots=True)
class _Interface:
    """What a section says of one of its interfaces.

    A tick is 10^-exponent s, or 2^-exponent s when `binary`.
    """

    name: str
    link_type: int
    exponent: int
    binary: bool
    offset_ns: int

    def t_ns(self, high: Column, low: Column) -> NDArray[np.int64]:
        """Times of stamps; -1 where there is no such time."""
        ticks = (high << np.uint64(32)) | low
        if self.binary:
            shift = min(self.exponent, 63)
            seconds, rest = ticks >> shift, ticks & ((1 << shift) - 1)
            cut = max(0, shift - 33)
            fraction = ((rest >> cut) * SECOND_NS) >> (shift - cut)
        else:
            worth = 10 ** min(self.exponent, 19)
            seconds, rest = ticks // worth, ticks % worth
            down = 10 ** max(0, min(self.exponent, 19) - 9)
            fraction = rest // down * 10 ** max(0, 9 - self.exponent)
        bad = seconds >= _MAX_T // SECOND_NS
        t_ns = np.where(bad, 0, seconds).astype(np.int64) * SECOND_NS + fraction.astype(np.int64)
        return np.where(bad, -1, t_ns + np.int64(self.offset_ns))

    @property
    def step_ns(self) -> int:
        """What a stamp's last digit is worth [ns]."""
        return 1 if self.binary else 10 ** max(0, 9 - self.exponent)


class PcapngReader(PacketReader):
    """A pcapng file; interfaces of the same name are the same bus."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "pcapng")
        self._order: ByteOrder = "<"
        self._interfaces: list[_Interface] = []
        self._restarts = 0
        self._row = 0
        self._before_ns = 0

    def _packets(self, data: bytes) -> tuple[list[Packets], int]:
        self._row = 0
        parts: list[Packets] = []
        view, at = ByteColumns(data), 0
        while len(data) - at >= 12:
            self._turn(data, at)
            if self._restarts > _MAX_RESTARTS:
                self.harm("the byte order changes again and again")
                return parts, -1
            view = view.ordered(self._order)
            places, end = self._chain(view, at, len(data))
            at = end
            for run in self._runs(view, data, places):
                if isinstance(run, int):
                    at = run
                    break
                parts += self._parts(view, run)
            if at == end and not self._is_turn(data, at):
                state = self._after(view, data, at)
                if state == at:
                    break
                at = state
                if at < 0:
                    return parts, -1
        return parts, at

    def _is_turn(self, data: bytes, at: int) -> bool:
        """Whether a section in another byte order begins here."""
        order = _ORDER_OF_MAGIC.get(data[at + 8 : at + 12])
        return data[at : at + 4] == PCAPNG_MAGIC and order is not None and order != self._order

    def _turn(self, data: bytes, at: int) -> None:
        if self._is_turn(data, at):
            self._restarts += 1
            self._order = ">" if self._order == "<" else "<"

    def _after(self, view: ByteColumns, data: bytes, at: int) -> int:
        """Where to go on behind the last whole block: there, or behind what is damaged; -1 nowhere."""
        if len(data) - at < 12:
            return at
        length = int(view.u32(np.array([at], np.intp), 4)[0])
        if 12 <= length <= MAX_PACKET and length % 4 == 0 and at + length > len(data):
            return at
        self.harm("a block does not start where the one before it ends")
        self._restarts += 1
        words = np.arange(at + 4 - at % 4, len(data) - 12, 4)
        lengths = view.u32(words, 4).astype(np.int64)
        likely = (view.u32(words, 0) == PACKET) & (lengths >= 32) & (lengths <= MAX_PACKET)
        words, lengths = words[likely], lengths[likely]
        again = words[view.u32(words + lengths, -4) == lengths.astype(np.uint64)]
        return int(again[0]) if len(again) else -1

    def _chain(self, view: ByteColumns, at: int, end: int) -> tuple[Places, int]:
        sizes = view.words(at, end, 4)
        lengths = np.where((sizes >= 12) & (sizes <= MAX_PACKET), sizes, 0)
        places, used = chained(lengths, 4, end - at)
        return places + at, used + at

    def _runs(self, view: ByteColumns, data: bytes, places: Places) -> Iterator[Places | int]:
        """Blocks between those that change what the others mean; a place where all changes."""
        kinds = view.u32(places, 0)
        start = 0
        special = np.isin(kinds, (SECTION, INTERFACE, STATISTICS))
        for i in np.flatnonzero(special).tolist():
            yield places[start:i]
            start = i + 1
            at = int(places[i])
            if kinds[i] == SECTION:
                self._interfaces = []
                if self._is_turn(data, at):
                    yield at
                    return
                continue
            body = data[at + 8 : at + int(view.u32(places[i : i + 1], 4)[0]) - 4]
            if kinds[i] == INTERFACE:
                self._add_interface(body)
            else:
                self._statistics(body)
        yield places[start:]

    def _number(self, raw: bytes) -> int:
        return int.from_bytes(raw, "little" if self._order == "<" else "big")

    def _options(self, body: bytes) -> Iterator[tuple[int, bytes]]:
        at = 0
        while at + 4 <= len(body):
            code, size = self._number(body[at : at + 2]), self._number(body[at + 2 : at + 4])
            if code == 0:
                return
            yield code, body[at + 4 : at + 4 + size]
            at += 4 + size + -size % 4

    def _add_interface(self, body: bytes) -> None:
        options = dict(self._options(body[8:]))
        raw = options.get(_OPTION_RESOLUTION, b"\x06")[:1] or b"\x06"
        offset_s = self._number(options.get(_OPTION_OFFSET, b""))
        offset_s -= 1 << 64 if offset_s >= 1 << 63 else 0
        name = options.get(_OPTION_NAME, b"").rstrip(b"\0").decode("utf-8", "replace")
        name = name or (f"interface {len(self._interfaces)}" if self._interfaces else "")
        interface = _Interface(
            name,
            self._number(body[:2]),
            raw[0] & 0x7F,
            bool(raw[0] & 0x80),
            max(-_MAX_T, min(_MAX_T, offset_s * SECOND_NS)),
        )
        self._interfaces.append(interface)
        speed = self._number(options.get(_OPTION_SPEED, b""))
        if name and 0 < speed <= 10**7:
            self.facts.bitrates[name] = speed

    def _statistics(self, body: bytes) -> None:
        options = dict(self._options(body[12:]))
        dropped = sum(
            self._number(options.get(code, b"")) for code in (_OPTION_IF_DROP, _OPTION_OS_DROP)
        )
        interface = self._interface(self._number(body[:4]))
        if dropped and interface is not None:
            name = interface.name or "can0"
            note = f"{dropped} frame(s) of {name} were dropped while it was captured"
            if note not in self.facts.notes and len(self.facts.notes) < 100:
                self.facts.notes.append(note)

    def _interface(self, number: int) -> _Interface | None:
        return self._interfaces[number] if number < len(self._interfaces) else None

    def _parts(self, view: ByteColumns, places: Places) -> list[Packets]:
        """Packets of a run of blocks, by interface."""
        kinds = view.u32(places, 0)
        wanted = np.isin(kinds, (PACKET, OLD_PACKET, SIMPLE_PACKET))
        places, kinds = places[wanted], kinds[wanted]
        if not len(places):
            return []
        rows = np.arange(self._row, self._row + len(places))
        self._row += len(places)
        simple, old = kinds == SIMPLE_PACKET, kinds == OLD_PACKET
        number = np.where(old, view.u16(places, 8), view.u32(places, 8)).astype(np.int64)
        number[simple] = 0
        total = view.u32(places, 4).astype(np.int64)
        body = np.where(simple, 12, 28)
        room = np.maximum(total - body - 4, 0)
        size = np.where(simple, view.u32(places, 8), view.u32(places, 20)).astype(np.int64)
        size = np.minimum(size, room)
        t_ns = self._times(view, places, number)
        if simple.any():
            # Such packets have no times: each takes that of the packet before it.
            last = np.maximum.accumulate(np.where(simple, -1, np.arange(len(places))))
            t_ns = np.where(last < 0, self._before_ns, t_ns[last])
        self._before_ns = int(t_ns[-1])
        tx, lost = self._packet_options(view, places + body + size + -size % 4, places + total - 4)
        drops = view.u16(places, 10).astype(np.int64)
        lost = np.where(old, np.where(drops == _UNKNOWN_DROPS, 0, drops), lost)
        tx[simple], lost[simple] = False, 0
        at = places + body
        parts = []
        for one in np.unique(number).tolist():
            chosen = number == one
            interface = self._interface(one)
            if interface is None:
                self.harm(f"packets of interface {one}, which is not described")
                continue
            parts.append(
                Packets(
                    view,
                    at[chosen],
                    size[chosen],
                    t_ns[chosen],
                    interface.link_type,
                    self._order,
                    interface.name,
                    rows[chosen],
                    tx[chosen],
                    lost[chosen],
                )
            )
        return parts

    def _times(
        self, view: ByteColumns, places: Places, number: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        t_ns = np.zeros(len(places), np.int64)
        high, low = view.u32(places, 12), view.u32(places, 16)
        for one in np.unique(number).tolist():
            interface = self._interface(one)
            if interface is not None:
                rows = number == one
                t_ns[rows] = interface.t_ns(high[rows], low[rows])
                self.resolution.written([((0, 0), interface.step_ns)])
        return t_ns

    def _packet_options(
        self, view: ByteColumns, at: Places, end: Places
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """Of each packet, whether it was sent, and how many were lost before it."""
        tx, lost = np.zeros(len(at), np.bool_), np.zeros(len(at), np.int64)
        at = at.copy()
        for _ in range(_MAX_OPTIONS):
            code, size = view.u16(at, 0), view.u16(at, 2).astype(np.int64)
            more = (at + 4 + size <= end) & (code != 0)
            if not more.any():
                break
            flags = more & (code == _OPTION_FLAGS) & (size == 4)
            tx |= flags & ((view.u32(at, 4) & 3) == 2)
            count = more & (code == _OPTION_DROPCOUNT) & (size == 8)
            lost = np.where(count, np.minimum(view.u64(at, 4), _MAX_T), lost).astype(np.int64)
            at = np.where(more, at + 4 + size + -size % 4, end)
        return tx, lost
