"""Data types of CiA 301 (7.4.7, table 44) and the decoding of one value."""

import datetime
import struct
from typing import Literal

from syncline_schemas.records import dataclass

Kind = Literal["bool", "signed", "unsigned", "float", "text", "bytes", "time", "none"]
Value = int | float | str | bytes


@dataclass(frozen=True, slots=True)
class DataType:
    """A static data type; `bits` is None where the length is not fixed."""

    code: int
    name: str
    kind: Kind
    bits: int | None


def _types() -> dict[int, DataType]:
    rows: list[tuple[int, str, Kind, int | None]] = [
        (0x01, "BOOLEAN", "bool", 1),
        (0x02, "INTEGER8", "signed", 8),
        (0x03, "INTEGER16", "signed", 16),
        (0x04, "INTEGER32", "signed", 32),
        (0x05, "UNSIGNED8", "unsigned", 8),
        (0x06, "UNSIGNED16", "unsigned", 16),
        (0x07, "UNSIGNED32", "unsigned", 32),
        (0x08, "REAL32", "float", 32),
        (0x09, "VISIBLE_STRING", "text", None),
        (0x0A, "OCTET_STRING", "bytes", None),
        (0x0B, "UNICODE_STRING", "text", None),
        (0x0C, "TIME_OF_DAY", "time", 48),
        (0x0D, "TIME_DIFFERENCE", "time", 48),
        (0x0F, "DOMAIN", "bytes", None),
        (0x10, "INTEGER24", "signed", 24),
        (0x11, "REAL64", "float", 64),
        (0x12, "INTEGER40", "signed", 40),
        (0x13, "INTEGER48", "signed", 48),
        (0x14, "INTEGER56", "signed", 56),
        (0x15, "INTEGER64", "signed", 64),
        (0x16, "UNSIGNED24", "unsigned", 24),
        (0x18, "UNSIGNED40", "unsigned", 40),
        (0x19, "UNSIGNED48", "unsigned", 48),
        (0x1A, "UNSIGNED56", "unsigned", 56),
        (0x1B, "UNSIGNED64", "unsigned", 64),
    ]
    return {code: DataType(code, name, kind, bits) for code, name, kind, bits in rows}


DATA_TYPES = _types()
"""Data type by its index in the object dictionary (0001h..001Bh)."""

UNICODE_STRING = 0x0B
TIME_OF_DAY = 0x0C
_TIME_ORIGIN = datetime.datetime(1984, 1, 1, tzinfo=datetime.UTC)


def type_name(code: int | None) -> str:
    """Name of a data type code; unknown codes as a number.

    >>> type_name(0x07), type_name(0x40)
    ('UNSIGNED32', 'type 0040h')
    """
    if code is None:
        return "unknown"
    known = DATA_TYPES.get(code)
    return known.name if known else f"type {code:04X}h"


def decode_value(code: int | None, data: bytes) -> Value:
    """Value of `data` in a data type.

    Surplus bytes are ignored, as size-less SDO answers have them. Data that are
    too short for the type, and types that are not known, come back as bytes.

    >>> decode_value(0x06, bytes.fromhex("01000000")), decode_value(0x03, bytes([254, 255]))
    (1, -2)
    >>> decode_value(0x0C, bytes.fromhex("E8030000 0100")), decode_value(0x0D, bytes(6))
    ('1984-01-02 00:00:01.000', '0 d 00:00:00.000')
    """
    known = DATA_TYPES.get(code) if code is not None else None
    if known is None:
        return data
    if known.kind == "text":
        return _text(known.code, data)
    if known.bits is None or len(data) * 8 < known.bits:
        return data
    return _fixed(known, data[: (known.bits + 7) // 8])


def _text(code: int, data: bytes) -> str:
    encoding = "utf-16-le" if code == UNICODE_STRING else "latin-1"
    return data.decode(encoding, errors="replace").rstrip("\0")


def _fixed(known: DataType, data: bytes) -> Value:
    match known.kind:
        case "float":
            value: float = struct.unpack("<f" if known.bits == 32 else "<d", data)[0]
            return value
        case "bool":
            return data[0] & 1
        case "signed" | "unsigned":
            return int.from_bytes(data, "little", signed=known.kind == "signed")
        case "time":
            return _time(known.code, data)
        case _:
            return data


def _time(code: int, data: bytes) -> str:
    """Days and milliseconds after midnight (CiA 301 7.1.6.5)."""
    since = datetime.timedelta(
        days=data[4] | data[5] << 8,
        milliseconds=int.from_bytes(data[:4], "little") & 0x0FFFFFFF,
    )
    moment = (_TIME_ORIGIN + since).replace(tzinfo=None)
    if code == TIME_OF_DAY:
        return moment.isoformat(" ", "milliseconds")
    return f"{since.days} d {moment.time().isoformat('milliseconds')}"
