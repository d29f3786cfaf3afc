"""When a frame can have been ready at the earliest, by the arbitration of the frames before it.

A controller that has a frame to send starts it as soon as the bus is free, and the lowest
identifier wins (ISO 11898-1). So a frame was not ready yet when the bus was idle, nor when another
node started one of lower priority; and it was ready at its own start at the latest.
"""

from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from syncline_schemas import native
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.named_tuples import NamedTuple
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

_T = TypeVar("_T", np.int16, np.uint32, np.int64)
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


class Asked(NamedTuple):
    """Answers of PDOs to SYNCs, those of a PDO behind one another.

    Attributes:
        starts: (p,) where those of each PDO begin, none of them without any.
        ranks, senders: (p,) of the PDOs.
        rows: (r,) of the answers.
        position: (r,) of the SYNC that each answers.
        sync_rows, sync_ns: (m,) rows of the SYNCs, -1 where they lie before these frames, and stamps.
        low_ns, most_ns: (r,) bounds of the time that the device took.
    """

    starts: Ints
    ranks: NDArray[np.uint32]
    senders: NDArray[np.int16]
    rows: Ints
    position: Ints
    sync_rows: Ints
    sync_ns: Ints
    low_ns: Floats
    most_ns: Floats

    def each(self, column: NDArray[_T]) -> NDArray[_T]:
        """(r,) what is told of the PDOs, (p,), for each of their answers."""
        return np.repeat(column, np.diff(self.starts, append=len(self.rows)))


class Most(NamedTuple):
    """Figures of the answers of one PDO in a block: those of a known time only.

    Attributes:
        waited: how many waited.
        own_ns: longest time on the wire.
        most_ns: longest time that the device can have taken.
        least_ns, waiting_ns: least and most of both.
    """

    waited: int
    own_ns: float
    most_ns: float
    least_ns: tuple[float, float]
    waiting_ns: tuple[float, float]


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

    def part(self, rows: slice) -> "Ready":
        """Some of them."""
        return Ready(
            self.least_ns[rows],
            self.waiting_ns[rows],
            self.first[rows],
            self.free[rows],
            self.known[rows],
        )


def order_is_told(slack_ns: float, bit_ns: float) -> bool:
    """Whether stamps that are off so far tell what was on the bus one after the other."""
    return slack_ns <= _SHORTEST_BITS * bit_ns


