"""Faults of identifiers, PDOs and their mappings (CiA 301 7.3.5 and 7.5.2, CiA 306 4.6.2)."""

from collections.abc import Iterator

from syncline_schemas.canopen.datatypes import DATA_TYPES
from syncline_schemas.devices.check.sheet import Fault, Sheet
from syncline_schemas.eds_repair import number
from syncline_schemas.records import dataclass

_OFF, _WIDE = 1 << 31, 1 << 29
_BITS_11_TO_28 = 0x1FFF_F800
_RESERVED_TYPES = range(241, 252)
_FRAME_BITS = 64
_MULTIPLEXED = (254, 255)
_RESTRICTED = (
    range(0x080), range(0x101, 0x181), range(0x581, 0x600), range(0x601, 0x680),
    range(0x6E0, 0x800),
)  # fmt: skip
_USUAL = {(0x1014, 0): 0x80, (0x1200, 1): 0x600, (0x1200, 2): 0x580}
"""Offsets to the node id in the predefined connection set, of what is no PDO."""
_OF_ALL_NODES = {0x1005: 0x80, 0x1012: 0x100}
"""Identifiers of SYNC and TIME."""


@dataclass(frozen=True, slots=True)
class _PdoKind:
    name: str
    parameter: int
    mapping: int
    first_id: int
    count_key: str

    def usual(self, k: int) -> int | None:
        """Identifier of the k-th PDO (from 0) less the node id, by the predefined connection set."""
        return self.first_id + 0x100 * k if k < 4 else None


_KINDS = (
    _PdoKind("RPDO", 0x1400, 0x1600, 0x200, "nrofrxpdo"),
    _PdoKind("TPDO", 0x1800, 0x1A00, 0x180, "nroftxpdo"),
)


def pdo_faults(sheet: Sheet) -> Iterator[Fault]:
    """Faults of COB-IDs and PDOs."""
    for (index, sub), base in _USUAL.items():
        yield from _identifier(sheet, index, sub, base)
    for index, usual in _OF_ALL_NODES.items():
        value = sheet.value(index, 0)
        if value is not None and value & 0x1FFF_FFFF != usual:
            text = f"default is {sheet.written(index, 0, 'defaultvalue')}, usual is {usual:X}h"
            yield sheet.fault("cob_id_unusual", (index, None), text, at="defaultvalue")
    for kind in _KINDS:
        yield from _of_kind(sheet, kind)
    yield from _identifiers_twice(sheet)
    yield from _granularity(sheet)


def _granularity(sheet: Sheet) -> Iterator[Fault]:
    granularity = sheet.info("granularity") or 1
    places = [i for i in sheet.indexes if any(0 <= i - kind.mapping < 512 for kind in _KINDS)]
    mapped = [sheet.value(index, sub) or 0 for index in places for sub in sheet.subs(index) if sub]
    finer = [entry & 0xFF for entry in mapped if entry & 0xFF and (entry & 0xFF) % granularity]
    if finer and granularity <= _FRAME_BITS:
        text = f"Granularity is {granularity}, {len(finer)} mapped objects are no multiple of it"
        yield sheet.general("mapping_granularity", "DeviceInfo", text, at="granularity")


def _of_kind(sheet: Sheet, kind: _PdoKind) -> Iterator[Fault]:
    parameters = [i - kind.parameter for i in sheet.indexes if 0 <= i - kind.parameter < 512]
    mappings = [i - kind.mapping for i in sheet.indexes if 0 <= i - kind.mapping < 512]
    compact = bool(sheet.info("compactpdo"))
    for k in sorted(set(parameters) ^ set(mappings)):
        there, missing = kind.parameter + k, kind.mapping + k
        if k in mappings:
            there, missing = missing, there
        text = f"{kind.name}{k + 1} has no {missing:04X}h beside it"
        yield sheet.fault("pdo_pair", (there, None), text)
    stated = sheet.info(kind.count_key)
    if stated is not None and stated != len(parameters) and not compact:
        text = f"{stated} {kind.name}s are said, {len(parameters)} are described"
        yield sheet.general("pdo_count", "DeviceInfo", text, at=kind.count_key)
    for k in parameters:
        yield from _identifier(sheet, kind.parameter + k, 1, kind.usual(k), pdo=True)
        yield from _transmission(sheet, kind.parameter + k)
    for k in mappings:
        yield from _mapping(sheet, kind, kind.mapping + k)


def _identifier(
    sheet: Sheet, index: int, sub: int, base: int | None, *, pdo: bool = False
) -> Iterator[Fault]:
    value = sheet.value(index, sub)
    if value is None or value & _OFF:
        return
    key, at = sheet.key(index, sub), "defaultvalue"
    if value & _WIDE:
        return
    if value & _BITS_11_TO_28:
        yield sheet.fault("cob_id_bits", key, f"the default {value:X}h is no 11-bit one", at=at)
        return
    can_id = value & 0x7FF
    lacks_node = can_id == base and not _relative(sheet, index, sub)
    if pdo and not lacks_node and any(can_id in span for span in _RESTRICTED):
        node = " of node 1" if _relative(sheet, index, sub) else ""
        text = f"identifier {can_id:03X}h{node} is restricted"
        yield sheet.fault("cob_id_restricted", key, text, at=at)
        return
    yield from _usual(sheet, index, sub, base, can_id)


