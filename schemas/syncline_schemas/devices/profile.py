"""The TOML file of a device read into facts; everything wrong in it is told at once."""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, cast

from syncline_schemas.devices.model import (
    BitField,
    Device,
    EmcyField,
    Jump,
    Key,
    ObjectFacts,
    Override,
    Quirks,
)
from syncline_schemas.eds_repair import number
from syncline_schemas.errors import DescriptionError

Convert = Callable[[Any], Any]


@dataclass(slots=True)
class Profile:
    """What the TOML file of a device says."""

    title: str = ""
    vendor: str = ""
    kind: str = "generic"
    eds: str = ""
    default_node: int | None = None
    default_bitrate: int | None = None
    notes: tuple[str, ...] = ()
    identity: dict[str, Any] = field(default_factory=dict)
    quirks: Quirks = field(default_factory=Quirks)
    emcy: dict[str, Any] = field(default_factory=dict)
    measurement: dict[str, Any] = field(default_factory=dict)
    limits: dict[str, float] = field(default_factory=dict)
    health: dict[str, Key] = field(default_factory=dict)
    overrides: dict[str, Override] = field(default_factory=dict)
    objects: dict[Key, dict[str, Any]] = field(default_factory=dict)


def object_key(text: Any) -> Key:
    """(index, sub) of "6000" or "1018:2", both hexadecimal.

    >>> object_key("1018:2"), object_key("6000")
    ((4120, 2), (24576, 0))
    """
    index, _, sub = str(text).strip().lower().partition(":")
    try:
        key = int(index.removesuffix("h"), 16), int(sub or "0", 16)
    except ValueError:
        raise ValueError(f'{text!r} is no object: write it as "6000" or "1018:2"') from None
    if not (0 <= key[0] <= 0xFFFF and 0 <= key[1] <= 0xFF):
        raise ValueError(f"{text!r} is no object: the index has four digits, the subindex two")
    return key


def _need(fits: bool, value: Any, what: str) -> None:
    if not fits:
        raise ValueError(f"{value!r} is no {what}")


def integer(value: Any) -> int:
    """A number, also as text ("0x10", "10h")."""
    _need(isinstance(value, int | str) and not isinstance(value, bool), value, "whole number")
    read = value if isinstance(value, int) else number(value)
    _need(read is not None, value, "whole number")
    return cast("int", read)


def _number(value: Any) -> float:
    _need(isinstance(value, int | float) and not isinstance(value, bool), value, "number")
    return float(value)


def _bit(value: Any) -> int:
    read = integer(value)
    _need(0 <= read < 64, value, "bit number from 0 to 63")
    return read


def _text(value: Any) -> str:
    _need(isinstance(value, str), value, "text")
    return cast("str", value)


def _truth(value: Any) -> bool:
    _need(isinstance(value, bool), value, "true or false")
    return cast("bool", value)


def _one_of(*choices: str) -> Convert:
    def convert(value: Any) -> str:
        if value not in choices:
            raise ValueError(f"{value!r} is none of {', '.join(choices)}")
        return str(value)

    return convert


def _list(item: Convert) -> Convert:
    def convert(value: Any) -> tuple[Any, ...]:
        _need(isinstance(value, list), value, "list")
        return tuple(item(part) for part in value)

    return convert


def _pair(item: Convert) -> Convert:
    def convert(value: Any) -> tuple[Any, ...]:
        read: tuple[Any, ...] = _list(item)(value)
        _need(len(read) == 2, value, "pair")
        return read

    return convert


def _table(key: Convert, item: Convert) -> Convert:
    def convert(value: Any) -> dict[Any, Any]:
        _need(isinstance(value, dict), value, "table")
        return {key(name): item(part) for name, part in value.items()}

    return convert


def _record(
    required: Mapping[str, Convert], optional: Mapping[str, Convert] | None = None
) -> Convert:
    known = {**required, **(optional or {})}

    def convert(value: Any) -> dict[str, Any]:
        _need(isinstance(value, dict), value, "table")
        if missing := required.keys() - value.keys():
            raise ValueError(f"{', '.join(sorted(missing))} missing")
        if unknown := value.keys() - known.keys():
            raise ValueError(f"unknown key {', '.join(sorted(unknown))}")
        return {name: known[name](part) for name, part in value.items()}

    return convert


