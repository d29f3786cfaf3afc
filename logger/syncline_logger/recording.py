"""From collected frames to chunks: what every recording does, live or simulated."""

import platform
import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray

from syncline_logger.bus_condition import BusCondition
from syncline_logger.capture_file import CaptureFile, capture_path
from syncline_logger.clock import ClockReading
from syncline_logger.decoding import UNREGISTERED, ChannelSpec, Decoded
from syncline_logger.live_status import LiveStatus, StatusSnapshot
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.layout import (
    CLOCK_TOPIC,
    GAP_TOPIC,
    Attachment,
    BusInfo,
    CaptureMetadata,
    Compression,
    description_attachment,
    device_attachment,
    status_topic,
)
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import Device
from syncline_schemas.proto import syncline_pb2

Block = tuple[ChannelSpec, MessageBlock]

MAX_KEPT = 1000
"""Gaps and problems kept for the result; all of them are in the file."""

STOP_METADATA_NAME = "syncline.stop"
"""Metadata record: when and why the recording ended, and the frames known to be lost."""

STATUS_SCHEMA = schema_of(syncline_pb2.BusStatus.DESCRIPTOR)
GAP_CHANNEL = ChannelSpec(GAP_TOPIC, schema_of(syncline_pb2.Gap.DESCRIPTOR))
CLOCK_CHANNEL = ChannelSpec(CLOCK_TOPIC, schema_of(syncline_pb2.ClockSample.DESCRIPTOR))


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """How to record; the defaults are right for most.

    Attributes:
        flush_ns: at most this much is lost to a power cut [ns].
        chunk_frames: a chunk is closed earlier when it holds so many frames (about 1 MiB).
        sync: wait for the disk after each chunk; only a simulated recording can do without.
        decode: write decoded channels beside the raw frames.
        description: what is known of the buses and their nodes.
        recording_id: the recording's name; None makes one.
        queue_frames: frames that may wait for the writer, all buses together.
    """

    flush_ns: int = 1_000_000_000
    chunk_frames: int = 1 << 15
    compression: Compression = "zstd"
    sync: bool = True
    decode: bool = True
    description: BusDescription = field(default_factory=BusDescription)
    recording_id: str | None = None
    queue_frames: int = 1 << 17

    @property
    def period_ns(self) -> int:
        """How often a chunk is written: a tenth of `flush_ns` is kept for writing it."""
        return self.flush_ns * 9 // 10


@dataclass(frozen=True, slots=True)
class RecordResult:
    """What was recorded.

    Attributes:
        frames: by bus name.
        lost_frames: known to be lost, all buses together.
        gap_count: stretches in which a bus was not heard; `gaps` holds the first thousand.
        problems: words on what was not decoded and what changed, each with its bus's name; the
            first thousand.
    """

    path: Path
    frames: dict[str, int]
    lost_frames: int
    gap_count: int
    gaps: list[Gap]
    problems: list[str]
    bytes_written: int

    @property
    def frame_count(self) -> int:
        """All buses together."""
        return sum(self.frames.values())


