"""Reading a capture: whole, cut off, damaged or rewritten by another tool."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import mcap.records as mcap_records
import numpy as np
from numpy.typing import NDArray

from syncline_schemas import native
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.channels import ChannelTable, Kind
from syncline_schemas.capture.chunk_content import (
    ChunkContent,
    frame_channels_by_content,
    open_chunk,
    read_frames,
)
from syncline_schemas.capture.chunk_group import (
    OpenedGroup,
    Other,
    PlainGroup,
    grouped,
    open_group,
)
from syncline_schemas.capture.clock_history import ClockHistory, ClockRepair
from syncline_schemas.capture.gap_message import gap_of
from syncline_schemas.capture.lag import LagBounds
from syncline_schemas.capture.layout import (
    END_METADATA_NAME,
    METADATA_NAME,
    PROFILE,
    Attachment,
    BusInfo,
    CaptureMetadata,
)
from syncline_schemas.capture.limit import Limit, Unread, last_frames
from syncline_schemas.capture.loss import LossTracker
from syncline_schemas.capture.mark import MAX_MARKS, Mark, mark_of
from syncline_schemas.capture.read_ahead import read_ahead
from syncline_schemas.capture.record_file import (
    ChunkPlace,
    Definition,
    Document,
    Lost,
    RawChunk,
    Record,
    RecordFile,
    Summary,
)
from syncline_schemas.errors import CaptureError
from syncline_schemas.memory import keep_freed_memory
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    from google.protobuf.message import Message

    from syncline_schemas.proto import syncline_pb2

FRAMES_PER_BATCH = 1 << 16
"""Frames of small chunks are joined until a batch has at least as many; less often only once, as
soon as the first are there."""


_M = TypeVar("_M", bound="Message")


@dataclass(frozen=True, slots=True)
class BusStatusSample:
    """A bus's state and counters at a time; `bus` is the bus number."""

    t_ns: int
    bus: int
    status: "syncline_pb2.BusStatus"


@dataclass(frozen=True, slots=True)
class ClockReading:
    """The clocks read together at a time."""

    t_ns: int
    sample: "syncline_pb2.ClockSample"


_EMPTY = "the file is empty"

Item = FrameBatch | Gap | BusStatusSample | ClockReading


@dataclass(slots=True)
class ScanFacts:
    """What is known of the file besides its messages; complete when the last item was read.

    Attributes:
        profile: of the header; "syncline" for our own captures.
        metadata: None where the record is missing.
        metadata_records: all of them, by name.
        buses: by number.
        schema_names: of all channels.
        topics: of all channels.
        closed: whether the file has its footer; a recording that was killed, or still runs, has
            none.
        damage: what could not be read, each in words.
        lost_chunks: chunks that are in the file and cannot be read.
        lost_frames: frames known to be lost with them; others may be uncounted.
        marks: the first thousand; `mark_count` are all.
    """

    profile: str = ""
    metadata: CaptureMetadata | None = None
    metadata_records: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[Attachment] = field(default_factory=list)
    buses: list[BusInfo] = field(default_factory=list)
    schema_names: list[str] = field(default_factory=list)
    topics: list[str] = field(default_factory=list)
    closed: bool = False
    damage: list[str] = field(default_factory=list)
    lost_chunks: int = 0
    lost_frames: int = 0
    marks: list[Mark] = field(default_factory=list)
    mark_count: int = 0


