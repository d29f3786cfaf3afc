"""A device: its object dictionary and everything an EDS has no field for."""

from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING, Any, Literal

from syncline_schemas.canopen import emcy
from syncline_schemas.canopen.datatypes import Value, decode_value, type_name
from syncline_schemas.eds import EdsWarning, assumed_value
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    from canopen import ObjectDictionary

Key = tuple[int, int]
"""(index, subindex) of an object."""
Kind = Literal["encoder", "inclinometer", "generic"]
Reaction = Literal["pre-operational", "keep", "stopped"]


@dataclass(frozen=True, slots=True)
class BitField:
    """A named group of bits of a value; `low` and `high` are inclusive."""

    name: str
    low: int
    high: int

    def of(self, value: int) -> int:
        """The field's value."""
        return value >> self.low & ((1 << (self.high - self.low + 1)) - 1)


@dataclass(frozen=True, slots=True)
class ObjectFacts:
    """One object: what the EDS says, and its unit, scale and meaning.

    The engineering value is `raw * scale` in `unit`; where `scale_object` is given, it is
    `raw * scale * value of that object`. `persisted` is "yes" (kept by a save or at once),
    "no", "?" (the maker does not say) or "" (does not apply).
    """

    index: int
    sub: int
    name: str
    data_type: int | None = None
    access: str = ""
    mappable: bool = False
    unit: str = ""
    scale: float = 1.0
    scale_object: Key | None = None
    meaning: str = ""
    values: Mapping[int, str] = field(default_factory=dict)
    """Enumeration: words by value."""
    bits: Mapping[int, str] = field(default_factory=dict)
    """Words by bit number."""
    fields: tuple[BitField, ...] = ()
    text: str = ""
    """Format that writes the fields as people do, for example "{year:02d}.{number}"."""
    change: str = ""
    """Format that says what a write did: {value} is the number, {words} its meaning, {unit} its unit."""
    persisted: str = ""
    low: int | None = None
    high: int | None = None
    record: str = ""
    """Name of the array or record that holds the object, "" for plain variables."""

    @property
    def full_name(self) -> str:
        """Name with that of the record before it: "TPDO1 communication parameter: COB-ID"."""
        return f"{self.record}: {self.name}" if self.record else self.name

    @property
    def type_name(self) -> str:
        """Name of the data type."""
        return type_name(self.data_type)

    def describe(self, value: int) -> str:
        """Words for a value: its enumeration, its bits or its fields; "" where there are none."""
        if value in self.values:
            return self.values[value]
        if self.fields and self.text:
            return self.text.format(**{part.name: part.of(value) for part in self.fields})
        named = [text for bit, text in sorted(self.bits.items()) if value >> bit & 1]
        return ", ".join(named)


@dataclass(frozen=True, slots=True)
class Jump:
    """An object whose write makes the measured value jump without motion.

    `values` lists the raw values that do so, None means any. `text` says what happened.
    """

    index: int
    sub: int
    text: str
    values: tuple[int, ...] | None = None


