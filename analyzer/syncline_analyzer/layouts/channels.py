"""The decoded channels of captures: topics, their message types, and fields that can be plotted."""

from collections.abc import Sequence
from pathlib import Path

import mcap.records as mcap_records
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError

from syncline_schemas.capture.layout import PROTOBUF
from syncline_schemas.capture.record_file import RecordFile
from syncline_schemas.capture.record_stream import MAGIC
from syncline_schemas.description import BusDescription
from syncline_schemas.errors import CaptureError
from syncline_schemas.records import dataclass

_NOT_NUMBERS = (
    FieldDescriptorProto.TYPE_STRING,
    FieldDescriptorProto.TYPE_BYTES,
    FieldDescriptorProto.TYPE_MESSAGE,
    FieldDescriptorProto.TYPE_GROUP,
)
_CANOPEN = "canopen"
_PDO_PACKAGE = "syncline.pdo."


@dataclass(frozen=True, slots=True)
class Field:
    """A number in the messages of a channel: its name, what it is, and its unit ("" = none)."""

    name: str
    label: str
    unit: str


@dataclass(frozen=True, slots=True)
class DecodedChannel:
    """A channel under /canopen.

    Attributes:
        topic: as in the file.
        schema: full name of its message type.
        bus, service: parts of the topic; service is "heartbeat", "emcy", "tpdo1" and the like.
        node: its node, None for services of the whole bus.
        name: the node's name in the bus description, "" where there is none.
        numbers: fields that hold a number, of PDOs alone.
    """

    topic: str
    schema: str
    bus: str
    service: str
    node: int | None
    name: str
    numbers: tuple[Field, ...]

    @property
    def label(self) -> str:
        """The node by bus, number and name."""
        return " ".join(filter(None, (self.bus, str(self.node or ""), self.name)))


def decoded_channels(captures: Sequence[Path]) -> list[DecodedChannel]:
    """The decoded channels that hold messages in any of the captures, by bus and node.

    Raises:
        CaptureError: a file is no MCAP, was never closed, or none holds a decoded channel.
    """
    found: dict[str, DecodedChannel] = {}
    for path in captures:
        found |= {channel.topic: channel for channel in _of_file(path)}
    if not found:
        names = ", ".join(path.name for path in captures)
        raise CaptureError(
            f"{names}: no decoded channels; only 'syncline record' with decoding on writes them, a"
            " converted log holds its frames alone"
        )
    return sorted(found.values(), key=lambda each: (each.bus, each.node or 0, each.service))


def _of_file(path: Path) -> list[DecodedChannel]:
    try:
        with path.open("rb") as stream:
            summary = RecordFile(stream).summary()
    except OSError as error:
        raise CaptureError(f"{path}: {error.strerror or error}") from error
    if summary is None or summary.statistics is None:
        if not _begins_as_mcap(path):
            raise CaptureError(
                f"{path}: no MCAP capture; layouts are for the channels that 'syncline record'"
                " decodes. 'syncline analyze --out' and 'syncline view' show any log"
            )
        raise CaptureError(f"{path}: no closed MCAP file; make one of it with syncline recover")
    description = _description(path)
    schemas = {schema.id: schema for schema in summary.schemas}
    counts = summary.statistics.channel_message_counts
    return [
        decoded
        for channel in summary.channels
        if counts.get(channel.id) and (schema := schemas.get(channel.schema_id))
        if (decoded := _decoded(channel, schema, description))
    ]


def _begins_as_mcap(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


def _description(path: Path) -> BusDescription:
    from syncline_analyzer.readers import open_capture

    facts = open_capture(path).facts
    if not facts.description_toml:
        return BusDescription()
    return BusDescription.loads(facts.description_toml, files=facts.eds_files)


def _decoded(
    channel: mcap_records.Channel, schema: mcap_records.Schema, description: BusDescription
) -> DecodedChannel | None:
    parts = channel.topic.strip("/").split("/")
    if parts[0] != _CANOPEN or len(parts) < 3 or schema.encoding != PROTOBUF:
        return None
    bus, service = parts[1], parts[-1]
    number = parts[2].removeprefix("node")
    node = int(number) if len(parts) == 4 and number.isdecimal() else None
    entry = description.node(bus, node) if node is not None else None
    numbers = _numbers(channel, schema) if schema.name.startswith(_PDO_PACKAGE) else ()
    name = entry.name or "" if entry else ""
    return DecodedChannel(channel.topic, schema.name, bus, service, node, name, numbers)


def _numbers(channel: mcap_records.Channel, schema: mcap_records.Schema) -> tuple[Field, ...]:
    message = _message(schema)
    about = channel.metadata
    return tuple(
        Field(
            field.name,
            about.get(f"object.{field.name}", field.name),
            about.get(f"unit.{field.name}", ""),
        )
        for field in (message.field if message else ())
        if field.type not in _NOT_NUMBERS
    )


def _message(schema: mcap_records.Schema) -> DescriptorProto | None:
    try:
        files = FileDescriptorSet.FromString(schema.data).file
    except DecodeError:
        return None
    named = {f"{file.package}.{each.name}": each for file in files for each in file.message_type}
    return named.get(schema.name)
