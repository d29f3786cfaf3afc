"""Faults of the sections that describe the file and the device as a whole (CiA 306 4.3 to 4.5)."""

import re
from collections import Counter
from collections.abc import Iterator

from syncline_schemas.devices.check.sheet import Fault, Sheet
from syncline_schemas.eds_repair import LISTS, number

_RATES = (10, 20, 50, 125, 250, 500, 800, 1000)
_DEVICE_KEYS = (
    "VendorName", "VendorNumber", "ProductName", "ProductNumber", "RevisionNumber", "OrderCode",
    *(f"BaudRate_{rate}" for rate in _RATES), "SimpleBootUpMaster", "SimpleBootUpSlave",
    "Granularity", "DynamicChannelsSupported", "GroupMessaging", "NrOfRXPDO", "NrOfTXPDO",
    "LSS_Supported",
)  # fmt: skip
_MANDATORY = (0x1000, 0x1001, 0x1018)
_MAKER = range(0x2000, 0x6000)
_FORMATS = {
    "creationdate": ("CreationDate", r"\d\d-\d\d-\d{4}", "mm-dd-yyyy"),
    "modificationdate": ("ModificationDate", r"\d\d-\d\d-\d{4}", "mm-dd-yyyy"),
    "creationtime": ("CreationTime", r"\d\d:\d\d(AM|PM)", "hh:mmAM or hh:mmPM"),
    "modificationtime": ("ModificationTime", r"\d\d:\d\d(AM|PM)", "hh:mmAM or hh:mmPM"),
    "edsversion": ("EDSVersion", r"\d\.\d", "a version of CiA 306 like 4.0"),
}


def general_faults(sheet: Sheet) -> Iterator[Fault]:
    """Faults of everything that is no object."""
    if not sheet.is_xml:
        yield from _sections(sheet)
        yield from _lists(sheet)
        yield from _file_info(sheet)
        yield from _device_keys(sheet)
    yield from _rates(sheet)
    yield from _set_rate(sheet)
    yield from _granularity(sheet)
    yield from _commissioning(sheet)


def _sections(sheet: Sheet) -> Iterator[Fault]:
    kinds = {_list_of(index) for index in sheet.indexes} | {"MandatoryObjects"}
    for name in sorted(kinds):
        if sheet.section(name) is None:
            yield sheet.general("missing_section", name, f"section [{name}] is missing")
    comments = sheet.section("Comments")
    lines = number(comments.get("lines") or "0") if comments else 0
    found = sum(bool(re.fullmatch(r"line\d+", key)) for key in comments.values) if comments else 0
    if lines != found:
        yield sheet.general(
            "comment_lines", "Comments", f"Lines is {lines}, there are {found}", at="lines"
        )


def _list_of(index: int) -> str:
    if index in _MANDATORY:
        return "MandatoryObjects"
    return "ManufacturerObjects" if index in _MAKER else "OptionalObjects"


def _lists(sheet: Sheet) -> Iterator[Fault]:
    seen: Counter[int] = Counter()
    for name in LISTS:
        section = sheet.section(name)
        if section is None:
            continue
        keys = {int(key) for key in section.values if key.isdecimal() and len(key) < 7}
        hole = next((place for place in range(1, len(keys) + 1) if place not in keys), None)
        if hole is not None:
            text = f"number {hole} is missing among {len(keys)} objects"
            yield sheet.general("list_numbers", section.name, text)
        listed = [number(value) for key, value in section.values.items() if key.isdecimal()]
        seen.update(index for index in listed if index is not None)
        wrong = [i for i in listed if i is not None and _list_of(i).lower() != section.name.lower()]
        if wrong:
            text = f"objects of another list: {_hex(wrong)}"
            yield sheet.general("list_wrong", section.name, text)
    twice = [index for index, count in seen.items() if count > 1]
    if twice:
        yield sheet.general("list_twice", "MandatoryObjects", f"listed twice: {_hex(twice)}")


def _hex(indexes: list[int]) -> str:
    shown = ", ".join(f"{index:04X}h" for index in sorted(set(indexes))[:10])
    return shown + (f" and {len(indexes) - 10} more" if len(indexes) > 10 else "")


def _file_info(sheet: Sheet) -> Iterator[Fault]:
    section = sheet.section("FileInfo")
    for key, (name, form, words) in _FORMATS.items():
        stated = section.get(key) if section else ""
        if stated and not re.fullmatch(form, stated):
            text = f"{name} is {stated[:30]!r}"
            yield sheet.general("file_info", "FileInfo", text, f"write {words}", at=key)


def _device_keys(sheet: Sheet) -> Iterator[Fault]:
    section = sheet.section("DeviceInfo")
    missing = [key for key in _DEVICE_KEYS if section and key.lower() not in section.values]
    if missing:
        text = f"{', '.join(missing)} missing"
        yield sheet.general("device_info_missing", "DeviceInfo", text)


def _rates(sheet: Sheet) -> Iterator[Fault]:
    section = sheet.section("DeviceInfo")
    stated = {f"baudrate_{rate}" for rate in _RATES} & section.values.keys() if section else set()
    for key in sorted(stated):
        value = sheet.info(key)
        if value is not None and value not in (0, 1):
            text = f"BaudRate_{key.partition('_')[2]} is {value}, which is neither 0 nor 1"
            yield sheet.general("baud_rates", "DeviceInfo", text, at=key)
    if stated and not any(sheet.info(key) for key in stated):
        text = "no bit rate is supported, by its BaudRate lines"
        yield sheet.general("baud_rates", "DeviceInfo", text, at=min(stated))


def _set_rate(sheet: Sheet) -> Iterator[Fault]:
    rate = sheet.loaded.bitrate or 0
    if rate and sheet.info(f"baudrate_{rate // 1000}") == 0:
        text = f"Baudrate is {rate // 1000}, BaudRate_{rate // 1000} in [DeviceInfo] is 0"
        yield sheet.general("baud_rate_set", "DeviceComissioning", text, at="baudrate")


def _granularity(sheet: Sheet) -> Iterator[Fault]:
    value = sheet.info("granularity")
    if value is not None and not 0 <= value <= 64:
        yield sheet.general(
            "granularity", "DeviceInfo", f"Granularity is {value}", at="granularity"
        )


def _commissioning(sheet: Sheet) -> Iterator[Fault]:
    if sheet.section("DeviceCommissioning") is not None and not sheet.is_xml:
        yield sheet.general("commissioning_name", "DeviceCommissioning", "spelled with two m")
    if sheet.suffix in (".dcf", ".xdc") and sheet.loaded.node_id is None:
        text = "a configured device without a node id"
        yield sheet.general("commissioning_missing", "DeviceComissioning", text)
    if sheet.suffix not in (".eds", ".xdd"):
        return
    having = [key for key in sheet.variables if sheet.written(*key, "parametervalue")]
    if having:
        text = f"{len(having)} objects have a set value (ParameterValue), this one first"
        yield sheet.fault("value_in_eds", sheet.key(*having[0]), text, at="parametervalue")
