"""PDOs as columns of engineering values by their mapping (CiA 301 7.5.2.36, 7.5.2.38)."""

from collections.abc import Callable, Sequence
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.canopen.datatypes import DATA_TYPES
from syncline_schemas.devices import Device
from syncline_schemas.records import dataclass

Number = NDArray[np.int64] | NDArray[np.uint64] | NDArray[np.float64]
Lookup = Callable[[int, int], int | None]
"""(index, sub) -> value of an object as far as it is known."""
EntryKind = Literal["signed", "unsigned", "float", "dummy"]

_FIRST_OBJECT = 0x20
"""Indexes below are data types: a mapping uses them as padding (CiA 301 7.4.7)."""


@dataclass(frozen=True, slots=True)
class MappedObject:
    """One entry of a mapping: `bits` long, from bit `offset` of the PDO on.

    Bit 0 is the lowest of the first byte.

    `unit` and `scale` give the engineering value raw * scale. `scale_assumed` says that the scale
    rests on an object that nobody has read. A dummy entry (index below 20h) carries nothing.
    """

    index: int
    sub: int
    bits: int
    offset: int
    name: str
    kind: EntryKind = "unsigned"
    unit: str = ""
    scale: float = 1.0
    scale_assumed: bool = False


@dataclass(frozen=True, slots=True)
class PdoMapping:
    """Layout of a PDO: its entries in order."""

    entries: tuple[MappedObject, ...]

    @property
    def bits(self) -> int:
        """Length of everything that is mapped [bits]."""
        return sum(entry.bits for entry in self.entries)

    @property
    def length(self) -> int:
        """Length of a complete frame [bytes]."""
        return (self.bits + 7) // 8

    @classmethod
    def from_objects(
        cls, values: Sequence[int], device: Device | None = None, number: Lookup | None = None
    ) -> Self:
        """Mapping from the values of 1A0xh:1.. or 160xh:1.. (index << 16 | sub << 8 | bits).

        Names, units and types come from the device; without one an entry is called "6004h:00"
        and is unsigned. `number` looks up objects that a scale depends on.

        >>> [(e.name, e.bits, e.offset) for e in PdoMapping.from_objects([0x60040020]).entries]
        [('6004h:00', 32, 0)]
        """
        entries: list[MappedObject] = []
        offset = 0
        for value in values:
            entries.append(_entry(value, offset, device, number))
            offset += entries[-1].bits
        return cls(tuple(entries))


def _entry(value: int, offset: int, device: Device | None, number: Lookup | None) -> MappedObject:
    index, sub, bits = value >> 16 & 0xFFFF, value >> 8 & 0xFF, value & 0xFF
    facts = device.object(index, sub) if device else None
    if index < _FIRST_OBJECT:
        return MappedObject(index, sub, bits, offset, "dummy", "dummy")
    if facts is None:
        return MappedObject(index, sub, bits, offset, f"{index:04X}h:{sub:02X}")
    scale, assumed = facts.scale, False
    if facts.scale_object is not None:
        known = number(*facts.scale_object) if number else None
        assumed = known is None
        default = device.default(*facts.scale_object, 0) if device and assumed else known
        scale *= default if isinstance(default, int) else 1
    return MappedObject(
        index,
        sub,
        bits,
        offset,
        facts.full_name,
        _kind(facts.data_type, bits),
        facts.unit,
        scale,
        assumed,
    )


def _kind(data_type: int | None, bits: int) -> EntryKind:
    known = DATA_TYPES.get(data_type) if data_type is not None else None
    if known is not None and known.kind == "signed":
        return "signed"
    return (
        "float" if known is not None and known.kind == "float" and bits in (32, 64) else "unsigned"
    )


@dataclass(frozen=True, slots=True, eq=False)
class PdoColumn:
    """Values of one mapped object.

    Attributes:
        entry: what it is.
        raw: (n,) int64; uint64 for an unsigned entry of 64 bits; float64 for float entries.
        valid: (n,) bool, False where the frame is too short to hold the entry.
    """

    entry: MappedObject
    raw: Number
    valid: NDArray[np.bool_]

    @property
    def value(self) -> NDArray[np.float64]:
        """(n,) float64 engineering values, NaN where not valid."""
        scaled: NDArray[np.float64] = np.where(self.valid, self.raw * self.entry.scale, np.nan)
        return scaled


def decode_pdo(
    mapping: PdoMapping, data: NDArray[np.uint8], dlc: NDArray[np.uint8]
) -> list[PdoColumn]:
    """Columns of a PDO's mapped objects, in mapping order without the dummies.

    Entries of no bits, of more than 64 bits, or beyond the frame's end have no valid row.

    Args:
        mapping: layout of the PDO.
        data: (n, 8) or (n, 64) uint8.
        dlc: (n,) uint8, length of each frame in bytes.
    """
    return [_column(entry, data, dlc) for entry in mapping.entries if entry.kind != "dummy"]


def _column(entry: MappedObject, data: NDArray[np.uint8], dlc: NDArray[np.uint8]) -> PdoColumn:
    end = entry.offset + entry.bits
    if not 0 < entry.bits <= 64 or end > data.shape[1] * 8:
        nothing = np.zeros(len(data), np.int64)
        return PdoColumn(entry, nothing, np.zeros(len(data), np.bool_))
    valid = dlc >= (end + 7) // 8
    return PdoColumn(entry, _typed(entry, _bits(data, entry.offset, entry.bits)), valid)


def _bits(data: NDArray[np.uint8], offset: int, bits: int) -> NDArray[np.uint64]:
    """(n,) uint64 of `bits` bits from bit `offset` on, little-endian as CiA 301 7.1.4 has it."""
    first, shift = divmod(offset, 8)
    width = (shift + bits + 7) // 8
    window = np.zeros((len(data), 8), np.uint8)
    window[:, : min(width, 8)] = data[:, first : first + min(width, 8)]
    value: NDArray[np.uint64] = window.view("<u8")[:, 0].astype(np.uint64) >> np.uint64(shift)
    if width > 8:
        value |= data[:, first + 8].astype(np.uint64) << np.uint64(64 - shift)
    return value & np.uint64((1 << bits) - 1)


def _typed(entry: MappedObject, value: NDArray[np.uint64]) -> Number:
    if entry.kind == "float":
        narrow = entry.bits == 32
        return (
            value.astype(np.uint32).view(np.float32) if narrow else value.view(np.float64)
        ).astype(np.float64)
    if entry.kind == "signed":
        spare = np.int64(64 - entry.bits)
        return value.view(np.int64) << spare >> spare
    return value if entry.bits == 64 else value.view(np.int64)
