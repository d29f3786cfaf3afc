"""SYNCs that had to wait and then came in a bunch: none of them is missing."""

import numpy as np
from numpy.typing import NDArray

LATE = 1.5
"""A period longer than this many cycles may be a SYNC that waited."""
_AT_ONCE = 0.25
"""A SYNC sooner than this share of a cycle after another one had waited behind it."""
_AHEAD = 256
"""Periods within which the producer has caught up."""
_MOST = 1000
"""Long periods that are looked at in one block."""
_ON_TIME = 0.5
"""Cycles that a SYNC is late at most when the producer has caught up."""
_BUNCHED = 0.5
"""So many of the SYNCs that were held back come at once; the others just sooner than usual."""


def catching_up(periods: NDArray[np.int64], median_ns: float) -> NDArray[np.bool_]:
    """(n,) which periods belong to a wait of the producer, or to its catching up after it.

    A producer whose driver sends in the order of asking (a queue) sends SYNC behind its other
    frames: one of them that waits for a full bus holds it back, and then all SYNCs come at once.

    >>> catching_up(np.array([10, 31, 1, 1, 8, 31, 10]), 10.0).tolist()
    [False, True, True, True, False, False, False]
    """
    found = np.zeros(len(periods), np.bool_)
    at_once = periods < _AT_ONCE * median_ns
    if not at_once.any():
        return found
    done = 0
    for at in np.flatnonzero(periods > LATE * median_ns)[:_MOST].tolist():
        if at < done:
            continue
        late = np.cumsum(periods[at : at + _AHEAD + 1] / median_ns - 1)
        on_time = np.flatnonzero(late < _ON_TIME)
        end = at + int(on_time[0]) + 1 if len(on_time) else at
        if np.count_nonzero(at_once[at:end]) >= max(_BUNCHED * (late[0] - _ON_TIME), 1):
            found[at:end] = True
            done = end
    return found
