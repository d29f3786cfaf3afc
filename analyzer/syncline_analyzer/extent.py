"""How long a capture is where its clock was set back: the stretches of stamps between the steps."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch
from syncline_schemas.named_tuples import NamedTuple

SET_BACK_NS = 1_000_000_000
"""Stamps that run back by at least so much are of a clock that was set, not disorder [ns]."""
MOST_STEPS = 100
"""Stamps that run back more often are disorder, however far they do."""


class Stretch(NamedTuple):
    """The earliest and the latest stamp between two steps back of the clock [ns]."""

    start_ns: int
    end_ns: int


class Extent:
    """Follows the stamps of a capture in the order of its frames.

    A step back of the clock is one of all frames, and of those of the bus itself: a log may hold
    the frames of several buses one after the other.
    """

    def __init__(self) -> None:
        self._stretches: list[Stretch] = []
        self._last: dict[int, int] = {}
        self._previous_ns: int | None = None
        self._steps = 0

    @property
    def stretches(self) -> list[Stretch]:
        """In order, where the clock was set back; none of a capture where it never was."""
        return list(self._stretches) if 0 < self._steps <= MOST_STEPS else []

    def update(self, frames: FrameBatch) -> None:
        """Take in the next frames."""
        if not len(frames):
            return
        t_ns, begin = frames.t_ns, 0
        for row in self._set_back(frames):
            self._extend(t_ns[begin:row])
            self._steps, begin = self._steps + 1, row
            if self._steps <= MOST_STEPS:
                self._stretches.append(Stretch(int(t_ns[row]), int(t_ns[row])))
        self._extend(t_ns[begin:])
        self._previous_ns = int(t_ns[-1])
        buses = frames.buses
        for bus in buses:
            last = -1 if len(buses) == 1 else np.flatnonzero(frames.bus == bus)[-1]
            self._last[bus] = int(t_ns[last])

    def _extend(self, t_ns: NDArray[np.int64]) -> None:
        if not len(t_ns):
            return
        first, last = int(t_ns.min()), int(t_ns.max())
        if not self._stretches:
            self._stretches.append(Stretch(first, last))
        known = self._stretches[-1]
        self._stretches[-1] = Stretch(min(known.start_ns, first), max(known.end_ns, last))

    def _set_back(self, frames: FrameBatch) -> list[int]:
        """Rows before which the clock was set back."""
        t_ns = frames.t_ns
        back = _back(t_ns, self._previous_ns)
        if not back.any():
            return []
        for bus in frames.buses:
            rows = np.flatnonzero(frames.bus == bus)
            own = _back(t_ns[rows], self._last.get(bus))
            own[0] |= bus not in self._last
            back[rows] &= own
        return np.flatnonzero(back).tolist()


def _back(t_ns: NDArray[np.int64], previous_ns: int | None) -> NDArray[np.bool_]:
    """(n,) whether each stamp is far before the one in front of it."""
    back = np.zeros(len(t_ns), np.bool_)
    # Stamps seldom run back at all, and to compare them takes less than to subtract.
    if np.any(t_ns[1:] < t_ns[:-1]):
        back[1:] = t_ns[1:] - t_ns[:-1] <= -SET_BACK_NS
    back[0] = previous_ns is not None and int(t_ns[0]) <= previous_ns - SET_BACK_NS
    return back
