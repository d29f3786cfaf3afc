"""How long a bus was busy without a pause, and its fullest moment."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_schemas import native
from syncline_schemas.records import dataclass

BURST_NS = 10_000_000
"""Time within which the peak burst is counted: a SYNC and all that answers it."""
PAUSE_BITS = 4
"""A pause up to so long is none: nodes' oscillators differ, and a waiting node starts early."""
SHORTEST_BITS = 47
"""An empty frame with intermission, the shortest there is."""
_COARSEST = 0.25
"""Stamps of a coarser step, as a share of the shortest frame, do not tell pauses."""
_STEPS = 10
"""The peak burst is as long as so many steps of the stamps at least."""
_BUNDLED = 0.02
"""With this share of frames sooner than the wire allows, the stamps are not those of the wire."""
_PART_NS = BURST_NS / 4
_MOST_PARTS = 4
"""Where there are more parts of the time to a frame, they are not looked at."""
_ROUNDING_NS = 1.0
"""Sums of times may be off by so much."""
_TOLD_BITS = 8
"""A frame must come so much too soon to count for that [bit]."""

_EARLIEST_NS, _FARTHEST_NS = int(np.iinfo(np.int64).min), int(np.iinfo(np.int64).max)

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Stretch:
    """Frames back to back: from the start of the first to the end of the last, and how many."""

    start_ns: int
    end_ns: int
    frames: int

    @property
    def lasts_ns(self) -> int:
        return self.end_ns - self.start_ns


class Busy:
    """Longest stretch without a pause, and the burst with the most bits, of one bus.

    Attributes:
        longest: None before the first frame.
        burst: (share of the time that was busy, its start [ns]) of the fullest `BURST_NS`.
    """

    def __init__(self) -> None:
        self.longest: Stretch | None = None
        self.burst: tuple[float, int] | None = None
        self._current: Stretch | None = None
        self._recent_ns: Ints = np.zeros(0, np.int64)
        self._recent_wire_ns: Floats = np.zeros(0)
        self._recent_soon: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._begun_ns = 0
        self._spacings = 0
        self._too_soon = 0

    def stretch(self, resolution_ns: int, bit_ns: float) -> Stretch | None:
        """The longest stretch, None where the stamps do not tell one."""
        coarse = resolution_ns > _COARSEST * SHORTEST_BITS * bit_ns
        return None if coarse or self._bundled else self.longest

    def peak(self, resolution_ns: int) -> tuple[float, int] | None:
        """The peak burst, None where the stamps do not tell one."""
        return None if _STEPS * resolution_ns > BURST_NS or self._bundled else self.burst

    @property
    def _bundled(self) -> bool:
        return self._too_soon > _BUNDLED * self._spacings

    def add(self, t_ns: Ints, wire_ns: Floats, bit_ns: float, resolution_ns: int) -> None:
        """Take in frames whose stamps run forward, with the time that each was on the wire."""
        # Sooner than the wire allows: stamped late, after the recorder had kept some of them.
        least_ns = -_TOLD_BITS * bit_ns - resolution_ns
        most_ns = PAUSE_BITS * bit_ns + resolution_ns
        before_ns = None if self._current is None else self._current.end_ns
        stretches = native.stretches if native.available() else _stretches
        soon, too_soon, rows = stretches(t_ns, wire_ns, before_ns, least_ns, most_ns)
        self._spacings += len(t_ns)
        self._too_soon += too_soon
        self._add_stretches(t_ns, wire_ns, rows)
        self._add_bursts(t_ns, wire_ns, soon)

    def close(self) -> None:
        """End what goes on: before a gap, and where the clock stepped back."""
        self._take(self._current)
        self._current = None
        self._recent_ns, self._recent_wire_ns = np.zeros(0, np.int64), np.zeros(0)
        self._recent_soon = np.zeros(0, np.bool_)

    def _take(self, stretch: Stretch | None) -> None:
        if stretch and (self.longest is None or stretch.lasts_ns > self.longest.lasts_ns):
            self.longest = stretch

    def _add_stretches(self, t_ns: Ints, wire_ns: Floats, rows: Sequence[int]) -> None:
        """Join the frames that come without a pause before them: rows as told by `_stretches`."""
        first, last, longest, end = rows
        if first > 0:
            assert self._current is not None
            self._current = Stretch(
                self._current.start_ns, int(t_ns[first - 1]), self._current.frames + first
            )
        if first == len(t_ns):
            return
        self._take(self._current)
        for begin, stop in ((longest, end), (last, len(t_ns) - 1)):
            start_ns = max(int(t_ns[begin]) - round(float(wire_ns[begin])), _EARLIEST_NS)
            self._current = Stretch(start_ns, int(t_ns[stop]), stop - begin + 1)
            if begin == longest:
                self._take(self._current)

    def _add_bursts(self, t_ns: Ints, wire_ns: Floats, soon: NDArray[np.bool_]) -> None:
        """Look at the time before the end and after the start of each frame.

        The fullest window ends or begins with a frame. Those with impossible stamps do not count.
        """
        if not len(self._recent_ns):
            self._begun_ns = int(t_ns[0])
        known = len(self._recent_ns)
        end_ns = np.concatenate([self._recent_ns, t_ns])
        wire_ns = np.concatenate([self._recent_wire_ns, wire_ns])
        soon = np.concatenate([self._recent_soon, soon])
        late = int(np.searchsorted(end_ns, max(int(end_ns[-1]) - BURST_NS, _EARLIEST_NS)))
        # Copies: what is kept must not hold on to the columns of the whole block.
        self._recent_ns, self._recent_wire_ns = end_ns[late:].copy(), wire_ns[late:].copy()
        self._recent_soon = soon[late:].copy()
        if self.burst is not None and self.burst[0] >= 1.0:
            return
        if int(end_ns[-1]) - self._begun_ns > _FARTHEST_NS:
            return
        spoiled = _Spoiled.by(end_ns, soon, self._begun_ns)
        # Windows up to the frames that are known were looked at before.
        looked_at = float(end_ns[known - 1] - self._begun_ns) if known else 0.0
        if spoiled.all_within(looked_at, float(int(end_ns[-1]) - self._begun_ns)):
            return
        best = self.burst[0] * BURST_NS if self.burst is not None else 0.0
        found = _fullest_window(end_ns, wire_ns, known, self._begun_ns, best, spoiled)
        if found is None:
            return
        carried, until = found
        share = min(1.0, carried / BURST_NS)
        if self.burst is None or share > self.burst[0]:
            self.burst = share, self._begun_ns + round(until) - BURST_NS