def _bit_fields(value: Any) -> tuple[BitField, ...]:
    table = _table(_text, _list(_bit))(value)
    for bits in table.values():
        _need(len(bits) > 0 and bits[0] <= bits[-1], bits, "range of bits, like [0, 15]")
    return tuple(BitField(name, bits[0], bits[-1]) for name, bits in table.items())


def _change(value: Any) -> str:
    read = _text(value)
    try:
        read.format(value=0, words="", unit="")
    except (LookupError, ValueError) as error:
        raise ValueError(f"{read!r} may hold {{value}}, {{words}} and {{unit}} only") from error
    return read


def _jump(value: Any) -> Jump:
    read = _record({"object": object_key, "text": _text}, {"values": _list(integer)})(value)
    index, sub = read["object"]
    return Jump(index, sub, read["text"], read.get("values"))


def _side_effect(value: Any) -> tuple[Key, Key, int]:
    read = _record({"write": object_key, "changes": object_key, "to": integer})(value)
    return read["write"], read["changes"], read["to"]


_REACTION = _one_of("pre-operational", "keep", "stopped")
_KEYS = _list(object_key)
_QUIRKS: dict[str, Convert] = {
    "bootup_bytes": _list(integer),
    "empty_heartbeat_after_rtr": _truth,
    "reset_quiet_ms": integer,
    "type_0": _one_of("acyclic", "off", "once_per_change", "unknown"),
    "event_timer_types": _list(integer),
    "pdo_cob_id_mask": integer,
    "fixed_mapping": _truth,
    "repeat_counters": _table(integer, object_key),
    "aliases": _table(object_key, object_key),
    "clear_on_read": _KEYS,
    "mute_in_stopped": _list(_one_of("sdo", "pdo", "emcy", "sync")),
    "rtr_any_state": _truth,
    "heartbeat_wins": _truth,
    "consumes_heartbeat": _truth,
    "guard_toggle_restarts_on": _KEYS,
    "life_guard_reaction": _one_of("1029h", "pre-operational"),
    "life_guard_cleared_by_request": _truth,
    "error_reactions": _table(integer, _REACTION),
    "error_reaction_default": integer,
    "hardware_preset": _truth,
    "reset_writes": _table(object_key, integer),
    "factory_reset_writes": _table(object_key, integer),
    "communication_reset_all": _truth,
    "bitrate_object": object_key,
    "bitrates": _table(integer, integer),
    "node_id_object": object_key,
    "node_id_switches": _truth,
    "node_id_order": _text,
    "storage": _table(integer, _KEYS),
    "saves_all": _truth,
    "stored_at_once": _KEYS,
    "load_writes_storage": _truth,
    "jumps": _list(_jump),
    "side_effects": _list(_side_effect),
    "settle_s": _table(object_key, _table(integer, _number)),
    "settle_pdos": _table(object_key, integer),
    "output_mode": object_key,
    "mode_pdos": _table(integer, _list(integer)),
    "absent": _list(lambda text: object_key(text)[0]),
    "unused_values": _table(object_key, integer),
    "since_restart": _KEYS,
    "pending_until_reset": _KEYS,
    "undocumented": _table(lambda text: object_key(text)[0], _text),
    "sdo_read_specifiers": _list(integer),
    "unspecified_size_writes": _truth,
    "termination": object_key,
}
_BIT = _record({"object": object_key, "bit": _bit})
_MEASUREMENT: dict[str, Convert] = {
    "position": _KEYS,
    "counts_per_turn": object_key,
    "hardware_counts_per_turn": object_key,
    "range": object_key,
    "turns": object_key,
    "offset": object_key,
    "preset": object_key,
    "direction": _BIT,
    "scaling": _BIT,
    "gray": _BIT,
    "reference": _KEYS,
    "zero": object_key,
    "alarms": object_key,
    "warnings": object_key,
    "resolution": object_key,
    "resolution_deg": _number,
    "quadrant": object_key,
    "definition": object_key,
    "axes": _table(lambda text: object_key(text)[0], integer),
    "definitions": _list(
        _record(
            {
                "value": integer,
                "name": _text,
                "axes": _pair(_text),
                "low": _pair(_number),
                "high": _pair(_number),
                "corrected": _list(integer),
            },
            {
                "singular": _text,
                "geometry": _one_of("perpendicular", "euler", "gimbal_x", "gimbal_y"),
            },
        )
    ),
    "defaults": _table(_text, _number),
}
_EMCY: dict[str, Convert] = {
    "codes": _table(lambda text: int(text, 16), _text),
    "groups": _table(lambda text: int(text, 16), _text),
    "register": _table(_bit, _text),
    "register_codes": _table(integer, _list(lambda text: int(text, 16))),
    "fields": _list(
        _record(
            {"name": _text, "start": _bit, "length": _bit},
            {
                "bits": _table(_bit, _text),
                "codes": _table(_bit, lambda text: int(text, 16)),
            },
        )
    ),
}


