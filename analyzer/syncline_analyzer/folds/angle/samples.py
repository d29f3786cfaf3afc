"""Where the samples of angle traces come from: TPDOs by their mapping, and SDO reads."""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.pdo_binding import Pdo, PdoBindings, settled
from syncline_analyzer.reads import Reads
from syncline_analyzer.shadow import Known, Shadow
from syncline_schemas.decoder import MappedObject, PdoColumn, PdoMapping, decode_pdo
from syncline_schemas.devices import Device, quirks, standard_device
from syncline_schemas.measurement import measured_by, position_objects
from syncline_schemas.records import dataclass

Key = tuple[int, int, int]
"""(bus number, node, index << 8 | sub) of a trace."""
SDO_SOURCE = -1
VIBRATION_UNITS = ("mm/s", "g")
"""Units of objects that are traced besides angles."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples of one object, in order of `seq`; all (n,).

    `source` is the COB-ID that carried a sample, `SDO_SOURCE` for SDO reads. `valid` is False
    where the frame is too short (`raw` is then the one before), `frozen` True where a sibling moves
    meanwhile, `singular` where an angle means nothing in that pose (None: nowhere). `entry.bits` is
    the width of the widest source, `bits` that of each sample (None: all alike).
    """

    entry: MappedObject
    seq: NDArray[np.int64]
    t_ns: NDArray[np.int64]
    raw: NDArray[np.int64]
    valid: NDArray[np.bool_]
    source: NDArray[np.int64]
    frozen: NDArray[np.bool_] | None = None
    bits: NDArray[np.int64] | None = None
    singular: NDArray[np.bool_] | None = None

    @property
    def told(self) -> NDArray[np.bool_]:
        """Samples (n,) that tell where the shaft or the platform is."""
        told = self.valid
        for bad in (self.frozen, self.singular):
            told = told if bad is None else told & ~bad
        return told

    @property
    def widths(self) -> NDArray[np.int64]:
        """Bits of each sample (n,)."""
        return np.full(len(self.seq), self.entry.bits, np.int64) if self.bits is None else self.bits

    def part(self, begin: int, stop: int) -> "Samples":
        """Samples from one row to before another one."""
        if begin == 0 and stop >= len(self.seq):
            return self
        return self.at(slice(begin, stop))

    def at(self, rows: slice | NDArray[np.intp]) -> "Samples":
        """Some of the samples."""
        return Samples(
            self.entry,
            self.seq[rows],
            self.t_ns[rows],
            self.raw[rows],
            self.valid[rows],
            self.source[rows],
            None if self.frozen is None else self.frozen[rows],
            None if self.bits is None else self.bits[rows],
            None if self.singular is None else self.singular[rows],
        )


