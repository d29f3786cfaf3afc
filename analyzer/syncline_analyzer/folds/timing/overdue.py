"""Missing frames of a PDO that an event timer sends."""

from dataclasses import field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from syncline_analyzer.distribution import quantile_of
from syncline_analyzer.folds.timing.rhythm import Missed
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

LATE = 1.5
"""A period longer than this many event timers may lack a frame."""
_MAKES_UP = 64
"""Periods after it that may make up for it: then the frame only waited for the bus."""
_LEARN = 16
_NEAR = 0.1
"""A usual period this close to the timer is what the device's own clock makes of it."""
_STEADY = 0.02
"""Interquartile range of the periods, as a share of the timer, where their median is its clock."""

Ints = NDArray[np.int64]


class _Held(NamedTuple):
    """Periods that wait for those after them; all (n,)."""

    periods: Ints
    before_ns: Ints
    before_seq: Ints
    judged: NDArray[np.bool_]

    def last(self) -> "_Held":
        """The last ones, which those that follow may make up for."""
        last = slice(-_MAKES_UP, None)
        return _Held(
            self.periods[last].copy(),
            self.before_ns[last].copy(),
            self.before_seq[last].copy(),
            self.judged[last].copy(),
        )

    def after(self, held: "_Held") -> "_Held":
        """These after others."""
        return _Held(
            np.concatenate((held.periods, self.periods)),
            np.concatenate((held.before_ns, self.before_ns)),
            np.concatenate((held.before_seq, self.before_seq)),
            np.concatenate((held.judged, self.judged)),
        )


_NOTHING = np.zeros(0, np.int64)
_NO_HELD = _Held(_NOTHING, _NOTHING, _NOTHING, np.zeros(0, np.bool_))


@dataclass(slots=True)
class Overdue:
    """Finds periods that lack frames, and that none of the next ones makes up for."""

    missed: Missed = field(default_factory=Missed)
    _timer_ns: int = 0
    _held: _Held = _NO_HELD

    def add(
        self,
        timer_ns: int,
        periods: Ints,
        before_ns: Ints,
        before_seq: Ints,
        judged: NDArray[np.bool_],
    ) -> None:
        """Take in periods in order, each with the frame that began it; all (n,).

        Args:
            timer_ns: the event timer; another one begins anew.
            periods: times from one frame to the next.
            before_ns, before_seq: of the frame before each period.
            judged: whether a period counts if it is long: nothing else explains it.
        """
        if timer_ns != self._timer_ns:
            self.flush()
            self._timer_ns = timer_ns
        if int(periods.min(initial=0)) < 0:
            periods = np.where(periods < 0, timer_ns, periods)
        new = _Held(periods, before_ns, before_seq, judged)
        longest = max(int(periods.max(initial=0)), int(self._held.periods.max(initial=0)))
        if longest <= _surely_whole(timer_ns) and len(periods) >= _MAKES_UP:
            self._held = new.last()
            return
        whole = new.after(self._held)
        self._judge(whole, max(len(whole.periods) - _MAKES_UP, 0))
        self._held = whole.last()

    def flush(self) -> None:
        """Judge what waits, as at a gap or the end."""
        if len(self._held.periods):
            self._judge(self._held, len(self._held.periods))
            self._held = _NO_HELD

    def _judge(self, held: _Held, count: int) -> None:
        """Find the long ones among the first `count` periods."""
        rows, lacking = lacking_after(held.periods, self._timer_ns)
        for at, number in zip(rows.tolist(), lacking.tolist(), strict=True):
            if at < count and held.judged[at]:
                last_ns, seq = int(held.before_ns[at]), int(held.before_seq[at])
                self.missed.add_evenly(last_ns, self._timer_ns, number, seq)


def lacking_after(periods: Ints, timer_ns: int) -> tuple[NDArray[np.intp], Ints]:
    """(rows, frames that they lack) of the periods that none of the next ones makes up for.

    Where events send frames as well, each of them starts the timer anew: nothing makes up then.

    >>> lacking_after(np.array([10, 16, 4, 10, 21, 9]), 10)
    (array([4]), array([1]))
    """
    if periods.max(initial=0) <= _surely_whole(timer_ns):
        return np.zeros(0, np.intp), _NOTHING
    usual = _usual(periods, timer_ns)
    rows = np.flatnonzero(periods > LATE * usual)
    if not len(rows):
        return rows, _NOTHING
    if float(np.minimum(periods, 2 * timer_ns).mean()) < (1 - _NEAR) * timer_ns:
        return rows, np.rint(periods[rows] / usual).astype(np.int64) - 1
    ahead = np.concatenate((periods / usual - 1, np.zeros(_MAKES_UP)))
    sums = np.cumsum(sliding_window_view(ahead, _MAKES_UP + 1)[rows], axis=1)
    lacking = np.rint(sums.min(axis=1)).astype(np.int64)
    return rows[lacking > 0], lacking[lacking > 0]


def _surely_whole(timer_ns: int) -> float:
    """No period up to this lacks a frame, whatever the device's clock makes of its timer."""
    return LATE * (1 - _NEAR) * timer_ns


def _usual(periods: Ints, timer_ns: int) -> float:
    """The median where it is what the device's clock makes of the timer, else the timer."""
    if len(periods) < _LEARN:
        return float(timer_ns)
    low, usual, high = (quantile_of(periods, share) for share in (0.25, 0.5, 0.75))
    steady = high - low <= _STEADY * timer_ns and abs(usual - timer_ns) <= _NEAR * timer_ns
    return float(usual) if steady else float(timer_ns)
