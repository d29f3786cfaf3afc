"""XDD and XDC files (CiA 311) as the sections of an EDS, so that both are repaired alike."""

import re
from xml.etree import ElementTree

from syncline_schemas.eds_text import EdsText, Section

_ATTRIBUTES = {
    "name": "parametername",
    "objectType": "objecttype",
    "accessType": "accesstype",
    "defaultValue": "defaultvalue",
    "actualValue": "parametervalue",
    "lowLimit": "lowlimit",
    "highLimit": "highlimit",
    "subNumber": "subnumber",
}
_TYPES = {
    "BOOL": 0x01, "SINT": 0x02, "INT": 0x03, "DINT": 0x04, "LINT": 0x15, "USINT": 0x05,
    "UINT": 0x06, "UDINT": 0x07, "ULINT": 0x1B, "BYTE": 0x05, "WORD": 0x06, "DWORD": 0x07,
    "LWORD": 0x1B, "REAL": 0x08, "LREAL": 0x11, "STRING": 0x09, "WSTRING": 0x0B, "CHAR": 0x05,
}  # fmt: skip
_ACCESS = {
    "const": "const", "read": "ro", "write": "wo", "readWrite": "rw",
    "readWriteInput": "rww", "readWriteOutput": "rwr", "noAccess": "",
}  # fmt: skip


def looks_like_xml(data: bytes) -> bool:
    """Whether a file is XML instead of the sections of an EDS."""
    return data[:200].lstrip(b"\xef\xbb\xbf\xff\xfe\x00 \t\r\n").startswith(b"<")


def parse_xdd(data: bytes) -> EdsText:
    """Sections of an XDD or XDC file; none (and a warning) where the XML cannot be read."""
    found = EdsText()
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        found.warn("file", f"is no well-formed XML: {error}")
        return found
    parameters = {e.get("uniqueID", ""): e for e in root.iter() if _tag(e) == "parameter"}
    _identity(root, found)
    for thing in root.iter():
        if _tag(thing) != "CANopenObject":
            continue
        index = thing.get("index", "")
        _add(found, index, thing, parameters)
        for part in thing:
            if _tag(part) == "CANopenSubObject":
                _add(found, f"{index}sub{part.get('subIndex', '')}", part, parameters)
    return found


def _tag(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _identity(root: ElementTree.Element, found: EdsText) -> None:
    texts = {_tag(e): (e.text or "").strip() for e in root.iter()}
    found.sections["fileinfo"] = Section("FileInfo", 0)
    found.sections["deviceinfo"] = info = Section("DeviceInfo", 0)
    found.sections["dummyusage"] = dummies = Section("DummyUsage", 0)
    dummies.values |= {f"dummy{code:04d}": "0" for code in range(1, 8)}
    for tag, key in (
        ("vendorName", "vendorname"),
        ("vendorID", "vendornumber"),
        ("productName", "productname"),
        ("productID", "productnumber"),
    ):
        if texts.get(tag):
            info.values[key] = texts[tag]


def _add(
    found: EdsText,
    name: str,
    element: ElementTree.Element,
    parameters: dict[str, ElementTree.Element],
) -> None:
    section = Section(name, 0)
    parameter = parameters.get(element.get("uniqueIDRef", ""))
    if parameter is not None:
        section.values |= _of_parameter(parameter)
    for attribute, key in _ATTRIBUTES.items():
        if value := element.get(attribute):
            section.values[key] = re.sub(r"\s+", " ", value).strip()
    if data_type := element.get("dataType"):
        section.values["datatype"] = f"0x{data_type.removeprefix('0x')}"
    mapped = element.get("PDOmapping", "no") not in ("no", "")
    section.values["pdomapping"] = str(int(mapped))
    if name.lower() in found.sections:
        found.warn(f"[{name}]", "is described twice, the first one is taken")
    found.sections.setdefault(name.lower(), section)


def _of_parameter(parameter: ElementTree.Element) -> dict[str, str]:
    """What an application parameter says of the object that refers to it."""
    values = {"accesstype": _ACCESS.get(parameter.get("access", ""), "")}
    for child in parameter:
        tag = _tag(child)
        if tag in _TYPES:
            values["datatype"] = f"0x{_TYPES[tag]:02X}"
        elif tag in ("defaultValue", "actualValue"):
            key = "defaultvalue" if tag == "defaultValue" else "parametervalue"
            values[key] = child.get("value", "")
        elif tag == "label":
            values.setdefault("parametername", (child.text or "").strip())
    return {key: value for key, value in values.items() if value}
