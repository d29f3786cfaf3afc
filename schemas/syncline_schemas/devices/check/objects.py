"""Faults of single objects (CiA 301 7.4 and 7.5.2, CiA 306 4.6)."""

import re
from collections.abc import Iterator

from syncline_schemas.canopen.datatypes import DATA_TYPES, type_name
from syncline_schemas.canopen.objects import standard_object
from syncline_schemas.devices.check.sheet import Fault, Sheet, fault

_MANDATORY = {0x1000: "device type", 0x1001: "error register"}
_READ_ONLY = (0x1000, 0x1001, 0x1018)
_COUNTED = (range(0x1003, 0x1004), range(0x1600, 0x1800), range(0x1A00, 0x1C00))
"""Objects whose subindex 0 counts what is in use, not what is described."""
_OTHER_SUB0 = (0x1004,)
"""Number of PDOs, an UNSIGNED32 in the first versions of CiA 301."""
_NUMBERS = ("bool", "signed", "unsigned")
_NODE_ID = re.compile(r"\$NODEID(\s*\+\s*(0[xX][0-9A-Fa-f]+|\d+))?")
_ENTRY_KEYS = {"defaultvalue": "DefaultValue", "parametervalue": "ParameterValue"}
_IDENTITY = (
    (1, "vendornumber", "VendorNumber", "identity"),
    (2, "productnumber", "ProductNumber", "identity"),
    (3, "revisionnumber", "RevisionNumber", "revision"),
)


def object_faults(sheet: Sheet) -> Iterator[Fault]:
    """Faults of every object by itself."""
    yield from _mandatory(sheet)
    yield from _identity(sheet)
    for index in sheet.indexes:
        yield from _structure(sheet, index)
    for index, sub in sheet.variables:
        yield from _variable(sheet, index, sub)


def _mandatory(sheet: Sheet) -> Iterator[Fault]:
    for index, name in _MANDATORY.items():
        if not sheet.has(index):
            text = f"mandatory object {index:04X}h ({name}) is missing"
            yield fault("mandatory", "file", None, text)
    if not sheet.has(0x1018):
        yield fault(
            "identity_missing", "file", None, "mandatory object 1018h (identity) is missing"
        )
    if not sheet.has(0x1017) and not (sheet.has(0x100C) and sheet.has(0x100D)):
        text = "neither heartbeat (1017h) nor node guarding (100Ch, 100Dh) is described"
        yield fault("error_control", "file", None, text)


def _identity(sheet: Sheet) -> Iterator[Fault]:
    for sub, key, name, kind in _IDENTITY:
        stated, default = sheet.info(key), sheet.value(0x1018, sub)
        if stated and default and stated != default:
            text = f"default is {default:#x}, {name} in [DeviceInfo] is {stated:#x}"
            yield sheet.fault(kind, (0x1018, sub), text, at="defaultvalue")


def _structure(sheet: Sheet, index: int) -> Iterator[Fault]:
    subs = sheet.subs(index)
    head = sheet.loaded.objects.written.get((index, None))
    if head is not None and head.values and not head.get("parametername"):
        yield sheet.fault("name_missing", (index, None), "ParameterName is missing")
    known = standard_object(index, 0)
    if known is not None and known.data_type != 0x05 and subs:
        text = f"has subindexes; {known.name} is one {type_name(known.data_type)}"
        yield sheet.fault("object_kind", (index, None), text, at="objecttype")
    if not subs or (head is not None and head.get("compactsubobj")):
        return
    if head is not None and not head.get("subnumber") and head.values and len(subs) > 1:
        text = f"SubNumber is missing, {len(subs)} subindexes are described"
        yield sheet.fault("sub_number", (index, None), text, f"write SubNumber={len(subs)}")
    yield from _sub0(sheet, index, subs)