class Arbitration:
    """The frames of one bus in order of arrival.

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
        self._t_ns = t_ns
        self._base_ns = int(t_ns[0]) if len(t_ns) else 0
        self._wire_ns = wire_ns
        self.bit_ns = bit_ns
        self._step_ns = resolution_ns - 1
        self.noise_ns = noise_ns

    @property
    def slack_ns(self) -> float:
        """What two stamps may be off against one another."""
        return self._step_ns + self.noise_ns

    @property
    def usable(self) -> bool:
        """Whether the stamps are exact enough to tell what was on the bus one after the other."""
        return order_is_told(self.slack_ns, self.bit_ns)

    @property
    def _idle_ns(self) -> float:
        """Frames apart for longer than this, or closer by more, are not back to back."""
        return self.slack_ns + _IDLE_BITS * self.bit_ns

    @cached_property
    def _rows(self) -> native.BusRows:
        """The same frames for the compiled loops."""
        return native.BusRows(self._t_ns, self._wire_ns, self.rank, self.sender, self._idle_ns)

    @cached_property
    def end_ns(self) -> Floats:
        """(n,) end of each frame, after the first stamp."""
        return (self._t_ns - self._base_ns).astype(np.float64)

    @cached_property
    def start_ns(self) -> Floats:
        """(n,) start of each frame after the first stamp, NaN where its length is not known."""
        started: Floats = self.end_ns - self._wire_ns + INTERMISSION_BITS * self.bit_ns
        return started

    @cached_property
    def _apart_ns(self) -> Floats:
        """(n,) from the end of the frame before to that of each one."""
        return np.diff(self.end_ns, prepend=np.nan)

    @cached_property
    def _spare_ns(self) -> Floats:
        """(n,) how much longer that is than the frame."""
        spare: Floats = self._apart_ns - self._wire_ns
        return spare

    @cached_property
    def exact(self) -> Bools:
        """(n,) True where length and stamp of a frame fit those beside it."""
        closer = self._spare_ns < -self._idle_ns
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
        waited = self._spare_ns > self._idle_ns
        found: Bools = waited & self.exact & self._after_frame
        return found

    @cached_property
    def _last_idle(self) -> Ints:
        """(n,) last row up to each one before which the bus was idle, -1 without any."""
        return np.maximum.accumulate(np.where(self.idle, np.arange(len(self.idle)), -1))

    @cached_property
    def _steps_back(self) -> Ints | None:
        """(n,) how often the stamps stepped back up to each row, None where they never do."""
        back = self._apart_ns < -self._idle_ns
        return np.cumsum(back) if back.any() else None

    @cached_property
    def _proves(self) -> Bools:
        """(n,) True where a node started a frame after another frame, as far as that is certain."""
        known: Bools = self.exact & self._after_frame & (self.sender != UNKNOWN)
        return known

    @cached_property
    def _sender_before(self) -> NDArray[np.int16]:
        return np.concatenate((np.array([UNKNOWN], np.int16), self.sender[:-1]))

    def ready(self, asked: Asked) -> tuple[Ready, list[Most]]:
        """When answers can have been ready, and the figures of each PDO."""
        if native.available():
            margins_ns = self.slack_ns, _JOIN_BITS * self.bit_ns, INTERMISSION_BITS * self.bit_ns
            found = self._rows.ready(*asked, margins_ns)
            return Ready(*found[:5]), _told(found.figures)
        ready = self._ready(asked)
        return ready, _told(_figures(asked, ready, self.own_ns(asked.rows)))

    def _ready(self, asked: Asked) -> Ready:
        """When they can have been ready, by numpy."""
        rows, sync_rows = asked.rows, asked.sync_rows.take(asked.position)
        ranks, senders = asked.each(asked.ranks), asked.each(asked.senders)
        first = self.last_without(rows, ranks, senders, sync_rows)
        untold = np.flatnonzero(first <= sync_rows)
        synced = (asked.sync_ns.take(asked.position) - self._base_ns).astype(np.float64)
        begun = self.start_ns.take(rows)
        begun = np.where(np.isfinite(begun), begun, self.end_ns.take(rows))
        free = self.idle.take(rows)
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
        least = np.minimum(np.maximum(np.maximum(earliest, 0.0), asked.low_ns), asked.most_ns)
        most = np.maximum(asked.most_ns - least, 0.0)
        waiting = np.minimum(np.maximum(waiting, 0.0), most)
        return Ready(least, waiting, first, free, known)

    def own_ns(self, rows: Ints) -> Floats:
        """(r,) time on the wire of frames without intermission."""
        own: Floats = self._wire_ns.take(rows) - INTERMISSION_BITS * self.bit_ns
        return own

    def last_without(
        self,
        rows: Ints,
        ranks: NDArray[np.uint32],
        senders: NDArray[np.int16],
        stops: Ints | None = None,
        *,
        itself: bool = False,
    ) -> Ints:
        """(r,) the last row up to each one at whose start no frame of a PDO was ready.

        That is where the bus was idle, or another node started a frame of lower priority. This
        proves nothing right behind a frame of the sender itself, which may have to load the next
        one, nor ahead of one of lower priority of its own, behind which it may have stood in line.

        Args:
            rows: (r,) frames.
            ranks, senders: (r,) of the PDOs.
            stops: (r,) rows that are told where there is no later one; by default -1.
            itself: the rows are frames of others, each of which may be such a one as well.
        """
        if native.available():
            return self._rows.last_without(rows, ranks, senders, stops, itself=itself)
        found: Ints = self._last_idle.take(rows)
        if stops is not None:
            found = np.maximum(found, stops)
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


def _figures(asked: Asked, ready: Ready, own_ns: Floats) -> Floats:
    """(p, 7) what `Most` holds."""
    known, starts, most, least = ready.known, asked.starts, np.maximum.reduceat, np.minimum.reduceat
    low, high = np.where(known, ready.least_ns, np.inf), np.where(known, ready.least_ns, -np.inf)
    short = np.where(known, ready.waiting_ns, np.inf)
    long = np.where(known, ready.waiting_ns, -np.inf)
    columns = (
        np.add.reduceat((ready.first < asked.rows) & known, starts, dtype=np.float64),
        np.fmax(np.fmax.reduceat(own_ns, starts), 0.0),
        most(np.where(known, asked.most_ns, 0.0), starts),
        least(low, starts),
        most(high, starts),
        least(short, starts),
        most(long, starts),
    )
    return np.stack(columns, axis=1)


def _told(figures: Floats) -> list[Most]:
    return [
        Most(int(w), own, most, (a, b), (c, d)) for w, own, most, a, b, c, d in figures.tolist()
    ]


def close_ns(t_ns: Ints, wire_ns: Floats, bit_ns: float) -> Floats:
    """(c,) distances of frames close behind one another, less the time of the later one [ns]."""
    if native.available():
        return native.close(t_ns, wire_ns, _CLOSE_BITS * bit_ns)
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
