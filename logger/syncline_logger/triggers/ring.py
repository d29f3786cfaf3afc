"""The last minutes of a recording in memory, compressed."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_logger.capture_file import Block
from syncline_logger.clocks_in_force import ClocksInForce, Knots, knots_of
from syncline_logger.content import Content
from syncline_logger.decoding import UNREGISTERED, ChannelSpec
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.chunk import compress, decompress
from syncline_schemas.capture.layout import CLOCK_TOPIC, GAP_TOPIC, MARK_TOPIC
from syncline_schemas.capture.message import MessageBlock

Array = NDArray[Any]
_OWN_TOPICS = (CLOCK_TOPIC, GAP_TOPIC, MARK_TOPIC)


@dataclass(frozen=True, slots=True)
class _Packed:
    """Arrays back to back, compressed; `shapes` tells them apart."""

    data: bytes
    size: int
    shapes: list[tuple[np.dtype[Any], tuple[int, ...]]]

    @classmethod
    def of(cls, arrays: Sequence[Array]) -> "_Packed":
        plain = b"".join(np.ascontiguousarray(each).tobytes() for each in arrays)
        shapes = [(each.dtype, each.shape) for each in arrays]
        return cls(compress(plain, "zstd"), len(plain), shapes)

    def arrays(self) -> list[Array]:
        plain = decompress(self.data, "zstd", self.size)
        assert isinstance(plain, bytes)
        found, begin = [], 0
        for dtype, shape in self.shapes:
            size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
            found.append(np.frombuffer(plain[begin : begin + size], dtype).reshape(shape))
            begin += size
        return found


@dataclass(slots=True)
class _Entry:
    """One content; what is decoded stands apart, as it can be decoded again."""

    first_ns: int
    last_ns: int
    frames: _Packed
    specs: list[ChannelSpec]
    decoded: tuple[list[ChannelSpec], _Packed] | None
    knots: Knots
    thinned: bool = False
    """Whether the decoded channels went for want of room."""

    @property
    def bytes(self) -> int:
        return len(self.frames.data) + (len(self.decoded[1].data) if self.decoded else 0)


class Ring:
    """Contents of the last `before_ns` of log time, in `max_bytes` of memory at most.

    Where the memory is too small, decoded channels go first, those of the oldest contents before
    others, then the oldest contents.

    Args:
        clocks: is fed with the clock samples of what the ring forgets.

    Attributes:
        bytes: held now.
        short: whether contents went for want of room that are not older than `before_ns`.
    """

    def __init__(self, before_ns: int, max_bytes: int, clocks: ClocksInForce | None = None) -> None:
        self._clocks = clocks or ClocksInForce()
        self._before_ns = before_ns
        self._max_bytes = max_bytes
        self._entries: deque[_Entry] = deque()
        self._whole = 0
        """Entries at the head that have no decoded channels."""
        self.bytes = 0
        self.short = False

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def thinned(self) -> int:
        """Contents that lost their decoded channels for want of room."""
        return sum(entry.thinned for entry in self._entries)

    @property
    def first_ns(self) -> int | None:
        """Log time of the oldest message."""
        return self._entries[0].first_ns if self._entries else None

    def add(self, content: Content, now_ns: int) -> None:
        """Take in what was recorded until `now_ns`, and forget what is too old."""
        if content:
            entry = _packed(content)
            self._entries.append(entry)
            self.bytes += entry.bytes
        while self._entries and self._entries[0].last_ns < now_ns - self._before_ns:
            self._drop()
            self.short = False
        self._bound()

    def hold(self, content: Content) -> list[Content]:
        """Take in a content behind the others; the oldest that went for want of room."""
        entry = _packed(content)
        self._entries.append(entry)
        self.bytes += entry.bytes
        return [_content(gone) for gone in self._bound()]

    def pop(self) -> Content:
        """The oldest content; it is no longer in the ring."""
        entry = self._entries[0]
        self._take_first()
        return _content(entry)

    def _bound(self) -> list[_Entry]:
        """Make what is held small enough; the contents that went."""
        while self.bytes > self._max_bytes and self._whole < len(self._entries):
            entry = self._entries[self._whole]
            before = entry.bytes
            entry.thinned = entry.decoded is not None
            entry.decoded = None
            self.bytes -= before - entry.bytes
            self._whole += 1
        gone = []
        while self.bytes > self._max_bytes and len(self._entries) > 1:
            gone.append(self._entries[0])
            self._drop()
            self.short = True
        return gone

    def _drop(self) -> None:
        """Forget the oldest content, but for the clocks that go on."""
        self._clocks.note(self._entries[0].knots)
        self._take_first()

    def _take_first(self) -> None:
        self.bytes -= self._entries.popleft().bytes
        self._whole = max(0, self._whole - 1)


def _packed(content: Content) -> _Entry:
    own: list[Block] = []
    derived: list[Block] = []
    for spec, block in content.blocks:
        kept = spec.topic in _OWN_TOPICS or spec.topic.endswith("/status")
        (own if kept else derived).append((spec, block))
    frames = content.frames
    arrays: list[Array] = [
        np.diff(frames.t_ns, prepend=0),
        np.diff(content.log_ns, prepend=0),
        frames.bus,
        frames.can_id,
        frames.flags,
        frames.dlc,
        np.ascontiguousarray(frames.data.T),
    ]
    arrays += [each for _, block in own for each in _columns(block)]
    packed = _Packed.of([each for _, block in derived for each in _columns(block)])
    return _Entry(
        content.first_ns,
        content.last_ns,
        _Packed.of(arrays),
        [spec for spec, _ in own],
        ([spec for spec, _ in derived], packed) if derived else None,
        knots_of(content),
    )


def _content(entry: _Entry) -> Content:
    arrays = entry.frames.arrays()
    t_ns, log_ns = np.cumsum(arrays[0]), np.cumsum(arrays[1])
    bus, can_id, flags, dlc, data = arrays[2:7]
    frames = FrameBatch(t_ns, bus, can_id, flags, dlc, np.ascontiguousarray(data.T))
    blocks = _blocks(entry.specs, arrays[7:])
    if entry.decoded:
        blocks += _blocks(entry.decoded[0], entry.decoded[1].arrays())
    return Content(frames, log_ns, blocks)


def _columns(block: MessageBlock) -> list[Array]:
    return [
        np.diff(block.log_time_ns, prepend=0),
        np.diff(block.publish_time_ns, prepend=0),
        block.length,
        block.payload,
    ]


def _blocks(
    specs: Sequence[ChannelSpec], arrays: Sequence[Array]
) -> list[tuple[ChannelSpec, MessageBlock]]:
    found = []
    for n, spec in enumerate(specs):
        log_ns, publish_ns, length, payload = arrays[4 * n : 4 * n + 4]
        block = MessageBlock(
            UNREGISTERED, np.cumsum(log_ns), np.cumsum(publish_ns), length, payload
        )
        found.append((spec, block))
    return found
