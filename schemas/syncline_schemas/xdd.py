"""XDD and XDC files (CiA 311) as the sections of an EDS, so that both are repaired alike."""

import re
from collections.abc import Iterable, Mapping

from syncline_schemas.eds_text import EdsText, Section, decoded
from syncline_schemas.xml_tree import Element, XmlFault, parse_xml

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
    "BITSTRING": 0x0A,
}  # fmt: skip
_ACCESS = {
    "const": "const", "read": "ro", "write": "wo", "readWrite": "rw",
    "readWriteInput": "rwr", "readWriteOutput": "rww", "noAccess": "",
}  # fmt: skip
_PROCESS_ACCESS = {"RPDO": "rww", "TPDO": "rwr"}
"""What is only mapped one way is process output or input (CiA 306 4.6.3), whatever `access` says:
tools disagree about which of readWriteInput and readWriteOutput is which."""
_UNMAPPED = ("", "no")

_Named = Mapping[str, Element]


def looks_like_xml(data: bytes) -> bool:
    """Whether a file is XML instead of the sections of an EDS."""
    return data[:200].lstrip(b"\xef\xbb\xbf\xff\xfe\x00 \t\r\n").startswith(b"<")


def parse_xdd(data: bytes) -> EdsText:
    """Sections of an XDD or XDC file; none (and a warning) where the XML cannot be read."""
    found = EdsText()
    try:
        root = _root(data.lstrip(b" \t\r\n"), found)
    except XmlFault as error:
        found.warn("file", str(error), "xml")
        return found
    _add_general(root, found)
    _Objects(root, found).add()
    return found


def _root(data: bytes, found: EdsText) -> Element:
    try:
        return parse_xml(data)
    except XmlFault:
        text, warnings = decoded(data)
        if not warnings:
            raise
        found.warnings += warnings
        return parse_xml(text.encode(errors="replace"), "utf-8")


def _add_general(root: Element, found: EdsText) -> None:
    """What the sections FileInfo, DeviceInfo, DummyUsage and DeviceComissioning hold."""
    body = root.first("ProfileBody") or root
    _section(found, "FileInfo", body, _file_info(body))
    identity = root.first("DeviceIdentity") or root
    _section(found, "DeviceInfo", identity, _identity(identity) | _features(root))
    dummies = root.first("dummyUsage")
    _section(found, "DummyUsage", dummies or root, _dummies(dummies))
    commissioning = root.first("deviceCommissioning")
    if commissioning is not None:
        _section(found, "DeviceComissioning", commissioning, _commissioning(commissioning))


def _section(found: EdsText, name: str, element: Element, values: Mapping[str, str]) -> None:
    kept = {key: value for key, value in values.items() if value}
    found.sections[name.lower()] = Section(name, element.line, kept)


def _file_info(body: Element) -> dict[str, str]:
    names = {
        "fileName": "filename", "fileVersion": "fileversion", "fileCreator": "createdby",
        "fileCreationDate": "creationdate", "fileCreationTime": "creationtime",
        "fileModifiedBy": "modifiedby", "fileModificationDate": "modificationdate",
        "fileModificationTime": "modificationtime",
    }  # fmt: skip
    return {key: body.get(name) for name, key in names.items()}


def _identity(identity: Element) -> dict[str, str]:
    tags = {
        "vendorName": "vendorname", "vendorID": "vendornumber", "productName": "productname",
        "productID": "productnumber", "orderNumber": "ordercode",
    }  # fmt: skip
    elements = {key: identity.first(tag) for tag, key in tags.items()}
    return {key: each.text for key, each in elements.items() if each is not None}


def _features(root: Element) -> dict[str, str]:
    values: dict[str, str] = {}
    rates = list(root.all("supportedBaudRate"))
    if rates:
        stated = {match[1] for each in rates if (match := re.match(r"(\d+)", each.get("value")))}
        for rate in ("10", "20", "50", "125", "250", "500", "800", "1000"):
            values[f"baudrate_{rate}"] = str(int(rate in stated))
    for tag, names in _FEATURES.items():
        if (element := root.first(tag)) is not None:
            values |= {key: _flag(element.get(name)) for name, key in names.items()}
    return values


def _flag(text: str) -> str:
    return {"true": "1", "false": "0"}.get(text.lower(), text)


_FEATURES = {
    "CANopenGeneralFeatures": {
        "granularity": "granularity", "nrOfRxPDO": "nrofrxpdo", "nrOfTxPDO": "nroftxpdo",
        "bootUpSlave": "simplebootupslave", "groupMessaging": "groupmessaging",
        "dynamicChannels": "dynamicchannelssupported", "layerSettingServiceSlave": "lss_supported",
    },
    "CANopenMasterFeatures": {"bootUpMaster": "simplebootupmaster"},
}  # fmt: skip


def _dummies(usage: Element | None) -> dict[str, str]:
    values = {f"dummy{code:04d}": "0" for code in range(1, 8)}
    for each in usage.all("dummy") if usage is not None else ():
        key, _, value = each.get("entry").partition("=")
        if key:
            values[key.strip().lower()] = value.strip()
    return values


