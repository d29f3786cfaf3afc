"""SYNCs that had to wait and then came in a bunch: none of them is missing."""

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]

LATE = 1.5
"""A period longer than this many cycles may be a SYNC that waited."""
_AT_ONCE = 0.25
"""A SYNC sooner than this share of a cycle after another one had waited behind it."""
_BUNCHED = 0.5
"""So many of the SYNCs that waited must come at once, unless the bus was full."""
_FULL = 0.5
"""Share of the wait in which the bus was busy, where it was the bus that made SYNC wait."""
_AS_USUAL = 0.75
"""Then, after catching up, a SYNC comes no sooner than this share of a cycle: else the producer was
set to another period."""
_AHEAD = 256
"""Periods within which the producer has caught up."""
_MOST = 1000
"""Long periods that are looked at in one block."""
_ON_TIME = 0.5
"""Cycles that a SYNC is late at most when the producer has caught up."""
_THEN = 4
"""Periods that are looked at for that."""


def catching_up(periods: Ints, bits: Ints, median_ns: float, bit_ns: float) -> NDArray[np.bool_]:
    """(n,) which periods belong to a wait of the producer, or to its catching up after it.

    A producer whose driver sends in the order of asking (a queue) sends SYNC behind its other
    frames: one of them that waits for a full bus holds it back, and then all SYNCs come at once, or
    each after what else has waited.

    Args:
        periods: (n,) SYNC periods [ns].
        bits: (n,) bits of all frames in each period.
        median_ns: the usual period.
        bit_ns: length of a bit, 0 where the bit rate is not known.

    >>> periods = np.array([10, 31, 1, 1, 8, 31, 10])
    >>> catching_up(periods, np.zeros(7, np.int64), 10.0, 0.0).tolist()
    [False, True, True, True, False, False, False]
    """
    found = np.zeros(len(periods), np.bool_)
    full = bits * bit_ns >= _FULL * periods
    done = 0
    for at in np.flatnonzero(periods > LATE * median_ns)[:_MOST].tolist():
        if at < done:
            continue
        late = np.cumsum(periods[at : at + _AHEAD + 1] / median_ns - 1)
        on_time = np.flatnonzero(late < _ON_TIME)
        if not len(on_time):
            continue
        end = at + int(on_time[0]) + 1
        at_once = np.count_nonzero(periods[at:end] < _AT_ONCE * median_ns)
        then = periods[end : end + _THEN]
        as_usual = not len(then) or float(then.mean()) >= _AS_USUAL * median_ns
        if at_once >= max(_BUNCHED * (late[0] - _ON_TIME), 1) or (full[at] and as_usual):
            found[at:end] = True
            done = end
    return found
