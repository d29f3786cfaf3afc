"""What a change of a parameter means, in the words of who changes such things."""

import re
from collections.abc import Callable, Mapping
from typing import Any

from syncline_schemas.canopen.objects import standard_meaning, standard_object
from syncline_schemas.canopen.sdo import LOAD_SIGNATURE, SAVE_SIGNATURE
from syncline_schemas.devices import Device, ObjectFacts, standard_facts
from syncline_schemas.devices.standard import standard_profile
from syncline_schemas.wording import counted

Key = tuple[int, int]
_SIGNED_BITS = {0x03: 16, 0x04: 32}
"""Bits of the signed data types (CiA 301 table 44)."""
_RPDO, _TPDO = range(0x1400, 0x1600), range(0x1800, 0x1A00)
_RPDO_MAPPING, _TPDO_MAPPING = range(0x1600, 0x1800), range(0x1A00, 0x1C00)
_GROUPS = {1: "all", 2: "communication", 3: "application"}
_AFTER_AN_ERROR = {0: "goes to Pre-operational", 1: "keeps its NMT state", 2: "goes to Stopped"}

LONG, SHOWN = 120, 48
"""Values of more characters than the first are told by as many as the second."""
_BYTES = re.compile("[0-9A-F]{2}( [0-9A-F]{2})*")
Shown = int | float | str | None
"""A value of an object as tables and words show it."""


def change_words(
    device: Device | None, profile: int | None, key: Key, old: object, new: object
) -> str:
    """What a new value of an object means.

    Args:
        device: the node's device, None where it is not known.
        profile: CiA profile number by 1000h, None where it was not seen.
        key: index and sub-index.
        old: value before, None where it is not known.
        new: value now; None where it is not known, text or a number.
    """
    facts = _facts(device, profile, key)
    name = _name(facts, key)
    if new is None:
        return f"{name} not known any more"
    if not isinstance(new, int):
        return f"{name} {shortened(str(new))}"
    if facts is not None and facts.change:
        return facts.change.format(value=new, words=_value(facts, key, new), unit=facts.unit)
    return (
        _undocumented(device, key, new)
        or _measuring(device, profile, facts, key, old, new)
        or _of_cia_301(facts, key, new)
        or f"{name} {_value(facts, key, new)}"
    )


def shortened(text: str) -> str:
    """A value as text, or as bytes in hexadecimal digits; a long one by its beginning alone.

    >>> shortened("00 " * 511 + "00"), shortened("LIR-DA158")
    ('00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 ... (512 bytes)', 'LIR-DA158')
    """
    if len(text) <= LONG:
        return text
    if _BYTES.fullmatch(text):
        return f"{text[:SHOWN].rstrip()} ... ({(len(text) + 1) // 3} bytes)"
    return f"{text[:SHOWN].rstrip()}... ({len(text)} characters)"


def value_words(device: Device | None, profile: int | None, key: Key, value: object) -> str:
    """A value of an object in words, else in its unit; "" where there is none."""
    if not isinstance(value, int):
        return "" if value is None else shortened(str(value))
    return _value(_facts(device, profile, key), key, value)


def typed(device: Device | None, profile: int | None, key: Key, value: Shown) -> Shown:
    """A value of an object that no EDS describes, with its sign where the CiA profile gives one."""
    facts = standard_facts(profile or 0, *key)
    if device is not None or facts is None or not isinstance(value, int):
        return value
    bits = _SIGNED_BITS.get(facts.data_type or 0)
    half = 1 << bits - 1 if bits else 0
    return (value + half) % (2 * half) - half if half else value


def object_facts(device: Device | None, profile: int | None, key: Key) -> ObjectFacts | None:
    """What the device, else its CiA profile tells of an object."""
    return _facts(device, profile, key)


def measuring_roles(device: Device | None, profile: int | None) -> Mapping[str, Any]:
    """Which object does what in the measurement, by the device, else by its CiA profile."""
    if device is not None and device.measurement:
        return device.measurement
    standard = standard_profile(profile or 0)
    return standard.measurement if standard is not None else {}


def _facts(device: Device | None, profile: int | None, key: Key) -> ObjectFacts | None:
    facts = device.object(*key) if device else None
    return facts if facts is not None else standard_facts(profile or 0, *key)


def _name(facts: ObjectFacts | None, key: Key) -> str:
    if facts is not None and facts.name:
        return facts.full_name
    usual = standard_object(*key)
    return usual.name if usual is not None else f"{key[0]:04X}h:{key[1]:02X}"


def _value(facts: ObjectFacts | None, key: Key, value: int) -> str:
    """A value in words, else in its unit."""
    words = (facts.describe(value) if facts else "") or standard_meaning(*key, value)
    if words:
        return words
    if facts is None or not facts.unit or facts.scale_object is not None:
        return str(value)
    return f"{value * facts.scale:.10g} {facts.unit}"


def _undocumented(device: Device | None, key: Key, new: int) -> str:
    """Words for an object that only related firmware has, "" for others."""
    words = device.quirks.undocumented.get(key[0], "") if device else ""
    if device is None or not words or device.object(*key) is not None:
        return ""
    alias = device.measurement.get("direction_alias", {})
    if key != alias.get("object"):
        return f"undocumented: {words}"
    counting = _bit("direction", "", on=bool(new >> alias["bit"] & 1))
    return f"{counting}, if it is as in related firmware (undocumented)"