def _commissioning(element: Element) -> dict[str, str]:
    """NodeID and Baudrate [kbit/s]; the rate comes as "250 Kbps", "250" or "250000"."""
    node = element.get("nodeID")
    match = re.match(r"\d+", element.get("actualBaudRate"))
    rate = int(match[0][:9]) if match else 0
    return {
        "nodeid": "" if node in ("0", "0x00", "00") else node,
        "nodename": element.get("nodeName"),
        "networkname": element.get("networkName"),
        "baudrate": str(rate if rate <= 1000 else rate // 1000) if rate else "",
    }


class _Objects:
    """The first list of objects in a document, with what parameters say of them."""

    def __init__(self, root: Element, found: EdsText) -> None:
        lists = list(root.all("CANopenObjectList"))
        if len(lists) > 1:
            said = f"{len(lists)} lists of objects: only the first device is taken"
            found.warn(lists[1].line, said, "several_devices")
        self._list = lists[0] if lists else root
        self._found = found
        self._parameters = _named(root.all("parameter"))
        self._templates = _named(root.all("parameterTemplate"))
        types = ("array", "struct", "enum", "derived")
        self._types = _named(each for tag in types for each in root.all(tag))

    def add(self) -> None:
        """Add a section for each object and sub-object."""
        for thing in self._list.all("CANopenObject"):
            index = _bare_hex(thing.get("index"))
            self._add(index, thing)
            for part in thing.children:
                if part.tag == "CANopenSubObject":
                    self._add(f"{index}sub{_bare_hex(part.get('subIndex'))}", part)

    def _add(self, name: str, element: Element) -> None:
        section = Section(name, element.line)
        section.values |= self._of_parameter(element)
        for attribute, key in _ATTRIBUTES.items():
            if value := element.get(attribute):
                section.values[key] = value
        if data_type := element.get("dataType"):
            section.values["datatype"] = _data_type(data_type)
        mapping = element.get("PDOmapping")
        section.values["pdomapping"] = str(int(mapping.lower() not in _UNMAPPED))
        if section.get("accesstype") in ("rw", "rwr", "rww"):
            section.values["accesstype"] = _PROCESS_ACCESS.get(mapping, section.get("accesstype"))
        if name.lower() in self._found.sections:
            said = f"[{name}] is described twice, the first one is taken"
            self._found.warn(element.line, said, "duplicate_section")
        self._found.sections.setdefault(name.lower(), section)

    def _of_parameter(self, element: Element) -> dict[str, str]:
        """What an application parameter says of the object that refers to it."""
        reference = element.get("uniqueIDRef")
        parameter = self._parameters.get(reference)
        if parameter is None:
            if reference and not element.get("dataType"):
                said = f"refers to parameter {reference[:40]}, which is not there"
                self._found.warn(element.line, said, "no_parameter")
            return {}
        template = self._templates.get(parameter.get("templateIDRef"))
        stated = self._stated(template) if template is not None else {}
        return stated | self._stated(parameter)

    def _stated(self, parameter: Element) -> dict[str, str]:
        values = {"accesstype": _ACCESS.get(parameter.get("access"), "")}
        if parameter.get("offset") in ("", "0") and parameter.get("multiplier") not in ("", "1"):
            values["factor"] = parameter.get("multiplier")
        for child in parameter.children:
            if child.tag in _TYPES:
                values["datatype"] = f"0x{_TYPES[child.tag]:02X}"
            elif child.tag == "dataTypeIDRef":
                values["datatype"] = self._simple_type(child.get("uniqueIDRef"))
            elif child.tag in ("defaultValue", "actualValue"):
                key = "defaultvalue" if child.tag == "defaultValue" else "parametervalue"
                values[key] = child.get("value")
            elif child.tag == "allowedValues":
                values |= _range(child)
            elif child.tag in ("label", "description"):
                key = "parametername" if child.tag == "label" else "description"
                if child.text and (child.get("lang").startswith("en") or key not in values):
                    values[key] = child.text
            elif child.tag == "unit":
                label = child.first("label")
                values["unit"] = label.text if label is not None else ""
        return {key: value for key, value in values.items() if value}

    def _simple_type(self, reference: str) -> str:
        """Data type of a derived type or enumeration; "" for arrays and structures."""
        described = self._types.get(reference)
        if described is None or described.tag not in ("derived", "enum"):
            return ""
        bases = (f"0x{_TYPES[tag]:02X}" for tag in _TYPES if described.first(tag) is not None)
        return next(bases, "")


def _named(elements: Iterable[Element]) -> _Named:
    found: dict[str, Element] = {}
    for each in elements:
        found.setdefault(each.get("uniqueID"), each)
    return found


def _range(allowed: Element) -> dict[str, str]:
    """Limits, where one range is all that is allowed."""
    ranges = [each for each in allowed.children if each.tag == "range"]
    if len(ranges) != 1:
        return {}
    low, high = ranges[0].first("minValue"), ranges[0].first("maxValue")
    limits = {"lowlimit": low, "highlimit": high}
    return {key: end.get("value") for key, end in limits.items() if end is not None}


def _bare_hex(text: str) -> str:
    return text.lower().removeprefix("0x").upper()


def _data_type(text: str) -> str:
    """Hexadecimal as CiA 311 writes it; names of types stay."""
    bare = text.lower().removeprefix("0x")
    return f"0x{bare}" if re.fullmatch(r"[0-9a-f]{1,4}", bare) else text
