"""Sections of an EDS or DCF put into the form that an importer expects (CiA 306 4.6)."""

import re
from dataclasses import field

from syncline_schemas.canopen.datatypes import DATA_TYPES
from syncline_schemas.eds_text import EdsText, Section
from syncline_schemas.records import dataclass

VAR, ARRAY, RECORD = 0x7, 0x8, 0x9
DEFTYPE, DEFSTRUCT = 0x5, 0x6
_OBJECT_TYPE_NAMES = {
    "var": VAR, "array": ARRAY, "record": RECORD, "domain": 0x2, "deftype": DEFTYPE,
    "defstruct": DEFSTRUCT,
}  # fmt: skip
_TYPE_NAMES = {known.name: code for code, known in DATA_TYPES.items()}
_OBJECT_TYPES = {0x2, VAR, ARRAY, RECORD}
DOMAIN = 0x0F
_OBJECT = re.compile(r"(?:0x)?([0-9a-f]{4,8})h?")
_ENTRY = re.compile(r"(?:0x)?([0-9a-f]{4,8})h?[\s_.-]*sub[\s_.-]*(?:0x)?([0-9a-f]{1,8})h?")
_COMPACT = re.compile(r"([0-9a-f]{4})(name|value|denotation|objectlinks)")
LISTS = ("mandatoryobjects", "optionalobjects", "manufacturerobjects")
_GENERAL = {
    "fileinfo", "deviceinfo", "dummyusage", "comments", "tools", "devicecomissioning",
    "devicecommissioning", "supportedmodules", "connectedmodules", "dynamicchannels", *LISTS,
}  # fmt: skip
_MODULE = re.compile(r"(m\d+\w+|tool\d+)")
_EXPRESSION = 200
"""Characters of an expression with $NODEID that are read."""
_ACCESS = {"ro", "wo", "rw", "rwr", "rww", "const"}

Entry = dict[str, str]
"""Normalised keys and values of one variable or object."""


@dataclass(slots=True)
class Objects:
    """Objects by index, each with its own keys and those of its entries by subindex.

    `written` holds the sections they were made of, by index and subindex (None for the object).
    """

    heads: dict[int, Entry] = field(default_factory=dict)
    entries: dict[int, dict[int, Entry]] = field(default_factory=dict)
    written: dict[tuple[int, int | None], Section] = field(default_factory=dict)


def number(text: str) -> int | None:
    """Number as EDS files write it: decimal, 0x or h hexadecimal, octal with a leading 0.

    >>> number("0x1A"), number("1Ah"), number("0x 0000 0010"), number("017"), number("ab")
    (26, 26, 16, 15, None)
    """
    bare = re.sub(r"[\s_]", "", text).rstrip(";,").lower()
    sign = -1 if bare.startswith("-") else 1
    bare = bare.lstrip("+-")
    if match := re.fullmatch(r"0x([0-9a-f]{1,32})", bare) or re.fullmatch(
        r"([0-9a-f]{1,32})h", bare
    ):
        return sign * int(match[1], 16)
    if re.fullmatch(r"0[0-7]{1,32}", bare):
        return sign * int(bare, 8)
    if re.fullmatch(r"[0-9]{1,32}", bare):
        return sign * int(bare)
    if match := re.fullmatch(r"([0-9]{1,32})\.0*", bare):
        return sign * int(match[1])
    return {"true": 1, "yes": 1, "false": 0, "no": 0}.get(bare)


def node_relative(text: str) -> int | None:
    """The offset to `$NODEID` in an expression; None where it is none.

    >>> node_relative("$NODEID+0x180"), node_relative("0x200 + $NodeId"), node_relative("384")
    (384, 512, None)
    """
    bare = re.sub(r"[\s()]", "", text[:_EXPRESSION]).lower()
    if "nodeid" not in bare or len(text) > _EXPRESSION:
        return None
    terms = re.findall(r"([+-]?)([^+-]+)", re.sub(r"\$?nodeid", "$", bare))
    values = [0 if term == "$" else number(sign + term) for sign, term in terms]
    once = sum(term == "$" for _, term in terms) == 1 and ("-", "$") not in terms
    known = [value for value in values if value is not None]
    return sum(known) if once and len(known) == len(values) else None


def objects_of(text: EdsText) -> Objects:
    """All objects of a file, repaired: every section named after an index; warnings go to `text`."""
    heads, entries = _sorted_sections(text)
    found = Objects()
    for index in sorted(heads.keys() | entries.keys()):
        parts = dict(entries.get(index, {}))
        head = heads.get(index)
        if head is None:
            head = Section(f"{index:04X}", next(iter(parts.values())).line)
            said = "the section is missing, only its subindexes are described"
            text.warn(head, said, "head_missing")
        found.written[index, None] = head
        found.written |= {(index, sub): section for sub, section in parts.items()}
        _add_object(text, found, index, head, parts)
    _check_lists(text, found)
    _add_compact_pdos(text, found)
    return found


