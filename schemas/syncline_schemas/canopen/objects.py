"""Names, types and units of the communication profile's objects (CiA 301 7.5.2)."""

from syncline_schemas.named_tuples import NamedTuple

UNSIGNED8, UNSIGNED16, UNSIGNED32, VISIBLE_STRING = 0x05, 0x06, 0x07, 0x09


class StandardObject(NamedTuple):
    """An object that CiA 301 describes; `name` holds the name of its record as well.

    `scale` times the raw value is in `unit`; `data_type` is a code of `DATA_TYPES`.
    """

    name: str
    data_type: int
    unit: str = ""
    scale: float = 1.0


def standard_object(index: int, sub: int) -> StandardObject | None:
    """What CiA 301 says of an object, None where it says nothing.

    >>> standard_object(0x1017, 0)
    StandardObject(name='producer heartbeat time', data_type=6, unit='ms', scale=1.0)
    >>> standard_object(0x1801, 2).name, standard_object(0x1A00, 3).name
    ('TPDO2 transmission type', 'TPDO1 mapped object 3')
    >>> standard_object(0x2000, 0) is None
    True
    """
    if sub == 0 and index in _VARIABLES:
        return _VARIABLES[index]
    for span, kind in ((_RPDO, "RPDO"), (_TPDO, "TPDO")):
        if index in span:
            return _pdo_parameter(f"{kind}{index - span.start + 1}", sub)
    for span, kind in ((_RPDO_MAPPING, "RPDO"), (_TPDO_MAPPING, "TPDO")):
        if index in span:
            return _mapping(f"{kind}{index - span.start + 1}", sub)
    if index in _SERVERS:
        return _sdo_parameter(f"SDO server {index - _SERVERS.start + 1}", sub, client=False)
    if index in _CLIENTS:
        return _sdo_parameter(f"SDO client {index - _CLIENTS.start + 1}", sub, client=True)
    return _array_entry(index, sub)


def drive_object(index: int) -> str | None:
    """Name of an object of the drive profile CiA 402-2, None for others.

    >>> drive_object(0x6040), drive_object(0x6004)
    ('controlword', None)
    """
    return _DRIVES.get(index)


def standard_meaning(index: int, sub: int, value: int) -> str:
    """Words for a value of a communication object (CiA 301 7.5.2), "" where the number says it all.

    >>> standard_meaning(0x1800, 1, 0x80000185), standard_meaning(0x1005, 0, 0x40000080)
    ('185h, off', '080h, produced here')
    >>> standard_meaning(0x1801, 2, 3), standard_meaning(0x1A00, 1, 0x60040020)
    ('every 3rd SYNC', '6004h:00, 32 bits')
    >>> standard_meaning(0x1016, 1, 0x000501F4)
    'node 5 within 500 ms'
    """
    if index in (0x1005, 0x1012):
        return _identifier(value, 0) + (", produced here" if value >> 30 & 1 else "")
    if index in _RPDO or index in _TPDO:
        return {1: _identifier(value, _OFF), 2: _transmission(value)}.get(sub, "")
    if index == 0x1014 or (index in range(0x1200, 0x1300) and sub in (1, 2)):
        return _identifier(value, _OFF)
    if (index in _RPDO_MAPPING or index in _TPDO_MAPPING) and sub:
        return f"{value >> 16:04X}h:{value >> 8 & 0xFF:02X}, {value & 0xFF} bits"
    if index == 0x1016 and sub and value:
        return f"node {value >> 16 & 0x7F} within {value & 0xFFFF} ms"
    return ""


_ORDINALS = {1: "st", 2: "nd", 3: "rd"}
_OFF, _FRAME_29_BIT = 1 << 31, 1 << 29


def _identifier(value: int, off: int) -> str:
    number = f"{value & 0x1FFFFFFF:08X}h" if value & _FRAME_29_BIT else f"{value & 0x7FF:03X}h"
    return f"{number}, off" if value & off else number


def _transmission(value: int) -> str:
    if 1 <= value <= 0xF0:
        if value == 1:
            return "every SYNC"
        last = value % 10 if value % 100 not in (11, 12, 13) else 0
        return f"every {value}{_ORDINALS.get(last, 'th')} SYNC"
    return {
        0x00: "at a SYNC after a change",
        0xFC: "asked for, sampled at the SYNC",
        0xFD: "asked for",
        0xFE: "on events, by the maker's rules",
        0xFF: "on events, by the profile's rules",
    }.get(value, "reserved")


_RPDO, _TPDO = range(0x1400, 0x1600), range(0x1800, 0x1A00)
_RPDO_MAPPING, _TPDO_MAPPING = range(0x1600, 0x1800), range(0x1A00, 0x1C00)
_SERVERS, _CLIENTS = range(0x1200, 0x1280), range(0x1280, 0x1300)