def _measuring(
    device: Device | None,
    profile: int | None,
    facts: ObjectFacts | None,
    key: Key,
    old: object,
    new: int,
) -> str:
    """Words for objects of the measurement, "" for others."""
    roles = measuring_roles(device, profile)
    if key == roles.get("preset"):
        return f"preset to {new}"
    if key == roles.get("counts_per_turn"):
        return f"{new} counts per turn"
    if key == roles.get("offset"):
        return f"offset {new}"
    if key in [place["object"] for place in _switches(roles).values()]:
        return ", ".join(_switched(roles, facts, key, old, new))
    return ""


def _switches(roles: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    return {name: roles[name] for name in ("direction", "scaling", "gray") if name in roles}


def _switched(
    roles: Mapping[str, Any], facts: ObjectFacts | None, key: Key, old: object, new: int
) -> list[str]:
    """The bits that changed; all that are known where the value before is not, or is the same."""
    changed = old ^ new if isinstance(old, int) and old != new else ~0
    own = {s["bit"]: name for name, s in _switches(roles).items() if s["object"] == key}
    bits = {**dict.fromkeys(own, ""), **(facts.bits if facts else {})}
    words = [
        _bit(own.get(bit, ""), text, on=bool(new >> bit & 1))
        for bit, text in sorted(bits.items())
        if changed >> bit & 1 and (bit in own or changed != ~0 or new >> bit & 1)
    ]
    unnamed = [bit for bit in range(32) if changed != ~0 and changed >> bit & 1 and bit not in bits]
    return [*words, *(f"bit {bit} {'on' if new >> bit & 1 else 'off'}" for bit in unnamed)]


def _bit(role: str, text: str, *, on: bool) -> str:
    match role:
        case "direction":
            return "counting " + ("counter-clockwise" if on else "clockwise")
        case "scaling":
            return "scaling on" if on else "scaling off"
        case "gray":
            return "Gray to binary on" if on else "Gray to binary off"
    plain = text.removesuffix(" on")
    return f"{plain} {'on' if on else 'off'}"


def _of_cia_301(facts: ObjectFacts | None, key: Key, value: int) -> str:
    """Words for objects of the communication profile, "" for others."""
    index, sub = key
    if index in _PLAIN and sub == 0:
        return _PLAIN[index](value)
    for span, kind in ((_RPDO, "RPDO"), (_TPDO, "TPDO")):
        if index in span:
            pdo = f"{kind}{index - span.start + 1}"
            if sub == 2:
                return f"{pdo} type {value}: {_value(facts, key, value)}"
            return _pdo(pdo, sub, value)
    for span, kind in ((_RPDO_MAPPING, "RPDO"), (_TPDO_MAPPING, "TPDO")):
        if index in span:
            pdo = f"{kind}{index - span.start + 1}"
            if sub == 0:
                return f"{pdo} maps {counted(value, 'object')}" if value else f"{pdo} maps nothing"
            return f"{pdo} object {sub}: {standard_meaning(index, sub, value)}"
    if index in (0x1010, 0x1011) and sub:
        return _storage(index, sub, value)
    if index == 0x1003 and sub == 0:
        return "error list cleared" if not value else ""
    if index == 0x1016 and sub:
        watched = standard_meaning(index, sub, value) if value & 0xFFFF else ""
        return f"waits for the heartbeat of {watched}" if watched else "waits for no heartbeat"
    if key == (0x1029, 1) and value in _AFTER_AN_ERROR:
        return f"after a communication error it {_AFTER_AN_ERROR[value]}"
    return ""


def _pdo(pdo: str, sub: int, value: int) -> str:
    match sub:
        case 1:
            can_id = standard_meaning(0x1800, 1, value).removesuffix(", off")
            return f"{pdo} off" if value >> 31 & 1 else f"{pdo} on {can_id}"
        case 3:
            return f"{pdo} inhibit time {value / 10:g} ms" if value else f"{pdo} no inhibit time"
        case 5:
            return f"{pdo} event timer {value} ms" if value else f"{pdo} event timer off"
    return ""


def _storage(index: int, sub: int, value: int) -> str:
    group = f"{_GROUPS.get(sub, f'group {sub}')} parameters"
    if index == 0x1010:
        return f"saved: {group}" if value == SAVE_SIGNATURE else ""
    return f"defaults for {group}, from the next reset on" if value == LOAD_SIGNATURE else ""


def _ms(tenths_ms: int) -> str:
    return f"{tenths_ms / 10:g} ms"


_PLAIN: dict[int, Callable[[int], str]] = {
    0x1005: lambda v: f"SYNC identifier {standard_meaning(0x1005, 0, v)}",
    0x1006: lambda v: f"SYNC period {v} us" if v else "no SYNC period",
    0x1007: lambda v: f"synchronous window {v} us" if v else "no synchronous window",
    0x100C: lambda v: f"guard time {v} ms" if v else "guarding off",
    0x100D: lambda v: f"life time factor {v}" if v else "guarding off",
    0x1014: lambda v: f"EMCY identifier {standard_meaning(0x1014, 0, v)}",
    0x1015: lambda v: f"EMCY inhibit time {_ms(v)}" if v else "no EMCY inhibit time",
    0x1017: lambda v: f"heartbeat every {v} ms" if v else "heartbeat off",
    0x1019: lambda v: f"SYNC counter up to {v}" if v else "SYNC without a counter",
}