def _stretches(
    t_ns: Ints, wire_ns: Floats, before_ns: int | None, least_ns: float, most_ns: float
) -> tuple[NDArray[np.bool_], int, list[int]]:
    """Frames back to back, as `native.stretches` tells them."""
    idle_ns = np.diff(t_ns, prepend=t_ns[0] if before_ns is None else before_ns) - wire_ns
    if before_ns is None:
        idle_ns[0] = 0
    soon = idle_ns < least_ns
    begins = soon | (idle_ns > most_ns)
    begins[0] |= before_ns is None
    rows, too_soon = np.flatnonzero(begins), int(np.count_nonzero(soon))
    if not len(rows):
        return soon, too_soon, [len(t_ns)] * 4
    ends = np.append(rows[1:], len(t_ns)) - 1
    starts_ns = t_ns[rows] - np.rint(wire_ns[rows]).astype(np.int64)
    longest = int(np.argmax(t_ns[ends] - starts_ns))
    return soon, too_soon, [int(each) for each in (rows[0], rows[-1], rows[longest], ends[longest])]


def _fullest_window(
    end_ns: Ints,
    wire_ns: Floats,
    known: int,
    begun_ns: int,
    best: float,
    spoiled: "_Spoiled",
) -> tuple[float, float] | None:
    """(what it carries, its end) of the fullest window, `known` and `best` as for `_ends`."""
    if native.available():
        after, until = spoiled.after, spoiled.until
        return native.fullest_window(end_ns, wire_ns, known, begun_ns, BURST_NS, best, after, until)
    since = (end_ns - begun_ns).astype(np.float64)
    busy = np.cumsum(wire_ns)
    ends = _ends(since, wire_ns, busy, known, best, spoiled)
    ends = ends[(ends >= BURST_NS) & (ends <= since[-1])]
    ends = ends[~spoiled.ends(ends)]
    if not len(ends):
        return None
    at = np.searchsorted(since, np.concatenate([ends, ends - BURST_NS]))
    near = np.zeros(len(since) + 2, np.bool_)
    near[at], near[at + 1], near[at + 2] = True, True, True
    knots, levels = _busy_around(np.flatnonzero(near[1:-1]), since, wire_ns, busy)
    carried = np.interp(ends, knots, levels) - np.interp(ends - BURST_NS, knots, levels)
    fullest = int(np.argmax(carried))
    return float(carried[fullest]), float(ends[fullest])


