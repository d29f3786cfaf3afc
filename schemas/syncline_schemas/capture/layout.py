"""Names and facts of a capture file: topics, metadata keys, channel metadata, attachments.

Time in the file: `log_time` = when the recorder took the frame, on a clock that never steps back
within a file; `publish_time` = the stamp closest to the wire, `t_ns`. Both ns since the UNIX epoch,
or since the start of the log for captures converted from logs without a date.
"""

import re
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Literal, Self

from syncline_schemas.records import dataclass

PROFILE = "syncline"
SCHEMA_VERSION = 1
METADATA_NAME = "syncline"
"""Metadata record with the facts of the recording, written at the start."""
END_METADATA_NAME = "syncline.end"
"""Metadata record written when the recorder closes the file; a killed recording has none."""
RECOVER_METADATA_NAME = "syncline.recover"
"""Metadata record of a recovered file: what it was made from and what was lost."""
AFTER_KEY = "after_recording"
"""In the record `syncline`: id and last segment of the recording before, `3f2a/12`; what lies between
stands in gaps at the head."""
FOLLOWS_KEY = "follows_segment"
"""In the record `syncline`: the segment before, where numbers between were never used."""
MARK_METADATA_NAME = "syncline.mark"
"""Metadata record of a file with a mark in it: the first one's time and reason."""
LEARNED_METADATA_NAME = "syncline.learned"
"""Metadata record of a later segment: the objects' values that the earlier ones revealed."""
ADAPTERS_METADATA_NAME = "syncline.adapters"
"""Metadata record of a converted capture: how well the clocks of adapters were mapped onto UTC."""
ATTACHMENT_METADATA_NAME = "syncline.attachment"
"""Followed by `/` and the name of an attachment: the metadata record with its `sha256`."""

FRAME_SCHEMA_NAME = "syncline.Frame"
PROTOBUF = "protobuf"

GAP_TOPIC = "/recorder/gap"
CLOCK_TOPIC = "/recorder/clock"
MARK_TOPIC = "/recorder/mark"

DESCRIPTION_ATTACHMENT = "bus-description.toml"
DESCRIPTION_MEDIA_TYPE = "application/toml"
EDS_MEDIA_TYPE = "text/x-canopen-eds"
_MOST_BITRATE = 1_000_000_000
"""No bus is so fast [bit/s]; CAN XL has 20 million."""
_COARSEST_NS = 3_600_000_000_000
"""No stamps have longer steps."""

Compression = Literal["zstd", "lz4", "none"]


@dataclass(frozen=True, slots=True)
class BusInfo:
    """A recorded bus; everything but the name and number may be unknown.

    `number` is the `bus` column of the batches. `interface` is python-can's name of the interface
    ("socketcan", "pcan"), `channel` what was opened on it. `filters` says in words what the
    recorder did not take. `clock` and `resolution_ns` tell whose stamps `t_ns` are and their step.
    """

    name: str
    number: int
    bitrate: int | None = None
    data_bitrate: int | None = None
    interface: str = ""
    channel: str = ""
    filters: str = ""
    clock: str = ""
    resolution_ns: int | None = None

    def to_channel(self) -> dict[str, str]:
        """Metadata of this bus's frame channel."""
        values = {
            "bus": self.name,
            "number": str(self.number),
            "bitrate": _text(self.bitrate),
            "data_bitrate": _text(self.data_bitrate),
            "interface": self.interface,
            "channel": self.channel,
            "filters": self.filters,
            "clock": self.clock,
            "resolution_ns": _text(self.resolution_ns),
        }
        return {key: value for key, value in values.items() if value}

    def numbered(self, number: int) -> "BusInfo":
        """The same bus under another number."""
        return replace(self, number=number)

    @classmethod
    def from_channel(cls, metadata: Mapping[str, str], fallback_number: int) -> Self:
        """The bus that a frame channel belongs to, from its metadata."""
        number = _integer(metadata.get("number"))
        return cls(
            name=metadata.get("bus") or f"bus{fallback_number}",
            number=fallback_number if number is None or not 0 <= number <= 255 else number,
            bitrate=_within(metadata.get("bitrate"), _MOST_BITRATE),
            data_bitrate=_within(metadata.get("data_bitrate"), _MOST_BITRATE),
            interface=metadata.get("interface", ""),
            channel=metadata.get("channel", ""),
            filters=metadata.get("filters", ""),
            clock=metadata.get("clock", ""),
            resolution_ns=_within(metadata.get("resolution_ns"), _COARSEST_NS),
        )


