"""What the recorder itself says in a capture: gaps, marks, clocks and the state of its buses."""

from dataclasses import dataclass, field

from google.protobuf.message import Message

from syncline_logger.adapter_clock import Knot
from syncline_logger.capture_file import Block
from syncline_logger.clock import ClockReading
from syncline_logger.decoding import UNREGISTERED, ChannelSpec
from syncline_schemas.capture.layout import CLOCK_TOPIC, GAP_TOPIC, MARK_TOPIC, status_topic
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.proto import syncline_pb2

STATUS_SCHEMA = schema_of(syncline_pb2.BusStatus.DESCRIPTOR)
GAP_CHANNEL = ChannelSpec(GAP_TOPIC, schema_of(syncline_pb2.Gap.DESCRIPTOR))
MARK_CHANNEL = ChannelSpec(MARK_TOPIC, schema_of(syncline_pb2.Mark.DESCRIPTOR))
CLOCK_CHANNEL = ChannelSpec(CLOCK_TOPIC, schema_of(syncline_pb2.ClockSample.DESCRIPTOR))


def status_channel(bus: str) -> ChannelSpec:
    """The channel of a bus's state."""
    return ChannelSpec(status_topic(bus), STATUS_SCHEMA)


def clock_message(reading: ClockReading) -> syncline_pb2.ClockSample:
    """What the machine's clocks said."""
    return syncline_pb2.ClockSample(
        utc_ns=reading.utc_ns,
        monotonic_ns=reading.monotonic_ns,
        step_ns=reading.step_ns,
        boot_ns=reading.boot_ns,
        slept_ns=reading.slept_ns,
        uncertainty_ns=reading.uncertainty_ns,
        offset_ns=reading.offset_ns,
    )


def knot_message(bus: int, knot: Knot, reading: ClockReading) -> syncline_pb2.ClockSample:
    """How the stamps of a bus's adapter become t."""
    return syncline_pb2.ClockSample(
        utc_ns=reading.utc_ns,
        monotonic_ns=reading.monotonic_ns,
        boot_ns=reading.boot_ns,
        bus=bus,
        adapter_ns=knot.adapter_ns,
        mapped_ns=knot.mapped_ns,
        rate_ppb=knot.rate_ppb,
        residual_ns=knot.residual_ns,
    )


@dataclass(slots=True)
class RecorderMessages:
    """Single messages since the last chunk."""

    _messages: list[tuple[ChannelSpec, int, Message]] = field(default_factory=list)

    def add(self, channel: ChannelSpec, log_ns: int, message: Message) -> None:
        """Note a message."""
        self._messages.append((channel, log_ns, message))

    def take(self) -> list[Block]:
        """What was noted since the last call, a block for each topic."""
        by_topic: dict[str, list[tuple[ChannelSpec, int, Message]]] = {}
        for message in self._messages:
            by_topic.setdefault(message[0].topic, []).append(message)
        self._messages.clear()
        blocks = []
        for messages in by_topic.values():
            messages.sort(key=lambda each: each[1])
            times = [log_ns for _, log_ns, _ in messages]
            block = MessageBlock.of_messages(
                UNREGISTERED, times, times, [message for _, _, message in messages]
            )
            blocks.append((messages[0][0], block))
        return blocks