def _ends(
    since: Floats, wire_ns: Floats, busy: Floats, known: int, best: float, spoiled: "_Spoiled"
) -> Floats:
    """(w,) ends of the windows that may be the fullest, of those from row `known` on.

    A window that ends with a frame carries no more than the frames that end in it, and no less
    than these without the first; one that ends between two frames no more than one frame more
    than the window that ends with the former.
    """
    longest = float(wire_ns.max())
    # Fewer frames than this cannot carry more than the fullest window so far.
    count = max(1, math.ceil((best - longest) / longest) if longest else 1)
    if count > len(since):
        return np.zeros(0)
    rows = np.flatnonzero(since[count - 1 :] - since[: len(since) - count + 1] < BURST_NS)
    rows += count - 1
    if best:
        rows = rows[_may_carry(best, since, wire_ns, longest).take(rows)]
    before = np.searchsorted(since, since[rows] - BURST_NS, "right") - 1
    most = busy[rows] - np.where(before >= 0, busy[before], 0.0)
    sure = (rows >= known) & (since[rows] >= BURST_NS) & ~spoiled.ends(since[rows])
    least = max(best, float(most[sure].max(initial=0.0)) - longest)
    chosen = most >= least - longest
    rows, before = rows[chosen], before[chosen]
    # Windows that begin with a frame and end behind one of these rows, before the next frame.
    next_ns = since[np.minimum(rows + 1, len(since) - 1)]
    stop = np.searchsorted(since, next_ns - BURST_NS + longest, "right")
    begins = np.zeros(len(since) + 1, np.int64)
    np.add.at(begins, np.maximum(before, 0), 1)
    np.add.at(begins, np.maximum(stop, np.maximum(before, 0)), -1)
    starting = np.flatnonzero(np.cumsum(begins) > 0)
    starting = starting[starting < len(since)]
    return np.concatenate(
        [since[rows[rows >= known]], since[starting] - wire_ns[starting] + BURST_NS]
    )


def _may_carry(best: float, since: Floats, wire_ns: Floats, longest: float) -> NDArray[np.bool_]:
    """(n,) whether a window that ends with a frame, or before the next one, may carry so much.

    Such a window carries no more than the parts of the time that it touches up to the frame, and
    then a part of the next one. Most of them need not be measured once a full one is known.
    """
    if (since[-1] - since[0]) > _MOST_PARTS * len(since) * _PART_NS:
        return np.ones(len(since), np.bool_)
    place = ((since - since[0]) / _PART_NS).astype(np.intp)
    carried = np.cumsum(np.bincount(place, wire_ns))
    touched = int(BURST_NS / _PART_NS) + 1
    carried[touched:] -= carried[:-touched].copy()
    may: NDArray[np.bool_] = (carried + longest > best - _ROUNDING_NS).take(place)
    return may


def _busy_around(
    rows: NDArray[np.intp], since: Floats, wire_ns: Floats, busy: Floats
) -> tuple[Floats, Floats]:
    """Knots of the busy time over time, where some frames begin and end, and the time at each.

    It grows while a frame is on the wire.
    """
    until, took, level = since[rows], wire_ns[rows], busy[rows]
    starts = until - took
    later = rows > 0
    starts[later] = np.maximum(starts[later], since[rows[later] - 1])
    return _alternating(starts, until), _alternating(level - took, level)


def _alternating(first: Floats, second: Floats) -> Floats:
    """(2n,) the values of both by turns."""
    both = np.empty(2 * len(first))
    both[::2], both[1::2] = first, second
    return both


@dataclass(frozen=True, slots=True, eq=False)
class _Spoiled:
    """Stretches of the ends of windows that hold an impossible stamp: after one moment, until another.

    Both (s,), ascending, without overlap.
    """

    after: Floats
    until: Floats

    @classmethod
    def by(cls, end_ns: Ints, soon: NDArray[np.bool_], begun_ns: int) -> "_Spoiled":
        """By the (n,) stamps of the frames, and whether each is impossible; times since `begun_ns`."""
        at = np.flatnonzero(soon)
        if not len(at):
            return cls(np.zeros(0), np.zeros(0))
        after = np.where(at > 0, end_ns[np.maximum(at - 1, 0)] - begun_ns, -np.inf)
        until = (end_ns[at] - begun_ns).astype(np.float64) + BURST_NS
        # Each spoils the ends from the frame before it on; most of these stretches overlap.
        first = np.flatnonzero(np.concatenate(([True], after[1:] > until[:-1])))
        last = np.append(first[1:], len(at)) - 1
        return cls(after[first], until[last])

    def ends(self, ends: Floats) -> NDArray[np.bool_]:
        """(w,) which windows are spoiled."""
        if not len(self.after):
            return np.zeros(len(ends), np.bool_)
        place = np.searchsorted(self.after, ends) - 1
        spoiled: NDArray[np.bool_] = (place >= 0) & (ends <= self.until[np.maximum(place, 0)])
        return spoiled

    def all_within(self, after: float, until: float) -> bool:
        """Whether all windows are spoiled that end after one moment, and no later than another."""
        return len(self.after) == 1 and self.after[0] <= after and until <= self.until[0]