def _evidence(value: Any) -> Any:
    if value in ("present", "absent"):
        return value
    return _list(integer)(value)


_RULES = _list(_record({"object": object_key, "is": _evidence}))
_IDENTITY: dict[str, Convert] = {
    "name": _text,
    "device_type": _list(integer),
    "product": _list(integer),
    "needs_one_of": _RULES,
    "excluded_by": _RULES,
}
_OBJECT: dict[str, Convert] = {
    "name": _text,
    "unit": _text,
    "scale": _number,
    "scale_object": object_key,
    "meaning": _text,
    "values": _table(integer, _text),
    "bits": _table(_bit, _text),
    "fields": _bit_fields,
    "text": _text,
    "change": _change,
    "persisted": _one_of("yes", "no", "?", "-"),
}
_OVERRIDE: dict[str, Convert] = {
    "default": lambda v: v,
    "choices": tuple,
    "meaning": _text,
    "quirk": _one_of(*_QUIRKS),
    "means": _table(_text, lambda value: value),
    "factor": integer,
    "object": object_key,
}
_TOP: dict[str, Convert] = {
    "title": _text,
    "vendor": _text,
    "kind": _one_of("encoder", "inclinometer", "generic"),
    "eds": _text,
    "default_node": integer,
    "default_bitrate": integer,
    "notes": _list(_text),
    "limits": _table(_text, _number),
    "health": _table(_text, object_key),
}


class _Reader:
    def __init__(self) -> None:
        self.errors: list[str] = []

    def table(self, where: str, data: Any, known: Mapping[str, Convert]) -> dict[str, Any]:
        if not isinstance(data, dict):
            self.errors.append(f"{where}: is no table")
            return {}
        found: dict[str, Any] = {}
        for name, value in data.items():
            path = f"{where}.{name}" if where else name
            if name not in known:
                self.errors.append(f"{path}: unknown key; known are {', '.join(known)}")
                continue
            try:
                found[name] = known[name](value)
            except (ValueError, TypeError, IndexError) as error:
                self.errors.append(f"{path}: {error}")
        return found

    def objects(self, data: Any) -> dict[Key, dict[str, Any]]:
        found: dict[Key, dict[str, Any]] = {}
        for name, value in data.items() if isinstance(data, dict) else ():
            facts = self.table(f"objects.{name}", value, _OBJECT)
            try:
                found |= dict.fromkeys(_key_range(name), facts)
                facts.get("text", "").format(**{f.name: 0 for f in facts.get("fields", ())})
            except (ValueError, LookupError, AttributeError) as error:
                self.errors.append(f"objects.{name}: {error}")
        return found


def _key_range(text: str) -> list[Key]:
    first, _, last = text.partition("..")
    index, sub = object_key(first)
    return [(index, s) for s in range(sub, int(last, 16) + 1)] if last else [(index, sub)]