class SampleReader:
    """Finds the position-like objects in the frames of a block."""

    def __init__(self, shadow: Shadow, bindings: PdoBindings) -> None:
        self._shadow = shadow
        self._bindings = bindings
        self._reads_seen: dict[int, int] = {}
        self._last_raw: dict[tuple[Key, int], int] = {}
        self._bits: dict[Key, int] = {}
        self._others: dict[int, tuple[int, set[int]]] = {}
        """By bus: a version of the shadow, and identifiers of which it tells no TPDO."""

    def read(self, block: Block, bus: int) -> dict[Key, Samples]:
        """Samples of every trace of a bus in a block."""
        self._bindings.refresh(bus)
        found: dict[Key, list[Samples]] = {}
        for can_id in self._identifiers(block, bus):
            for key, samples in self._from_pdo(block, bus, can_id):
                found.setdefault(key, []).append(samples)
        last_seq = block.batch.last_seq
        for key, samples in self._from_sdo(bus, self._reads_seen.get(bus, -1), last_seq):
            found.setdefault(key, []).append(samples)
        self._reads_seen[bus] = last_seq
        return {key: self._widest(key, joined(parts)) for key, parts in found.items()}

    def _widest(self, key: Key, samples: Samples) -> Samples:
        """Samples of one object that know the width of its widest source so far."""
        widest = max(self._bits.get(key, 0), samples.entry.bits)
        self._bits[key] = widest
        if widest == samples.entry.bits:
            return samples
        return replace(samples, entry=replace(samples.entry, bits=widest), bits=samples.widths)

    def _identifiers(self, block: Block, bus: int) -> list[int]:
        """Identifiers in a block that may carry a TPDO, looked up again when the shadow changes."""
        seen = [can_id for id_bus, can_id in block.batch.ids() if id_bus == bus]
        version = settled(self._shadow, bus, block.batch.seq0 - 1)
        if version is None:
            return seen
        if self._others.get(bus, (None,))[0] != version:
            self._others[bus] = version, set()
        others = self._others[bus][1]
        wanted = [can_id for can_id in seen if can_id not in others]
        tpdos = [can_id for can_id in wanted if _is_tpdo(self._bindings.owner(bus, can_id))]
        others.update(set(wanted).difference(tpdos))
        return tpdos

    def _from_pdo(self, block: Block, bus: int, can_id: int) -> Iterator[tuple[Key, Samples]]:
        rows = block.batch.rows(bus, can_id)
        first, last = block.batch.seq(rows[0]), block.batch.seq(rows[-1])
        cuts = {
            *self._bindings.cuts(bus, can_id, first, last),
            *self._modes(bus, can_id, first, last),
        }
        edges = [first, *sorted(cuts), last + 1]
        for begin, stop in pairwise(edges):
            owner = self._bindings.owner(bus, can_id, begin)
            if owner is None or not _is_tpdo(owner):
                continue
            mapping = self._bindings.mapping(owner, begin)
            low, high = np.searchsorted(block.batch.seqs_at(rows), [begin, stop])
            if mapping is not None and high > low:
                yield from self._decode(block, owner, mapping, rows[low:high], can_id)

    def _modes(self, bus: int, can_id: int, first: int, last: int) -> list[int]:
        """Moments `first < seq <= last` at which the owner measures something else."""
        owner = self._bindings.owner(bus, can_id, last)
        mode = quirks(self._shadow.device(bus, owner.node)).output_mode if owner else None
        if owner is None or mode is None:
            return []
        changes = self._shadow.changes(bus, owner.node, *mode)
        return [seq for seq in changes if first < seq <= last]

    def _decode(
        self, block: Block, owner: Pdo, mapping: PdoMapping, rows: NDArray[np.intp], can_id: int
    ) -> Iterator[tuple[Key, Samples]]:
        device = self._shadow.device(owner.bus, owner.node)
        wanted = {e: t for e in mapping.entries if (t := self._as_traced(owner, device, e))}
        if not wanted or not self._is_measured(owner, device, block.batch.seq(rows[0])):
            return
        frames = block.frames
        for column in decode_pdo(mapping, frames.data[rows], frames.dlc[rows]):
            if column.entry in wanted:
                entry = wanted[column.entry]
                key = (owner.bus, owner.node, entry.index << 8 | entry.sub)
                yield key, self._held(key, can_id, _samples(block, rows, column, entry, can_id))

    def _held(self, key: Key, can_id: int, samples: Samples) -> Samples:
        """The same, with the value before a frame that is too short in its place: it is no jump."""
        rows = np.flatnonzero(samples.valid)
        before = self._last_raw.get((key, can_id))
        if len(rows):
            self._last_raw[key, can_id] = int(samples.raw[rows[-1]])
            before = int(samples.raw[rows[0]]) if before is None else before
        if len(rows) == len(samples.raw) or before is None:
            return samples
        known = np.concatenate(([before], samples.raw[rows]))
        return replace(samples, raw=known[np.cumsum(samples.valid)])

    def _as_traced(
        self, owner: Pdo, device: Device | None, entry: MappedObject
    ) -> MappedObject | None:
        """The entry as its trace shows it; None when it is no measurement."""
        if entry.kind in ("float", "dummy"):
            return None
        if entry.unit in VIBRATION_UNITS:
            return entry
        if (entry.index, entry.sub) in alarm_objects(device):
            return replace(entry, unit="bits")
        device_type = self._shadow.number(owner.bus, owner.node, 0x1000)
        key = entry.index, entry.sub
        by, assumed = measured_by(device, device_type, *key)
        if by is None:
            return None
        if device is None or device.object(*key) is None:
            standard = _entry(by, *key)
            entry = replace(entry, name=standard.name, kind=standard.kind)
        return replace(entry, name=f"{entry.name} ({by.title} assumed)") if assumed else entry

    def _is_measured(self, owner: Pdo, device: Device | None, seq: int) -> bool:
        """False while the device's output mode leaves the PDO's content undefined."""
        facts = quirks(device)
        if facts.output_mode is None:
            return True
        mode = self._shadow.number(owner.bus, owner.node, *facts.output_mode, seq)
        return mode is None or mode not in facts.mode_pdos or owner.number in facts.mode_pdos[mode]

    def _from_sdo(self, bus: int, first: int, last: int) -> Iterator[tuple[Key, Samples]]:
        """Values that were read by SDO at `first < seq <= last`."""
        for node_bus, node in self._shadow.nodes():
            if node_bus != bus:
                continue
            device = self._shadow.device(bus, node)
            if not position_objects(device):
                profile = (self._shadow.number(bus, node, 0x1000) or 0) & 0xFFFF
                device = standard_device(profile) or device
            for index, sub in (*position_objects(device), *alarm_objects(device)):
                entry = _entry(device, index, sub)
                if (index, sub) in alarm_objects(device):
                    entry = replace(entry, unit="bits")
                reads = self._reads(bus, node, entry, first, last)
                if len(reads):
                    yes = np.ones(len(reads), np.bool_)
                    source = np.full(len(reads), SDO_SOURCE, np.int64)
                    raw = _resigned(reads.raw, entry)
                    key = (bus, node, index << 8 | sub)
                    yield key, Samples(entry, reads.seq, reads.t_ns, raw, yes, source)

    def _reads(self, bus: int, node: int, entry: MappedObject, first: int, last: int) -> Reads:
        key = entry.index, entry.sub
        news = [
            known
            for known in changes_within(self._shadow, bus, node, key, first, last)
            if known.source == "sdo-read"
        ]
        return Reads.joined(Reads.of(*news), self._shadow.take_rereads(bus, node, *key, last))


