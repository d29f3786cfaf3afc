"""Data types of objects, and values as the shadow keeps them."""

from functools import lru_cache

from syncline_schemas.canopen.datatypes import DATA_TYPES, decode_value
from syncline_schemas.canopen.objects import standard_object
from syncline_schemas.devices import Device

_NUMBERS = ("signed", "unsigned", "bool")


def type_code(device: Device | None, index: int, sub: int) -> int | None:
    """Data type of an object by the device's dictionary, else by CiA 301."""
    facts = device.object(index, sub) if device else None
    if facts is not None and facts.data_type is not None:
        return facts.data_type
    return _usual_type(index, sub)


@lru_cache(4096)
def _usual_type(index: int, sub: int) -> int | None:
    usual = standard_object(index, sub)
    return usual.data_type if usual is not None else None


def known_value(device: Device | None, index: int, sub: int, data: bytes) -> int | bytes:
    """An object's bytes as the shadow keeps them: numbers as int, everything else as bytes."""
    code = type_code(device, index, sub)
    known = DATA_TYPES.get(code) if code is not None else None
    if known is not None and known.kind in _NUMBERS:
        value = decode_value(code, data)
        return value if isinstance(value, int) else int.from_bytes(data, "little")
    if known is not None or not 0 < len(data) <= 8:
        return data
    return int.from_bytes(data, "little")
