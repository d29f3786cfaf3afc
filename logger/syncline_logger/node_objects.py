"""What the recorder knows of a node's objects, and which PDOs that makes."""

from dataclasses import dataclass
from typing import Literal

from syncline_schemas.decoder import PdoMapping
from syncline_schemas.description import NodeEntry
from syncline_schemas.devices import Device, identity_objects, quirks

Key = tuple[int, int]
Direction = Literal["tpdo", "rpdo"]

PDO_RECORDS: tuple[tuple[Direction, int, int, int], ...] = (
    ("tpdo", 0x1800, 0x1A00, 0x180),
    ("rpdo", 0x1400, 0x1600, 0x200),
)
"""Direction, first communication record, first mapping record, predefined identifier of PDO 1."""

PREDEFINED_PDOS = 4
MAX_PDOS = 512
MAX_ENTRIES = 64
"""More in subindex 0 means a multiplexed PDO (FEh, FFh) or nonsense (CiA 301 7.5.2.36)."""
_TEXTS = (0x1008, 0x1009, 0x100A)
STORE_PARAMETERS = 0x1010
PDO_PARAMETERS = range(0x1400, 0x1C00)
COMMUNICATION = range(0x1000, 0x2000)
MAX_SETTING = 64
"""Longer values are files or texts, and no settings."""

_INVALID = 1 << 31
_EXTENDED = 1 << 29


@dataclass(frozen=True, slots=True)
class PdoBinding:
    """A PDO that is known well enough to decode it."""

    node: int
    direction: Direction
    number: int
    can_id: int
    mapping: PdoMapping

    @property
    def service(self) -> str:
        """The last part of its topic.

        >>> PdoBinding(5, "tpdo", 1, 0x185, PdoMapping(())).service
        'tpdo1'
        """
        return f"{self.direction}{self.number}"


class NodeObjects:
    """Values of one node's objects by what was learned, described, or is the device's default.

    A value that was written and not saved (1010h) is forgotten when the node is reset.
    """

    def __init__(self, node: int, entry: NodeEntry | None = None) -> None:
        self.node = node
        self.device: Device | None = entry.device if entry else None
        self._described = dict(entry.objects) if entry else {}
        self._values: dict[Key, bytes] = {}
        self._kept: dict[Key, bytes] = {}
        self._unsaved: set[Key] = set()
        self._identity = identity_objects()
        self._scales: set[Key | None] = set()
        self._scales_of: Device | None = None

    def value(self, key: Key) -> bytes | None:
        """What the bus revealed of an object."""
        return self._values.get(key)

    def configuration(self) -> dict[Key, tuple[bytes, bool]]:
        """What the bus revealed of the node's settings, each with whether a reset keeps it."""
        return {
            key: (data, key not in self._unsaved)
            for key, data in self._values.items()
            if len(data) <= MAX_SETTING and (key[0] in COMMUNICATION or self.shapes_pdos(key))
        }

    def shapes_pdos(self, key: Key) -> bool:
        """Whether an object decides which PDOs the node has and what they mean."""
        if key[0] in self._identity or key[0] == STORE_PARAMETERS or key[0] in PDO_PARAMETERS:
            return True
        if self.device is None:
            return False
        if self._scales_of is not self.device:
            self._scales_of = self.device
            self._scales = {facts.scale_object for facts in self.device.facts.values()}
        return key == self.device.quirks.output_mode or key in self._scales

    def learn(self, key: Key, data: bytes, *, written: bool) -> None:
        """Take in a confirmed write or an answered read."""
        self._values[key] = data
        if written and key[0] == STORE_PARAMETERS:
            self._kept = dict(self._values)
            self._unsaved.clear()
        elif written:
            self._unsaved.add(key)
        elif key not in self._unsaved:
            self._kept[key] = data

    def reset(self) -> bool:
        """Forget what was not saved; whether anything was forgotten."""
        changed = bool(self._unsaved)
        self._values = dict(self._kept)
        self._unsaved.clear()
        return changed

    def identity(self) -> dict[Key, int | bytes]:
        """What the node answered about itself; numbers where they are 1..4 bytes."""
        return {
            key: data if key[0] in _TEXTS else int.from_bytes(data, "little")
            for key, data in self._values.items()
            if key[0] in identity_objects()
        }

    def number(self, index: int, sub: int) -> int | None:
        """An object's value as an unsigned number, None when nothing is known of it."""
        told = self.told(index, sub)
        if told is not None:
            return told
        value = self.device.default(index, sub, self.node) if self.device else None
        return value if isinstance(value, int) else None

    def told(self, index: int, sub: int) -> int | None:
        """The same without the device's default: what the bus or the description says."""
        data = self._values.get((index, sub))
        if data is not None:
            return int.from_bytes(data, "little")
        return self._described.get((index, sub))

    def bindings(self) -> list[PdoBinding]:
        """Every valid PDO of which identifier and mapping are known."""
        found = (
            self._binding(direction, communication, mapping, predefined, number)
            for direction, communication, mapping, predefined in PDO_RECORDS
            for number in sorted(self._pdo_numbers(mapping))
        )
        return [binding for binding in found if binding is not None]

    def _pdo_numbers(self, mapping: int) -> set[int]:
        indexes = {index for index, _ in self._values} | {index for index, _ in self._described}
        if self.device:
            indexes |= {index for index, _ in self.device.facts}
        return {index - mapping + 1 for index in indexes if 0 <= index - mapping < MAX_PDOS}

    def _binding(
        self, direction: Direction, communication: int, mapping: int, predefined: int, number: int
    ) -> PdoBinding | None:
        record = mapping + number - 1
        count = self.number(record, 0) or 0
        if count > MAX_ENTRIES or (direction == "tpdo" and not self._has_content(number)):
            return None
        entries = [self.number(record, sub) for sub in range(1, count + 1)]
        can_id = self.number(communication + number - 1, 1)
        if can_id is None and number <= PREDEFINED_PDOS:
            can_id = predefined + 0x100 * (number - 1) + self.node
        known = [entry for entry in entries if entry is not None]
        if not known or len(known) < count or can_id is None or can_id & (_INVALID | _EXTENDED):
            return None
        layout = PdoMapping.from_objects(known, self.device, self.number)
        return PdoBinding(self.node, direction, number, can_id & 0x7FF, layout)

    def _has_content(self, number: int) -> bool:
        """Whether a TPDO carries its mapped objects in the device's present output mode."""
        facts = quirks(self.device)
        mode = self.number(*facts.output_mode) if facts.output_mode else None
        return mode is None or number in facts.mode_pdos.get(mode, (number,))
