"""The 11-bit frames of a batch put in order by bus and identifier: one sort for all analyses."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas import native
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.records import dataclass

REMOTE_KEY = 1 << 11
"""Bit of a key: remote frames."""
BUS_SHIFT = 12
_OTHER = FrameFlag.EXTENDED | FrameFlag.ERROR


def key_of(frames: FrameBatch) -> NDArray[np.uint32]:
    """(n,) bus << 12 | remote << 11 | identifier of 11-bit frames."""
    key = frames.can_id
    if frames.bus.any():
        key = key | (frames.bus.astype(np.uint32) << np.uint32(BUS_SHIFT))
    remote = (frames.flags & FrameFlag.REMOTE) != 0
    return key | np.where(remote, np.uint32(REMOTE_KEY), np.uint32(0)) if remote.any() else key


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Rows of a batch by key, in arrival order within each.

    Attributes:
        rows: (m,) intp, rows of the batch.
        t_ns: (m,) their stamps.
        keys: (g,) `key_of` each group, ascending.
        edges: (g + 1,) where in `rows` the groups begin, and the end of the last.
        shortest, longest: (g,) uint8, least and largest `dlc` of each group.
    """

    rows: NDArray[np.intp]
    t_ns: NDArray[np.int64]
    keys: NDArray[np.unsignedinteger]
    edges: NDArray[np.intp]
    shortest: NDArray[np.uint8]
    longest: NDArray[np.uint8]

    @classmethod
    def of(cls, frames: FrameBatch, but: int = 0) -> "Grouping":
        """The 11-bit frames that are no errors, and have none of some further flags."""
        counted = _counted(frames, _OTHER | but) if native.available() else None
        return cls._by_sorting(frames, but) if counted is None else cls(*counted)

    @classmethod
    def _by_sorting(cls, frames: FrameBatch, but: int) -> "Grouping":
        unwanted = np.uint16(_OTHER | but)
        if not frames.flags_seen & int(unwanted):
            rows, key = _stable_order(key_of(frames))
        else:
            wanted = np.flatnonzero((frames.flags & unwanted) == 0)
            order, key = _stable_order(key_of(frames[wanted]))
            rows = wanted[order]
        begins = np.flatnonzero(
            np.concatenate((np.ones(min(len(key), 1), np.bool_), key[1:] != key[:-1]))
        )
        edges, dlc = np.append(begins, len(key)), frames.dlc.take(rows)
        shortest, longest = dlc[:0], dlc[:0]
        if len(begins):
            shortest, longest = np.minimum.reduceat(dlc, begins), np.maximum.reduceat(dlc, begins)
        return cls(rows, frames.t_ns.take(rows), key[begins], edges, shortest, longest)

    @property
    def key(self) -> NDArray[np.unsignedinteger]:
        """(m,) `key_of` each row."""
        return np.repeat(self.keys, np.diff(self.edges))

    @property
    def first(self) -> NDArray[np.intp]:
        """(g,) first row of each group."""
        return self.rows[self.edges[:-1]]

    @property
    def last(self) -> NDArray[np.intp]:
        """(g,) last row of each group."""
        return self.rows[self.edges[1:] - 1] if len(self.rows) else self.rows

    def soon(self, limit_ns: int) -> NDArray[np.intp]:
        """Places in `rows` whose frame comes at most so much after the one before of its key."""
        if native.available():
            return native.soon(self.t_ns, self.edges, limit_ns)
        # A negative distance is a large unsigned one.
        near = (self.t_ns[1:] - self.t_ns[:-1]).view(np.uint64) <= limit_ns
        near[self.edges[1:-1] - 1] = False
        found: NDArray[np.intp] = np.flatnonzero(near) + 1
        return found


def _counted(frames: FrameBatch, unwanted: int) -> native.Grouped | None:
    """The `Grouping` of frames without some flags, where their keys are few enough to be counted."""
    keys = _keys(frames)
    if keys is None:
        return None
    columns = frames.can_id, frames.bus, frames.flags, frames.dlc, frames.t_ns
    return native.grouping(*columns, unwanted, keys)


def _keys(frames: FrameBatch) -> int | None:
    """How many keys there can be; None if too many."""
    buses = int(frames.bus.max(initial=0)) + 1
    return buses << BUS_SHIFT if buses << BUS_SHIFT <= native.MOST_KEYS else None


def _stable_order(
    key: NDArray[np.uint32],
) -> tuple[NDArray[np.intp], NDArray[np.unsignedinteger]]:
    """Rows in the order of their keys, and the keys in that order.

    Key and row in one integer make any sort a stable one; numpy sorts integers about three times
    as fast as it finds their order.
    """
    bits = len(key).bit_length()
    if int(key.max(initial=0)) >> (32 - bits) == 0:
        packed = key << np.uint32(bits)
        packed |= np.arange(len(key), dtype=np.uint32)
        packed.sort()
        return (packed & np.uint32((1 << bits) - 1)).astype(np.intp), packed >> np.uint32(bits)
    wide = key.astype(np.uint64) << np.uint64(32)
    wide |= np.arange(len(key), dtype=np.uint64)
    wide.sort()
    return (wide & np.uint64(0xFFFFFFFF)).astype(np.intp), (wide >> np.uint64(32)).astype(np.uint32)