@dataclass(frozen=True, slots=True)
class Quirks:
    """Where a device deviates from CiA 301, or what the standard leaves open; facts, not errors."""

    bootup_bytes: tuple[int, ...] = (0x00,)
    """State bytes that a boot-up may carry; 7Fh where heartbeat runs from the start."""
    empty_heartbeat_after_rtr: bool = False
    """After a remote frame on 700h+n heartbeats have byte 00h or no data until a reset."""
    reset_quiet_ms: int = 0
    """Silence after an NMT reset that is normal, before or after the boot-up."""
    type_0: Literal["acyclic", "off", "once_per_change", "unknown"] = "acyclic"
    event_timer_types: tuple[int, ...] = (0xFE, 0xFF)
    """Transmission types with which 180xh:5 works."""
    pdo_cob_id_mask: int = 0xFFFFFFFF
    """Bits of 180xh:1 that a write changes: 80000000h = on/off only, 0 = read-only."""
    fixed_mapping: bool = False
    repeat_counters: Mapping[int, Key] = field(default_factory=dict)
    """By TPDO number: object that limits how many equal frames follow a change (0 = no limit)."""
    aliases: Mapping[Key, Key] = field(default_factory=dict)
    """Objects that share the storage of another one."""
    clear_on_read: tuple[Key, ...] = ()
    """Objects whose bits vanish when they are read."""
    mute_in_stopped: tuple[str, ...] = ("sdo", "pdo", "emcy", "sync")
    """Services that are silent in Stopped."""
    rtr_any_state: bool = False
    """Remote frames on TPDOs are answered in any NMT state."""
    heartbeat_wins: bool | None = None
    """Whether 1017h > 0 switches node guarding off; None where the maker does not say."""
    consumes_heartbeat: bool = True
    """Whether 1016h makes the device watch another node."""
    guard_toggle_restarts_on: tuple[Key, ...] = ()
    """Objects whose write restarts the guard toggle bit at 0."""
    life_guard_reaction: Literal["1029h", "pre-operational"] = "1029h"
    life_guard_cleared_by_request: bool = False
    """The next message of the master clears 8130h (EMCY 0000h)."""
    error_reactions: Mapping[int, Reaction] = field(
        default_factory=lambda: {0: "pre-operational", 1: "keep", 2: "stopped"}
    )
    """NMT state after a communication error by the value of 1029h:1."""
    error_reaction_default: int = 0
    """1029h:1 where it is not known."""
    hardware_preset: bool = False
    """A wire zeroes the position without any bus message."""
    reset_writes: Mapping[Key, int] = field(default_factory=dict)
    """Objects that reset the device when this value is written, without an NMT command."""
    factory_reset_writes: Mapping[Key, int] = field(default_factory=dict)
    """Objects that bring back the maker's values of 2000h..5FFFh when this value is written."""
    communication_reset_all: bool = False
    """NMT 82h reloads everything, not only 1000h..1FFFh."""
    bitrate_object: Key | None = None
    bitrates: Mapping[int, int] = field(default_factory=dict)
    """Bit rate [bit/s] by raw value of the bit rate object."""
    node_id_object: Key | None = None
    node_id_switches: bool = False
    """Rotary switches may overrule the node id and bit rate objects."""
    node_id_order: str = ""
    """How a new node id becomes active, in words."""
    storage: Mapping[int, tuple[Key, ...]] = field(default_factory=dict)
    """By subindex of 1010h: objects that this save keeps."""
    saves_all: bool = False
    """1010h:1 keeps every writable object."""
    stored_at_once: tuple[Key, ...] = ()
    """Objects kept without a save."""
    load_writes_storage: bool = True
    """1011h puts the defaults into the storage; running values stay until a reset."""
    jumps: tuple[Jump, ...] = ()
    side_effects: tuple[tuple[Key, Key, int], ...] = ()
    """(written object, object that changes with it, its new value)."""
    settle_s: Mapping[Key, Mapping[int, float]] = field(default_factory=dict)
    """Silence [s] of the affected PDO after a write, by object and written value."""
    settle_pdos: Mapping[Key, int] = field(default_factory=dict)
    """TPDO number that falls silent after a write to the object."""
    output_mode: Key | None = None
    """Object that selects what is measured."""
    mode_pdos: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    """TPDO numbers with defined content by value of the output mode."""
    absent: tuple[int, ...] = ()
    """Indexes that may abort with 0602 0000 although the profile has them."""
    unused_values: Mapping[Key, int] = field(default_factory=dict)
    """Values that mean "not used", for example serial number FFFFFFFFh."""
    since_restart: tuple[Key, ...] = ()
    """Objects that count from the last restart: a smaller value tells of one."""
    pending_until_reset: tuple[Key, ...] = ()
    """Objects whose new value acts only after it was saved and the device restarted."""
    undocumented: Mapping[int, str] = field(default_factory=dict)
    """What an index that is not in the dictionary most likely means."""
    sdo_read_specifiers: tuple[int, ...] = (0x40,)
    unspecified_size_writes: bool = False
    """Writes are printed as 22h: four bytes, the size not given."""
    termination: Key | None = None
    """Object that switches the terminating resistor; 1 = on."""
    self_test: Mapping[Key, Key] = field(default_factory=dict)
    """Object that starts a self-test when 1 is written, and the one that tells its result."""
    self_test_good: int | None = None
    """The result where all is well."""
    self_test_ms: int = 0
    """A self-test lasts so long."""


GENERIC_QUIRKS = Quirks()
"""What CiA 301 says, for devices of which nothing else is known."""


@dataclass(frozen=True, slots=True)
class Override:
    """A setting that a user may give per node, with the values it takes.

    `quirk` names the quirk that it changes, `means` the quirk's value by the text of the setting,
    `factor` that of a number; `object` is the object whose scale it gives, `sets` the one whose
    value it states. `loads` says that `means` names another device, `binds` that it tells whose
    identifiers are sent. "auto" changes nothing.
    """

    name: str
    default: Any = None
    choices: tuple[Any, ...] = ()
    meaning: str = ""
    quirk: str = ""
    means: Mapping[str, Any] = field(default_factory=dict)
    factor: int = 1
    object: Key | None = None
    sets: Key | None = None
    loads: bool = False
    binds: bool = False


@dataclass(frozen=True, slots=True)
class Contradiction:
    """A place at which a device's manual contradicts itself or leaves something open.

    `reading` is how it is read here; `override` names the setting that reads it another way, "" for
    none.
    """

    manual: str
    reading: str
    override: str = ""


@dataclass(frozen=True, slots=True)
class EmcyField:
    """Bytes of the manufacturer's part of an EMCY: first byte and length within the five."""

    name: str
    start: int
    length: int
    bits: Mapping[int, str] = field(default_factory=dict)
    codes: Mapping[int, int] = field(default_factory=dict)
    """EMCY code that a set bit stands for."""


