"""What the bus and the description tell of the objects that a watch needs, over time."""

from collections.abc import Iterator

from syncline_logger.node_objects import Key, NodeObjects
from syncline_logger.sdo_listener import LearnedValue
from syncline_schemas.description import NodeEntry
from syncline_schemas.devices import Quirks, identify, identity_objects, quirks

CONSUMER_TIME, PRODUCER_TIME = 0x1016, 0x1017
GUARD_TIME, LIFE_TIME_FACTOR = 0x100C, 0x100D
EMCY_ID = 0x1014
KEPT = 8
"""Values of 1017h that are remembered of a node."""
MAX_CONSUMERS = 127


class Knowledge:
    """Objects of the nodes of one bus, with the values that 1017h had."""

    def __init__(self, described: dict[int, NodeEntry] | None = None) -> None:
        self.nodes = {node: NodeObjects(node, entry) for node, entry in (described or {}).items()}
        self._producer: dict[int, list[tuple[int, int, bool]]] = {}
        self._consumers: dict[int, list[tuple[int, int, int]]] | None = None

    def quirks(self, node: int) -> Quirks:
        """Where the node's device deviates from the standard."""
        known = self.nodes.get(node)
        return quirks(known.device if known else None)

    def number(self, node: int, index: int, sub: int = 0) -> int | None:
        """An object's value, None when nothing is known of it."""
        known = self.nodes.get(node)
        return known.number(index, sub) if known else None

    def learn(self, value: LearnedValue, t_ns: int) -> None:
        """Take in what an SDO transfer revealed."""
        objects = self.nodes.setdefault(value.node, NodeObjects(value.node))
        objects.learn((value.index, value.sub), value.data, written=value.written)
        if value.index == PRODUCER_TIME:
            self._note(value.node, t_ns, int.from_bytes(value.data, "little"), value.written)
        elif value.index == CONSUMER_TIME:
            self._consumers = None
        elif value.index in identity_objects() and objects.device is None:
            objects.device = identify(objects.identity())

    def restart(self, node: int, t_ns: int) -> None:
        """Forget what a reset takes from a node's objects."""
        objects = self.nodes.get(node)
        if objects is None:
            return
        objects.reset()
        self._consumers = None
        if node in self._producer:
            self._note(node, t_ns, objects.number(PRODUCER_TIME, 0) or -1, False)

    def producer_ms(self, node: int, since_ns: int, period_ns: int) -> int | None:
        """The longest 1017h that held from a time on [ms]; 0 when it was switched off."""
        noted = self._producer.get(node)
        if not noted:
            return self.number(node, PRODUCER_TIME) or None
        at = max((i for i, each in enumerate(noted) if each[0] <= since_ns), default=None)
        held = noted[at or 0 :]
        begun = [] if at is not None else [self.number(node, PRODUCER_TIME) or 0]
        if any(not ms and told and t_ns >= since_ns - 2 * period_ns for t_ns, ms, told in held):
            return 0
        longest = max([ms for _, ms, _ in held] + begun)
        return longest if longest > 0 else None

    def consumer_ms(self, node: int) -> int | None:
        """The shortest time that another node allows this one (1016h) [ms]."""
        if self._consumers is None:
            self._consumers = {}
            for watcher, watched, ms in self._all_consumers():
                self._consumers.setdefault(watched, []).append((ms, watcher, watched))
        return min((ms for ms, by, of in self._consumers.get(node, []) if by != of), default=None)

    def life_ms(self, node: int) -> int | None:
        """The node life time (100Ch x 100Dh), None where it is off or only a device's default."""
        known = self.nodes.get(node)
        if known is None:
            return None
        told = [known.told(index, 0) for index in (GUARD_TIME, LIFE_TIME_FACTOR)]
        return (told[0] or 0) * (told[1] or 0) or None

    def _all_consumers(self) -> Iterator[tuple[int, int, int]]:
        for watcher, objects in self.nodes.items():
            if not quirks(objects.device).consumes_heartbeat:
                continue
            for sub in range(1, MAX_CONSUMERS + 1):
                value = objects.number(CONSUMER_TIME, sub)
                if value is None:
                    break
                if value >> 16 & 0x7F and value & 0xFFFF:
                    yield watcher, value >> 16 & 0x7F, value & 0xFFFF

    def _note(self, node: int, t_ns: int, ms: int, told: bool) -> None:
        noted = self._producer.setdefault(node, [])
        noted.append((t_ns, ms, told))
        del noted[:-KEPT]


def reset_by_write(knowledge: Knowledge, value: LearnedValue) -> bool:
    """Whether a write resets the device, as its maker says."""
    place: Key = (value.index, value.sub)
    wanted = knowledge.quirks(value.node).reset_writes.get(place)
    return value.written and wanted is not None and int.from_bytes(value.data, "little") == wanted
