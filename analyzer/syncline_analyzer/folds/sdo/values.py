"""Data types of objects, and values as the shadow keeps them."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


def known_values(
    device: Device | None,
    index: int,
    sub: int,
    word: NDArray[np.uint32],
    size: NDArray[np.uint8],
) -> NDArray[Any]:
    """Values of expedited transfers of one object, each as `known_value` tells it.

    Args:
        device, index, sub: the object.
        word: (n,) the value, little endian.
        size: (n,) bytes that the frame states, 0 where it states none and holds four.

    Returns:
        (n,) int64, or objects (bytes) where the type is none of numbers.
    """
    code = type_code(device, index, sub)
    known = DATA_TYPES.get(code) if code is not None else None
    length = np.where(size == 0, 4, size).astype(np.int64)
    value = word.astype(np.int64)
    if known is None:
        return value
    if known.kind not in _NUMBERS:
        data = zip(word.astype("<u4").tolist(), length.tolist(), strict=True)
        held = np.empty(len(word), object)
        held[:] = [each.to_bytes(4, "little")[:count] for each, count in data]
        return held
    if known.bits is None or known.bits > 32:
        return value
    low = value & (1 << known.bits) - 1
    if known.kind == "signed":
        half = 1 << known.bits - 1
        low = (low ^ half) - half
    return np.where(length * 8 < known.bits, value, low)