@dataclass(frozen=True, slots=True, eq=False)
class Device:
    """Everything that is known of a kind of device.

    Attributes:
        identity: rules by which `identify` knows the device.
        name: catalogue name, or the stem of the user's file.
        od: object dictionary of python-canopen, imported without a node id.
        warnings: what the EDS import had to repair.
        files: the description files by name, for the attachments of a capture.
        emcy_codes: the maker's meaning by EMCY code; `emcy_groups` by high byte.
        emcy_registers: EMCY code by register bit that stays set while the error is active.
        measurement: profile-specific facts, read by `syncline_schemas.measurement`.
        limits: plausibility limits, for example `max_rpm`.
        health: objects that tell the state of the device, by what they are ("EEPROM writes").
    """

    name: str
    title: str
    vendor: str
    kind: Kind
    od: "ObjectDictionary"
    facts: Mapping[Key, ObjectFacts]
    quirks: Quirks = GENERIC_QUIRKS
    default_node: int | None = None
    default_bitrate: int | None = None
    identity: Mapping[str, Any] = field(default_factory=dict)
    emcy_codes: Mapping[int, str] = field(default_factory=dict)
    emcy_groups: Mapping[int, str] = field(default_factory=dict)
    emcy_register_names: Mapping[int, str] = field(default_factory=lambda: emcy.REGISTER_BITS)
    emcy_registers: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    emcy_fields: tuple[EmcyField, ...] = ()
    measurement: Mapping[str, Any] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)
    health: Mapping[str, Key] = field(default_factory=dict)
    overrides: Mapping[str, Override] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    contradictions: tuple[Contradiction, ...] = ()
    warnings: tuple[EdsWarning, ...] = ()
    files: Mapping[str, bytes] = field(default_factory=dict)

    def default(self, index: int, sub: int, node: int) -> int | bytes | None:
        """Value that the description gives an object: ParameterValue of a DCF, else DefaultValue.

        `$NODEID` is resolved with `node`; strings and floats come as their bytes on the wire;
        None where the description gives none.
        """
        return assumed_value(self.od, index, sub, node)

    def object(self, index: int, sub: int = 0) -> ObjectFacts | None:
        """Facts of an object, None when the dictionary does not hold it."""
        return self.facts.get((index, sub))

    def object_name(self, index: int, sub: int = 0) -> str | None:
        """Name of an object; of a record's entry with the record's name before it."""
        facts = self.facts.get((index, sub))
        return facts.full_name if facts else None

    def value(self, index: int, sub: int, data: bytes) -> Value:
        """Value of an object by its data type; surplus bytes of size-less answers are dropped."""
        facts = self.facts.get((index, sub))
        return decode_value(facts.data_type if facts else None, data)

    def emcy_meaning(self, code: int) -> str:
        """Words for an EMCY code: the maker's table, then CiA 301."""
        return emcy_meaning(self, code)

    def register_bits(self, register: int) -> list[str]:
        """Names of the bits set in the error register."""
        return emcy.register_bits(register, dict(self.emcy_register_names))

    def emcy_details(self, manufacturer: bytes) -> dict[str, Any]:
        """The five manufacturer bytes of an EMCY, decoded: value and bit names per field."""
        return emcy_details(self, manufacturer)

    def settings(self, given: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """The user overrides with the defaults of those that were not given."""
        return {name: o.default for name, o in self.overrides.items()} | dict(given or {})


def emcy_meaning(device: Device | None, code: int) -> str:
    """Words for an EMCY code, without its number: the device's code, its group, then CiA 301."""
    if device is not None:
        if code in device.emcy_codes:
            return device.emcy_codes[code]
        if code >> 8 in device.emcy_groups and code not in emcy.CODES:
            return device.emcy_groups[code >> 8]
    return emcy.code_meaning(code)


def register_bits(device: Device | None, register: int) -> list[str]:
    """Names of the bits set in an error register, by the device's table or CiA 301."""
    return device.register_bits(register) if device else emcy.register_bits(register)


def emcy_details(device: Device | None, manufacturer: bytes) -> dict[str, Any]:
    """Fields of the manufacturer bytes: `name` -> value, `name_bits` -> names of its set bits.

    Bytes that no field covers are left out; a device without fields gives an empty dict.
    """
    details: dict[str, Any] = {}
    for part in device.emcy_fields if device else ():
        value = int.from_bytes(manufacturer[part.start : part.start + part.length], "little")
        details[part.name] = value
        if part.bits:
            width = range(8 * part.length)
            details[f"{part.name}_bits"] = [
                part.bits.get(bit, f"bit {bit}") for bit in width if value >> bit & 1
            ]
    return details


def quirks(device: Device | None) -> Quirks:
    """Quirks of a device, those of plain CiA 301 when it is not known."""
    return device.quirks if device else GENERIC_QUIRKS
