"""The capture of a bundle: a stretch of the captures given, without the redacted payloads."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import BinaryIO

import numpy as np

from syncline_analyzer.capture import CaptureFacts, CaptureReader
from syncline_analyzer.merge import Merge
from syncline_analyzer.redaction import REDACTED_KEY, Redaction
from syncline_analyzer.writers.carried import NOT_SOCKETCAN, merged_marks, write_marks
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.gap_message import gap_message
from syncline_schemas.capture.layout import (
    GAP_TOPIC,
    LEARNED_METADATA_NAME,
    Attachment,
    BusInfo,
    CaptureMetadata,
)
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.proto import syncline_pb2
from syncline_schemas.records import dataclass

Rates = Callable[[str], tuple[int | None, int | None]]


@dataclass(frozen=True, slots=True)
class Stretch:
    """A half-open stretch of stamps [start_ns, end_ns); None is open."""

    start_ns: int | None = None
    end_ns: int | None = None

    @property
    def whole(self) -> bool:
        """Whether nothing is cut."""
        return self.start_ns is None and self.end_ns is None

    def overlap(self, gap: Gap) -> Gap | None:
        """The part of a gap that lies within."""
        start = gap.start_ns if self.start_ns is None else max(gap.start_ns, self.start_ns)
        end = gap.end_ns if self.end_ns is None else min(gap.end_ns, self.end_ns)
        return replace(gap, start_ns=start, end_ns=end) if start < end else None

    def holds(self, t_ns: int) -> bool:
        """Whether a moment lies within."""
        after = self.start_ns is None or t_ns >= self.start_ns
        return after and (self.end_ns is None or t_ns < self.end_ns)

    def rows(self, batch: FrameBatch) -> FrameBatch:
        """The frames within."""
        info = np.iinfo(np.int64)
        low = info.min if self.start_ns is None else self.start_ns
        high = info.max if self.end_ns is None else self.end_ns
        inside = (batch.t_ns >= low) & (batch.t_ns < high)
        return batch if inside.all() else batch[inside]


@dataclass(slots=True)
class Written:
    """What went into the capture: frames, those before and after the stretch, redacted ones."""

    frames: int = 0
    before: int = 0
    after: int = 0
    redacted: int = 0
    redacted_bytes: int = 0


def write_capture(
    stream: BinaryIO,
    readers: Sequence[CaptureReader],
    stretch: Stretch,
    redaction: Redaction,
    *,
    rates: Rates,
    attachments: Sequence[Attachment],
    learned: Mapping[str, str],
    progress: Callable[[int], None] | None = None,
) -> Written:
    """Write the frames and gaps of a stretch as one capture of our own.

    rates: bit rate and that of the data phase [bit/s] of a bus by its name, where they are known.
    learned: record of what the frames before the stretch told of objects.
    """
    merge = Merge(readers)
    facts = [reader.facts for reader in readers]
    metadata = _metadata(facts, stretch, redaction, merge.first_ns or 0)
    writer = CaptureWriter(stream, metadata, [], attachments=attachments)
    if learned:
        writer.add_metadata(LEARNED_METADATA_NAME, learned)
    done = Written()
    for item in merge.stream():
        for number in range(writer.bus_count, len(merge.buses)):
            writer.add_bus(_bus(merge.buses[number], number, facts, rates))
        if isinstance(item, Gap):
            if gap := stretch.overlap(item):
                _write_gap(writer, gap)
            continue
        chosen = stretch.rows(item)
        _count(done, item, chosen, redaction)
        if len(chosen):
            writer.write_frames(redaction.applied(chosen))
        if progress:
            progress(done.before + done.frames + done.after)
    marks = [mark for mark in merged_marks(facts, merge.buses) if stretch.holds(mark.t_ns)]
    if redaction:
        # What made the recorder mark a moment may stand in a payload that is redacted.
        marks = [replace(mark, reason="(redacted)") for mark in marks]
    write_marks(writer, marks)
    writer.finish()
    return done


def _count(done: Written, batch: FrameBatch, chosen: FrameBatch, redaction: Redaction) -> None:
    left = len(batch) - len(chosen)
    if done.frames or len(chosen):
        # Within a batch that begins the stretch what is left out lies before it.
        first = not done.frames and len(chosen) and batch.t_ns[0] < chosen.t_ns[0]
        before = int(np.count_nonzero(batch.t_ns < chosen.t_ns[0])) if first else 0
        done.before += before
        done.after += left - before
    else:
        done.before += left
    done.frames += len(chosen)
    rows = redaction.covers(chosen)
    done.redacted += int(np.count_nonzero(rows))
    done.redacted_bytes += int(chosen.dlc[rows].sum(dtype=np.int64))


def _metadata(
    facts: Sequence[CaptureFacts], stretch: Stretch, redaction: Redaction, first_ns: int
) -> CaptureMetadata:
    names = ", ".join(each.path.name for each in facts)
    identity = f"{names}|{first_ns}|{stretch.start_ns}|{stretch.end_ns}|{redaction.text}"
    clock = facts[0].clock
    return CaptureMetadata(
        version=version("syncline"),
        recording_id=hashlib.sha256(identity.encode()).hexdigest()[:16],
        created_ns=max(first_ns, 0),
        clock=clock if clock != "unknown" else "log",
        resolution_ns=max(each.resolution_ns for each in facts),
        time_base=facts[0].time_base,
        source=f"{'part' if not stretch.whole else 'all'} of {names}",
        extra={REDACTED_KEY: redaction.text} if redaction else {},
    )


def _bus(
    name: str,
    number: int,
    facts: Sequence[CaptureFacts],
    rates: Rates,
) -> BusInfo:
    bitrate, data_bitrate = rates(name)
    foreign = any(name in each.foreign_errors for each in facts)
    return BusInfo(
        name=name,
        number=number,
        bitrate=bitrate,
        data_bitrate=data_bitrate,
        interface=NOT_SOCKETCAN if foreign else "",
    )


def _write_gap(writer: CaptureWriter, gap: Gap) -> None:
    """Write a gap at its end, when the recorder could know of it."""
    payload = gap_message(gap).SerializeToString()
    channel = writer.add_channel(GAP_TOPIC, schema_of(syncline_pb2.Gap.DESCRIPTOR))
    end_ns = np.array([gap.end_ns], np.int64)
    length = np.array([len(payload)], np.int64)
    block = MessageBlock(channel, end_ns, end_ns, length, np.frombuffer(payload, np.uint8))
    writer.write_chunk(FrameBatch.empty(), messages=[block])