class Recording:
    """The chunks of one recording, fed in log time order."""

    def __init__(
        self,
        target: Path,
        buses: Sequence[BusInfo],
        options: RecordOptions,
        *,
        start_ns: int,
        host: str | None = None,
        source: str = "",
    ) -> None:
        recording_id = options.recording_id or uuid.uuid4().hex[:8]
        self._buses = {bus.number: bus for bus in buses}
        self.conditions = {bus.number: BusCondition(bus.interface) for bus in buses}
        self.live = LiveStatus(buses, start_ns)
        self._gaps: list[Gap] = []
        self._gap_count = self._lost_frames = 0
        self._problems: list[str] = []
        self._messages: list[tuple[ChannelSpec, int, Message]] = []
        self._heard_ns = start_ns
        self.file = CaptureFile(
            capture_path(target, start_ns, recording_id),
            CaptureMetadata(
                version=version("syncline"),
                recording_id=recording_id,
                host=platform.node() if host is None else host,
                created_ns=start_ns,
                clock=_one_of({bus.clock for bus in buses}, "mixed"),
                resolution_ns=max((bus.resolution_ns or 1 for bus in buses), default=1),
                source=source,
                extra=_loss_counters(buses),
            ),
            buses,
            attachments=_attachments(options.description),
            compression=options.compression,
            sync=options.sync,
        )
        for bus in buses:
            for node, entry in options.description.described(bus.name).items():
                if entry.device:
                    self._recognised(bus.number, node, entry.device)

    def add_gap(self, gap: Gap, log_ns: int) -> None:
        """Note a stretch in which nothing was heard; it stands in the file at `log_ns`."""
        self._gap_count += 1
        self._lost_frames += gap.lost_frames or 0
        if len(self._gaps) < MAX_KEPT:
            self._gaps.append(gap)
        message = syncline_pb2.Gap(
            start_ns=gap.start_ns,
            end_ns=gap.end_ns,
            reason=gap.reason,
            lost_frames=gap.lost_frames,
            bus=gap.bus,
        )
        self._messages.append((GAP_CHANNEL, log_ns, message))

    def add_clock(self, reading: ClockReading, log_ns: int) -> None:
        """Note what the clocks said."""
        message = syncline_pb2.ClockSample(
            utc_ns=reading.utc_ns, monotonic_ns=reading.monotonic_ns, step_ns=reading.step_ns
        )
        self._messages.append((CLOCK_CHANNEL, log_ns, message))

    def add_status(self, bus: int, log_ns: int, text: str = "") -> None:
        """Note a bus's state and counters; `text` says what changed."""
        spec = ChannelSpec(status_topic(self._buses[bus].name), STATUS_SCHEMA)
        self._messages.append((spec, log_ns, self.conditions[bus].message(text)))
        if text and len(self._problems) < MAX_KEPT:
            self._problems.append(f"{self._buses[bus].name}: {text}")

    def add_all_status(self, log_ns: int) -> None:
        """Note the state and counters of every bus."""
        for bus in self._buses:
            self.add_status(bus, log_ns)

    def take_frames(self, frames: FrameBatch, log_ns: NDArray[np.int64]) -> None:
        """Count frames and follow the state of their buses; they are written by `write`."""
        if len(frames) == 0:
            return
        self._heard_ns = int(log_ns[-1])
        for bus, condition in self.conditions.items():
            rows = np.flatnonzero(frames.bus == bus)
            for change in condition.update(frames[rows], log_ns[rows]):
                self.add_status(bus, change.log_ns, change.text)
        self.live.update(frames, log_ns)

    def write(
        self, frames: FrameBatch, log_ns: NDArray[np.int64], decoded: Iterable[Decoded] = ()
    ) -> None:
        """Write a chunk of these frames, what was decoded, and everything noted since."""
        blocks: list[Block] = []
        for part in decoded:
            blocks += part.blocks
            for bus, text in part.problems:
                self.add_status(bus, self._heard_ns, text)
            for bus, node, device in part.devices:
                self._recognised(bus, node, device)
        blocks += self._noted()
        if len(frames) or blocks:
            self.file.write(frames, log_ns, blocks)

    def snapshot(self, now_ns: int) -> StatusSnapshot:
        """The live state; begins the next period of its rates."""
        return self.live.snapshot(
            now_ns, str(self.file.path), self.file.bytes_written, list(self.conditions.values())
        )

    def finish(self, end_ns: int, why: str) -> RecordResult:
        """Write the end of the file and close it."""
        result = self.result()
        self.file.add_metadata(
            STOP_METADATA_NAME,
            {
                "end_ns": str(end_ns),
                "reason": why,
                "lost_frames": str(result.lost_frames),
            },
        )
        self.file.finish()
        return result

    def result(self) -> RecordResult:
        """What was recorded so far."""
        return RecordResult(
            path=self.file.path,
            frames={bus.name: self.conditions[n].frames for n, bus in self._buses.items()},
            lost_frames=self._lost_frames,
            gap_count=self._gap_count,
            gaps=list(self._gaps),
            problems=list(self._problems),
            bytes_written=self.file.bytes_written,
        )

    def _noted(self) -> list[Block]:
        """The single messages since the last chunk, as blocks by topic."""
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

    def _recognised(self, bus: int, node: int, device: Device) -> None:
        self._attach(device)
        name = self._buses[bus].name
        self.file.add_metadata(
            f"syncline.device.{name}.node{node}",
            {"bus": name, "node": str(node), "device": device.name},
        )

    def _attach(self, device: Device) -> None:
        for name, data in device.files.items():
            self.file.attach(device_attachment(name, data))


def _attachments(description: BusDescription) -> list[Attachment]:
    files = [device_attachment(name, data) for name, data in description.files.items()]
    return ([description_attachment(description.text)] if description.text else []) + files


def _one_of(values: set[str], several: str) -> str:
    return next(iter(values)) or "unknown" if len(values) == 1 else several


def _loss_counters(buses: Sequence[BusInfo]) -> Mapping[str, str]:
    """Which of BusStatus's loss counters can count anything: python-can reports none of its own."""
    return {
        f"{bus.name}.loss_counters": "queue, controller"
        if bus.interface in ("socketcan", "socketcand")
        else "queue"
        for bus in buses
    }
