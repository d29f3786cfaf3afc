"""What strangers read in a capture: the official mcap reader, protobuf's own decoder, the doctor."""

import json
import shutil
import struct
import subprocess
import sys
import sysconfig
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader

from syncline_schemas.proto import syncline_pb2


@dataclass(slots=True)
class Contents:
    """Decoded messages by topic, each with (log time, publish time, message)."""

    messages: dict[str, list[tuple[int, int, Any]]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    channel_metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    log_times: list[int] = field(default_factory=list)

    def values(self, topic: str) -> list[Any]:
        """The messages of a topic without their times."""
        return [message for _, _, message in self.messages.get(topic, [])]

    def frames(self, bus: str) -> list[tuple[int, int, int, bytes]]:
        """(identifier, flags, length, data) of each frame of a bus."""
        return [(m.can_id, m.flags, m.dlc, m.data) for m in self.values(f"/can/{bus}/frames")]


def _classes(schemas: dict[int, Any], schema: Schema) -> Any:
    if schema.id not in schemas:
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
            pool.Add(file)
        descriptor = pool.FindMessageTypeByName(schema.name)
        schemas[schema.id] = message_factory.GetMessageClass(descriptor)
    return schemas[schema.id]


def read_capture(path: Path) -> Contents:
    """Everything in a closed capture."""
    contents, schemas = Contents(), dict[int, Any]()
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            decoded = _classes(schemas, schema).FromString(message.data)
            entry = (message.log_time, message.publish_time, decoded)
            contents.messages.setdefault(channel.topic, []).append(entry)
            contents.channel_metadata[channel.topic] = channel.metadata
        contents.attachments = {a.name: a.data for a in reader.iter_attachments()}
        contents.metadata = {m.name: dict(m.metadata) for m in reader.iter_metadata()}
    with path.open("rb") as stream:
        unordered = make_reader(stream).iter_messages(log_time_order=False)
        contents.log_times = [message.log_time for _, _, message in unordered]
    return contents


def read_cut_frames(path: Path) -> list[bytes]:
    """Data of every frame that can be read of a file that was cut off, in file order."""
    data, frames_channels = [], set()
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Channel) and record.topic.endswith("/frames"):
                    frames_channels.add(record.id)
                elif isinstance(record, Message) and record.channel_id in frames_channels:
                    data.append(syncline_pb2.Frame.FromString(record.data).data)
        except (McapError, EOFError, struct.error):
            pass
    return data


def doctor_complaints(path: Path) -> list[str]:
    """Errors and warnings of `pymcap-cli doctor`, but for chunks too small to gain by compression."""
    scripts = sysconfig.get_path("scripts")
    doctor = shutil.which("pymcap-cli", path=scripts) or "pymcap-cli"
    done = subprocess.run(
        [doctor, "doctor", "--strict-message-order", "--format", "jsonl", str(path)],
        capture_output=True,
        check=False,
        encoding="utf-8",
    )
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert found[-1]["type"] == "summary"
    return [
        str(each)
        for each in found[:-1]
        if each["severity"] != "info" and each["code"] != "CHUNK_COMPRESSION_INEFFICIENT"
    ]


def syncline(*words: str) -> list[str]:
    """The command line of `syncline`, run by this Python."""
    return [sys.executable, "-m", "syncline_logger", *words]
