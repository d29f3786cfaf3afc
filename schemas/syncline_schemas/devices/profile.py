"""The TOML file of a device read into facts; everything wrong in it is told at once."""

from collections.abc import Mapping
from dataclasses import field, fields, replace
from typing import Any, cast

from syncline_schemas.devices.convert import (
    Convert,
    integer,
    need,
    object_key,
    to_bit,
    to_list,
    to_number,
    to_one_of,
    to_pair,
    to_record,
    to_table,
    to_text,
    to_truth,
)
from syncline_schemas.devices.model import (
    BitField,
    Contradiction,
    EmcyField,
    Jump,
    Key,
    ObjectFacts,
    Override,
    Quirks,
)
from syncline_schemas.errors import DescriptionError
from syncline_schemas.records import dataclass


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
    contradictions: tuple[Contradiction, ...] = ()
    objects: dict[Key, dict[str, Any]] = field(default_factory=dict)


def _bit_fields(value: Any) -> tuple[BitField, ...]:
    table = to_table(to_text, to_list(to_bit))(value)
    for bits in table.values():
        need(len(bits) > 0 and bits[0] <= bits[-1], bits, "range of bits, like [0, 15]")
    return tuple(BitField(name, bits[0], bits[-1]) for name, bits in table.items())


def _change(value: Any) -> str:
    read = to_text(value)
    try:
        read.format(value=0, words="", unit="")
    except (LookupError, ValueError) as error:
        raise ValueError(f"{read!r} may hold {{value}}, {{words}} and {{unit}} only") from error
    return read


def _jump(value: Any) -> Jump:
    read = to_record({"object": object_key, "text": to_text}, {"values": to_list(integer)})(value)
    index, sub = read["object"]
    return Jump(index, sub, read["text"], read.get("values"))


def _side_effect(value: Any) -> tuple[Key, Key, int]:
    read = to_record({"write": object_key, "changes": object_key, "to": integer})(value)
    return read["write"], read["changes"], read["to"]


_REACTION = to_one_of("pre-operational", "keep", "stopped")
_KEYS = to_list(object_key)
QUIRKS: dict[str, Convert] = {
    "bootup_bytes": to_list(integer),
    "empty_heartbeat_after_rtr": to_truth,
    "reset_quiet_ms": integer,
    "type_0": to_one_of("acyclic", "off", "once_per_change", "unknown"),
    "event_timer_types": to_list(integer),
    "pdo_cob_id_mask": integer,
    "fixed_mapping": to_truth,
    "repeat_counters": to_table(integer, object_key),
    "aliases": to_table(object_key, object_key),
    "clear_on_read": _KEYS,
    "mute_in_stopped": to_list(to_one_of("sdo", "pdo", "emcy", "sync")),
    "rtr_any_state": to_truth,
    "heartbeat_wins": to_truth,
    "consumes_heartbeat": to_truth,
    "guard_toggle_restarts_on": _KEYS,
    "life_guard_reaction": to_one_of("1029h", "pre-operational"),
    "life_guard_cleared_by_request": to_truth,
    "error_reactions": to_table(integer, _REACTION),
    "error_reaction_default": integer,
    "hardware_preset": to_truth,
    "reset_writes": to_table(object_key, integer),
    "factory_reset_writes": to_table(object_key, integer),
    "communication_reset_all": to_truth,
    "bitrate_object": object_key,
    "bitrates": to_table(integer, integer),
    "node_id_object": object_key,
    "node_id_switches": to_truth,
    "node_id_order": to_text,
    "storage": to_table(integer, _KEYS),
    "saves_all": to_truth,
    "stored_at_once": _KEYS,
    "load_writes_storage": to_truth,
    "jumps": to_list(_jump),
    "side_effects": to_list(_side_effect),
    "settle_s": to_table(object_key, to_table(integer, to_number)),
    "settle_pdos": to_table(object_key, integer),
    "output_mode": object_key,
    "mode_pdos": to_table(integer, to_list(integer)),
    "absent": to_list(lambda text: object_key(text)[0]),
    "unused_values": to_table(object_key, integer),
    "since_restart": _KEYS,
    "pending_until_reset": _KEYS,
    "undocumented": to_table(lambda text: object_key(text)[0], to_text),
    "sdo_read_specifiers": to_list(integer),
    "unspecified_size_writes": to_truth,
    "termination": object_key,
    "self_test": to_table(object_key, object_key),
    "self_test_good": integer,
    "self_test_ms": integer,
}
_BIT = to_record({"object": object_key, "bit": to_bit})
_MEASUREMENT: dict[str, Convert] = {
    "position": _KEYS,
    "counts_per_turn": object_key,
    "hardware_counts_per_turn": object_key,
    "range": object_key,
    "turns": object_key,
    "offset": object_key,
    "preset": object_key,
    "direction": _BIT,
    "direction_alias": _BIT,
    "scaling": _BIT,
    "gray": _BIT,
    "reference": _KEYS,
    "zero": object_key,
    "alarms": object_key,
    "warnings": object_key,
    "measuring_step": object_key,
    "resolution": object_key,
    "resolution_deg": to_number,
    "quadrant": object_key,
    "definition": object_key,
    "axes": to_table(lambda text: object_key(text)[0], integer),
    "definitions": to_list(
        to_record(
            {
                "value": integer,
                "name": to_text,
                "axes": to_pair(to_text),
                "low": to_pair(to_number),
                "high": to_pair(to_number),
                "corrected": to_list(integer),
            },
            {
                "singular": to_text,
                "geometry": to_one_of("perpendicular", "euler", "gimbal_x", "gimbal_y"),
            },
        )
    ),
    "defaults": to_table(to_text, to_number),
}
_EMCY: dict[str, Convert] = {
    "codes": to_table(lambda text: int(text, 16), to_text),
    "groups": to_table(lambda text: int(text, 16), to_text),
    "register": to_table(to_bit, to_text),
    "register_codes": to_table(integer, to_list(lambda text: int(text, 16))),
    "fields": to_list(
        to_record(
            {"name": to_text, "start": to_bit, "length": to_bit},
            {
                "bits": to_table(to_bit, to_text),
                "codes": to_table(to_bit, lambda text: int(text, 16)),
            },
        )
    ),
}