def _is_tpdo(owner: Pdo | None) -> bool:
    """Whether more than the predefined connection set says that it is a TPDO."""
    return owner is not None and not owner.guess and owner.kind == "tpdo"


def alarm_objects(device: Device | None) -> tuple[tuple[int, int], ...]:
    """Objects (index, sub) whose bits are alarms or warnings of the measurement."""
    measured = device.measurement if device else {}
    return tuple(measured[role] for role in ("alarms", "warnings") if role in measured)


def changes_within(
    shadow: Shadow, bus: int, node: int, key: tuple[int, int], first: int, last: int
) -> Iterator[Known]:
    """What became known of an object at `first < seq <= last`; resets leave nothing known."""
    changes = shadow.changes(bus, node, *key)
    for seq in changes[bisect_right(changes, first) : bisect_right(changes, last)]:
        known = shadow.get(bus, node, *key, seq)
        if known is not None and known.seq == seq:
            yield known


def _samples(
    block: Block, rows: NDArray[np.intp], column: PdoColumn, entry: MappedObject, can_id: int
) -> Samples:
    raw = column.raw.astype(np.int64)
    if entry.kind != column.entry.kind and entry.bits < 64:
        half = 1 << entry.bits - 1
        raw = (raw + half) % (2 * half) - half
    return Samples(
        entry,
        block.batch.seqs_at(rows),
        block.frames.t_ns[rows],
        raw,
        column.valid,
        np.full(len(rows), can_id, np.int64),
    )


def _entry(device: Device | None, index: int, sub: int) -> MappedObject:
    """How an object reads when it comes by SDO."""
    facts = device.object(index, sub) if device else None
    bits, signed = _WIDTHS.get(facts.data_type if facts else None, (32, False))
    return MappedObject(
        index,
        sub,
        bits,
        0,
        facts.name if facts else f"{index:04X}h:{sub:02X}",
        "signed" if signed else "unsigned",
        facts.unit if facts else "",
        facts.scale if facts else 1.0,
    )


_WIDTHS: dict[int | None, tuple[int, bool]] = {
    0x02: (8, True),
    0x03: (16, True),
    0x04: (32, True),
    0x05: (8, False),
    0x06: (16, False),
    0x07: (32, False),
}
"""(bits, signed) by data type (CiA 301 table 44)."""


def _resigned(raw: NDArray[np.int64], entry: MappedObject) -> NDArray[np.int64]:
    """The value that the low bits make, as wide as the object is."""
    value: NDArray[np.int64] = raw & (1 << entry.bits) - 1
    negative = (entry.kind == "signed") & (value >> entry.bits - 1 != 0)
    return np.where(negative, value - (1 << entry.bits), value)


def joined(parts: list[Samples]) -> Samples:
    """Samples of several sources as one trace, in order of `seq`."""
    if len(parts) == 1:
        return parts[0]
    seq = np.concatenate([part.seq for part in parts])
    in_order = bool((seq[1:] >= seq[:-1]).all())
    order = slice(None) if in_order else np.argsort(seq, kind="stable")
    bits = max(part.entry.bits for part in parts)
    alike = all(part.bits is None and part.entry.bits == bits for part in parts)
    named = max((part.entry for part in parts), key=lambda entry: bool(entry.name))
    return Samples(
        replace(named, bits=bits),
        seq[order],
        np.concatenate([part.t_ns for part in parts])[order],
        np.concatenate([part.raw for part in parts])[order],
        np.concatenate([part.valid for part in parts])[order],
        np.concatenate([part.source for part in parts])[order],
        _marked([part.frozen for part in parts], order, parts),
        None if alike else np.concatenate([part.widths for part in parts])[order],
        _marked([part.singular for part in parts], order, parts),
    )


def _marked(
    marks: list[NDArray[np.bool_] | None],
    order: slice | NDArray[np.intp],
    parts: list[Samples],
) -> NDArray[np.bool_] | None:
    if all(mark is None for mark in marks):
        return None
    whole = [
        np.zeros(len(part.seq), np.bool_) if mark is None else mark
        for mark, part in zip(marks, parts, strict=True)
    ]
    return np.concatenate(whole)[order]
