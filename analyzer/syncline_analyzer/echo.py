"""Frames that a recorder wrote down twice, recognised before the analyses count them twice."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distinct import distinct
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.grouping import BUS_SHIFT, REMOTE_KEY, Grouping, key_of
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.records import dataclass

COPY = np.uint16(1 << 15)
"""Bit of the `flags` column, within the analyses only: the frame stands in the capture twice."""
LONGEST_NS = 1_000_000
"""A copy comes within this time of its frame [ns]."""
BLOCK = 1 << 16
"""Frames that are judged together: batches of any multiple of it tell the same."""
MIN_PAIRS = 5
"""So many frames of an identifier stand twice before it is taken for doubled."""
_PAIRED = 0.95
"""Share of an identifier's frames that stand twice, from the first to the last that does."""
_WHOLE = 0.9
"""The same of all frames of a bus that was recorded twice."""
_APART = 4
"""Frames come at least so many times further apart than a copy from its frame."""
_COPIES = 2
"""No frame is written down more often beside itself; more equal frames are a fast producer's."""
_SHORTEST_BITS = 44
"""An empty frame without stuff bits and intermission, the shortest there is [bit]."""
_BIT_NS = 1000
"""A bit at 1 Mbit/s, the fastest a bus can be [ns]."""
_BUNDLED = 0.2
"""With this share of frames closer than the wire allows, the stamps are those of bundles."""
_MIN_FRAMES = 200
"""With fewer frames of its bus a batch is judged as the one before."""
_FINE_NS = 10_000
"""Stamps of coarser steps do not tell whether the wire could carry both frames [ns]."""
_EVIDENCE = 20
_SDO_REQUEST = range(0x601, 0x680)

Ints = NDArray[np.int64]


@dataclass(slots=True)
class Doubling:
    """What was doubled on a bus so far: keys by the rule that tells it, counts and delays."""

    whole: bool = False
    own: bool = False
    keys: set[int] = field(default_factory=set)
    limit_ns: int = 0
    copies: int = 0
    start_ns: int = 0
    end_ns: int = 0
    delay_ns: int = 0
    told: set[int] = field(default_factory=set)
    evidence: list[int] = field(default_factory=list)

    def takes(self, key: int) -> bool:
        """Whether equal frames of an identifier that was too rare to judge are copies."""
        return self.whole or (self.own and _is_own(key)) or key in self.keys


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """The frames of one identifier in order: rows, stamps, and which equal the one before."""

    key: int
    rows: NDArray[np.intp]
    t_ns: Ints
    equal: NDArray[np.bool_]
    dlc: int

    def copies(self, limit_ns: float) -> NDArray[np.bool_]:
        """(n,) which frames repeat the one before within a time."""
        near = self.equal.copy()
        near[1:] &= np.diff(self.t_ns) <= limit_ns
        return near

    @property
    def limit_ns(self) -> float:
        """How far behind its frame a copy may come, by how far apart the frames are."""
        if len(self.t_ns) < 4:
            return 0.0
        return min(float(LONGEST_NS), float(np.median(self.t_ns[2:] - self.t_ns[:-2])) / _APART)


class Echoes:
    """Marks the copies in a stream; `doubled` tells by bus number what was found, once it is read.

    Args:
        resolution_ns: step of the stamps, as far as it is known when a batch has been read.
    """

    def __init__(self, resolution_ns: Callable[[], int] = lambda: 1) -> None:
        self._resolution_ns = resolution_ns
        self.doubled: dict[int, Doubling] = {}
        self._last: FrameBatch = FrameBatch.empty()

    def marked(self, stream: Iterable[IndexedBatch | Gap]) -> Iterator[IndexedBatch | Gap]:
        """The stream with `COPY` set on every frame that is a copy; `seq` stays as it is."""
        for item in stream:
            yield item if isinstance(item, Gap) else self._mark(item)

    def _mark(self, batch: IndexedBatch) -> IndexedBatch:
        if not self._suspects(batch):
            self._last = _last_of_each(self._last, batch)
            return batch
        parts = (batch.part(slice(at, at + BLOCK)) for at in range(0, len(batch), BLOCK))
        copy = np.concatenate([self._found(part) for part in parts])
        if not copy.any():
            return batch
        flags = batch.frames.flags
        return batch.showing(replace(batch.frames, flags=np.where(copy, flags | COPY, flags)))

    def _suspects(self, batch: IndexedBatch) -> bool:
        """Whether enough frames of a batch repeat the one before them."""
        number = len(_repeats(batch.grouping, batch.frames)) + _carried(self._last, batch)
        return number >= (1 if self.doubled else MIN_PAIRS)

    def _found(self, block: IndexedBatch) -> NDArray[np.bool_]:
        """(n,) which frames of a block are copies."""
        before, suspects = self._last, self._suspects(block)
        self._last = _last_of_each(before, block)
        if not suspects:
            return np.zeros(len(block), np.bool_)
        frames = FrameBatch.concat([before, block.frames]) if len(before) else block.frames
        return self._copies(frames, block.seq0 - len(before))[len(before) :]

    def _copies(self, frames: FrameBatch, seq0: int) -> NDArray[np.bool_]:
        """(n,) which frames are copies."""
        grouping = Grouping.of(frames)
        rows, key = grouping.rows, grouping.key
        equal = np.zeros(len(rows), np.bool_)
        equal[_repeats(grouping, frames)] = True
        copy = np.zeros(len(frames), np.bool_)
        for number in distinct(key[equal] >> np.uint32(BUS_SHIFT)):
            first, stop = np.searchsorted(key, [number << BUS_SHIFT, (number + 1) << BUS_SHIFT])
            groups = _groups(frames, rows[first:stop], key[first:stop], equal[first:stop])
            state = self.doubled.get(number, Doubling())
            _judge(state, frames, groups, self._resolution_ns())
            found = _copies(state, groups)
            if found:
                self.doubled[number] = state
                _count(state, frames, found, seq0)
                for _, chosen in found:
                    copy[chosen] = True
        return copy