def _sorted_sections(text: EdsText) -> tuple[dict[int, Section], dict[int, dict[int, Section]]]:
    heads: dict[int, Section] = {}
    entries: dict[int, dict[int, Section]] = {}
    for name, section in text.sections.items():
        if match := _ENTRY.fullmatch(name):
            index, sub = int(match[1], 16), int(match[2], 16)
            if index <= 0xFFFF and sub <= 0xFF:
                _place(text, entries.setdefault(index, {}), sub, section)
                continue
        elif (match := _OBJECT.fullmatch(name)) and int(match[1], 16) <= 0xFFFF:
            _place(text, heads, int(match[1], 16), section)
            continue
        if not (name in _GENERAL or _COMPACT.fullmatch(name) or _MODULE.fullmatch(name)):
            text.warn(section, "unknown section, not used", "unknown_section")
    return heads, entries


def _place(text: EdsText, into: dict[int, Section], key: int, section: Section) -> None:
    if key in into:
        said = f"is the same object as [{into[key].name}], not used"
        text.warn(section, said, "duplicate_section")
    else:
        into[key] = section


def _add_object(
    text: EdsText, found: Objects, index: int, head: Section, parts: dict[int, Section]
) -> None:
    compact = _count(text, head, "compactsubobj")
    object_type = _object_type(text, head, bool(parts) or compact > 0)
    name = head.get("parametername") or f"Object {index:04X}h"
    found.heads[index] = {
        "ParameterName": name,
        "ObjectType": f"0x{object_type:X}",
        "StorageLocation": head.get("storagelocation"),
    }
    if object_type not in (ARRAY, RECORD):
        found.heads[index] |= _variable(text, head, name, object_type)
        return
    subs = found.entries.setdefault(index, {})
    for sub, section in sorted(parts.items()):
        part_name = section.get("parametername") or f"{name} {sub}"
        subs[sub] = _variable(text, section, part_name, _object_type(text, section, False))
    if compact:
        _expand(text, subs, index, head, compact)
    elif (stated := _count(text, head, "subnumber")) != len(parts) and head.get("subnumber"):
        said = f"SubNumber is {stated}, {len(parts)} subindexes are described"
        text.warn(head, said, "sub_number", "subnumber")


def _object_type(text: EdsText, section: Section, has_entries: bool) -> int:
    stated = section.get("objecttype")
    kind = _OBJECT_TYPE_NAMES.get(stated.lower(), number(stated))
    if stated and kind is None:
        text.warn(section, f"ObjectType {stated[:30]!r} is no number", "object_type", "objecttype")
    if has_entries and kind not in (ARRAY, RECORD):
        if kind not in (None, DEFSTRUCT):
            said = f"ObjectType {stated} has subindexes: taken as a record"
            text.warn(section, said, "object_type_subs", "objecttype")
        return RECORD
    if kind in _OBJECT_TYPES:
        assert kind is not None
        return kind if has_entries or kind not in (ARRAY, RECORD) else _empty(text, section, kind)
    if kind not in (None, DEFTYPE):
        said = f"ObjectType {stated} is not used here: taken as a variable"
        text.warn(section, said, "object_type", "objecttype")
    return VAR


def _empty(text: EdsText, section: Section, kind: int) -> int:
    """An array or record without subindexes: a variable when it has a data type of its own."""
    if section.get("datatype") and number(section.get("subnumber") or "0") == 0:
        said = "array or record without subindexes: taken as a variable"
        text.warn(section, said, "no_subs", "objecttype")
        return VAR
    return kind


def _count(text: EdsText, section: Section, key: str) -> int:
    stated = section.get(key)
    value = number(stated) if stated else 0
    if value is None or not 0 <= value <= 0xFF:
        text.warn(section, f"{key} {stated[:30]!r} is no number of subindexes", "sub_number", key)
        return 0
    return value


