"""Whose PDO an identifier is at a moment, how it is mapped, and when it is sent."""

from bisect import bisect_right
from collections.abc import Iterator
from typing import Literal

from syncline_analyzer.service_ids import FRAME_29_BIT, OFF, cob_id, sync_id
from syncline_analyzer.shadow import Known, Shadow
from syncline_schemas.canopen.services import predefined_pdo
from syncline_schemas.decoder import PdoMapping
from syncline_schemas.devices import Device, quirks
from syncline_schemas.records import dataclass

Kind = Literal["tpdo", "rpdo"]

COMMUNICATION: dict[Kind, int] = {"tpdo": 0x1800, "rpdo": 0x1400}
"""First communication parameter record; PDO n has the (n - 1)th after it."""
MAPPING: dict[Kind, int] = {"tpdo": 0x1A00, "rpdo": 0x1600}
PDO_COUNT = 512
_END = 1 << 63
"""A `seq` behind all others."""
MAX_MAPPED = 64
"""Objects that one PDO can carry (CiA 301 7.5.2.36)."""
_TIME_ID, _EMCY_ID = (0x1012, 0), (0x1014, 0)
_SERVICE_IDS = {_TIME_ID, _EMCY_ID}
_SYNC_PARAMETERS = (0x1005, 0x1006, 0x1007, 0x1019)
_RANK = {"sdo-read": 0, "sdo-write": 0, "bus-description": 1, "eds-default": 2, "predefined": 3}


@dataclass(frozen=True, slots=True)
class Pdo:
    """A PDO of a node and what binds it to its identifier ("predefined" is only a guess)."""

    bus: int
    node: int
    kind: Kind
    number: int
    source: str

    @property
    def guess(self) -> bool:
        """Whether only the predefined connection set says so."""
        return self.source == "predefined"

    @property
    def name(self) -> str:
        """ "TPDO1", or "TPDO1 (guess)"."""
        return f"{self.kind.upper()}{self.number}{' (guess)' if self.guess else ''}"

    @property
    def communication(self) -> int:
        """Index of its communication parameters (180xh or 140xh)."""
        return COMMUNICATION[self.kind] + self.number - 1

    @property
    def mapping(self) -> int:
        """Index of its mapping parameters (1A0xh or 160xh)."""
        return MAPPING[self.kind] + self.number - 1


@dataclass(frozen=True, slots=True)
class Transmission:
    """When a PDO is sent, as far as somebody said so; each value with its source."""

    type: Known | None
    inhibit_100us: Known | None
    event_timer_ms: Known | None


def settled(shadow: Shadow, bus: int, seq: int) -> int | None:
    """Version of the shadow where what a bus is set to at `seq` is what it is in the end, else None.

    While it stays, no setting of the communication profile need be looked up again.
    """
    later = any(shadow.configured(bus, node, seq, _END) for node in shadow.nodes_of(bus))
    return None if later else shadow.version