class CaptureScan:
    """A capture file, read once from the first item to the last, in arrival order.

    Metadata, attachments and buses that stand before the first chunk, or in the summary, are in
    `facts` at once. A time range takes the frames with `start_ns <= t_ns < end_ns` and the gaps
    that overlap it, cut to it; of a closed capture only the chunks that can hold such frames are read.

    Attributes:
        repair: moves the stamps, before the range is taken; bus states and clock readings stay.

    Raises:
        CaptureError: the path cannot be opened or is no MCAP file. Damage never raises.
    """

    def __init__(
        self, path: Path, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> None:
        self.path = path
        self.facts = ScanFacts()
        self.repair: ClockRepair | None = None
        self._range = _TimeRange(start_ns, end_ns)
        self._summary: Summary | None = None
        self._first_chunk = 0
        self._losses = LossTracker()
        self._undescribed = 0
        self._sampled = True
        self._limit: Limit | None = None
        with _opened(path, self.facts.damage) as file:
            self._begin(file)

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches and gaps alone; bus states and clock readings are not looked at."""
        self._sampled = False
        for item in self.items():
            if isinstance(item, FrameBatch | Gap):
                yield item

    def items(self) -> Iterator[Item]:
        """Batches, gaps, bus states and clock readings, in file order.

        A gap stands exactly between the frames before and after it; bus states and clock readings
        follow the batch in whose stretch they fell.
        """
        keep_freed_memory()
        pending = _Pending()
        with _opened(self.path, self.facts.damage) as file:
            groups = grouped(self._chunks(file))
            for opened in read_ahead(groups, partial(open_group, channels=self._channels)):
                for item in self._items_of_groups(file, opened):
                    yield from pending.add(item)
        yield from pending.flush()
        yield from self._range.wanted(self._losses.finish())
        if self._undescribed:
            text = f"{self._undescribed} messages of channels that are not described"
            self.facts.damage.append(text)
        if not self.facts.closed and self.facts.damage != [_EMPTY]:
            self.facts.damage.append("no footer: the recording was cut off or still runs")

    def limit(
        self, start_ns: int, end_ns: int, skipped: Callable[[int], object] = lambda frames: None
    ) -> None:
        """From here on leave out whole chunks without frames of `start_ns <= t_ns < end_ns`.

        Frames of the others are all given. Chunks with gaps or marks are read wherever they are, and
        the last one of each bus. `skipped` is told how many frames before the range are left out,
        no later than the first frame of it is given.
        """
        self._limit = Limit(start_ns, end_ns, skipped)

    def add_clock_samples(self, history: ClockHistory) -> None:
        """Give a history all clock samples; nothing else is read, and no damage told.

        A file that was closed tells at its end what they say, so that nothing need be unpacked.
        """
        if history.add_record(self.facts.metadata_records.get(END_METADATA_NAME, {})):
            return
        with _opened(self.path, []) as file:
            for raw in self._clock_chunks(file):
                if isinstance(raw, Definition | Document):
                    self._register(raw)
                elif isinstance(raw, RawChunk) and self._may_hold_clocks(raw.index):
                    content = open_chunk(raw)
                    if isinstance(content, ChunkContent):
                        self._add_clocks(content, history)

    def _clock_chunks(self, file: RecordFile) -> Iterator[Record]:
        if self._summary is None:
            yield from file.records(self._first_chunk)
            return
        for place in self._summary.chunks:
            if self._may_hold_clocks(place.messages()):
                yield file.chunk_at(place)

    def _may_hold_clocks(self, channels: Iterable[int] | None) -> bool:
        kind = self._channels.kind
        return channels is None or any(kind[channel] == Kind.CLOCK for channel in channels)

    def _add_clocks(self, content: ChunkContent, history: ClockHistory) -> None:
        from google.protobuf.message import DecodeError

        from syncline_schemas.proto import syncline_pb2

        for row in np.flatnonzero(self._channels.kind[content.channel] == Kind.CLOCK).tolist():
            with suppress(DecodeError):
                sample = syncline_pb2.ClockSample.FromString(content.payload(row))
                history.add(int(content.log_time_ns[row]), sample)

    def _begin(self, file: RecordFile) -> None:
        if not file.plausible:
            raise CaptureError(f"{self.path} is no MCAP file")
        self.facts.closed = file.closed
        self.facts.profile = file.profile()
        self._channels = ChannelTable(self.facts.buses, ours=self.facts.profile == PROFILE)
        if file.size == 0:
            self.facts.damage.append(_EMPTY)
            return
        summary = file.summary()
        if summary is not None:
            self._register(*summary.schemas, *summary.channels)
        if summary is not None and summary.complete:
            self._summary = summary
            self._register(*file.documents(summary))
            return
        for record in file.records():
            if isinstance(record, RawChunk | Lost):
                self._first_chunk = record.offset
                return
            self._register(record)
        self._first_chunk = file.size

    def _chunks(self, file: RecordFile) -> Iterator[Record | Unread]:
        """Chunks in file order and, where no summary told them before, what else is in the file."""
        if self._summary is None:
            yield from file.records(self._first_chunk)
            return
        lag = LagBounds.from_record(self.facts.metadata_records.get(END_METADATA_NAME, {}))
        if self.repair is not None:
            lag = None
        last = None
        # Compiled, chunks are walked through; numpy goes by the message indexes.
        chunk_at = partial(file.chunk_at, indexed=not native.available())
        for place in self._summary.chunks:
            if lag is None or (self._limit is None and self._range.may_hold(place, lag)):
                yield chunk_at(place)
            elif self._limit is not None:
                last = last or last_frames(self._summary.chunks, self._channels)
                unread = self._limit.unread(place, lag, self._channels)
                yield chunk_at(place) if unread is None or place in last else unread

    def _register(self, *records: Definition | Document) -> None:
        for record in records:
            if isinstance(record, mcap_records.Metadata):
                self._take_metadata(record)
            elif isinstance(record, mcap_records.Attachment):
                attachment = Attachment(record.name, record.media_type, record.data)
                self.facts.attachments.append(attachment)
            else:
                self._channels.register(record)
        self.facts.schema_names = self._channels.schema_names()
        self.facts.topics = self._channels.topics()

    def _take_metadata(self, record: mcap_records.Metadata) -> None:
        self.facts.metadata_records[record.name] = record.metadata
        if record.name == METADATA_NAME:
            self.facts.metadata = CaptureMetadata.from_record(record.metadata)

    def _items_of_groups(
        self, file: RecordFile, opened: list[OpenedGroup] | Other
    ) -> Iterator[Item]:
        if isinstance(opened, list):
            for group in opened:
                yield from self._items_of_group(file, group)
        elif isinstance(opened, Lost):
            yield from self._items_of(opened)
        elif isinstance(opened, Unread):
            yield from self._range.wanted(self._losses.read(opened.start_ns, opened.end_ns))
            opened.tell()
        else:
            self._register(opened)

    def _items_of_group(self, file: RecordFile, opened: OpenedGroup) -> Iterator[Item]:
        if opened.plain is None or opened.version != self._channels.version:
            for raw in opened.raws:
                yield from self._items_of(file.indexed(raw))
        else:
            yield from self._items_of_plain(opened.plain)

    def _items_of_plain(self, plain: PlainGroup) -> Iterator[Item]:
        yield from self._range.wanted(self._losses.read(plain.first_ns, plain.last_ns))
        yield self._range.of(self._repaired(plain.frames, plain.log_time_ns))
        for content, kind in plain.others:
            self._take_marks(content, kind)
        for content, kind in plain.others:
            yield from self._samples(content, kind)

    def _items_of(self, raw: RawChunk | Lost) -> Iterator[Item]:
        if isinstance(raw, Lost):
            yield from self._loss(raw.reason, raw.start_ns, raw.end_ns, None)
            return
        content = open_chunk(raw)
        if isinstance(content, str):
            reason = f"chunk at byte {raw.offset} is damaged: {content}"
            lost = self._channels.frames_in(raw.index)
            yield from self._loss(reason, raw.start_ns, raw.end_ns, lost)
            return
        self._register(*content.definitions)
        if content.damage:
            self.facts.damage.append(f"chunk at byte {raw.offset}: {content.damage}")
        if len(content.log_time_ns) == 0:
            return
        first_ns, last_ns = int(content.log_time_ns[0]), int(content.log_time_ns[-1])
        yield from self._range.wanted(self._losses.read(first_ns, last_ns))
        yield from self._items_in(content)

    def _loss(
        self, reason: str, start_ns: int | None, end_ns: int | None, frames: int | None
    ) -> Iterator[Gap]:
        self.facts.damage.append(reason)
        self.facts.lost_chunks += 1
        self.facts.lost_frames += frames or 0
        yield from self._range.wanted(self._losses.lost(start_ns, end_ns, frames))

    def _items_in(self, content: ChunkContent) -> Iterator[Item]:
        undescribed = np.flatnonzero(self._channels.kind[content.channel] == Kind.UNKNOWN)
        if len(undescribed):
            self._register(*frame_channels_by_content(content, undescribed))
        kind = self._channels.kind[content.channel]
        self._undescribed += int(np.count_nonzero(kind == Kind.UNKNOWN))
        frame_rows = np.flatnonzero(kind == Kind.FRAME)
        start = 0
        for row in np.flatnonzero(kind == Kind.GAP).tolist():
            until = int(np.searchsorted(frame_rows, row))
            yield self._frames(content, frame_rows[start:until])
            yield from self._range.wanted(self._gap(content, row))
            start = until
        yield self._frames(content, frame_rows[start:])
        self._take_marks(content, kind)
        yield from self._samples(content, kind)

    def _frames(self, content: ChunkContent, rows: NDArray[np.intp]) -> FrameBatch:
        frames, unreadable = read_frames(content, rows, self._channels.bus)
        if len(unreadable):
            self.facts.lost_frames += len(unreadable)
            self.facts.damage.append(f"{len(unreadable)} messages are no frames")
            rows = rows[~np.isin(rows, unreadable)]
        return self._range.of(self._repaired(frames, content.log_time_ns[rows]))

    def _repaired(self, frames: FrameBatch, log_time_ns: NDArray[np.int64]) -> FrameBatch:
        if self.repair is None:
            return frames
        return replace(frames, t_ns=self.repair.t_ns(frames.t_ns, log_time_ns))

    def _gap(self, content: ChunkContent, row: int) -> Gap | None:
        from syncline_schemas.proto import syncline_pb2

        message = self._parsed(syncline_pb2.Gap, content, row)
        if message is None or self.repair is None:
            return None if message is None else gap_of(message)
        gap = gap_of(message)
        start_ns, end_ns = self.repair.log_t_ns(gap.start_ns), self.repair.log_t_ns(gap.end_ns)
        return replace(gap, start_ns=start_ns, end_ns=max(start_ns, end_ns))

    def _take_marks(self, content: ChunkContent, kind: NDArray[np.uint8]) -> None:
        for row in np.flatnonzero(kind == Kind.MARK).tolist():
            from syncline_schemas.proto import syncline_pb2

            message = self._parsed(syncline_pb2.Mark, content, row)
            if message is None:
                continue
            mark = mark_of(message)
            if self.repair is not None:
                mark = replace(mark, t_ns=self.repair.log_t_ns(mark.t_ns))
            if self._range.holds(mark.t_ns):
                self.facts.mark_count += 1
                self.facts.marks += [mark] if len(self.facts.marks) < MAX_MARKS else []

    def _samples(self, content: ChunkContent, kind: NDArray[np.uint8]) -> Iterator[Item]:
        if not self._sampled:
            return
        from syncline_schemas.proto import syncline_pb2

        for row in np.flatnonzero((kind == Kind.STATUS) | (kind == Kind.CLOCK)).tolist():
            t_ns = content.publish_time_ns(row)
            if not self._range.holds(t_ns):
                continue
            if kind[row] == Kind.CLOCK:
                clock = self._parsed(syncline_pb2.ClockSample, content, row)
                if clock is not None:
                    yield ClockReading(t_ns, clock)
            else:
                status = self._parsed(syncline_pb2.BusStatus, content, row)
                if status is not None:
                    yield BusStatusSample(
                        t_ns, int(self._channels.bus[content.channel[row]]), status
                    )

    def _parsed(self, kind: type[_M], content: ChunkContent, row: int) -> _M | None:
        from google.protobuf.message import DecodeError

        try:
            return kind.FromString(content.payload(row))
        except DecodeError:
            self.facts.damage.append(f"a message of {kind.DESCRIPTOR.full_name} is unreadable")
            return None


@dataclass(frozen=True, slots=True)
class _TimeRange:
    """The half-open stretch that was asked for; None = no bound."""

    start_ns: int | None
    end_ns: int | None

    def holds(self, t_ns: int) -> bool:
        after_start = self.start_ns is None or t_ns >= self.start_ns
        return after_start and (self.end_ns is None or t_ns < self.end_ns)

    def of(self, frames: FrameBatch) -> FrameBatch:
        if self.start_ns is None and self.end_ns is None:
            return frames
        wanted = np.ones(len(frames), np.bool_)
        if self.start_ns is not None:
            wanted &= frames.t_ns >= self.start_ns
        if self.end_ns is not None:
            wanted &= frames.t_ns < self.end_ns
        return frames[wanted]

    def overlaps(self, start_ns: int, end_ns: int) -> bool:
        begins_before_end = self.end_ns is None or start_ns < self.end_ns
        return begins_before_end and (self.start_ns is None or end_ns > self.start_ns)

    def wanted(self, gap: Gap | None) -> Iterator[Gap]:
        """The gap, if any, as far as it lies in the stretch."""
        if gap is not None and self.overlaps(gap.start_ns, gap.end_ns):
            start_ns = gap.start_ns if self.start_ns is None else max(gap.start_ns, self.start_ns)
            end_ns = gap.end_ns if self.end_ns is None else min(gap.end_ns, self.end_ns)
            yield replace(gap, start_ns=start_ns, end_ns=end_ns)

    def may_hold(self, place: ChunkPlace, lag: LagBounds) -> bool:
        """Whether a chunk can hold wanted frames."""
        return self.overlaps(place.start_ns - lag.max_ns, place.end_ns - lag.min_ns + 1)


class _Pending:
    """Frames of small chunks on their way into a batch of usual size."""

    def __init__(self) -> None:
        self._batches: list[FrameBatch] = []
        self._count = 0
        # Who looks only where a file begins shall not wait for more.
        self._enough = 1
        self._samples: list[Item] = []

    def add(self, item: Item) -> Iterator[Item]:
        if isinstance(item, FrameBatch):
            self._batches += [item] if len(item) else []
            self._count += len(item)
            if self._count >= self._enough:
                self._enough = FRAMES_PER_BATCH
                yield from self.flush()
        elif isinstance(item, Gap):
            yield from self.flush()
            yield item
        else:
            self._samples.append(item)

    def flush(self) -> Iterator[Item]:
        if self._batches:
            yield FrameBatch.concat(self._batches)
        yield from self._samples
        self._batches, self._samples, self._count = [], [], 0


@contextmanager
def _opened(path: Path, damage: list[str]) -> Iterator[RecordFile]:
    try:
        file = path.open("rb")
    except OSError as error:
        raise CaptureError(f"{path} cannot be opened: {error.strerror}") from error
    with file:
        records = RecordFile(file)
        yield records
        damage += records.damage