def _expand(text: EdsText, subs: dict[int, Entry], index: int, head: Section, compact: int) -> None:
    """Write out CompactSubObj (CiA 306 4.6.3.2) with the names and values listed beside it."""
    names = _listed(text, f"{index:04x}name")
    values = _listed(text, f"{index:04x}value")
    name = head.get("parametername") or f"Object {index:04X}h"
    template = _variable(text, head, name, VAR)
    subs.setdefault(
        0,
        {"ParameterName": "Number of entries", "ObjectType": "0x7", "DataType": "0x5",
         "AccessType": "ro", "DefaultValue": str(compact), "PDOMapping": "0"},
    )  # fmt: skip
    for sub in range(1, min(compact, 0xFE) + 1):
        entry = template | {"ParameterName": names.get(sub) or f"{name} {sub}"}
        if sub in values:
            entry["ParameterValue"] = _value(
                text, head, "ParameterValue", values[sub], int(template["DataType"], 0)
            )
        subs.setdefault(sub, entry)


def _listed(text: EdsText, section_name: str) -> dict[int, str]:
    section = text.sections.get(section_name)
    values = section.values if section else {}
    return {int(key): value for key, value in values.items() if re.fullmatch(r"\d{1,3}", key)}


_COMPACT_PDOS = (
    ("nrofrxpdo", "RPDO", 0x1400, 0x1600, 0x100),
    ("nroftxpdo", "TPDO", 0x1800, 0x1A00, 0x80),
)
"""Key of the count, kind, first communication and mapping records, and first identifier."""
_PDO_PARAMETERS = {1: ("COB-ID", "0x7"), 2: ("Transmission type", "0x5"), 3: ("Inhibit time", "0x6"),
                   5: ("Event timer", "0x6"), 6: ("SYNC start value", "0x5")}  # fmt: skip


def _add_compact_pdos(text: EdsText, found: Objects) -> None:
    """Write out the PDOs that CompactPDO leaves to be understood (CiA 306 4.4.2).

    As many as [DeviceInfo] counts and no section describes, in the gaps from the first on. Their
    values are not stated; the first four have their identifiers by the predefined connection set.
    """
    info = text.sections.get("deviceinfo")
    if info is None or not number(info.get("compactpdo") or "0"):
        return
    for key, kind, communication, mapping, first_id in _COMPACT_PDOS:
        missing = min(number(info.get(key) or "0") or 0, 512)
        missing -= sum(communication <= index < communication + 512 for index in found.heads)
        free = [k for k in range(512) if communication + k not in found.heads]
        for k in free[: max(0, missing)]:
            cob_id = f"$NODEID+0x{first_id + 0x100 * (k + 1):X}" if k < 4 else ""
            _add_record(found, communication + k, f"{kind}{k + 1} communication parameter")
            for sub, (what, data_type) in _PDO_PARAMETERS.items():
                value = cob_id if sub == 1 else ""
                found.entries[communication + k][sub] = _implied(what, data_type, value)
        for k in range(512):
            if communication + k in found.heads and mapping + k not in found.heads:
                _add_record(found, mapping + k, f"{kind}{k + 1} mapping parameter")
                for sub in range(1, 9):
                    found.entries[mapping + k][sub] = _implied(f"Mapped object {sub}", "0x7", "")


def _add_record(found: Objects, index: int, name: str) -> None:
    found.heads[index] = {"ParameterName": name, "ObjectType": f"0x{RECORD:X}"}
    found.entries[index] = {0: _implied("Number of entries", "0x5", "")}


def _implied(name: str, data_type: str, default: str) -> Entry:
    entry = {"ParameterName": name, "ObjectType": "0x7", "DataType": data_type, "AccessType": "rw"}
    return entry | {"PDOMapping": "0"} | ({"DefaultValue": default} if default else {})


def _variable(text: EdsText, section: Section, name: str, object_type: int) -> Entry:
    data_type = _data_type(text, section, object_type)
    entry = {
        "ParameterName": name,
        "ObjectType": f"0x{object_type:X}",
        "StorageLocation": section.get("storagelocation"),
        "DataType": f"0x{data_type:04X}",
        "AccessType": _access(text, section),
        "PDOMapping": str(int(bool(number(section.get("pdomapping") or "0")))),
    }
    for key in ("DefaultValue", "ParameterValue", "LowLimit", "HighLimit"):
        if stated := section.get(key.lower()):
            entry[key] = _value(text, section, key, stated, data_type)
    for key in ("Factor", "Description", "Unit"):
        if stated := section.get(key.lower()):
            entry[key] = stated
    return {key: value for key, value in entry.items() if value}


def _data_type(text: EdsText, section: Section, object_type: int) -> int:
    stated = section.get("datatype")
    code = _TYPE_NAMES.get(stated.upper(), number(stated))
    if code is None:
        if object_type != DOMAIN and object_type != 0x2:
            problem = f"DataType {stated[:30]!r} is no number" if stated else "DataType is missing"
            text.warn(section, f"{problem}: the value stays bytes", "data_type", "datatype")
        return DOMAIN
    if code in DATA_TYPES:
        return code
    defined = text.sections.get(f"{code:x}sub1") or text.sections.get(f"{code:04x}sub1")
    base = number(defined.get("defaultvalue")) if defined else None
    if base in DATA_TYPES:
        assert base is not None
        return base
    said = f"DataType {stated} is not known: the value stays bytes"
    text.warn(section, said, "data_type_unknown", "datatype")
    return DOMAIN


