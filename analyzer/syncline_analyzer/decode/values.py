"""Objects and their values in words."""

import math

from syncline_analyzer.folds.sdo.values import type_code
from syncline_analyzer.objects import meaning, named
from syncline_analyzer.views.words import object_name, printable
from syncline_schemas.canopen.datatypes import decode_value
from syncline_schemas.canopen.objects import standard_object
from syncline_schemas.devices import Device

LONG_BYTES = 24
"""More bytes than these are not shown."""
MOST_DIGITS = 9


def object_words(device: Device | None, index: int, sub: int) -> str:
    """An object by its number, and its name where anybody knows it.

    >>> object_words(None, 0x1017, 0), object_words(None, 0x2000, 1)
    ('1017h:00 producer heartbeat time', '2000h:01')
    """
    name, _ = named(device, index, sub)
    number = object_name(index, sub)
    return f"{number} {printable(name)}" if name else number


def value_words(device: Device | None, index: int, sub: int, data: bytes) -> str:
    """The value of an object with its unit and what it means.

    >>> value_words(None, 0x1017, 0, (500).to_bytes(2, "little"))
    '500 ms'
    >>> value_words(None, 0x2000, 0, bytes.fromhex("F401"))
    '500 (01F4h)'
    >>> value_words(None, 0x1008, 0, b"JN2100")
    '"JN2100"'
    """
    value = decode_value(type_code(device, index, sub), data)
    if isinstance(value, bytes):
        if not 0 < len(value) <= 8:
            more = f" and {len(value) - LONG_BYTES} more bytes" * (len(value) > LONG_BYTES)
            return (value[:LONG_BYTES].hex(" ") + more) or "nothing"
        number = int.from_bytes(value, "little")
        return f"{number} ({number:0{2 * len(value)}X}h)"
    if isinstance(value, str):
        return f'"{printable(value)}"'
    return _number_words(device, index, sub, value)


def _number_words(device: Device | None, index: int, sub: int, value: float) -> str:
    facts = device.object(index, sub) if device else None
    usual = standard_object(index, sub)
    known = facts if facts is not None else usual
    _, unit = named(device, index, sub)
    scale = known.scale if known is not None and not (facts and facts.scale_object) else 1.0
    text = scaled(value, scale)
    said = meaning(device, index, sub, value)
    if unit:
        text += f" {unit}"
    elif isinstance(value, int) and not said and value > 9:
        text += f" ({value:X}h)"
    return f"{text} ({printable(said)})" if said else text


def digits(scale: float) -> int:
    """Digits behind the point that values of this step have.

    >>> [digits(step) for step in (1.0, 0.01, 0.044, 360 / 65536, 10.0)]
    [0, 2, 2, 3, 0]
    """
    if not 0 < scale < 1:
        return 0
    return min(math.ceil(-math.log10(scale) - 1e-9), MOST_DIGITS)


def scaled(value: float, scale: float) -> str:
    """A raw value as an engineering value, with as many digits as its step has.

    >>> scaled(1234, 0.01), scaled(-5, 1.0), scaled(2.5, 1.0)
    ('12.34', '-5', '2.5')
    """
    if scale == 1:
        whole = str(value)
        return whole if whole.lstrip("-").isdecimal() else f"{value:.6g}"
    return f"{value * scale:.{digits(scale)}f}"
