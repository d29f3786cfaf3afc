"""Object-dictionary shadow: what is known of each node's objects at each moment, and from where."""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

from syncline_schemas.description import BusDescription
from syncline_schemas.devices import Device, identify, quirks

Source = Literal["sdo-read", "sdo-write", "bus-description", "eds-default"]
MAX_CHANGES = 20_000
"""Changes kept per object: a value polled for days must not fill the memory."""
Value = int | bytes
Key = tuple[int, int]
"""(index, subindex) of an object."""


@dataclass(frozen=True, slots=True)
class Known:
    """One object's value, where it comes from, and since when (`seq` is None when it always held)."""

    value: Value
    source: Source
    seq: int | None = None
    t_ns: int | None = None


@dataclass(slots=True)
class _History:
    """Values by `seq`; `saved` is what a reset falls back to once the value is `unsaved`."""

    seqs: list[int] = field(default_factory=list)
    values: list[Known | None] = field(default_factory=list)
    saved: Known | None = None
    unsaved: bool = False

    def add(self, seq: int, known: Known | None) -> None:
        self.seqs.append(seq)
        self.values.append(known)
        if len(self.seqs) > MAX_CHANGES:
            del self.seqs[: MAX_CHANGES // 2], self.values[: MAX_CHANGES // 2]


class Shadow:
    """Values of objects per bus number and node over the capture, addressed by `seq`.

    Values learned from the bus come first, then the bus description, then the device's EDS.
    A None in a history means: thrown away by a reset, fall back to what is assumed. A capture gap
    forgets nothing: what was written before it is still the best that is known.
    """

    def __init__(
        self,
        bus_name: Callable[[int], str],
        description: BusDescription | None = None,
        devices: dict[int, Device] | None = None,
    ) -> None:
        self._bus_name = bus_name
        self._description = description or BusDescription()
        self._devices_by_node = dict(devices or {})
        self._identified: dict[tuple[int, int], Device | None] = {}
        self._known: dict[tuple[int, int], dict[Key, _History]] = {}
        self._refused: dict[tuple[int, int], set[Key]] = {}

    def learn(self, bus: int, node: int, index: int, sub: int, known: Known) -> None:
        """Store a value seen on the bus; calls come in order of `seq`.

        A value that is read while no write waits to be saved is taken as the stored one.
        """
        key = (index, sub)
        if known.source == "sdo-read" and self._reads_the_same(bus, node, key, known):
            return
        facts = quirks(self.device(bus, node))
        self._store(bus, node, facts.aliases.get(key, key), known, key in facts.stored_at_once)
        if index in _IDENTITY:
            self._identified.pop((bus, node), None)
        if known.source != "sdo-write":
            return
        for written, changed, value in facts.side_effects:
            if written == key:
                self._store(bus, node, changed, replace(known, value=value), False)
        if facts.factory_reset_writes.get(key) == known.value:
            self.restore(bus, node)

    def refuse(self, bus: int, node: int, index: int, sub: int) -> None:
        """Note that the node said that it has no such object (abort 0602 0000)."""
        self._refused.setdefault((bus, node), set()).add((index, sub))
        if index in _IDENTITY:
            self._identified.pop((bus, node), None)

    def save(self, bus: int, node: int, sub: int = 1) -> None:
        """Keep the present values as those that a reset falls back to (1010h `save`)."""
        for key, history in self._known.get((bus, node), {}).items():
            if history.values and self._kept_by(bus, node, key, sub):
                history.saved = history.values[-1]
                history.unsaved = False

    def restore(self, bus: int, node: int, sub: int = 1) -> None:
        """Forget what was saved: the next reset falls back to what is assumed (1011h `load`)."""
        for key, history in self._known.get((bus, node), {}).items():
            if self._kept_by(bus, node, key, sub):
                history.saved = None
                history.unsaved = True

    def reset(self, bus: int, node: int, seq: int) -> None:
        """Throw written values back to the last saved ones (boot-up, 81h, 82h)."""
        for history in self._known.get((bus, node), {}).values():
            if history.unsaved:
                history.add(seq, history.saved)
                history.unsaved = False

    def get(
        self, bus: int, node: int, index: int, sub: int = 0, seq: int | None = None
    ) -> Known | None:
        """What is known of an object at `seq` (at the end when None)."""
        history = self._known.get((bus, node), {}).get((index, sub))
        if history is not None:
            at = len(history.seqs) if seq is None else bisect_right(history.seqs, seq)
            if at and (known := history.values[at - 1]) is not None:
                return known
        return self._assumed(bus, node, index, sub)

    def number(
        self, bus: int, node: int, index: int, sub: int = 0, seq: int | None = None
    ) -> int | None:
        """The value of a numeric object, None when nothing is known."""
        known = self.get(bus, node, index, sub, seq)
        if known is None:
            return None
        return (
            known.value if isinstance(known.value, int) else int.from_bytes(known.value, "little")
        )

    def changes(self, bus: int, node: int, index: int, sub: int = 0) -> list[int]:
        """`seq` of every moment at which knowledge of an object changed."""
        history = self._known.get((bus, node), {}).get((index, sub))
        return list(history.seqs) if history else []

    def learned(self, bus: int, node: int) -> dict[tuple[int, int], Known]:
        """The last value of every object that was seen on the bus."""
        found = self._known.get((bus, node), {})
        return {key: h.values[-1] for key, h in found.items() if h.values[-1] is not None}

    def nodes(self) -> list[tuple[int, int]]:
        """(bus, node) of which at least one object was seen."""
        return list(self._known)

    def device(self, bus: int, node: int) -> Device | None:
        """Device of a node: as told by the user, else identified by the objects it answered."""
        if (bus, node) not in self._identified:
            self._identified[bus, node] = self._find_device(bus, node)
        return self._identified[bus, node]

    def name(self, bus: int, node: int) -> str | None:
        """Name of a node by the bus description."""
        entry = self._description.node(self._bus_name(bus), node)
        return entry.name if entry else None

    def _find_device(self, bus: int, node: int) -> Device | None:
        if node in self._devices_by_node:
            return self._devices_by_node[node]
        entry = self._description.node(self._bus_name(bus), node)
        if entry is not None and entry.device is not None:
            return entry.device
        identity = self._identity(bus, node)
        return identify(identity) if identity else None

    def _reads_the_same(self, bus: int, node: int, key: Key, known: Known) -> bool:
        """Whether a read only confirms the value that was read before."""
        history = self._known.get((bus, node), {}).get(key)
        last = history.values[-1] if history else None
        return last is not None and last.source == "sdo-read" and last.value == known.value

    def _store(self, bus: int, node: int, key: Key, known: Known, at_once: bool) -> None:
        seq = known.seq
        assert seq is not None
        history = self._known.setdefault((bus, node), {}).setdefault(key, _History())
        if known.source == "sdo-write":
            known = self._as_taken_over(bus, node, key, known)
            history.unsaved = not at_once
        history.add(seq, known)
        if not history.unsaved:
            history.saved = known

    def _as_taken_over(self, bus: int, node: int, key: Key, known: Known) -> Known:
        """A written PDO COB-ID as the device takes it: some only let bits of it change."""
        mask = quirks(self.device(bus, node)).pdo_cob_id_mask
        if not (0x1800 <= key[0] < 0x1A00 and key[1] == 1) or mask == 0xFFFFFFFF:
            return known
        before = self.number(bus, node, *key)
        if before is None or not isinstance(known.value, int):
            return known
        return replace(known, value=before & ~mask | known.value & mask)

    def _kept_by(self, bus: int, node: int, key: Key, sub: int) -> bool:
        """Whether 1010h:sub keeps an object (CiA 301 7.5.2.13, or what the device's maker says)."""
        facts = quirks(self.device(bus, node))
        if facts.storage and not facts.saves_all:
            return key in facts.storage.get(sub, ())
        return key[0] in _SAVED_BY_SUB.get(sub, _ALL)

    def _identity(self, bus: int, node: int) -> dict[Key, Value]:
        known = self._known.get((bus, node), {})
        identity: dict[Key, Value] = {
            key: b"absent" for key in self._refused.get((bus, node), ()) if key[0] in _IDENTITY
        }
        for key, history in known.items():
            value = history.values[-1]
            if key[0] in _IDENTITY and value is not None:
                identity[key] = value.value
        return identity

    def _assumed(self, bus: int, node: int, index: int, sub: int) -> Known | None:
        entry = self._description.node(self._bus_name(bus), node)
        if entry is not None and (index, sub) in entry.objects:
            return Known(entry.objects[index, sub], "bus-description")
        device = self.device(bus, node)
        default = device.default(index, sub, node) if device else None
        return Known(default, "eds-default") if default is not None else None


_IDENTITY = frozenset(
    {0x1000, 0x1008, 0x1009, 0x100A, 0x1010, 0x1015, 0x1018, 0x3000, 0x3001, 0x6200}
    | set(range(0x6503, 0x6509))
)
"""Indexes by which devices are told apart."""
_ALL = range(0x1000, 0x10000)
_SAVED_BY_SUB = {2: range(0x1000, 0x2000), 3: range(0x6000, 0xA000)}