def read_profile(text: str, where: str) -> Profile:
    """Profile from the text of a TOML file.

    Raises:
        DescriptionError: the text is no TOML, or keys or values are wrong; all at once.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise DescriptionError(f"{where} is no TOML: {error}") from error
    reader = _Reader()
    parts = {name: data.pop(name, {}) for name in _PARTS}
    profile = Profile(**reader.table("", data, _TOP))
    profile.identity = reader.table("identity", parts["identity"], _IDENTITY)
    profile.quirks = replace(Quirks(), **reader.table("quirks", parts["quirks"], _QUIRKS))
    profile.emcy = reader.table("emcy", parts["emcy"], _EMCY)
    profile.measurement = reader.table("measurement", parts["measurement"], _MEASUREMENT)
    profile.objects = reader.objects(parts["objects"])
    overrides = parts["overrides"] if isinstance(parts["overrides"], dict) else {}
    profile.overrides = {
        name: Override(name, **reader.table(f"overrides.{name}", value, _OVERRIDE))
        for name, value in overrides.items()
    }
    if reader.errors:
        raise DescriptionError(f"{where}: " + "; ".join(reader.errors))
    return profile


_PARTS = ("identity", "quirks", "emcy", "measurement", "objects", "overrides")


def known_keys() -> dict[str, list[str]]:
    """Keys of a device's TOML file by table; "" is the head of the file."""
    tables: dict[str, Mapping[str, Convert]] = {
        "identity": _IDENTITY,
        "measurement": _MEASUREMENT,
        "quirks": _QUIRKS,
        "emcy": _EMCY,
        "objects.INDEX": _OBJECT,
        "overrides.NAME": _OVERRIDE,
    }
    head = [name for name in _TOP if name not in ("limits", "health")]
    free = {"limits": ["max_rpm", "max_angle_deg"], "health": ["any name of a quantity"]}
    return {"head": head, **{name: list(keys) for name, keys in tables.items()}, **free}


def configured(device: Device, given: Mapping[str, Any]) -> Device:
    """The device with a user's settings in its quirks, limits, scales and EMCY fields.

    Raises:
        DescriptionError: there is no such setting, or it does not take the value; all at once.
    """
    errors: list[str] = []
    changed: dict[str, Any] = {}
    facts = dict(device.facts)
    for name, value in given.items():
        setting = device.overrides.get(name)
        if setting is None:
            errors.append(f"{name}: there is no such setting, but {', '.join(device.overrides)}")
            continue
        try:
            _suits(setting, value)
            if setting.quirk and value != "auto":
                changed[setting.quirk] = _QUIRKS[setting.quirk](_quirk_value(setting, value))
            if setting.object in facts and value != "auto":
                facts[setting.object] = replace(facts[setting.object], scale=float(value))
        except (ValueError, TypeError) as error:
            errors.append(f"{name}: {error}")
    if errors:
        raise DescriptionError(f"settings of {device.name}: " + "; ".join(errors))
    numbers = {k: float(v) for k, v in given.items() if k in device.limits and v != "auto"}
    return replace(
        device,
        facts=facts,
        quirks=replace(device.quirks, **changed),
        limits={**device.limits, **numbers},
        emcy_fields=() if given.get("emcy_layout") == "none" else device.emcy_fields,
    )


def _suits(setting: Override, value: Any) -> None:
    """Raise ValueError where the value is none that the setting takes."""
    if setting.choices:
        choices = ", ".join(str(choice) for choice in setting.choices)
        if value not in setting.choices:
            raise ValueError(f"{value!r} is none of {choices}")
    elif isinstance(setting.default, bool):
        _truth(value)
    elif value != "auto" and (
        isinstance(setting.default, int | float) or setting.default == "auto"
    ):
        _number(value)


def _quirk_value(setting: Override, value: Any) -> Any:
    if setting.means:
        return setting.means[str(value).lower()]
    return int(value * setting.factor) if setting.factor != 1 else value


def with_profile(facts: dict[Key, ObjectFacts], profile: Profile) -> dict[Key, ObjectFacts]:
    """Facts from the EDS with those of the profile added; what the EDS lacks is left out."""
    known = {f.name for f in fields(ObjectFacts)}
    return {
        key: replace(fact, **cast("dict[str, Any]", {k: v for k, v in more.items() if k in known}))
        if (more := profile.objects.get(key))
        else fact
        for key, fact in facts.items()
    }


def emcy_fields(profile: Profile) -> tuple[EmcyField, ...]:
    """Fields of the manufacturer bytes."""
    return tuple(EmcyField(**part) for part in profile.emcy.get("fields", ()))
