"""When a frame can have been ready at the earliest, by the arbitration of the frames before it.

A controller that has a frame to send starts it as soon as the bus is free, and the lowest
identifier wins (ISO 11898-1). So a frame was not ready yet when the bus was idle, nor when another
node started one of lower priority; and it was ready at its own start at the latest.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.records import dataclass
from syncline_schemas.wire_length import INTERMISSION_BITS

MASTER = 0
"""Sender of what only a master sends, where nothing names its node."""
UNKNOWN = -1
"""Sender of a frame that no service tells: it may be any node, so it proves nothing."""
_SHORTEST_BITS = 44
"""Shortest frame without stuff bits and intermission: beyond that, stamps tell no order."""
_IDLE_BITS = 2.0
"""The bus is idle when nobody starts within so many bits after the intermission."""
_JOIN_BITS = 1.0
"""A frame that becomes ready so late may miss the arbitration that is just beginning."""
_CLOSE_BITS = 200
"""Frames closer than this, their own length aside, show how exact the stamps are."""
_OUTLIERS = 0.02
"""So many of the spacings may be off more than the noise of the stamps: those prove nothing."""
ENOUGH_CLOSE = 50
"""Frames close behind others from which it is known how exact the stamps are."""
_NOISE_NS = (0, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000)
"""What stamps may be off, in steps."""

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def rank(frames: FrameBatch) -> NDArray[np.uint32]:
    """Place of each frame in the arbitration: the lower wins.

    The bits in the order in which they are sent (ISO 11898-1): 11-bit identifier, RTR or SRR, IDE,
    and of 29-bit identifiers the other 18 bits and RTR.

    Returns: (n,) uint32.
    """
    kinds = int(np.bitwise_or.reduce(frames.flags, initial=0))
    can_id = frames.can_id
    if not kinds & (FrameFlag.EXTENDED | FrameFlag.REMOTE):
        return can_id << np.uint32(21)
    extended = (frames.flags & FrameFlag.EXTENDED) != 0
    remote = ((frames.flags & FrameFlag.REMOTE) != 0).astype(np.uint32)
    short = can_id << 21 | remote << 20
    long = (can_id >> 18) << 21 | 3 << 19 | (can_id & 0x3FFFF) << 1 | remote
    place: NDArray[np.uint32] = np.where(extended, long, short)
    return place


@dataclass(frozen=True, slots=True, eq=False)
class Ready:
    """When frames can have been ready.

    Attributes:
        least_ns: (r,) earliest moment, after the end of the SYNC; 0 where nothing tells it.
        waiting_ns: (r,) at most so long until the frame started.
        first: (r,) row of the first frame that it may have waited for, its own where it waited for
            none.
        free: (r,) whether the bus was idle until it started, so that `least_ns` is exact.
        known: (r,) False where the stamps stepped back between the SYNC and the frame.
    """

    least_ns: Floats
    waiting_ns: Floats
    first: Ints
    free: Bools
    known: Bools

    def put(self, column: Callable[[NDArray[Any]], NDArray[Any]]) -> "Ready":
        """The same, in another order or a part of it: what `column` makes of each column."""
        columns = self.least_ns, self.waiting_ns, self.first, self.free, self.known
        return Ready(*(column(each) for each in columns))

    def within(self, least_ns: Floats, most_ns: Floats) -> "Ready":
        """The same within other bounds of the moment."""
        least = np.minimum(np.maximum(self.least_ns, least_ns), most_ns)
        waiting = np.minimum(self.waiting_ns, np.maximum(most_ns - least, 0.0))
        return Ready(least, waiting, self.first, self.free, self.known)


def order_is_told(slack_ns: float, bit_ns: float) -> bool:
    """Whether stamps that are off so far tell what was on the bus one after the other."""
    return slack_ns <= _SHORTEST_BITS * bit_ns


class Arbitration:
    """The frames of one bus in order of arrival.

    Attributes:
        end_ns: (n,) end of each frame, after the first stamp.

    Args:
        t_ns: (n,) stamps at the ends of the frames.
        wire_ns: (n,) time on the wire with intermission; NaN where it is not known (error frames).
        rank: (n,) place in the arbitration.
        sender: (n,) node that sends each frame, `MASTER` or `UNKNOWN`.
        bit_ns: length of a bit at the (nominal) bit rate.
        resolution_ns: step of the stamps.
        noise_ns: what the stamps are off beyond their step, see `noise_of`.
    """

    def __init__(
        self,
        t_ns: Ints,
        wire_ns: Floats,
        rank: NDArray[np.uint32],
        sender: NDArray[np.int16],
        *,
        bit_ns: float,
        resolution_ns: int = 1,
        noise_ns: float = 0.0,
    ) -> None:
        self.rank = rank
        self.sender = sender
        self._base_ns = int(t_ns[0]) if len(t_ns) else 0
        self.end_ns = (t_ns - self._base_ns).astype(np.float64)
        self._wire_ns = wire_ns
        self.bit_ns = bit_ns
        self._step_ns = resolution_ns - 1
        self._apart_ns = np.empty_like(self.end_ns)
        self._apart_ns[:1] = np.nan
        np.subtract(self.end_ns[1:], self.end_ns[:-1], out=self._apart_ns[1:])
        self._spare_ns = self._apart_ns - wire_ns
        self.noise_ns = noise_ns

    @property
    def slack_ns(self) -> float:
        """What two stamps may be off against one another."""
        return self._step_ns + self.noise_ns

    @property
    def usable(self) -> bool:
        """Whether the stamps are exact enough to tell what was on the bus one after the other."""
        return order_is_told(self.slack_ns, self.bit_ns)

    @cached_property
    def start_ns(self) -> Floats:
        """(n,) start of each frame after the first stamp, NaN where its length is not known."""
        started: Floats = self.end_ns - self._wire_ns + INTERMISSION_BITS * self.bit_ns
        return started

    @cached_property
    def exact(self) -> Bools:
        """(n,) True where length and stamp of a frame fit those beside it."""
        closer = self._spare_ns < -(self.slack_ns + _IDLE_BITS * self.bit_ns)
        sound = np.isfinite(self._wire_ns) & ~closer
        # The stamp of the one before may be as wrong: too late.
        sound[:-1] &= ~closer[1:]
        return sound

    @cached_property
    def _after_frame(self) -> Bools:
        """(n,) True where the row before is a frame: around an error frame nothing is certain."""
        return np.concatenate(([False], np.isfinite(self._wire_ns[:-1])))

    @cached_property
    def idle(self) -> Bools:
        """(n,) True where the bus was idle before a frame."""
        waited = self._spare_ns > self.slack_ns + _IDLE_BITS * self.bit_ns
        found: Bools = waited & self.exact & self._after_frame
        return found

    @cached_property
    def _measured(self) -> bool:
        """Whether the length of every frame is known."""
        return bool(np.isfinite(self._wire_ns).all())

    @cached_property
    def _last_idle(self) -> Ints:
        """(n,) last row up to each one before which the bus was idle, -1 without any."""
        return np.maximum.accumulate(np.where(self.idle, np.arange(len(self.idle)), -1))

    @cached_property
    def _steps_back(self) -> Ints | None:
        """(n,) how often the stamps stepped back up to each row, None where they never do."""
        back = self._apart_ns < -(self.slack_ns + _IDLE_BITS * self.bit_ns)
        return np.cumsum(back) if back.any() else None

    @cached_property
    def _proves(self) -> Bools:
        """(n,) True where a node started a frame after another frame, as far as that is certain."""
        known: Bools = self.exact & self._after_frame & (self.sender != UNKNOWN)
        return known

    @cached_property
    def _sender_before(self) -> NDArray[np.int16]:
        return np.concatenate((np.array([UNKNOWN], np.int16), self.sender[:-1]))

    def ready(
        self,
        rows: Ints,
        sync_rows: Ints,
        sync_ns: Ints,
        can_rank: NDArray[np.uint32] | int,
        sender: NDArray[np.int16] | int,
    ) -> Ready:
        """When frames can have been ready.

        Args:
            rows: (r,) the frames.
            sync_rows: (r,) row of the SYNC that each answers, -1 where it lies before these frames.
            sync_ns: (r,) stamp of that SYNC.
            can_rank, sender: of the identifier, or (r,) of that of each frame.
        """
        first = self.last_without(rows, can_rank, sender)
        untold = np.flatnonzero(first <= sync_rows)
        synced = (sync_ns - self._base_ns).astype(np.float64)
        begun = self.start_ns.take(rows)
        if not self._measured:
            begun = np.where(np.isfinite(begun), begun, self.end_ns.take(rows))
        free = first == rows
        earliest = self.start_ns.take(first)
        earliest -= self.slack_ns
        earliest -= _JOIN_BITS * self.bit_ns
        earliest[untold] = synced.take(untold)
        waiting = begun - earliest
        waiting[untold] += self.slack_ns
        first[untold] = sync_rows.take(untold) + 1
        waiting[free] = 0.0
        known = np.ones(len(rows), np.bool_)
        back = self._steps_back
        if back is not None:
            known = back[rows] == np.where(sync_rows >= 0, back[sync_rows], 0)
        earliest -= synced
        return Ready(
            np.maximum(earliest, 0.0, out=earliest),
            np.maximum(waiting, 0.0, out=waiting),
            first,
            free,
            known,
        )

    def last_without(
        self,
        rows: Ints,
        can_rank: NDArray[np.uint32] | int,
        sender: NDArray[np.int16] | int,
        *,
        itself: bool = False,
    ) -> Ints:
        """(r,) the last row up to each one at whose start no frame of an identifier was ready.

        That is where the bus was idle, or another node started a frame of lower priority. This
        proves nothing right behind a frame of the sender itself, which may have to load the next
        one, nor ahead of one of lower priority of its own, behind which it may have stood in line.
        `itself`: the rows are frames of others, each of which may be such a one as well.
        """
        found: Ints = self._last_idle.take(rows)
        senders = np.broadcast_to(np.asarray(sender, np.int16), rows.shape)
        ranks = np.broadcast_to(np.asarray(can_rank, np.uint32), rows.shape)
        if itself:
            proof = (found < rows) & self._proof(rows, ranks, senders) & (senders > MASTER)
            found[proof] = rows[proof]
        left = np.flatnonzero((found < rows - 1) & (senders > MASTER))
        self._walk(found, left, rows.take(left) - 1, ranks.take(left), senders.take(left))
        return found

    def _walk(
        self, found: Ints, left: Ints, at: Ints, rank: NDArray[np.uint32], sender: NDArray[np.int16]
    ) -> None:
        """Go back from each row `at` to what proves something, but no further than to `found`."""
        stop = found.take(left)
        while len(left):
            lower = self.rank.take(at) > rank
            at_end = self._before_run.take(at)
            over = at_end <= stop
            below = np.flatnonzero(lower)
            if len(below):
                row = at[below]
                own = self.sender.take(row) == sender[below]
                proof = self._proof(row, rank[below], sender[below])
                found[left[below[proof]]] = row[proof]
                at_end[below] = row - 1
                over[below] = own | proof | (row - 1 <= stop[below])
            go_on = np.flatnonzero(~over)
            left, at, stop = left[go_on], at_end[go_on], stop[go_on]
            rank, sender = rank[go_on], sender[go_on]

    def _proof(self, rows: Ints, rank: NDArray[np.uint32], sender: NDArray[np.int16]) -> Bools:
        """(r,) at which rows another node started a frame of lower priority behind another one."""
        found: Bools = self._proves.take(rows) & (self.rank.take(rows) > rank)
        found &= (self.sender.take(rows) != sender) & (self._sender_before.take(rows) != sender)
        return found

    @cached_property
    def _before_run(self) -> Ints:
        """(n,) the row before those up to each one that follow one another by priority.

        None of those is of a lower priority than the last of them.
        """
        begins = np.arange(-1, len(self.rank) - 1)
        begins[1:][self.rank[1:] >= self.rank[:-1]] = -1
        return np.maximum.accumulate(begins)


def close_ns(t_ns: Ints, wire_ns: Floats, bit_ns: float) -> Floats:
    """(c,) distances of frames close behind one another, less the time of the later one [ns]."""
    apart_ns = np.diff(t_ns).astype(np.float64)
    spare_ns = apart_ns - wire_ns[1:]
    near = (spare_ns < _CLOSE_BITS * bit_ns) & (apart_ns >= 0) & np.isfinite(wire_ns[:-1])
    close: Floats = spare_ns[near]
    return close


def noise_of(
    t_ns: Ints, wire_ns: Floats, *, bit_ns: float, resolution_ns: int, before_ns: float = 0.0
) -> float:
    """What stamps are off beyond their step [ns]: no frame can follow closer than its own length.

    Args:
        t_ns, wire_ns: (n,) stamps and times on the wire of a bus, as for `Arbitration`.
        bit_ns: length of a bit.
        resolution_ns: step of the stamps.
        before_ns: what they were off before; at least that where these frames do not tell.
    """
    close, allowed = close_ns(t_ns, wire_ns, bit_ns), resolution_ns - 1 + _IDLE_BITS * bit_ns
    if len(close) < ENOUGH_CLOSE:
        return _stepped(max(float(np.max(-close, initial=0.0)) - allowed, before_ns))
    at = int(_OUTLIERS * len(close))
    return _stepped(-float(np.partition(close, at)[at]) - allowed)


def _stepped(noise_ns: float) -> float:
    """The next of a few steps up, so that a frame more or less changes nothing."""
    steps = [step for step in _NOISE_NS if step >= noise_ns]
    return float(steps[0]) if steps else noise_ns