def hidden(batch: FrameBatch) -> FrameBatch:
    """The batch as the analyses see it: a copy is an empty 29-bit frame, which is no service."""
    if not batch.flags_seen & int(COPY):
        return batch
    copy = (batch.flags & COPY) != 0
    return replace(
        batch,
        flags=np.where(copy, COPY | np.uint16(FrameFlag.EXTENDED), batch.flags),
        dlc=np.where(copy, np.uint8(0), batch.dlc),
        data=np.where(copy[:, np.newaxis], np.uint8(0), batch.data),
    )


def _last_of_each(before: FrameBatch, batch: IndexedBatch) -> FrameBatch:
    """The last frame of every identifier after a batch, in order."""
    grouping = batch.grouping
    last = batch.frames[np.sort(grouping.last)]
    if not len(before) or not len(last):
        return last if len(last) else before
    gone = np.flatnonzero(_groups_of(before, grouping) < 0)
    return FrameBatch.concat([before[gone], last]) if len(gone) else last


def _groups_of(frames: FrameBatch, grouping: Grouping) -> NDArray[np.intp]:
    """(n,) number of the group that each frame belongs to; -1 where there is none."""
    keys, key = grouping.keys, key_of(frames)
    group = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
    return np.where(keys[group] == key, group, -1)


def _repeats(grouping: Grouping, frames: FrameBatch) -> NDArray[np.intp]:
    """Places in a grouping whose frame repeats the one before of its identifier at once."""
    rows, near = grouping.rows, grouping.soon(LONGEST_NS)
    return near[_alike(frames[rows[near - 1]], frames[rows[near]])] if len(near) else near


def _carried(before: FrameBatch, batch: IndexedBatch) -> int:
    """How many identifiers begin the batch with their last frame before it once more."""
    grouping, frames = batch.grouping, batch.frames
    if not len(before) or not len(grouping.keys):
        return 0
    group = _groups_of(before, grouping)
    last = np.flatnonzero(group >= 0)
    first = grouping.first[group[last]]
    # A negative distance is a large unsigned one.
    near = (frames.t_ns[first] - before.t_ns[last]).view(np.uint64) <= LONGEST_NS
    if not near.any():
        return 0
    return int(np.count_nonzero(_alike(before[last[near]], frames[first[near]])))


def _alike(one: FrameBatch, other: FrameBatch) -> NDArray[np.bool_]:
    """(n,) which frames have the same content."""
    width = min(one.data.shape[1], other.data.shape[1])
    same: NDArray[np.bool_] = (one.data[:, :width] == other.data[:, :width]).all(axis=1)
    same &= one.dlc == other.dlc
    return same


def _groups(
    frames: FrameBatch,
    rows: NDArray[np.intp],
    key: NDArray[np.unsignedinteger],
    equal: NDArray[np.bool_],
) -> list[_Group]:
    cuts = np.flatnonzero(np.diff(key)) + 1
    edges = [0, *cuts.tolist(), len(key)]
    return [
        _Group(
            int(key[a]) & 0xFFF,
            rows[a:b],
            frames.t_ns[rows[a:b]],
            equal[a:b],
            int(frames.dlc[rows[a:b]].min()),
        )
        for a, b in pairwise(edges)
        if b > a
    ]


