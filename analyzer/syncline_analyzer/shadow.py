"""Object-dictionary shadow: what is known of each node's objects at each moment, and from where."""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from syncline_schemas.description import BusDescription
from syncline_schemas.devices import Device, identify, load_device

Source = Literal["sdo-read", "sdo-write", "bus-description", "eds-default"]
Value = int | bytes


@dataclass(frozen=True, slots=True)
class Known:
    """One object's value, where it comes from, and since when (`seq` is None when it always held)."""

    value: Value
    source: Source
    seq: int | None = None
    t_ns: int | None = None


@dataclass(slots=True)
class _History:
    seqs: list[int] = field(default_factory=list)
    values: list[Known | None] = field(default_factory=list)
    saved: Known | None = None


class Shadow:
    """Values of objects per bus number and node over the capture, addressed by `seq`.

    Values learned from the bus come first, then the bus description, then the device's EDS.
    A None in a history means: thrown away by a reset, fall back to what is assumed.
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
        self._known: dict[tuple[int, int], dict[tuple[int, int], _History]] = {}

    def learn(self, bus: int, node: int, index: int, sub: int, known: Known) -> None:
        """Store a value seen on the bus; calls come in order of `seq`."""
        history = self._known.setdefault((bus, node), {}).setdefault((index, sub), _History())
        assert known.seq is not None
        history.seqs.append(known.seq)
        history.values.append(known)
        if known.source == "sdo-read":
            history.saved = history.saved or known
        if (index, sub) in _IDENTITY:
            self._identified.pop((bus, node), None)

    def save(self, bus: int, node: int) -> None:
        """Remember the present values as the ones that a reset falls back to (1010h `save`)."""
        for history in self._known.get((bus, node), {}).values():
            history.saved = history.values[-1]

    def reset(self, bus: int, node: int, seq: int) -> None:
        """Throw written values back to the last saved ones (boot-up, 81h, 82h)."""
        for history in self._known.get((bus, node), {}).values():
            last = history.values[-1]
            if last is not None and last.source == "sdo-write" and last is not history.saved:
                history.seqs.append(seq)
                history.values.append(history.saved)

    def get(self, bus: int, node: int, index: int, sub: int = 0, seq: int | None = None) -> Known | None:
        """What is known of an object at `seq` (at the end when None)."""
        history = self._known.get((bus, node), {}).get((index, sub))
        if history is not None:
            at = len(history.seqs) if seq is None else bisect_right(history.seqs, seq)
            if at and (known := history.values[at - 1]) is not None:
                return known
        return self._assumed(bus, node, index, sub)

    def number(self, bus: int, node: int, index: int, sub: int = 0, seq: int | None = None) -> int | None:
        """The value of a numeric object, None when nothing is known."""
        known = self.get(bus, node, index, sub, seq)
        if known is None:
            return None
        return known.value if isinstance(known.value, int) else int.from_bytes(known.value, "little")

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
        if node in self._devices_by_node:
            return self._devices_by_node[node]
        entry = self._description.node(self._bus_name(bus), node)
        if entry is not None and entry.device is not None:
            return load_device(entry.device)
        if (bus, node) not in self._identified:
            self._identified[bus, node] = identify(self._identity(bus, node))
        return self._identified[bus, node]

    def name(self, bus: int, node: int) -> str | None:
        """Name of a node by the bus description."""
        entry = self._description.node(self._bus_name(bus), node)
        return entry.name if entry else None

    def _identity(self, bus: int, node: int) -> dict[tuple[int, int], Value]:
        known = self._known.get((bus, node), {})
        return {
            key: value.value
            for key in _IDENTITY
            if key in known and (value := known[key].values[-1]) is not None
        }

    def _assumed(self, bus: int, node: int, index: int, sub: int) -> Known | None:
        entry = self._description.node(self._bus_name(bus), node)
        if entry is not None and (index, sub) in entry.objects:
            return Known(entry.objects[index, sub], "bus-description")
        device = self.device(bus, node)
        default = device.default(index, sub, node) if device else None
        return Known(default, "eds-default") if default is not None else None


_IDENTITY = {
    (0x1000, 0), (0x1008, 0), (0x1010, 0), (0x1018, 1), (0x1018, 2), (0x1015, 0), (0x6200, 0),
}