class PdoBindings:
    """Identifiers of the PDOs of all nodes over the capture, by what the shadow knows.

    The claims are collected by `refresh`, which costs little and is due whenever the shadow may
    have learned something; `owner` and the like then answer for any `seq`.
    """

    def __init__(self, shadow: Shadow) -> None:
        self._shadow = shadow
        self._claims: dict[tuple[int, int], list[tuple[Kind, int, int]]] = {}
        self._assumed: dict[int, dict[int, list[tuple[Kind, int, int]]]] = {}
        self._devices: dict[int, list[Device | None]] = {}
        self._version: dict[int, int] = {}

    def refresh(self, bus: int) -> None:
        """Collect the identifiers that any node of a bus claims or ever claimed."""
        if self._version.get(bus) == self._shadow.version:
            return
        self._version[bus] = self._shadow.version
        claims: dict[tuple[int, int], list[tuple[Kind, int, int]]] = {}
        for can_id, found in self._assumed_claims(bus).items():
            claims[bus, can_id] = list(found)
        for learned_bus, node in self._shadow.nodes():
            if learned_bus != bus:
                continue
            for kind, number, value in self._learned_claims(bus, node):
                entry = claims.setdefault((bus, value & 0x7FF), [])
                if (kind, number, node) not in entry:
                    entry.append((kind, number, node))
        for key in [key for key in self._claims if key[0] == bus]:
            del self._claims[key]
        self._claims.update(claims)

    def identifiers(self, bus: int) -> list[int]:
        """Every 11-bit identifier that a PDO of the bus is or was bound to."""
        return [can_id for claimed_bus, can_id in self._claims if claimed_bus == bus]

    def owner(self, bus: int, can_id: int, seq: int | None = None) -> Pdo | None:
        """The PDO that an identifier carries at `seq` (at the end when None).

        What was seen on the bus wins over the bus description, that over the device's EDS, that
        over the predefined connection set. A TPDO wins over an RPDO: it is the one that is sent.
        """
        bound: list[Pdo] = []
        for kind, number, node in self._claims.get((bus, can_id), ()):
            known = self.identifier(bus, node, kind, number, seq)
            if known is not None and known.value == can_id:
                bound.append(Pdo(bus, node, kind, number, known.source))
        if bound:
            return min(bound, key=lambda pdo: (pdo.kind == "rpdo", _RANK[pdo.source]))
        return self._guess(bus, can_id, seq)

    def cuts(self, bus: int, can_id: int, first: int, last: int) -> list[int]:
        """Moments `first < seq <= last` at which owner or mapping of an identifier may change."""
        found: set[int] = set()
        claims = self._claims.get((bus, can_id), [])
        guess = predefined_pdo(can_id)
        if guess is not None:
            kind, number, node = guess
            claims = [*claims, ("tpdo" if kind == "tpdo" else "rpdo", number, node)]
        for kind, number, node in claims:
            if not self._shadow.configured(bus, node, first, last):
                continue
            subs = [(COMMUNICATION[kind] + number - 1, 1)]
            subs += [(MAPPING[kind] + number - 1, sub) for sub in range(MAX_MAPPED + 1)]
            for index, sub in subs:
                found.update(self._shadow.changes(bus, node, index, sub))
        return sorted(seq for seq in found if first < seq <= last)

    def turns(self, bus: int, first: int, last: int) -> list[int]:
        """Moments `first < seq <= last` at which the timing of any PDO or SYNC of a bus changed.

        These are new values of 1005h to 1007h, 1019h and the communication parameters of PDOs; a value that
        is written once more is none.
        """
        found: set[int] = set()
        for node in self._shadow.nodes_of(bus):
            if not self._shadow.configured(bus, node, first, last):
                continue
            for (index, sub), history in self._shadow.history(bus, node):
                if index in _SYNC_PARAMETERS or _pdo_of(index) is not None:
                    found.update(
                        seq
                        for seq in history.seqs[bisect_right(history.seqs, first) :]
                        if seq <= last and self._turned(bus, node, index, sub, seq)
                    )
        return sorted(found)

    def _turned(self, bus: int, node: int, index: int, sub: int, seq: int) -> bool:
        before = self._shadow.number(bus, node, index, sub, seq - 1)
        return before != self._shadow.number(bus, node, index, sub, seq)

    def mapping(self, pdo: Pdo, seq: int | None = None) -> PdoMapping | None:
        """Mapping of a PDO at `seq`; None when nobody said what it carries."""
        shadow, bus, node = self._shadow, pdo.bus, pdo.node
        count = self._mapping_value(pdo, 0, seq)
        if not count or count > MAX_MAPPED:
            return None
        values = [self._mapping_value(pdo, sub, seq) for sub in range(1, count + 1)]
        if any(value is None for value in values):
            return None
        return PdoMapping.from_objects(
            [value for value in values if value is not None],
            shadow.device(bus, node),
            lambda index, sub: shadow.number(bus, node, index, sub, seq),
        )

    def mapping_confirmed(self, pdo: Pdo, seq: int | None = None) -> bool:
        """Whether the node itself told or acknowledged all of its mapping."""
        count = self._shadow.confirmed(pdo.bus, pdo.node, pdo.mapping, 0, seq)
        if not count or count > MAX_MAPPED:
            return False
        values = (
            self._shadow.confirmed(pdo.bus, pdo.node, pdo.mapping, sub, seq)
            for sub in range(1, count + 1)
        )
        return all(value is not None for value in values)

    def mapping_fixed(self, pdo: Pdo) -> bool:
        """Whether the node is by its own word a device that has this mapping and no other."""
        device = self._shadow.device(pdo.bus, pdo.node)
        if device is None or self._shadow.told_by(pdo.bus, pdo.node) is not None:
            return False
        count = device.default(pdo.mapping, 0, pdo.node)
        return device.quirks.fixed_mapping and isinstance(count, int) and count > 0

    def transmission(self, pdo: Pdo, seq: int | None = None) -> Transmission:
        """Transmission type, inhibit time and event timer of a PDO at `seq`, with their sources."""
        get = self._shadow.get
        index = pdo.communication
        return Transmission(
            *(get(pdo.bus, pdo.node, index, sub, seq) for sub in (2, 3, 5)),
        )

    def repeat_counter(self, pdo: Pdo, seq: int | None = None) -> Known | None:
        """The object that limits how many equal frames follow a change, where a device has one."""
        device = self._shadow.device(pdo.bus, pdo.node)
        key = quirks(device).repeat_counters.get(pdo.number) if pdo.kind == "tpdo" else None
        return self._shadow.get(pdo.bus, pdo.node, *key, seq) if key else None

    def sync_cob_id(self, bus: int, node: int, seq: int | None = None) -> int:
        """Identifier of the SYNC that a node listens to (1005h), 080h unless it is told otherwise."""
        return sync_id(self._shadow, bus, node, seq)

    def other_services(self, bus: int, seq: int | None = None) -> set[int]:
        """Identifiers that the nodes of a bus give to EMCY, TIME and SDO (CiA 301 7.5.2)."""
        found: set[int] = set()
        for learned_bus, node in self._shadow.nodes():
            for key in self._shadow.learned(bus, node) if learned_bus == bus else ():
                if key in _SERVICE_IDS or (0x1200 <= key[0] < 0x1300 and key[1] in (1, 2)):
                    value = self._shadow.number(bus, node, *key, seq)
                    # Bit 31 of 1012h says that the node takes TIME, not that it is off.
                    bits = ~OFF if key == _TIME_ID else ~0
                    if value is not None and (can_id := cob_id(value & bits)) is not None:
                        found.add(can_id)
        return found

    def _mapping_value(self, pdo: Pdo, sub: int, seq: int | None) -> int | None:
        device = self._shadow.device(pdo.bus, pdo.node)
        if device is not None and quirks(device).fixed_mapping:
            value = device.default(pdo.mapping, sub, pdo.node)
            if isinstance(value, int):
                return value
        return self._shadow.number(pdo.bus, pdo.node, pdo.mapping, sub, seq)

    def identifier(
        self, bus: int, node: int, kind: Kind, number: int, seq: int | None = None
    ) -> Known | None:
        """Identifier of a PDO by 180xh:1; None when it is off, 29-bit or not known at all.

        An identifier of 0 counts as off: that is how devices write an unused PDO.
        """
        index = COMMUNICATION[kind] + number - 1
        known = self._shadow.get(bus, node, index, 1, seq)
        if known is None or not isinstance(known.value, int):
            return None
        value = known.value
        device = self._shadow.device(bus, node)
        mask = quirks(device).pdo_cob_id_mask
        if device is not None and known.source == "sdo-write" and mask != 0xFFFFFFFF:
            default = device.default(index, 1, node)
            fixed = default if isinstance(default, int) else value
            value = fixed & ~mask | value & mask
        if value & (OFF | FRAME_29_BIT) or not value & 0x7FF:
            return None
        return Known(value & 0x7FF, known.source, known.seq, known.t_ns)

    def _guess(self, bus: int, can_id: int, seq: int | None) -> Pdo | None:
        predefined = predefined_pdo(can_id)
        if predefined is None:
            return None
        kind: Kind = "tpdo" if predefined[0] == "tpdo" else "rpdo"
        _, number, node = predefined
        if self._shadow.get(bus, node, COMMUNICATION[kind] + number - 1, 1, seq) is not None:
            return None
        # A mapping seen on the bus proves that the node has this PDO.
        mapping = self._shadow.get(bus, node, MAPPING[kind] + number - 1, 0, seq)
        proven = mapping is not None and mapping.source in ("sdo-read", "sdo-write")
        source = mapping.source if mapping is not None and proven else "predefined"
        return Pdo(bus, node, kind, number, source)

    def _learned_claims(self, bus: int, node: int) -> Iterator[tuple[Kind, int, int]]:
        shadow = self._shadow
        for (index, sub), history in shadow.history(bus, node):
            place = _pdo_of(index)
            if sub != 1 or place is None:
                continue
            kind, number = place
            for seq in history.seqs:
                known = self.identifier(bus, node, kind, number, seq)
                if known is not None and isinstance(known.value, int):
                    yield kind, number, known.value

    def _assumed_claims(self, bus: int) -> dict[int, list[tuple[Kind, int, int]]]:
        """What description and devices say before anything was seen; devices may come later."""
        devices = [self._shadow.device(bus, node) for node in range(128)]
        if self._devices.get(bus) == devices:
            return self._assumed[bus]
        found: dict[int, list[tuple[Kind, int, int]]] = {}
        for node, device in enumerate(devices):
            indexes = {index for index, _ in device.facts} if device else set()
            indexes |= {index for index, _ in self._shadow.described(bus, node)}
            for index in sorted(indexes):
                place = _pdo_of(index)
                known = self.identifier(bus, node, *place, 0) if place else None
                if place and known is not None and isinstance(known.value, int):
                    found.setdefault(known.value, []).append((*place, node))
        self._assumed[bus] = found
        self._devices[bus] = devices
        return found


def _pdo_of(index: int) -> tuple[Kind, int] | None:
    """Kind and number of a PDO by the index of its communication parameters."""
    if 0x1800 <= index < 0x1800 + PDO_COUNT:
        return "tpdo", index - 0x17FF
    if 0x1400 <= index < 0x1400 + PDO_COUNT:
        return "rpdo", index - 0x13FF
    return None