@dataclass(frozen=True, slots=True)
class CaptureMetadata:
    """The metadata record `syncline`.

    Attributes:
        version: version of Syncline that wrote the file.
        recording_id: the same in all segments of one recording.
        segment: number of the file in its recording, from 0.
        host: name of the machine that recorded.
        created_ns: when the file was begun, UTC.
        clock: whose stamps `t_ns` are: "hardware", "kernel", "host", "simulated" or "log".
        resolution_ns: step of the stamps.
        time_base: "utc", "relative" (to the start of the log) or "none".
        source: what was recorded or converted, in words.
        extra: further keys, kept as they are.
    """

    version: str
    recording_id: str
    segment: int = 0
    host: str = ""
    created_ns: int = 0
    clock: str = "unknown"
    resolution_ns: int = 1
    time_base: str = "utc"
    source: str = ""
    extra: Mapping[str, str] = field(default_factory=dict)

    def to_record(self) -> dict[str, str]:
        """Keys and values of the metadata record."""
        return {
            "schema_version": str(SCHEMA_VERSION),
            "version": self.version,
            "recording_id": self.recording_id,
            "segment": str(self.segment),
            "host": self.host,
            "created_ns": str(self.created_ns),
            "clock": self.clock,
            "resolution_ns": str(self.resolution_ns),
            "time_base": self.time_base,
            "source": self.source,
            **self.extra,
        }

    @classmethod
    def from_record(cls, record: Mapping[str, str]) -> Self:
        """The facts in a metadata record; what is missing or unreadable takes its default."""
        known = set(cls("", "").to_record())
        return cls(
            version=record.get("version", ""),
            recording_id=record.get("recording_id", ""),
            segment=_integer(record.get("segment")) or 0,
            host=record.get("host", ""),
            created_ns=_integer(record.get("created_ns")) or 0,
            clock=record.get("clock") or "unknown",
            resolution_ns=_within(record.get("resolution_ns"), _COARSEST_NS) or 1,
            time_base=record.get("time_base") or "utc",
            source=record.get("source", ""),
            extra={key: value for key, value in record.items() if key not in known},
        )


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file carried in the capture."""

    name: str
    media_type: str
    data: bytes


def description_attachment(toml: str) -> Attachment:
    """The bus description as an attachment."""
    return Attachment(DESCRIPTION_ATTACHMENT, DESCRIPTION_MEDIA_TYPE, toml.encode())


def eds_attachment(file_name: str, data: bytes) -> Attachment:
    """An EDS or DCF file, byte for byte, as an attachment."""
    return Attachment(file_name, EDS_MEDIA_TYPE, data)


def device_attachment(file_name: str, data: bytes) -> Attachment:
    """One of a device's own files, its EDS or its TOML, as an attachment."""
    if file_name.endswith(".toml"):
        return Attachment(file_name, DESCRIPTION_MEDIA_TYPE, data)
    return eds_attachment(file_name, data)


def topic_part(name: str) -> str:
    """A name as one part of a topic: what is no letter, digit, `_`, `-` or `.` becomes `_`.

    >>> topic_part("/dev/ttyUSB0")
    'dev_ttyUSB0'
    """
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", name).strip("_") or "_"


def frames_topic(bus: str) -> str:
    """Topic of a bus's raw frames.

    >>> frames_topic("can0")
    '/can/can0/frames'
    """
    return f"/can/{topic_part(bus)}/frames"


def status_topic(bus: str) -> str:
    """Topic of a bus's state and counters."""
    return f"/can/{topic_part(bus)}/status"


def service_topic(bus: str, service: Literal["nmt", "sync", "time", "lss"]) -> str:
    """Topic of a decoded network-wide service."""
    return f"/canopen/{topic_part(bus)}/{service}"


def node_topic(bus: str, node: int, service: str) -> str:
    """Topic of a node's decoded service: "heartbeat", "emcy", "sdo", "tpdo1" ...

    >>> node_topic("can0", 10, "tpdo1")
    '/canopen/can0/node10/tpdo1'
    """
    return f"/canopen/{topic_part(bus)}/node{node}/{service}"


def _text(value: int | None) -> str:
    return "" if value is None else str(value)


def _integer(text: str | None) -> int | None:
    try:
        return int(text or "")
    except ValueError:
        return None


def _within(text: str | None, most: int) -> int | None:
    """A number from 1 on up to another one; what else a damaged file holds is unknown."""
    found = _integer(text)
    return found if found is not None and 0 < found <= most else None
