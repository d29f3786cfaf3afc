"""EDS, DCF and XDD files as they are found in the wild, imported through python-canopen.

What is wrong in the text is repaired first (`eds_text`, `eds_repair`); the importer then sees a
file without faults, so that it never raises.
"""

import io
import re
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from syncline_schemas.canopen.datatypes import DATA_TYPES, UNICODE_STRING
from syncline_schemas.eds_repair import Entry, Objects, number, objects_of
from syncline_schemas.eds_text import EdsText, EdsWarning, Section, parse
from syncline_schemas.errors import DescriptionError
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    from canopen import ObjectDictionary
    from canopen.objectdictionary import ODVariable

__all__ = ["EdsWarning", "LoadedEds", "assumed_value", "load_eds", "read_eds", "variables"]


MAX_BYTES = 16 << 20
"""Ten times an EDS with ten thousand objects."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadedEds:
    """An object dictionary and what had to be repaired to get it.

    Attributes:
        info: FileInfo, DeviceInfo and DeviceComissioning as text, keys as "deviceinfo.vendorname".
        node_id: node id of a DCF. bitrate: bit rate of a DCF [bit/s].
        text: the sections as written. objects: the same, repaired.
    """

    od: "ObjectDictionary"
    warnings: list[EdsWarning]
    info: dict[str, str] = field(default_factory=dict)
    node_id: int | None = None
    bitrate: int | None = None
    text: EdsText = field(default_factory=EdsText)
    objects: Objects = field(default_factory=Objects)


def load_eds(source: str | Path | bytes, node_id: int | None = None) -> LoadedEds:
    """Load an EDS, DCF, XDD or XDC file, repairing what is wrong in it.

    Args:
        source: path of the file, or its content.
        node_id: node id that `$NODEID` stands for in the dictionary; without one such values stay
            open and `assumed_value` resolves them.

    Raises:
        DescriptionError: the file cannot be read, or nothing in it can be used.
    """
    from syncline_schemas.xdd import looks_like_xml, parse_xdd

    where, data = _content(source)
    text = parse_xdd(data) if looks_like_xml(data) else parse(data)
    objects = objects_of(text)
    if not objects.heads:
        raise DescriptionError(
            f"{where} holds no object: no section is named after an index, like [1000]; "
            f"is it an EDS, DCF or XDD file?{_first(text)}"
        )
    info = _info(text)
    for name in ("FileInfo", "DeviceInfo"):
        if name.lower() not in text.sections:
            text.warn("file", f"section [{name}] is missing", "missing_section")
    od = _imported(text, objects, info, node_id)
    _add_dummies(text, od)
    for variable in variables(od):
        _set_limits(variable, objects)
    if text.untold:
        text.warnings.append(EdsWarning("file", f"and {text.untold} more", "untold"))
    return LoadedEds(od, text.warnings, info, od.node_id, od.bitrate, text, objects)


def _first(text: EdsText) -> str:
    return f" ({text.warnings[0]})" if text.warnings else ""


def read_eds(path: Path) -> bytes:
    """Content of a description file.

    Raises:
        DescriptionError: it cannot be read, or is larger than any EDS.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DescriptionError(f"{path} cannot be read: {reason}") from error
    _check_size(str(path), data)
    return data


def _content(source: str | Path | bytes) -> tuple[str, bytes]:
    if not isinstance(source, bytes):
        return str(source), read_eds(Path(source))
    _check_size("the EDS file", source)
    return "the EDS file", source


def _check_size(where: str, data: bytes) -> None:
    if len(data) > MAX_BYTES:
        raise DescriptionError(f"{where} is larger than {MAX_BYTES >> 20} MiB: no EDS file is")


_NUMBERS = {
    "vendornumber": "VendorNumber",
    "productnumber": "ProductNumber",
    "revisionnumber": "RevisionNumber",
    "simplebootupmaster": "SimpleBootUpMaster",
    "simplebootupslave": "SimpleBootUpSlave",
    "granularity": "Granularity",
    "dynamicchannelssupported": "DynamicChannelsSupported",
    "groupmessaging": "GroupMessaging",
    "nrofrxpdo": "NrOfRXPDO",
    "nroftxpdo": "NrOfTXPDO",
    "lss_supported": "LSS_Supported",
    **{f"baudrate_{rate}": f"BaudRate_{rate}" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)},
}
_TEXTS = {"vendorname": "VendorName", "productname": "ProductName", "ordercode": "OrderCode"}
_COMMISSIONING = ("devicecomissioning", "devicecommissioning")


def _info(text: EdsText) -> dict[str, str]:
    found: dict[str, str] = {}
    for name in ("fileinfo", "deviceinfo", *_COMMISSIONING):
        section = text.sections.get(name)
        kept = "devicecomissioning" if name in _COMMISSIONING else name
        for key, value in section.values.items() if section else ():
            found.setdefault(f"{kept}.{key}", value)
    return found


def _device_info(text: EdsText, info: dict[str, str]) -> Entry:
    entry = {name: info.get(f"deviceinfo.{key}", "") for key, name in _TEXTS.items()}
    for key, name in _NUMBERS.items():
        stated = info.get(f"deviceinfo.{key}")
        value = number(stated) if stated else None
        if value is not None:
            entry[name] = str(value)
        elif stated is not None:
            said = f"{stated[:30]!r} is no number" if stated else "is empty"
            kind = "device_info_number" if stated else "device_info_empty"
            text.warn(text.sections["deviceinfo"], f"{name} {said}, not used", kind, key)
    return entry