def _sub0(sheet: Sheet, index: int, subs: list[int]) -> Iterator[Fault]:
    if 0 not in subs:
        yield sheet.fault("sub0_missing", (index, None), "subindex 0 is missing")
        return
    data_type = sheet.variables[index, 0].data_type
    if data_type != 0x05 and index not in _OTHER_SUB0 and sheet.written(index, 0, "datatype"):
        text = f"is {type_name(data_type)}"
        yield sheet.fault("sub0_type", (index, 0), text, at="datatype")
    default, highest = sheet.value(index, 0), max(sub for sub in subs if sub < 0xFF or sub == 0)
    if default is None or any(index in span for span in _COUNTED) or default == highest:
        return
    text = f"says {default}, the highest subindex described is {highest}"
    yield sheet.fault("sub0_value", (index, 0), text, f"write {highest}", at="defaultvalue")


def _variable(sheet: Sheet, index: int, sub: int) -> Iterator[Fault]:
    variable, key = sheet.variables[index, sub], sheet.key(index, sub)
    section = sheet.loaded.objects.written.get(key)
    if section is None:
        return
    if key[1] is not None and not section.get("parametername"):
        yield sheet.fault("name_missing", key, "ParameterName is missing")
    if section.get("datatype") and section.get("accesstype"):
        yield from _as_standard(sheet, index, sub)
    for name, repaired in _ENTRY_KEYS.items():
        stated = section.get(name)
        understood = "$NODEID" in sheet.entry(index, sub).get(repaired, "")
        if understood and not _NODE_ID.fullmatch(stated):
            text = f"{stated[:40]!r}: {_form(stated)}"
            yield sheet.fault("node_id_form", key, text, at=name)
    known = DATA_TYPES.get(variable.data_type or 0)
    if known is None or not section.get("datatype") or sheet.type_unknown(index, sub):
        return
    if variable.pdo_mappable and (known.bits is None or known.bits > 64):
        text = f"is {known.name} and said to be mappable"
        yield sheet.fault("mappable_type", key, text, at="pdomapping")
    if known.kind in _NUMBERS:
        yield from _limits(sheet, index, sub)


def _form(stated: str) -> str:
    """What is unusual about an expression with `$NODEID` that is understood."""
    text = stated.strip()
    if "$" not in text:
        return "NODEID has no $ before it"
    if _NODE_ID.fullmatch(text.upper().replace("0X", "0x")):
        return "$NODEID is not written in capitals"
    if text.upper().startswith("$NODEID"):
        return "what follows $NODEID is not + and one number"
    return "$NODEID does not stand first"


def _as_standard(sheet: Sheet, index: int, sub: int) -> Iterator[Fault]:
    variable, known = sheet.variables[index, sub], standard_object(index, sub)
    key = sheet.key(index, sub)
    if known is not None and variable.data_type != known.data_type and (sub or key[1] is None):
        text = (
            f"is a {type_name(variable.data_type)}; {known.name} is a {type_name(known.data_type)}"
        )
        write = f"write DataType=0x{known.data_type:04X}"
        yield sheet.fault("standard_type", key, text, write, at="datatype")
    if index in _READ_ONLY and variable.access_type not in ("ro", "const"):
        text = f"AccessType is {variable.access_type}: CiA 301 makes it read only"
        yield sheet.fault("standard_access", key, text, at="accesstype")


def _limits(sheet: Sheet, index: int, sub: int) -> Iterator[Fault]:
    variable, key = sheet.variables[index, sub], sheet.key(index, sub)
    low, high = variable.min, variable.max
    if low is not None and high is not None and low > high:
        written = sheet.written(index, sub, "highlimit") or high
        in_type = f" ({written} as {type_name(variable.data_type)})" if written != str(high) else ""
        text = f"LowLimit {low} is above HighLimit {high}{in_type}"
        yield sheet.fault("limits_order", key, text, at="lowlimit")
        return
    if low is not None and low == high:
        return  # both 0 is how editors write that there are none
    for name, words, value in (
        ("defaultvalue", "default", variable.default),
        ("parametervalue", "set value", variable.value),
    ):
        if isinstance(value, int) and not _relative(sheet, index, sub, name):
            below = low is not None and value < low
            if below or (high is not None and value > high):
                text = f"{words} {value} is outside its limits {low} .. {high}"
                yield sheet.fault("outside_limits", key, text, at=name)


def _relative(sheet: Sheet, index: int, sub: int, name: str) -> bool:
    return "nodeid" in sheet.written(index, sub, name).lower()
