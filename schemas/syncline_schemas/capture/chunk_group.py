"""Chunks that follow each other, read as one: recorders write a small one every second."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_schemas import native
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.channels import ChannelTable, Kind
from syncline_schemas.capture.chunk import is_plausible
from syncline_schemas.capture.chunk_content import ChunkContent, open_joined, unpacked
from syncline_schemas.capture.frame_record import FRAME_HEAD, gather_frames
from syncline_schemas.capture.limit import Unread
from syncline_schemas.capture.record_file import Definition, Document, Lost, RawChunk, Record
from syncline_schemas.records import dataclass

GROUP_BYTES = 4 << 20
"""Unpacked chunks are joined until they have as many bytes: about 80,000 frames."""
_LEAST_BYTES = 1 << 10
"""A chunk counts for so many at least: nothing limits how many small ones there are."""

Other = Lost | Definition | Document | Unread


@dataclass(frozen=True, slots=True, eq=False)
class PlainGroup:
    """Chunks in which nothing needs a second look: all whole, every frame as we write it, no gaps.

    Attributes:
        frames: of all chunks, in file order.
        log_time_ns: (frames,) their log times.
        others: messages of bus states, clocks and marks, and perhaps more; with the `Kind` of each.
        first_ns: log time of the first message.
        last_ns: the latest log time at the end of a chunk.
        chunks: how many they are.
    """

    frames: FrameBatch
    log_time_ns: NDArray[np.int64]
    others: list[tuple[ChunkContent, NDArray[np.uint8]]]
    first_ns: int
    last_ns: int
    chunks: int


@dataclass(frozen=True, slots=True, eq=False)
class OpenedGroup:
    """Chunks and, where they are plain by the channels known then, their content.

    `version` is that of the channel table: with another one `plain` may be wrong.
    """

    raws: Sequence[RawChunk]
    version: int
    plain: PlainGroup | None


def grouped(records: Iterable[Record | Unread]) -> Iterator[list[RawChunk] | Other]:
    """Chunks that follow each other in groups, the first by itself; all else as it comes."""
    group: list[RawChunk] = []
    size, enough = 0, 0
    for record in records:
        if not isinstance(record, RawChunk):
            if group:
                yield group
                group, size = [], 0
            yield record
            continue
        group.append(record)
        size += max(record.uncompressed_size, _LEAST_BYTES)
        if size >= enough:
            yield group
            group, size, enough = [], 0, GROUP_BYTES
    if group:
        yield group


def open_group(group: list[RawChunk] | Other, channels: ChannelTable) -> list[OpenedGroup] | Other:
    """Unpack a group and read its frames; it may be called in any thread."""
    if not isinstance(group, list):
        return group
    # The table may grow meanwhile: whoever takes the group compares the versions.
    version = channels.version
    if not native.available():
        return [OpenedGroup(group, version, _plain_by_index(group, channels))]
    return [OpenedGroup(raws, version, plain) for raws, plain in _by_walk(group, channels)]


def _by_walk(
    group: list[RawChunk], channels: ChannelTable
) -> Iterator[tuple[list[RawChunk], PlainGroup | None]]:
    """Chunks that are plain, whatever the message indexes say, as one; others by themselves."""
    claimed = ((raw.uncompressed_size, len(raw.data)) for raw in group)
    size = sum(size for size, packed in claimed if is_plausible(size, packed))
    columns = native.ChunkFrames(size // FRAME_HEAD, channels.kind, channels.bus)
    run = _Run(columns, channels)
    for raw in group:
        if not run.add(raw):
            if run.raws:
                yield run.raws, run.plain()
            yield [raw], None
            run = _Run(columns, channels)
    if run.raws:
        yield run.raws, run.plain()


class _Run:
    """Plain chunks that follow each other; their frames stand behind those that `columns` hold."""

    def __init__(self, columns: native.ChunkFrames, channels: ChannelTable) -> None:
        self.raws: list[RawChunk] = []
        self._columns = columns
        self._channels = channels
        self._begin = columns.count
        self._others: list[tuple[ChunkContent, NDArray[np.uint8]]] = []
        self._firsts_ns: list[int] = []
        self._lasts_ns: list[int] = []

    def add(self, raw: RawChunk) -> bool:
        """Unpack a chunk and walk through it while it is in the cache; False if it is not plain."""
        plain = unpacked(raw)
        if not isinstance(plain, bytes) or (found := self._columns.add(plain)) is None:
            return False
        self.raws.append(raw)
        if len(found.others):
            offset, end, channel, log_time_ns = found.others.T
            buffer, ids = np.frombuffer(plain, np.uint8), channel.astype(np.uint16)
            content = ChunkContent(buffer, len(plain), offset, end, ids, log_time_ns)
            self._others.append((content, self._channels.kind.take(ids)))
        self._firsts_ns.append(found.first_ns)
        self._lasts_ns.append(found.last_ns)
        return True

    def plain(self) -> PlainGroup:
        """What they hold."""
        of, kept = self._columns, slice(self._begin, self._columns.count)
        frames = FrameBatch(of.t_ns, of.bus, of.can_id, of.flags, of.dlc, of.data)
        return PlainGroup(
            frames[kept],
            of.log_time_ns[kept],
            self._others,
            self._firsts_ns[0],
            max(self._lasts_ns),
            len(self.raws),
        )


def _plain_by_index(group: list[RawChunk], channels: ChannelTable) -> PlainGroup | None:
    """By the message indexes, where each names all that is in its chunk."""
    joined = open_joined(group)
    if joined is None:
        return None
    content = joined.content
    kind = channels.kind.take(content.channel)
    if np.any(kind == Kind.UNKNOWN) or np.any(kind == Kind.GAP):
        return None
    rows = np.flatnonzero(kind == Kind.FRAME)
    heads, offset = joined.heads, content.offset
    if len(rows) < len(kind):
        heads, offset = heads.rows(rows), offset[rows]
    bus = channels.bus.take(heads.u2(9)).astype(np.uint8)
    gathered = gather_frames(content.buffer, offset, heads, bus)
    if not gathered.regular.all():
        return None
    ends = np.append(joined.first_row[1:], len(kind)) - 1
    return PlainGroup(
        gathered.frames,
        content.log_time_ns[rows],
        [(content, kind)],
        int(content.log_time_ns[0]),
        int(content.log_time_ns[ends].max()),
        len(group),
    )