def _access(text: EdsText, section: Section) -> str:
    stated = section.get("accesstype").lower()
    if stated in _ACCESS:
        return stated
    said = f"AccessType {stated[:20]!r} is not known" if stated else "AccessType is missing"
    text.warn(section, f"{said}: taken as rw", "access_type", "accesstype")
    return "rw"


def _value(text: EdsText, section: Section, key: str, stated: str, data_type: int) -> str:
    """A value in the form that the importer reads; "" (and a warning) where it makes no sense."""
    kind = DATA_TYPES[data_type].kind
    if kind == "text":
        return stated
    if kind in ("bytes", "time"):
        return _bytes_value(text, section, key, stated)
    if kind == "float":
        return _float_value(text, section, key, stated)
    if (offset := node_relative(stated)) is not None:
        return f"$NODEID+0x{offset:X}" if offset >= 0 else ""
    value = number(stated)
    if value is None:
        wrong = "node_id" if "nodeid" in stated.lower() else "value"
        said = f"{key} {stated[:40]!r} is no number, not used"
        text.warn(section, said, wrong, key.lower())
        return ""
    if re.fullmatch(r"0[0-7]+", stated) and value != int(stated):
        said = f"{key} {stated} is octal by its leading 0: {value}"
        text.warn(section, said, "octal", key.lower())
    _check_range(text, section, f"{key} {stated}", value, data_type)
    return str(_in_type(value, data_type))


def _check_range(text: EdsText, section: Section, said: str, value: int, data_type: int) -> None:
    low, high = _range(data_type)
    if not low <= value <= high and _in_type(value, data_type) == value:
        key = said.partition(" ")[0].lower()
        type_name = DATA_TYPES[data_type].name
        text.warn(section, f"{said} does not fit into {type_name}", "value_range", key)


def _range(data_type: int) -> tuple[int, int]:
    bits = DATA_TYPES[data_type].bits or 64
    if DATA_TYPES[data_type].kind == "signed":
        return -(1 << bits - 1), (1 << bits - 1) - 1
    return 0, (1 << bits) - 1


def _in_type(value: int, data_type: int) -> int:
    """A signed value that is written as the unsigned number of its bits; others stay."""
    low, high = _range(data_type)
    return value + 2 * low if low < 0 and high < value < -2 * low else value


def _bytes_value(text: EdsText, section: Section, key: str, stated: str) -> str:
    digits = re.sub(r"0x|[\s,:-]", "", stated.lower())
    if re.fullmatch(r"([0-9a-f]{2})+", digits):
        return digits
    if number(stated) not in (None, 0):
        text.warn(
            section, f"{key} {stated[:40]!r} is no byte string, not used", "value", key.lower()
        )
    return ""


def _float_value(text: EdsText, section: Section, key: str, stated: str) -> str:
    try:
        return repr(float(stated.replace(",", ".").rstrip("fF") or "x"))
    except ValueError:
        value = number(stated)
    if value is None:
        text.warn(section, f"{key} {stated[:40]!r} is no number, not used", "value", key.lower())
        return ""
    return repr(float(value))


def _check_lists(text: EdsText, found: Objects) -> None:
    """Compare the object lists with the sections; both kinds of difference are told."""
    listed: set[int] = set()
    for name in LISTS:
        section = text.sections.get(name)
        if section is None:
            continue
        numbers = [v for k, v in section.values.items() if k.isdecimal()]
        values = {number(value) for value in numbers if value}
        listed |= {value for value in values if value is not None}
        stated = number(section.get("supportedobjects") or "0")
        if stated != len(numbers):
            said = f"SupportedObjects is {stated}, {len(numbers)} are listed"
            text.warn(section, said, "list_count", "supportedobjects")
    missing = sorted(listed - found.heads.keys())
    extra = sorted(index for index in found.heads.keys() - listed if index >= 0x1000)
    if missing:
        text.warn("file", f"listed but not described: {_hex_list(missing)}", "listed_missing")
    if extra and listed:
        text.warn("file", f"described but not listed: {_hex_list(extra)}", "unlisted")


def _hex_list(indexes: list[int]) -> str:
    shown = ", ".join(f"{index:04X}h" for index in indexes[:20])
    return shown + (f" and {len(indexes) - 20} more" if len(indexes) > 20 else "")
