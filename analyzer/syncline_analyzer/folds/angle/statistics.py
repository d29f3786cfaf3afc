"""Statistics of angles: on the circle, at rest, and how often the direction changed."""

from dataclasses import field
from math import atan2, degrees, hypot, log, sqrt

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass

WINDOW = 64
"""Samples in a row that are judged together on whether it stands still."""
PARTS = 8
"""Parts of such a stretch whose means are compared."""
BACK_DEG = 1.0
"""A turn back by less is no change of direction."""
BACK_COUNTS = 3
_EVEN = 1e-9
"""A mean resultant length below this points nowhere."""

Floats = NDArray[np.float64]


@dataclass(slots=True)
class Circle:
    """Mean and spread of angles on the circle (Mardia and Jupp, Directional Statistics, 2.2-2.3)."""

    count: int = 0
    cosines: float = 0.0
    sines: float = 0.0

    def add(self, angle_deg: Floats) -> None:
        """Take in angles (n,) in degrees; NaN are left out."""
        known = np.radians(angle_deg[np.isfinite(angle_deg)])
        self.count += len(known)
        self.cosines += float(np.cos(known).sum())
        self.sines += float(np.sin(known).sum())

    @property
    def length(self) -> float:
        """Mean resultant length: 1 where all angles are the same, 0 where they cancel out."""
        return min(1.0, hypot(self.cosines, self.sines) / self.count) if self.count else 0.0

    @property
    def mean_deg(self) -> float | None:
        """Direction of the sum, in (-180, 180]; None where there is none."""
        return degrees(atan2(self.sines, self.cosines)) if self.length > _EVEN else None

    @property
    def std_deg(self) -> float | None:
        """Circular standard deviation; None where there is none."""
        return degrees(sqrt(2.0 * abs(log(self.length)))) if self.length > _EVEN else None


@dataclass(slots=True)
class Rest:
    """Spread of the stretches in which nothing moves."""

    samples: int = 0
    squares: float = 0.0
    widest: float = 0.0
    _open: Floats = field(default_factory=lambda: np.zeros(0))

    def cut(self) -> None:
        """Forget the stretch that is not whole yet."""
        self._open = np.zeros(0)

    def add(self, line_deg: Floats, step_deg: float) -> None:
        """Take in an unwrapped line (n,) that goes on; `step_deg` is one count."""
        line = np.concatenate((self._open, line_deg))
        whole = len(line) // WINDOW * WINDOW
        self._open = line[whole:]
        if not whole:
            return
        stretches = line[:whole].reshape(-1, WINDOW)
        parts = stretches.reshape(-1, PARTS, WINDOW // PARTS)
        means = parts.mean(axis=2)
        within = parts.std(axis=2)
        usual = np.median(within, axis=1)
        # A drift shows in the means of the parts long before it shows within one of them, and where
        # a motion begins one part scatters more than the others.
        still = np.ptp(means, axis=1) <= np.maximum(1.01 * step_deg, 2 * usual)
        still &= within.max(axis=1) <= 2.5 * usual + 1.01 * step_deg
        resting = stretches[still]
        if len(resting):
            self.samples += resting.size
            self.squares += float(resting.var(axis=1).sum()) * WINDOW
            self.widest = max(self.widest, float(np.ptp(resting, axis=1).max()))

    @property
    def noise_deg(self) -> float | None:
        """Standard deviation about the mean of each stretch; None without any."""
        return sqrt(self.squares / self.samples) if self.samples else None


@dataclass(slots=True)
class Reversals:
    """Changes of direction, with a play: small movements to and fro are none."""

    count: int = 0
    _held: float | None = None
    _direction: int = 0

    def cut(self) -> None:
        """The next sample begins anew."""
        self._held, self._direction = None, 0

    def add(self, line_deg: Floats, step_deg: float) -> None:
        """Take in an unwrapped line (n,) that goes on; `step_deg` is one count."""
        if not len(line_deg):
            return
        play = max(BACK_DEG, BACK_COUNTS * step_deg)
        held = float(line_deg[0]) if self._held is None else self._held
        turns = _turning_points(line_deg)
        low, high = turns - play / 2, turns + play / 2
        if low.max() <= held <= high.min():
            self._held = held
            return
        follows = np.concatenate(([held], _through(held, low, high)))
        self._held = float(follows[-1])
        steps = np.sign(np.diff(follows)).astype(np.int64)
        ways = np.concatenate(([self._direction], steps[steps != 0]))
        ways = ways[ways != 0]
        self.count += int(np.count_nonzero(np.diff(ways)))
        self._direction = int(ways[-1]) if len(ways) else 0


def _turning_points(line: Floats) -> Floats:
    """The first sample, those where the line turns, and the last one."""
    kept = line[np.concatenate(([True], np.diff(line) != 0))]
    way = np.sign(np.diff(kept))
    inner = np.flatnonzero(way[1:] != way[:-1]) + 1 if len(way) > 1 else np.zeros(0, np.intp)
    return np.concatenate((kept[:1], kept[inner], kept[-1:]))


def _through(held: float, low: Floats, high: Floats) -> Floats:
    """A value moved into each of the bands low..high one after another: (n,).

    Two such moves in a row are one move into another band, so all are worked out by doubling.
    """
    low, high = low.copy(), high.copy()
    shift = 1
    while shift < len(low):
        first_low, first_high = low[:-shift].copy(), high[:-shift].copy()
        last_low, last_high = low[shift:].copy(), high[shift:].copy()
        low[shift:] = np.clip(first_low, last_low, last_high)
        high[shift:] = np.clip(first_high, last_low, last_high)
        shift *= 2
    through: Floats = np.clip(held, low, high)
    return through


@dataclass(slots=True)
class Statistics:
    """Everything of one trace that is counted rather than drawn."""

    circle: Circle = field(default_factory=Circle)
    rest: Rest = field(default_factory=Rest)
    reversals: Reversals = field(default_factory=Reversals)
    scaled: bool = False
    """Whether anything in degrees was seen."""

    def cut(self) -> None:
        """What comes next does not go on from here."""
        self.rest.cut()
        self.reversals.cut()

    def add(self, line_deg: Floats, step_deg: float, breaks: NDArray[np.intp]) -> None:
        """Take in an unwrapped line (n,); at each of `breaks`, places in it, it goes on elsewhere."""
        if not len(line_deg):
            return
        self.scaled = True
        for number, part in enumerate(np.split(line_deg, breaks)):
            if number:
                self.cut()
            self.rest.add(part, step_deg)
            self.reversals.add(part, step_deg)
