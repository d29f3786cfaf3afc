"""What Syncline knows of a device, in words: for `syncline devices NAME` and `docs/devices/`."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

from syncline_schemas.devices import GENERIC_QUIRKS, Device, Jump, ObjectFacts

_BYTES = ("bootup_bytes", "event_timer_types", "sdo_read_specifiers")
"""Quirks that list bytes as they are on the wire."""
_TRACED_UNITS = ("mm/s", "g")
"""Units of objects that are traced besides positions."""

HANDLED: dict[str, str] = {
    "bootup_bytes": "these state bytes are taken for a boot-up after a reset or a silence",
    "empty_heartbeat_after_rtr": "00h or no byte after a remote frame is a sign of life without a"
    " state, not a boot-up",
    "reset_quiet_ms": "silence of so many ms after a reset is no loss",
    "type_0": "what transmission type 0 does: its silence is judged by that",
    "event_timer_types": "180xh:5 counts only with these transmission types",
    "pdo_cob_id_mask": "only these bits of a write to 180xh:1 are followed",
    "fixed_mapping": "writes to 1A0xh are not followed: the mapping is fixed",
    "repeat_counters": "by TPDO: so many equal frames follow a change; silence after them is no fault",
    "aliases": "objects with one storage: a write to the one is a write to the other",
    "clear_on_read": "bits that are gone after a read were cleared by it, not repaired",
    "mute_in_stopped": "services that are silent in Stopped: not missed there",
    "rtr_any_state": "PDOs that answer a remote frame outside Operational are no fault",
    "heartbeat_wins": "a heartbeat time above 0 switches guarding off",
    "consumes_heartbeat": "whether 1016h makes it watch another node",
    "guard_toggle_restarts_on": "writes after which the guard toggle begins at 0 again",
    "life_guard_reaction": "state after a guarding loss",
    "life_guard_cleared_by_request": "the master's next message clears EMCY 8130h",
    "error_reactions": "state after a communication error, by the value of 1029h:1",
    "error_reaction_default": "1029h:1 where nobody read it",
    "hardware_preset": "a jump onto the preset value without a message is told as the set input",
    "reset_writes": "a boot-up after such a write is a reset by SDO",
    "factory_reset_writes": "such a write brings back the maker's settings, also node id and bit rate",
    "communication_reset_all": "82h reloads everything, as 81h does",
    "bitrate_object": "writes to it are told in kbit/s",
    "bitrates": "bit/s by its value",
    "node_id_object": "a node that comes up under another number after such a write is the same one",
    "node_id_switches": "rotary switches may overrule a written node id and bit rate",
    "node_id_order": "how a new node id becomes active",
    "storage": "what 1010h keeps, by its sub-index; the rest falls back at a reset",
    "saves_all": "1010h:1 keeps every writable object",
    "stored_at_once": "kept without a save",
    "load_writes_storage": "1011h acts from the next reset on",
    "jumps": "the trace is cut at such a write: the value jumps without motion",
    "side_effects": "(write, object that changes with it, its new value)",
    "settle_s": "silence [s] of the PDO after such a write, by its value",
    "settle_pdos": "the TPDO that is silent then",
    "output_mode": "selects what is measured; PDOs without defined content are not shown",
    "mode_pdos": "TPDOs with defined content by its value",
    "absent": 'may answer "object does not exist": no fault',
    "unused_values": "values that mean: not used",
    "since_restart": "counts from the last restart: a smaller value tells of one",
    "pending_until_reset": "a new value acts after a save and a restart",
    "undocumented": "not in the dictionary; a write to it is told with what relatives make of it",
    "sdo_read_specifiers": "bytes that ask for an object",
    "unspecified_size_writes": "writes come as 22h with four bytes: the type of the object counts",
    "termination": "switches the terminating resistor on: counted on a bus with error frames",
    "self_test": "the object that starts a self-test, and the one that tells its result",
    "self_test_good": "another result after a self-test is a warning",
    "self_test_ms": "a result that is read sooner is that of no test",
}
"""What Syncline makes of each quirk."""

_ROLES = {
    "counts_per_turn": "counts per turn",
    "hardware_counts_per_turn": "counts per turn of the hardware",
    "range": "measuring range, where the position wraps",
    "turns": "number of turns",
    "offset": "offset, already in the position",
    "preset": "preset",
    "direction": "counting direction",
    "scaling": "scaling on or off",
    "gray": "Gray code",
    "resolution": "resolution",
    "quadrant": "quadrant correction",
    "definition": "angle definition",
    "reference": "relative or absolute",
    "zero": "zero point",
    "measuring_step": "measuring step",
    "alarms": "alarms",
    "warnings": "warnings",
}
"""Roles of objects in the measurement."""


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the sheet: a table with as many columns as there are heads."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def sections(device: Device) -> list[Section]:
    """Everything that is known of a device besides its objects; empty parts are left out."""
    found = (
        Section("Recognised by", ("object", "value"), tuple(_identity(device))),
        Section("Shown", ("what", "from", "how"), tuple(_shown(device))),
        Section("EMCY codes", ("code", "meaning"), tuple(_emcy(device))),
        Section("Quirks", ("quirk", "value", "what Syncline makes of it"), tuple(_quirks(device))),
        Section("Limits", ("limit", "value"), tuple(_limits(device))),
        Section("Settings per node", ("setting", "default", "meaning"), tuple(_settings(device))),
        Section(
            "Where the manual contradicts itself",
            ("the manual", "read as", "setting"),
            tuple((each.manual, each.reading, each.override) for each in device.contradictions),
        ),
        Section(
            "Repaired in the EDS",
            ("where", "what"),
            tuple((w.where, w.text) for w in device.warnings),
        ),
    )
    return [section for section in found if section.rows]


def objects(device: Device) -> Section:
    """The object dictionary: types, factory values, units, meaning."""
    heads = ("object", "name", "type", "access", "default", "unit", "kept", "meaning")
    node = device.default_node or 1
    rows = (
        (
            place(*key, record=bool(facts.record)),
            facts.full_name,
            facts.type_name,
            facts.access,
            _default(device, facts, device.default(*key, node)),
            _unit(facts),
            {"yes": "saved", "no": "no"}.get(facts.persisted, facts.persisted.strip("-")),
            _meaning(facts),
        )
        for key, facts in sorted(device.facts.items())
    )
    return Section("Objects", heads, tuple(rows))


def place(index: int, sub: int, *, record: bool = False) -> str:
    """An object as people write it.

    >>> place(0x6004, 0), place(0x1018, 1), place(0x1018, 0, record=True)
    ('6004h', '1018h:01', '1018h:00')
    """
    return f"{index:04X}h:{sub:02X}" if sub or record else f"{index:04X}h"


def _identity(device: Device) -> Iterator[tuple[str, str]]:
    rules = device.identity
    if "name" in rules:
        yield "1008h", f'"{rules["name"]}"'
    if "vendor" in rules:
        yield "1018h:01", f"{rules['vendor']:X}h"
    if "product" in rules:
        yield "1018h:02", " or ".join(f"{each:08X}h" for each in rules["product"])
    if "device_type" in rules:
        yield "1000h", " or ".join(f"{each:08X}h" for each in rules["device_type"])
    for key, words in (("needs_one_of", "{} (one of these)"), ("excluded_by", "not if {}")):
        for rule in rules.get(key, ()):
            wanted = rule["is"]
            told = wanted if isinstance(wanted, str) else " or ".join(map(str, wanted))
            yield place(*rule["object"]), words.format(told)


def _shown(device: Device) -> Iterator[tuple[str, str, str]]:
    """Traces with what their scale comes from, health, changes."""
    roles = device.measurement
    for key in roles.get("position", ()):
        yield f"trace {_name(device, key)}", place(*key), _trace(device)
    for key, facts in sorted(device.facts.items()):
        if facts.unit in _TRACED_UNITS and facts.mappable:
            yield f"trace {facts.name}", place(*key), f"in {facts.unit}"
    for role, words in _ROLES.items():
        for key in _places(roles.get(role)):
            yield words, place(*key), _name(device, key)
    for each in roles.get("definitions", ()):
        axes = (
            f"{axis} {low:g}..{high:g}"
            for axis, low, high in zip(each["axes"], each["low"], each["high"], strict=True)
        )
        singular = f"; {each['singular']}" if "singular" in each else ""
        yield f"angles, {each['name']}", f"value {each['value']}", ", ".join(axes) + singular
    for what, key in device.health.items():
        fact = device.object(*key)
        unit = f" in {fact.unit}" if fact and fact.unit else ""
        yield what, place(*key), f"whenever it is read{unit}"


def _places(role: Any) -> list[tuple[int, int]]:
    """Objects of a role: one, several, or one with the number of a bit."""
    match role:
        case None:
            return []
        case {"object": key}:
            return [key]
        case (int(), int()):
            return [role]
    return list(role)


def _trace(device: Device) -> str:
    if device.kind == "inclinometer":
        return "degrees by resolution, quadrant correction and angle definition"
    if device.kind == "encoder":
        return "position, turn, angle, unwrapped angle and speed"
    return "its value"


def _name(device: Device, key: tuple[int, int]) -> str:
    return device.object_name(*key) or place(*key)


def _emcy(device: Device) -> Iterator[tuple[str, str]]:
    yield from ((f"{code:04X}h", text) for code, text in sorted(device.emcy_codes.items()))
    yield from (
        (f"{high:02X}xxh", f"{text}, where the code itself is not listed")
        for high, text in sorted(device.emcy_groups.items())
    )
    yield from (
        (f"register bit {bit}", text) for bit, text in sorted(device.emcy_register_names.items())
    )
    for field in device.emcy_fields:
        first = 3 + field.start
        bits = "; ".join(f"bit {bit} = {text}" for bit, text in field.bits.items())
        yield f"bytes {first}..{first + field.length - 1}", f"{field.name}: {bits}"


def _quirks(device: Device) -> Iterator[tuple[str, str, str]]:
    for field in fields(device.quirks):
        value = getattr(device.quirks, field.name)
        if value != getattr(GENERIC_QUIRKS, field.name):
            text = _byte_list(field.name, value) or _quirk_text(value)
            yield field.name.replace("_", " "), text, HANDLED[field.name]


def _byte_list(name: str, value: Any) -> str:
    return ", ".join(f"{byte:02X}h" for byte in value) if name in _BYTES else ""


def _quirk_text(value: Any) -> str:
    match value:
        case bool():
            return "yes" if value else "no"
        case Jump():
            values = f" = {', '.join(map(str, value.values))}" if value.values else ""
            return f"{value.index:04X}h{values} ({value.text})"
        case (int(index), int(sub)) if index > 0xFF:
            return f"{index:04X}h" + (f":{sub:X}" if sub else "")
        case int():
            return f"{value:04X}h" if value > 0xFFF and value % 1000 else str(value)
        case Mapping():
            return "; ".join(f"{_quirk_text(k)}: {_quirk_text(v)}" for k, v in value.items())
        case tuple():
            return ", ".join(_quirk_text(part) for part in value)
    return str(value)


def _limits(device: Device) -> Iterator[tuple[str, str]]:
    yield from ((name, f"{value:g}") for name, value in device.limits.items())


def _settings(device: Device) -> Iterator[tuple[str, str, str]]:
    for name, setting in device.overrides.items():
        choices = f" ({' | '.join(map(str, setting.choices))})" if setting.choices else ""
        yield name, f"{_as_toml(setting.default)}{choices}", setting.meaning


def _as_toml(value: Any) -> str:
    """A default as the user would write it, texts without their quotes."""
    if isinstance(value, list):
        return f"[{', '.join(f'0x{part:02X}' for part in value)}]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _default(device: Device, facts: ObjectFacts, default: int | bytes | None) -> str:
    if isinstance(default, bytes):
        return str(device.value(facts.index, facts.sub, default))
    if default is None:
        return ""
    return f"{default:X}h" if default > 9 and not facts.unit else str(default)


def _unit(facts: ObjectFacts) -> str:
    scale = "" if facts.scale == 1 else f"{facts.scale:g} "
    by = f"{facts.scale_object[0]:04X}h x " if facts.scale_object else ""
    return f"{by}{scale}{facts.unit}"


def _meaning(facts: ObjectFacts) -> str:
    """The maker's words, which name the values too; else the values and bits alone."""
    words = [f"{value} = {text}" for value, text in facts.values.items()]
    words += [f"bit {bit} = {text}" for bit, text in facts.bits.items()]
    return facts.meaning or "; ".join(words)