def _commissioning(text: EdsText, info: dict[str, str]) -> Entry:
    entry: Entry = {}
    for key, name, high in (("nodeid", "NodeID", 127), ("baudrate", "Baudrate", 1000)):
        stated = info.get(f"devicecomissioning.{key}")
        value = number(stated) if stated else None
        if key == "baudrate" and value is not None and 1000 < value <= 1_000_000:
            said = f"Baudrate {value} is in bit/s, kbit/s is meant"
            text.warn("[DeviceComissioning]", said, "commissioning")
            value //= 1000
        if value is not None and 1 <= value <= high:
            entry[name] = str(value)
        elif stated:
            said = f"{name} {stated[:30]!r} is not usable"
            text.warn("[DeviceComissioning]", said, "commissioning")
    return entry


def _comments(text: EdsText) -> str:
    section = text.sections.get("comments")
    values = section.values.items() if section else ()
    return "\n".join(value for key, value in values if re.fullmatch(r"line\d+", key))


def _imported(
    text: EdsText, objects: Objects, info: dict[str, str], node_id: int | None
) -> "ObjectDictionary":
    sections: dict[str, Entry] = {
        "DeviceInfo": _device_info(text, info),
        "DeviceComissioning": _commissioning(text, info),
    }
    for index, head in objects.heads.items():
        sections[f"{index:04X}"] = head
        for sub, entry in objects.entries.get(index, {}).items():
            sections[f"{index:04X}sub{sub:X}"] = entry
    from syncline_schemas.lean_canopen import import_eds

    with _quiet_importer():
        od: ObjectDictionary = import_eds(io.StringIO(_written(sections)), node_id)
    od.comments = _comments(text)
    return od


def _written(sections: dict[str, Entry]) -> str:
    lines: list[str] = []
    for name, entry in sections.items():
        lines.append(f"[{name}]")
        lines += [f"{key}={value}" for key, value in entry.items() if value]
    return "\n".join(lines) + "\n"


@contextmanager
def _quiet_importer() -> Iterator[None]:
    """What the importer logs is in our own warnings already."""
    import logging

    logger = logging.getLogger("canopen.objectdictionary.eds")
    before = logger.disabled
    logger.disabled = True
    try:
        yield
    finally:
        logger.disabled = before


_DUMMIES = tuple(f"Dummy{code:04d}" for code in range(1, 8))


def _add_dummies(text: EdsText, od: "ObjectDictionary") -> None:
    """Data types that may pad an RPDO mapping (CiA 306 4.6.2): all that are listed, not seven."""
    from syncline_schemas.lean_canopen import ODVariable

    section = text.sections.get("dummyusage") or Section("DummyUsage", 0)
    missing = [key for key in _DUMMIES if not section.get(key.lower())]
    if missing:
        said = f"{', '.join(missing)} missing, taken as not mappable"
        text.warn(section if section.line else "[DummyUsage]", said, "dummy_missing")
    for key, value in section.values.items():
        match = re.fullmatch(r"dummy([0-9a-f]{4})", key)
        code = int(match[1], 16) if match else -1
        if code in DATA_TYPES and number(value) == 1 and code not in od.indices:
            variable = ODVariable(f"Dummy{code:04X}", code, 0)
            variable.data_type = code
            variable.access_type = "const"
            od.add_object(variable)
        elif code not in DATA_TYPES:
            text.warn(section, f"{key[:30]} is not a data type, not used", "dummy_unknown", key)


def variables(od: "ObjectDictionary") -> Iterable["ODVariable"]:
    """Every variable of a dictionary, the entries of arrays and records included."""
    for thing in od.indices.values():
        yield from thing.subindices.values() if hasattr(thing, "subindices") else (thing,)


def _set_limits(variable: Any, objects: Objects) -> None:
    """Limits of every number type; the importer knows only some of them."""
    entry = objects.entries.get(variable.index, {}).get(variable.subindex)
    stated = entry or objects.heads.get(variable.index, {})
    for key, attribute in (("LowLimit", "min"), ("HighLimit", "max")):
        if (value := stated.get(key)) and re.fullmatch(r"-?\d+", value):
            setattr(variable, attribute, int(value))


_RELATIVE = re.compile(r"\$NODEID\+0x([0-9A-F]+)")


def assumed_value(od: "ObjectDictionary", index: int, sub: int, node: int) -> int | bytes | None:
    """Value that a description gives an object: ParameterValue of a DCF, else DefaultValue.

    `$NODEID` is resolved with `node`; strings and floats come as their bytes on the wire; None
    where the description gives none.
    """
    thing: Any = od.indices.get(index)
    if hasattr(thing, "subindices"):
        thing = thing.subindices.get(sub)
    elif sub != 0:
        return None
    if thing is None:
        return None
    for raw, value in (("value_raw", thing.value), ("default_raw", thing.default)):
        if match := _RELATIVE.fullmatch(getattr(thing, raw, "")):
            return int(match[1], 16) + node
        if value is not None:
            return _on_wire(thing.data_type, value)
    return None


def _on_wire(data_type: int | None, value: float | str | bytes) -> int | bytes:
    if isinstance(value, str):
        return value.encode("utf-16-le" if data_type == UNICODE_STRING else "latin-1", "replace")
    if isinstance(value, float):
        wide = data_type is not None and DATA_TYPES[data_type].bits == 64
        try:
            return struct.pack("<d" if wide else "<f", value)
        except OverflowError:
            return struct.pack("<f", float("inf") if value > 0 else float("-inf"))
    return value
