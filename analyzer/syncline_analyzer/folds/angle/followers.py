"""Encoders that follow one another although nobody says that they sit on one shaft."""

from dataclasses import field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.angle.samples import Key, Samples
from syncline_analyzer.folds.angle.shafts import FAR_NS, LAG_NS, TOLERANCE_DEG
from syncline_analyzer.folds.angle.trace import Encoder
from syncline_analyzer.results import FollowerRow
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

TICK_NS = 100_000_000
"""All encoders are looked at on a common grid, twice as wide each time it gets too long."""
MAX_TICKS = 4096
MIN_TICKS = 100
MIN_NS = 60_000_000_000
"""So long must they be seen together."""
MOVED_DEG = 45.0
"""So far must each of them turn."""
SURE = 10.0
"""Motion that no straight line explains must be so many times what they may differ: two shafts that
turn evenly follow one another in any case."""
FIT = 0.99
"""Share of the grid at which they must fit."""
_SIMPLE = 20
"""Ratios of gears and belts are sought up to this denominator."""

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_Member = tuple[int, int]
"""(bus number, node)"""


class _Points(NamedTuple):
    """An encoder on the grid, all (n,): number of the tick, angle, what it may be off by the motion
    meanwhile, and a number per stretch over which its turns are counted surely."""

    tick: Integers
    deg: Floats
    doubt_deg: Floats
    stretch: Integers

    def at(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> "_Points":
        """Some of the points."""
        return _Points(self.tick[rows], self.deg[rows], self.doubt_deg[rows], self.stretch[rows])


class _End(NamedTuple):
    """The last sample: stamp, angle, the step that led to it, and its segment."""

    t_ns: int
    deg: float
    step_deg: float
    segment: int


@dataclass(slots=True)
class _Track:
    """One encoder on the grid."""

    object: int
    points: _Points = field(
        default_factory=lambda: _Points(
            np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0, np.int64)
        )
    )
    end: _End | None = None
    stretch: int = 0

    def add(
        self, stamps: Integers, line_deg: Floats, segment: int, circle_deg: float, tick_ns: int
    ) -> None:
        """Take in an unbroken piece: stamps and unwrapped angle (n,)."""
        if self.end is None or self.end.segment != segment:
            self.stretch += 1
            # A clock that steps back repeats no tick.
            start_ns = max(int(stamps[0]), self.end.t_ns if self.end is not None else 0)
            self.end = _End(start_ns, float(line_deg[0]), 0.0, segment)
        t_ns = np.maximum.accumulate(np.concatenate(([self.end.t_ns], stamps)))
        deg = np.concatenate(([self.end.deg], line_deg))
        step, span = np.diff(deg), np.diff(t_ns)
        # After a step of a quarter of the range nobody knows which way round it went.
        broken = (np.abs(step) > circle_deg / 4) | (span > FAR_NS)
        stretch = self.stretch + np.cumsum(broken)
        bend = np.abs(np.diff(step, prepend=self.end.step_deg))
        doubt = np.abs(step) / np.maximum(span, 1) * LAG_NS + bend
        first = t_ns[:-1] // tick_ns
        count = np.where(broken, 0, t_ns[1:] // tick_ns - first)
        row = np.repeat(np.arange(len(count)), count)
        tick = first[row] + 1 + np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        part = (tick * tick_ns - t_ns[:-1][row]) / np.maximum(span[row], 1)
        new = _Points(tick, deg[:-1][row] + part * step[row], doubt[row], stretch[row])
        self.points = _Points(
            *(np.concatenate(pair) for pair in zip(self.points, new, strict=True))
        )
        self.stretch = int(stretch[-1])
        self.end = _End(int(t_ns[-1]), float(deg[-1]), float(step[-1]), segment)

    def widen(self) -> None:
        """Go over to a grid that is twice as wide."""
        points = self.points.at(self.points.tick % 2 == 0)
        self.points = points._replace(tick=points.tick // 2)


class Followers:
    """Looks for pairs of encoders of one bus that follow one another."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._tracks: dict[_Member, _Track] = {}
        self._tick_ns = TICK_NS

    def take(
        self, key: Key, piece: Samples, unwrapped_deg: Floats, segment: int, converter: Encoder
    ) -> None:
        """Take in an unbroken piece of an encoder; of a node with several the first one heard."""
        range_deg = converter.range_deg
        if not self._context.timed or not np.isfinite(range_deg) or not len(piece.seq):
            return
        track = self._tracks.setdefault(key[:2], _Track(key[2]))
        if track.object != key[2]:
            return
        track.add(piece.t_ns, unwrapped_deg, segment, range_deg, self._tick_ns)
        while len(track.points.tick) > MAX_TICKS:
            self._tick_ns *= 2
            for each in self._tracks.values():
                each.widen()

    def rows(self) -> list[FollowerRow]:
        """Pairs that follow one another; of three that do, two pairs."""
        moved = [
            (member, track)
            for member, track in sorted(self._tracks.items())
            if len(track.points.tick) >= MIN_TICKS and np.ptp(track.points.deg) >= MOVED_DEG
        ]
        group = self._described()
        found: list[FollowerRow] = []
        for (other, its), (member, own) in combinations(moved, 2):
            if member[0] != other[0] or group.get(member, member) == group.get(other, other):
                continue
            row = self._compare(member, own.points, other, its.points)
            if row is None:
                continue
            found.append(row)
            old, new = group.get(member, member), group.get(other, other)
            group |= {each: new for each in self._tracks if group.get(each, each) == old}
        return found

    def _described(self) -> dict[_Member, _Member]:
        """A representative of each shaft by encoder, where the bus description tells shafts."""
        group: dict[_Member, _Member] = {}
        for bus, name in enumerate(self._context.buses):
            for node, entry in self._context.description.described(name).items():
                if entry.same_shaft_as is None:
                    continue
                one, two = (bus, node), (bus, entry.same_shaft_as)
                old, new = group.get(one, one), group.get(two, two)
                joined = {each for each, shaft in group.items() if shaft == old} | {one}
                group |= dict.fromkeys(joined, new) | {two: new}
        return group

    def _compare(
        self, member: _Member, own: _Points, other: _Member, its: _Points
    ) -> FollowerRow | None:
        """What two encoders have in common, None where they do not follow one another."""
        ticks, mine, theirs = np.intersect1d(
            own.tick, its.tick, assume_unique=True, return_indices=True
        )
        if len(ticks) < MIN_TICKS or (ticks[-1] - ticks[0]) * self._tick_ns < MIN_NS:
            return None
        own, its = own.at(mine), its.at(theirs)
        x, y, ratio = _fitted(own, its)
        # A step of the clock or a lost value must not bend the line.
        off = np.abs(x - ratio * y)
        near = off <= np.quantile(off, FIT)
        own, its = own.at(near), its.at(near)
        x, y, ratio = _fitted(own, its)
        ratio = _simple(ratio, float(np.ptp(y)))
        if min(np.ptp(x), np.ptp(y)) < MOVED_DEG or not ratio:
            return None
        off = np.abs(x - ratio * y)
        allowed = TOLERANCE_DEG + own.doubt_deg + abs(ratio) * its.doubt_deg
        telling = SURE * float(np.quantile(allowed, 0.95))
        if np.mean(off <= allowed) < FIT or _unevenness(x, own, its) < telling:
            return None
        return FollowerRow(
            self._context.bus_name(member[0]),
            member[1],
            other[1],
            ratio,
            int(ticks[0]) * self._tick_ns,
            int(ticks[-1]) * self._tick_ns,
            len(ticks),
            float(np.ptp(x)),
            float(np.quantile(off, FIT)),
        )


def _fitted(own: _Points, its: _Points) -> tuple[Floats, Floats, float]:
    """Both angles about their means, and how many times as far the first one turned."""
    stretch = _common(own, its)
    x, y = _about_mean(own.deg, stretch), _about_mean(its.deg, stretch)
    squares = float(y @ y)
    return x, y, float(x @ y) / squares if squares else 0.0


def _common(own: _Points, its: _Points) -> NDArray[np.intp]:
    """A number (n,) per stretch in which the turns of both are counted surely."""
    pairs = np.stack((own.stretch, its.stretch))
    return np.unique(pairs, axis=1, return_inverse=True)[1].reshape(-1)


def _unevenness(about: Floats, own: _Points, its: _Points) -> float:
    """Root mean square [deg] of what no even turning explains."""
    stretch = _common(own, its)
    time = _about_mean(own.tick.astype(np.float64), stretch)
    return float(np.sqrt(np.mean(_about_line(about, time, stretch) ** 2)))


def _about_mean(values: Floats, stretch: NDArray[np.intp]) -> Floats:
    """Values (n,) less the mean of their stretch."""
    means = np.bincount(stretch, values) / np.bincount(stretch)
    about: Floats = values - means[stretch]
    return about


def _about_line(values: Floats, time: Floats, stretch: NDArray[np.intp]) -> Floats:
    """Values less the best straight line of each stretch; both (n,) about their means."""
    squares = np.bincount(stretch, time * time)
    slope = np.bincount(stretch, values * time) / np.where(squares > 0, squares, 1.0)
    about: Floats = values - slope[stretch] * time
    return about


def _simple(ratio: float, turned_deg: float) -> float:
    """The ratio of a gear or belt if one is near enough.

    >>> _simple(-1.9999, 3600.0), round(_simple(0.3183, 36000.0), 4)
    (-2.0, 0.3183)
    """
    from fractions import Fraction

    simple = float(Fraction(ratio).limit_denominator(_SIMPLE))
    return simple if abs(simple - ratio) * turned_deg <= TOLERANCE_DEG / 2 else ratio
