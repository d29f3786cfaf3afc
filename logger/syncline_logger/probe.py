"""Which objects of a node `syncline probe` reads, in which order; sends nothing by itself."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from syncline_schemas.devices import Device, identify, identity_objects
from syncline_schemas.devices.catalog import ABSENT
from syncline_schemas.devices.model import Key
from syncline_schemas.devices.standard import standard_device, standard_profiles

Read = Callable[[Key], "bytes | int | None"]
"""Reads an object: its bytes, or the abort code of the refusal; None when no answer came."""

NOT_THERE = 0x0602_0000
"""Abort code: the object does not exist."""

DEVICE_TYPE: Key = (0x1000, 0)
NAMES: tuple[Key, ...] = ((0x1008, 0), (0x1009, 0), (0x100A, 0))
IDENTITY = 0x1018
CONTROL: tuple[Key, ...] = (
    (0x1005, 0),
    (0x1006, 0),
    (0x100C, 0),
    (0x100D, 0),
    (0x1014, 0),
    (0x1015, 0),
    (0x1016, 1),
    (0x1017, 0),
    (0x1029, 1),
)
"""What decides how a node behaves on the bus: SYNC, guarding, heartbeat, EMCY.

Not 1001h: there are devices that clear it when it is read (sheet skbis-lir-canopen).
"""
PDO_RECORDS = ((0x1800, 0x1A00), (0x1400, 0x1600))
"""Communication and mapping parameters of the first TPDO and the first RPDO."""
PDO_SUBS = (1, 2, 3, 5)
MAX_PDOS = 8
MAX_ENTRIES = 64
PROFILE_AREA = range(0x6000, 0xA000)
SILENT_AFTER = 2
"""A node that answers nothing so often in a row is left alone."""


@dataclass(slots=True)
class NodeProbe:
    """What a node answered: values, and abort codes of refusals. `device` is what it fits."""

    node: int
    values: dict[Key, bytes] = field(default_factory=dict)
    refused: dict[Key, int] = field(default_factory=dict)
    device: Device | None = None

    @property
    def answered(self) -> bool:
        """Whether there is such a node."""
        return bool(self.values or self.refused)

    @property
    def name(self) -> str:
        """Its own name (1008h), "" when it has none."""
        return self.values.get(NAMES[0], b"").decode("ascii", "replace").strip("\0 ")

    def number(self, key: Key) -> int | None:
        """A value as an unsigned number."""
        value = self.values.get(key)
        return None if value is None else int.from_bytes(value, "little")


class _Enough(Exception):
    """The node does not answer, or nobody wants to know any more."""


def probe_node(node: int, read: Read, stopped: Callable[[], bool] = lambda: False) -> NodeProbe:
    """Read identity, communication parameters, PDOs and scales; never what reading changes.

    stopped: asked before each object; True ends it with what is known until then.
    """
    found = NodeProbe(node)
    misses = 0

    def take(keys: Iterable[Key]) -> None:
        nonlocal misses
        for key in keys:
            if key in found.values or key in found.refused:
                continue
            if stopped():
                raise _Enough
            answer = read(key)
            misses = misses + 1 if answer is None else 0
            if misses == SILENT_AFTER or (answer is None and not found.answered):
                raise _Enough
            if isinstance(answer, bytes):
                found.values[key] = answer
            elif answer is not None:
                found.refused[key] = answer

    try:
        take([DEVICE_TYPE, *NAMES, (IDENTITY, 0)])
        take((IDENTITY, sub) for sub in range(1, min(found.number((IDENTITY, 0)) or 0, 4) + 1))
        take((index, 0) for index in sorted(identity_objects()))
        found.device = _device(found)
        take(CONTROL)
        for communication, mapping in PDO_RECORDS:
            for number in range(MAX_PDOS):
                take([(communication + number, 1), (mapping + number, 0)])
                if not {(communication + number, 1), (mapping + number, 0)} & found.values.keys():
                    break
                take((communication + number, sub) for sub in PDO_SUBS)
                entries = min(found.number((mapping + number, 0)) or 0, MAX_ENTRIES)
                take((mapping + number, sub) for sub in range(1, entries + 1))
        take(_profile_objects(found))
    except _Enough:
        pass
    return found


def _device(found: NodeProbe) -> Device | None:
    answers = {key: _identity_value(key, value) for key, value in found.values.items()}
    absent = [key for key, code in found.refused.items() if code == NOT_THERE]
    return identify({**answers, **dict.fromkeys(absent, ABSENT)})


def _identity_value(key: Key, value: bytes) -> int | bytes:
    return value if key in NAMES else int.from_bytes(value, "little")


def _profile_objects(found: NodeProbe) -> Iterator[Key]:
    """Objects of the device's profile that can be read, and those that give scales."""
    number = (found.number(DEVICE_TYPE) or 0) & 0xFFFF
    device = found.device or standard_device(number)
    if device is None:
        return
    harmful = set(device.quirks.clear_on_read)
    if found.device is None:
        keys = set(standard_profiles()[number].objects) | set(device.facts)
    else:
        keys = {key for key, facts in device.facts.items() if facts.access.lower() != "wo"}
    scales = {facts.scale_object for facts in device.facts.values() if facts.scale_object}
    wanted = {key for key in keys if key[0] in PROFILE_AREA} | scales
    if device.quirks.output_mode:
        wanted.add(device.quirks.output_mode)
    yield from sorted(wanted - harmful)