def _judge(state: Doubling, frames: FrameBatch, groups: list[_Group], resolution_ns: int) -> None:
    """What of a bus is doubled in this batch."""
    frequent = [group for group in groups if len(group.rows) >= 2 * MIN_PAIRS]
    if state.copies and sum(len(group.rows) for group in groups) < _MIN_FRAMES:
        return
    state.whole, state.own, state.keys = False, False, set()
    doubled = [group for group in frequent if _is_doubled(group)]
    if not doubled or _bundled(frames, groups, doubled):
        return
    delays = np.concatenate([_delays(group) for group in doubled])
    state.limit_ns = min(LONGEST_NS, 20_000 + int(1.5 * np.quantile(delays, 0.99)))
    keys = {group.key for group in doubled}
    own = {group.key for group in frequent if _is_own(group.key)}
    state.whole = (
        len(keys) >= 3
        and len({key & 0x7F for key in keys}) >= 2
        and sum(len(g.rows) for g in doubled) >= _WHOLE * sum(len(g.rows) for g in frequent)
        and len(keys) >= _WHOLE * len(frequent)
    )
    if resolution_ns > _FINE_NS:
        return
    state.own = not state.whole and len(own) >= 2 and own <= keys
    state.keys = {
        group.key
        for group in doubled
        if group.key in _SDO_REQUEST or _too_close(group, _delays(group))
    }


def _is_doubled(group: _Group) -> bool:
    """Whether an identifier's frames stand in pairs, from the first pair to the last."""
    copy = group.copies(group.limit_ns)
    at = np.flatnonzero(copy)
    if len(at) < MIN_PAIRS:
        return False
    paired = copy.copy()
    paired[at - 1] = True
    span = paired[at[0] - 1 : at[-1] + 1]
    runs = np.diff(np.flatnonzero(~copy), append=len(copy))
    return bool(span.mean() >= _PAIRED) and int(runs.max()) <= _COPIES + 1


def _delays(group: _Group) -> Ints:
    at = np.flatnonzero(group.copies(group.limit_ns))
    return group.t_ns[at] - group.t_ns[at - 1]


def _too_close(group: _Group, delays: Ints) -> bool:
    """Whether no wire can carry the second frame so soon after the first."""
    shortest_ns = (_SHORTEST_BITS + 8 * group.dlc * (group.key < REMOTE_KEY)) * _BIT_NS
    return float(np.quantile(delays, 0.95)) < shortest_ns


def _bundled(frames: FrameBatch, groups: list[_Group], doubled: list[_Group]) -> bool:
    """Whether the stamps of different frames are closer than the wire allows, so tell nothing."""
    keys = {group.key for group in doubled}
    alone = [
        group.rows[~group.copies(group.limit_ns)] if group.key in keys else group.rows
        for group in groups
    ]
    originals = np.sort(np.concatenate(alone))
    apart = np.diff(frames.t_ns[originals])
    close = (apart >= 0) & (apart < _SHORTEST_BITS * _BIT_NS)
    return bool(len(apart)) and float(close.mean()) > _BUNDLED


def _is_own(key: int) -> bool:
    """Whether only a master sends it: NMT, SYNC, TIME, SDO requests and remote frames."""
    return key >= REMOTE_KEY or key in (0x000, 0x080, 0x100) or key in _SDO_REQUEST


def _copies(state: Doubling, groups: list[_Group]) -> list[tuple[_Group, NDArray[np.intp]]]:
    """(identifier, rows of its copies) of those that are doubled."""
    found = []
    for group in groups:
        if state.takes(group.key) and group.equal.any():
            chosen = group.rows[group.copies(state.limit_ns)]
            if len(chosen):
                found.append((group, chosen))
    return found


def _count(
    state: Doubling, frames: FrameBatch, found: list[tuple[_Group, NDArray[np.intp]]], seq0: int
) -> None:
    rows = np.sort(np.concatenate([chosen for _, chosen in found]))
    if not state.copies:
        state.start_ns = int(frames.t_ns[rows[0]])
        delays = [group.t_ns[1:] - group.t_ns[:-1] for group, _ in found]
        near = [each[group.equal[1:]] for each, (group, _) in zip(delays, found, strict=True)]
        state.delay_ns = int(np.median(np.concatenate(near)))
        state.evidence.extend((rows[:_EVIDENCE] + seq0).tolist())
    state.copies += len(rows)
    state.end_ns = int(frames.t_ns[rows[-1]])
    state.told.update(group.key for group, _ in found)
