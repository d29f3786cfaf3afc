"""Which channel of a capture carries what, and of which bus."""

import re
from enum import IntEnum

import mcap.records as mcap_records
import numpy as np

from syncline_schemas.capture.layout import (
    CLOCK_TOPIC,
    FRAME_SCHEMA_NAME,
    GAP_TOPIC,
    MARK_TOPIC,
    PROTOBUF,
    BusInfo,
    topic_part,
)
from syncline_schemas.capture.record_file import MessageIndex

MAX_BUSES = 256


class Kind(IntEnum):
    """What the messages of a channel are to the reader."""

    UNKNOWN = 0
    """No such channel was described."""
    FRAME = 1
    GAP = 2
    STATUS = 3
    CLOCK = 4
    OTHER = 5
    MARK = 6


_KIND_OF_SCHEMA = {
    FRAME_SCHEMA_NAME: Kind.FRAME,
    "syncline.Gap": Kind.GAP,
    "syncline.BusStatus": Kind.STATUS,
    "syncline.ClockSample": Kind.CLOCK,
    "syncline.Mark": Kind.MARK,
}
_BUS_TOPIC = re.compile(r"/can/(?P<bus>[^/]+)/(?:frames|status)")


class ChannelTable:
    """Kind and bus of each channel id.

    In a file of our own profile (`ours`) a topic of ours says what a channel holds where the schema
    or encoding says nothing known: those may be damaged.

    Attributes:
        version: another one after each change of `kind` or `bus`.
        kind: (65536,) uint8, `Kind` by channel id.
        bus: (65536,) int16, bus number by channel id; 0 where a channel has none.
    """

    def __init__(self, buses: list[BusInfo], *, ours: bool = False) -> None:
        self.version = 0
        self.kind = np.zeros(1 << 16, np.uint8)
        self.bus = np.zeros(1 << 16, np.int16)
        self._buses = buses
        self._ours = ours
        self._schemas: dict[int, mcap_records.Schema] = {}
        self._channels: dict[int, mcap_records.Channel] = {}

    def register(self, record: mcap_records.Schema | mcap_records.Channel) -> None:
        """Take in a schema or channel; the first of an id counts."""
        if isinstance(record, mcap_records.Schema):
            self._schemas.setdefault(record.id, record)
        elif record.id not in self._channels:
            self._channels[record.id] = record
            kind = self._kind(record)
            if kind in (Kind.FRAME, Kind.STATUS):
                self.bus[record.id] = self._bus_number(record, add=kind == Kind.FRAME)
            self.kind[record.id] = kind
            # Last: threads that read ahead take columns of this version as complete.
            self.version += 1

    def frames_in(self, index: MessageIndex | None) -> int | None:
        """Number of frames that a message index names; None without an index."""
        if index is None:
            return None
        return sum(len(rows) for channel, rows in index.items() if self.kind[channel] == Kind.FRAME)

    def schema_names(self) -> list[str]:
        """Names of the schemas that channels use, sorted; of schemaless channels the encoding."""
        return sorted({self._schema_name(channel) for channel in self._channels.values()})

    def topics(self) -> list[str]:
        """Topics, in the order of their first appearance."""
        return list(dict.fromkeys(channel.topic for channel in self._channels.values()))

    def _schema_name(self, channel: mcap_records.Channel) -> str:
        schema = self._schemas.get(channel.schema_id)
        return schema.name if schema else f"({channel.message_encoding or 'no encoding'})"

    def _kind(self, channel: mcap_records.Channel) -> Kind:
        schema = self._schemas.get(channel.schema_id)
        if channel.message_encoding == PROTOBUF and schema and schema.name in _KIND_OF_SCHEMA:
            return _KIND_OF_SCHEMA[schema.name]
        return self._kind_by_topic(channel.topic) if self._ours else Kind.OTHER

    def _kind_by_topic(self, topic: str) -> Kind:
        if _BUS_TOPIC.fullmatch(topic):
            return Kind.FRAME if topic.endswith("/frames") else Kind.STATUS
        own = {GAP_TOPIC: Kind.GAP, CLOCK_TOPIC: Kind.CLOCK, MARK_TOPIC: Kind.MARK}
        return own.get(topic, Kind.OTHER)

    def _bus_number(self, channel: mcap_records.Channel, *, add: bool) -> int:
        metadata = dict(channel.metadata)
        topic = _BUS_TOPIC.fullmatch(channel.topic)
        if topic:
            metadata.setdefault("bus", topic["bus"])
        claimed = BusInfo.from_channel(metadata, len(self._buses))
        for bus in self._buses:
            if claimed.name in (bus.name, topic_part(bus.name)):
                return bus.number
        return self._add_bus(claimed) if add else 0

    def _add_bus(self, bus: BusInfo) -> int:
        """Number of a new bus: the one it claims, unless another bus has it."""
        taken = {each.number for each in self._buses}
        free = (number for number in range(MAX_BUSES) if number not in taken)
        number = bus.number if bus.number not in taken else next(free, MAX_BUSES - 1)
        self._buses.append(bus.numbered(number))
        self._buses.sort(key=lambda each: each.number)
        return number