def _usual(sheet: Sheet, index: int, sub: int, base: int | None, can_id: int) -> Iterator[Fault]:
    key, at = sheet.key(index, sub), "defaultvalue"
    if base is None or sheet.written(index, sub, "parametervalue"):
        return
    if _relative(sheet, index, sub):
        if can_id - 1 != base:
            text = f"default is $NODEID+{can_id - 1:X}h, usual is $NODEID+{base:X}h"
            yield sheet.fault("cob_id_unusual", key, text, at=at)
    elif can_id == base:
        text = f"default {can_id:X}h is the identifier of no node"
        yield sheet.fault("cob_id_node", key, text, f"write $NODEID+0x{base:X}", at=at)
    elif base < can_id < base + 0x80:
        text = f"default {can_id:X}h is fixed to node {can_id - base}"
        yield sheet.fault("cob_id_fixed", key, text, f"write $NODEID+0x{base:X}", at=at)
    else:
        text = f"default is {can_id:X}h, usual is $NODEID+{base:X}h"
        yield sheet.fault("cob_id_unusual", key, text, at=at)


def _relative(sheet: Sheet, index: int, sub: int) -> bool:
    return sheet.entry(index, sub).get("DefaultValue", "").startswith("$NODEID")


def _identifiers_twice(sheet: Sheet) -> Iterator[Fault]:
    first: dict[int, int] = {}
    for index in sheet.indexes:
        if any(0 <= index - kind.parameter < 512 for kind in _KINDS):
            value = sheet.value(index, 1)
            if value is None or value & _OFF or not value & 0x1FFF_FFFF:
                continue
            other = first.setdefault(value & 0x3FFF_FFFF & ~(1 << 30), index)
            if other != index:
                text = (
                    f"identifier {value & 0x1FFF_FFFF:X}h (for node 1) is that of {other:04X}h too"
                )
                yield sheet.fault("cob_id_twice", sheet.key(index, 1), text, at="defaultvalue")


def _transmission(sheet: Sheet, index: int) -> Iterator[Fault]:
    value = sheet.value(index, 2)
    if value in _RESERVED_TYPES:
        text = f"transmission type {value} is reserved"
        yield sheet.fault("transmission", sheet.key(index, 2), text, at="defaultvalue")


def _mapping(sheet: Sheet, kind: _PdoKind, index: int) -> Iterator[Fault]:
    subs = [sub for sub in sheet.subs(index) if sub]
    entries = {sub: sheet.value(index, sub) for sub in subs}
    count = sheet.value(index, 0)
    if count is None:
        count = len([value for value in entries.values() if value])
    if count in _MULTIPLEXED or not subs:
        return
    if count > max(subs):
        text = f"says that {count} objects are mapped, {max(subs)} are described"
        yield sheet.fault("mapping_count", sheet.key(index, 0), text, at="defaultvalue")
    total = 0
    for sub in (sub for sub in subs if sub <= count):
        entry = entries[sub]
        if entry == 0:
            text = f"is mapped by subindex 0 ({count}) and holds no object"
            yield sheet.fault("mapping_empty", (index, sub), text, at="defaultvalue")
        elif entry is not None:
            total += entry & 0xFF
            yield from _mapped(sheet, kind, (index, sub), entry)
    if total > _FRAME_BITS:
        yield sheet.fault("mapping_too_long", (index, None), f"maps {total} bits, a frame holds 64")


def _mapped(sheet: Sheet, kind: _PdoKind, key: tuple[int, int], entry: int) -> Iterator[Fault]:
    index, sub, bits = entry >> 16 & 0xFFFF, entry >> 8 & 0xFF, entry & 0xFF
    name, at = f"{index:04X}h:{sub:02X}", "defaultvalue"
    if sheet.written(*key, "parametervalue"):
        at = "parametervalue"
    if index in DATA_TYPES:
        yield from _dummy(sheet, kind, key, index)
        return
    variable = sheet.variables.get((index, sub))
    if variable is None:
        text = f"maps {name}, which is not described"
        yield sheet.fault("mapping_missing", key, text, at=at)
        return
    known = DATA_TYPES.get(variable.data_type or 0)
    if known is not None and known.bits is not None and known.bits != bits:
        text = f"maps {bits} bits of {name}, which is {known.name}"
        write = f"write 0x{entry & ~0xFF | known.bits:08X}"
        yield sheet.fault("mapping_length", key, text, write, at=at)
    if not variable.pdo_mappable:
        text = f"maps {name}, whose PDOMapping is 0"
        yield sheet.fault("mapping_not_allowed", key, text, at=at)
    wrong = ("wo",) if kind.name == "TPDO" else ("ro", "const")
    if variable.access_type in wrong:
        text = f"a {kind.name} maps {name}, whose AccessType is {variable.access_type}"
        yield sheet.fault("mapping_direction", key, text, at=at)


def _dummy(sheet: Sheet, kind: _PdoKind, key: tuple[int, int], code: int) -> Iterator[Fault]:
    name = DATA_TYPES[code].name
    if kind.name == "TPDO":
        yield sheet.fault(
            "dummy_tpdo", key, f"maps the dummy {name} into a TPDO", at="defaultvalue"
        )
        return
    usage = sheet.section("DummyUsage")
    allowed = number(usage.get(f"dummy{code:04x}") or "0") if usage else 0
    if not allowed:
        text = f"maps the dummy {name}, which [DummyUsage] does not allow"
        yield sheet.fault("dummy_forbidden", key, text, at="defaultvalue")
