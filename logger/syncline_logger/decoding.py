"""Decoded channels: CANopen services of a batch as messages on their topics."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from operator import itemgetter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from syncline_logger import service_messages
from syncline_logger.node_objects import Key, NodeObjects, PdoBinding
from syncline_logger.pdo_channel import PdoChannel
from syncline_logger.pdo_values import PdoValues
from syncline_logger.sdo_listener import LearnedValue, SdoListener
from syncline_logger.triggers.conditions import Condition
from syncline_logger.triggers.event import Event
from syncline_logger.triggers.values import ValueWatch
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.canopen.nmt import RESETS
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.capture.layout import node_topic, service_topic
from syncline_schemas.capture.message import MessageBlock, MessageSchema
from syncline_schemas.decoder import PdoMapping
from syncline_schemas.decoder.pdo import PdoColumn
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import Device, identify, identity_objects, quirks

Rows = NDArray[np.intp]
Int64s = NDArray[np.int64]
Change = Callable[[], None]

MAX_MAPPINGS = 16
"""A PDO that is mapped anew more often than this is no longer decoded."""

UNREGISTERED = -1
"""Channel id of a block whose channel the file does not know yet."""

_NOT_STANDARD_DATA = np.uint16(FrameFlag.EXTENDED | FrameFlag.ERROR | FrameFlag.REMOTE)


@dataclass(frozen=True, slots=True)
class ChannelSpec:
    """A decoded channel before the file has given it an id."""

    topic: str
    schema: MessageSchema
    metadata: Mapping[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class Decoded:
    """What decoding one batch gave.

    Attributes:
        blocks: messages by channel; each block ascending in log time.
        problems: (bus number, words) of what was turned off or does not fit.
        devices: devices that were recognised in this batch, with (bus number, node).
        events: values that crossed a bound of a condition.
        settings: of nodes whose objects changed: all that is known of them after the batch.
    """

    blocks: list[tuple[ChannelSpec, MessageBlock]] = field(default_factory=list)
    problems: list[tuple[int, str]] = field(default_factory=list)
    devices: list[tuple[int, int, Device]] = field(default_factory=list)
    settings: dict[tuple[int, int], Mapping[Key, tuple[bytes, bool]]] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)


class Watch(Protocol):
    """Is shown the values of every PDO."""

    def update(self, values: PdoValues) -> tuple[list[Event], list[str]]:
        """Events of the values of one PDO, and words on what is wrong."""
        ...


class LiveDecoder:
    """Decodes batches of several buses in capture order; its state is small and bounded.

    An exception turns off the service or PDO in which it happened, with a problem that says so;
    everything else goes on.

    Args:
        values: bounds of values that are watched.
        watch: what is shown the values instead.
    """

    def __init__(
        self,
        buses: Mapping[int, str],
        description: BusDescription | None = None,
        values: Sequence[Condition] = (),
        watch: Watch | None = None,
    ) -> None:
        known = description or BusDescription()
        watch = watch or ValueWatch(values)
        self._buses = {
            number: _BusDecoder(number, name, known, watch) for number, name in buses.items()
        }

    @property
    def devices(self) -> list[Device]:
        """Devices known from the description."""
        return [
            objects.device
            for bus in self._buses.values()
            for objects in bus.nodes.values()
            if objects.device
        ]

    def decode(self, frames: FrameBatch, log_ns: NDArray[np.int64]) -> Decoded:
        """Messages of a batch. log_ns: (n,) int64, never decreasing."""
        decoded = Decoded()
        standard = (frames.flags & _NOT_STANDARD_DATA) == 0
        for number, bus in self._buses.items():
            rows = np.flatnonzero(standard & (frames.bus == number))
            bus.decode(frames[rows], log_ns[rows], decoded)
        return decoded


class _BusDecoder:
    def __init__(self, number: int, name: str, description: BusDescription, watch: Watch) -> None:
        self._number = number
        self._watch = watch
        self._name = name
        self._sdo = SdoListener()
        self._off: set[str] = set()
        self.nodes = {
            node: NodeObjects(node, entry) for node, entry in description.described(name).items()
        }
        self._bindings: dict[int, PdoBinding] = {}
        self._channels: dict[str, dict[PdoMapping, PdoChannel]] = {}
        self._stale = True
        self._changed: set[int] = set()

    def decode(self, frames: FrameBatch, log_ns: NDArray[np.int64], decoded: Decoded) -> None:
        """Decode standard data frames of this bus."""
        begin = 0
        self._changed.clear()
        for row, change in self._changes(frames, log_ns, decoded):
            self._decode_part(frames[begin:row], log_ns[begin:row], decoded)
            begin = row
            self._guarded("object values", change, decoded)
        self._decode_part(frames[begin:], log_ns[begin:], decoded)
        for node in self._changed:
            decoded.settings[self._number, node] = self.nodes[node].configuration()

    def _changes(
        self, frames: FrameBatch, log_ns: NDArray[np.int64], decoded: Decoded
    ) -> list[tuple[int, Change]]:
        """Rows from which on PDOs may mean something else, ascending, with what to do there."""
        service = SERVICE_OF_ID[frames.can_id]
        found: list[tuple[int, Change]] = []
        rows = np.flatnonzero((service == Service.SDO_REQUEST) | (service == Service.SDO_ANSWER))
        if len(rows):
            self._guarded(
                "sdo", lambda: self._take_sdo(frames, log_ns, rows, found, decoded), decoded
            )
        boot_ups = (service == Service.ERROR_CONTROL) & (frames.dlc == 1) & (frames.data[:, 0] == 0)
        resets = (service == Service.NMT) & (frames.dlc == 2) & np.isin(frames.data[:, 0], RESETS)
        for row in np.flatnonzero(boot_ups | resets):
            boot_up = bool(boot_ups[row])
            node = int(frames.can_id[row]) & 0x7F if boot_up else int(frames.data[row, 1])
            found.append((int(row), partial(self._forget, node, boot_up)))
        return sorted(found, key=itemgetter(0))

    def _take_sdo(
        self,
        frames: FrameBatch,
        log_ns: NDArray[np.int64],
        rows: Rows,
        found: list[tuple[int, Change]],
        decoded: Decoded,
    ) -> None:
        done = self._sdo.update(frames, rows)
        for value in done.learned:
            objects = self.nodes.get(value.node)
            if objects is None:
                objects = self.nodes[value.node] = NodeObjects(value.node)
            key = (value.index, value.sub)
            if objects.value(key) != value.data or value.written:
                self._changed.add(value.node)
            # Known values come again and again where a master polls; they change nothing, unless
            # an earlier value of this batch still waits for its row.
            if objects.shapes_pdos(key) and (found or objects.value(key) != value.data):
                found.append((value.row, partial(self._learn, value, decoded)))
            else:
                objects.learn(key, value.data, written=value.written)
        for node in np.unique(done.node).tolist():
            chosen = np.flatnonzero(done.node == node)
            device = self.nodes[node].device if node in self.nodes else None
            block = service_messages.encode_sdo(done, chosen, frames, log_ns, device)
            topic = node_topic(self._name, node, "sdo")
            decoded.blocks.append((ChannelSpec(topic, service_messages.SDO_SCHEMA), block))

    def _learn(self, value: LearnedValue, decoded: Decoded) -> None:
        node = self.nodes[value.node]
        node.learn((value.index, value.sub), value.data, written=value.written)
        self._stale = True
        if value.index in identity_objects() and node.device is None:
            device = identify(node.identity())
            if device is not None:
                node.device = device
                decoded.devices.append((self._number, value.node, device))

    def _forget(self, node: int, boot_up: bool) -> None:
        """Forget what a reset of this node (0 = all) takes from its objects."""
        for number, objects in self.nodes.items():
            # On such a device the byte 00h may be the answer to a guard request.
            unsure = boot_up and quirks(objects.device).empty_heartbeat_after_rtr
            if node in (0, number) and not unsure:
                self._stale |= objects.reset()
                self._changed.add(number)

    def _decode_part(self, frames: FrameBatch, log_ns: NDArray[np.int64], decoded: Decoded) -> None:
        if len(frames) == 0:
            return
        if self._stale:
            self._guarded("PDO mappings", self._bind, decoded)
            self._stale = False
        order = np.argsort(frames.can_id.astype(np.uint16), kind="stable")
        frames, log_ns = frames[order], log_ns[order]
        for can_id, rows in _stretches(frames.can_id):
            binding = self._bindings.get(can_id)
            if binding is not None:
                self._decode_pdo(binding, frames[rows], log_ns[rows], decoded)
            else:
                self._decode_service(can_id, frames[rows], log_ns[rows], decoded)

    def _bind(self) -> None:
        bindings: dict[int, PdoBinding] = {}
        for _, node in sorted(self.nodes.items()):
            for binding in node.bindings():
                taken = bindings.get(binding.can_id)
                if taken is None or (taken.direction, binding.direction) == ("rpdo", "tpdo"):
                    bindings[binding.can_id] = binding
        self._bindings = bindings

    def _channel(self, binding: PdoBinding) -> PdoChannel:
        """The channel of a PDO with this mapping; each further mapping gets one of its own."""
        topic = node_topic(self._name, binding.node, binding.service)
        channels = self._channels.setdefault(topic, {})
        if binding.mapping not in channels:
            version = len(channels) + 1
            if version > MAX_MAPPINGS:
                raise ValueError(f"it was mapped in more than {MAX_MAPPINGS} ways")
            name = topic if version == 1 else f"{topic}_v{version}"
            channels[binding.mapping] = PdoChannel(binding, name)
        return channels[binding.mapping]

    def _decode_pdo(
        self, binding: PdoBinding, frames: FrameBatch, log_ns: NDArray[np.int64], decoded: Decoded
    ) -> None:
        def look(columns: Sequence[PdoColumn], t_ns: Int64s, taken_ns: Int64s) -> None:
            node = binding.node
            events, words = self._watch.update(
                PdoValues(self._number, self._name, node, columns, t_ns, taken_ns)
            )
            decoded.events += events
            decoded.problems += [(self._number, text) for text in words]

        def decode() -> None:
            channel = self._channel(binding)
            block, problem = channel.decode(frames, log_ns, look)
            if block is not None:
                spec = ChannelSpec(channel.topic, channel.schema, channel.metadata)
                decoded.blocks.append((spec, block))
            if problem:
                decoded.problems.append((self._number, problem))

        self._guarded(node_topic(self._name, binding.node, binding.service), decode, decoded)

    def _decode_service(
        self, can_id: int, frames: FrameBatch, log_ns: NDArray[np.int64], decoded: Decoded
    ) -> None:
        service, node = Service(int(SERVICE_OF_ID[can_id])), can_id & 0x7F
        encoder = service_messages.ENCODERS.get(service)
        if encoder is None:
            return
        objects = self.nodes.get(node) if encoder.of_node else None
        topic = (
            node_topic(self._name, node, encoder.name)
            if encoder.of_node
            else service_topic(self._name, encoder.name)
        )

        def decode() -> None:
            block = encoder.encode(frames, log_ns, objects.device if objects else None)
            if len(block):
                decoded.blocks.append((ChannelSpec(topic, encoder.schema), block))

        self._guarded(topic, decode, decoded)

    def _guarded(self, what: str, act: Callable[[], None], decoded: Decoded) -> None:
        """Do it, or turn it off for good: decoding may cost messages, never the recording."""
        if what in self._off:
            return
        try:
            act()
        except Exception as error:  # noqa: BLE001 - whatever it is, frames go on
            self._off.add(what)
            decoded.problems.append(
                (self._number, f"decoding of {what} is off: {type(error).__name__}: {error}")
            )


def _stretches(ordered: NDArray[np.uint32]) -> Iterator[tuple[int, slice]]:
    """Each identifier of sorted ones with the rows where it stands."""
    starts = [0, *(np.flatnonzero(np.diff(ordered)) + 1).tolist(), len(ordered)]
    for begin, end in pairwise(starts):
        yield int(ordered[begin]), slice(begin, end)