def _evidence(value: Any) -> Any:
    if value in ("present", "absent"):
        return value
    return to_list(integer)(value)


_RULES = to_list(to_record({"object": object_key, "is": _evidence}))
_IDENTITY: dict[str, Convert] = {
    "name": to_text,
    "device_type": to_list(integer),
    "product": to_list(integer),
    "needs_one_of": _RULES,
    "excluded_by": _RULES,
}
_OBJECT: dict[str, Convert] = {
    "name": to_text,
    "unit": to_text,
    "scale": to_number,
    "scale_object": object_key,
    "meaning": to_text,
    "values": to_table(integer, to_text),
    "bits": to_table(to_bit, to_text),
    "fields": _bit_fields,
    "text": to_text,
    "change": _change,
    "persisted": to_one_of("yes", "no", "?", "-"),
}
_OVERRIDE: dict[str, Convert] = {
    "default": lambda v: v,
    "choices": tuple,
    "meaning": to_text,
    "quirk": to_one_of(*QUIRKS),
    "means": to_table(to_text, lambda value: value),
    "factor": integer,
    "object": object_key,
    "sets": object_key,
    "loads": to_truth,
    "binds": to_truth,
}


def _contradictions(value: Any) -> tuple[Contradiction, ...]:
    record = to_record({"manual": to_text, "reading": to_text}, {"override": to_text})
    return tuple(Contradiction(**entry) for entry in to_list(record)(value))


_TOP: dict[str, Convert] = {
    "title": to_text,
    "vendor": to_text,
    "kind": to_one_of("encoder", "inclinometer", "generic"),
    "eds": to_text,
    "default_node": integer,
    "default_bitrate": integer,
    "notes": to_list(to_text),
    "limits": to_table(to_text, to_number),
    "health": to_table(to_text, object_key),
    "contradictions": _contradictions,
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
    import tomllib

    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise DescriptionError(f"{where} is no TOML: {error}") from error
    reader = _Reader()
    parts = {name: data.pop(name, {}) for name in _PARTS}
    profile = Profile(**reader.table("", data, _TOP))
    profile.identity = reader.table("identity", parts["identity"], _IDENTITY)
    profile.quirks = replace(Quirks(), **reader.table("quirks", parts["quirks"], QUIRKS))
    profile.emcy = reader.table("emcy", parts["emcy"], _EMCY)
    profile.measurement = reader.table("measurement", parts["measurement"], _MEASUREMENT)
    profile.objects = reader.objects(parts["objects"])
    overrides = parts["overrides"] if isinstance(parts["overrides"], dict) else {}
    profile.overrides = {
        name: Override(name, **reader.table(f"overrides.{name}", value, _OVERRIDE))
        for name, value in overrides.items()
    }
    reader.errors += [
        f"contradictions: there is no setting {each.override}"
        for each in profile.contradictions
        if each.override and each.override not in profile.overrides
    ]
    if reader.errors:
        raise DescriptionError(f"{where}: " + "; ".join(reader.errors))
    return profile


_PARTS = ("identity", "quirks", "emcy", "measurement", "objects", "overrides")


def known_keys() -> dict[str, list[str]]:
    """Keys of a device's TOML file by table; "" is the head of the file."""
    tables: dict[str, Mapping[str, Convert]] = {
        "identity": _IDENTITY,
        "measurement": _MEASUREMENT,
        "quirks": QUIRKS,
        "emcy": _EMCY,
        "objects.INDEX": _OBJECT,
        "overrides.NAME": _OVERRIDE,
    }
    head = [name for name in _TOP if name not in ("limits", "health", "contradictions")]
    free = {"limits": ["max_rpm", "max_angle_deg"], "health": ["any name of a quantity"]}
    own = {"[contradictions]": ["manual", "reading", "override"]}
    return {"head": head, **{name: list(keys) for name, keys in tables.items()}, **free, **own}


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