_VARIABLES = {
    0x1000: StandardObject("device type", UNSIGNED32),
    0x1001: StandardObject("error register", UNSIGNED8),
    0x1002: StandardObject("manufacturer status register", UNSIGNED32),
    0x1005: StandardObject("COB-ID SYNC", UNSIGNED32),
    0x1006: StandardObject("communication cycle period", UNSIGNED32, "us"),
    0x1007: StandardObject("synchronous window length", UNSIGNED32, "us"),
    0x1008: StandardObject("manufacturer device name", VISIBLE_STRING),
    0x1009: StandardObject("manufacturer hardware version", VISIBLE_STRING),
    0x100A: StandardObject("manufacturer software version", VISIBLE_STRING),
    0x100C: StandardObject("guard time", UNSIGNED16, "ms"),
    0x100D: StandardObject("life time factor", UNSIGNED8),
    0x1012: StandardObject("COB-ID TIME", UNSIGNED32),
    0x1013: StandardObject("high resolution time stamp", UNSIGNED32, "us"),
    0x1014: StandardObject("COB-ID EMCY", UNSIGNED32),
    0x1015: StandardObject("inhibit time EMCY", UNSIGNED16, "us", 100.0),
    0x1017: StandardObject("producer heartbeat time", UNSIGNED16, "ms"),
    0x1019: StandardObject("synchronous counter overflow value", UNSIGNED8),
    0x1020: StandardObject("verify configuration: number of entries", UNSIGNED8),
    0x1021: StandardObject("store EDS", 0x0F),
    0x1022: StandardObject("store format", UNSIGNED8),
    0x1024: StandardObject("OS command mode", UNSIGNED8),
    0x102A: StandardObject("NMT inhibit time", UNSIGNED16, "us", 100.0),
    0x1F80: StandardObject("NMT startup", UNSIGNED32),
}
_ARRAYS: dict[int, tuple[str, dict[int, str], StandardObject]] = {
    0x1003: ("pre-defined error field", {}, StandardObject("entry", UNSIGNED32)),
    0x1010: (
        "store parameters",
        {1: "all", 2: "communication", 3: "application"},
        StandardObject("parameters", UNSIGNED32),
    ),
    0x1011: (
        "restore default parameters",
        {1: "all", 2: "communication", 3: "application"},
        StandardObject("parameters", UNSIGNED32),
    ),
    0x1016: ("consumer heartbeat time", {}, StandardObject("entry", UNSIGNED32)),
    0x1018: (
        "identity",
        {1: "vendor-ID", 2: "product code", 3: "revision number", 4: "serial number"},
        StandardObject("entry", UNSIGNED32),
    ),
    0x1020: (
        "verify configuration",
        {1: "date", 2: "time"},
        StandardObject("entry", UNSIGNED32),
    ),
    0x1029: (
        "error behaviour",
        {1: "communication error"},
        StandardObject("class", UNSIGNED8),
    ),
    0x1F81: ("NMT slave assignment", {}, StandardObject("node", UNSIGNED32)),
}
_PDO_ENTRIES = {
    0: StandardObject("number of parameters", UNSIGNED8),
    1: StandardObject("COB-ID", UNSIGNED32),
    2: StandardObject("transmission type", UNSIGNED8),
    3: StandardObject("inhibit time", UNSIGNED16, "us", 100.0),
    5: StandardObject("event timer", UNSIGNED16, "ms"),
    6: StandardObject("SYNC start value", UNSIGNED8),
}
_SDO_ENTRIES = {
    0: ("number of parameters", UNSIGNED8),
    1: ("COB-ID client to server", UNSIGNED32),
    2: ("COB-ID server to client", UNSIGNED32),
}


def _pdo_parameter(pdo: str, sub: int) -> StandardObject | None:
    entry = _PDO_ENTRIES.get(sub)
    return entry._replace(name=f"{pdo} {entry.name}") if entry else None


def _mapping(pdo: str, sub: int) -> StandardObject | None:
    if sub == 0:
        return StandardObject(f"{pdo} number of mapped objects", UNSIGNED8)
    return StandardObject(f"{pdo} mapped object {sub}", UNSIGNED32) if sub <= 64 else None


def _sdo_parameter(channel: str, sub: int, *, client: bool) -> StandardObject | None:
    if sub == 3:
        return StandardObject(
            f"{channel} node of the {'server' if client else 'client'}", UNSIGNED8
        )
    name, kind = _SDO_ENTRIES.get(sub, ("", 0))
    return StandardObject(f"{channel} {name}", kind) if name else None


def _array_entry(index: int, sub: int) -> StandardObject | None:
    if index not in _ARRAYS:
        return None
    name, words, entry = _ARRAYS[index]
    if sub == 0:
        return StandardObject(f"{name}: number of entries", UNSIGNED8)
    return entry._replace(name=f"{name}: {words.get(sub, f'{entry.name} {sub}')}")


DRIVES = 402
"""Profile number of drives in the low half of 1000h."""
_DRIVES = {
    0x603F: "error code",
    0x6040: "controlword",
    0x6041: "statusword",
    0x605A: "quick stop option code",
    0x605E: "fault reaction option code",
    0x6060: "modes of operation",
    0x6061: "modes of operation display",
    0x6062: "position demand value",
    0x6063: "position actual internal value",
    0x6064: "position actual value",
    0x6065: "following error window",
    0x6067: "position window",
    0x606B: "velocity demand value",
    0x606C: "velocity actual value",
    0x6071: "target torque",
    0x6072: "max torque",
    0x6077: "torque actual value",
    0x6078: "current actual value",
    0x6079: "DC link circuit voltage",
    0x607A: "target position",
    0x607C: "home offset",
    0x607D: "software position limit",
    0x607F: "max profile velocity",
    0x6080: "max motor speed",
    0x6081: "profile velocity",
    0x6083: "profile acceleration",
    0x6084: "profile deceleration",
    0x6085: "quick stop deceleration",
    0x6098: "homing method",
    0x6099: "homing speeds",
    0x60FD: "digital inputs",
    0x60FE: "digital outputs",
    0x60FF: "target velocity",
    0x6502: "supported drive modes",
}
