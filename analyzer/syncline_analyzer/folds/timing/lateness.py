"""Frames that come late all at once: then the bus was not heard, or the clock was set."""

import numpy as np

from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.pdo_binding import Pdo

_LEARN = 8
_STEADY = 0.1
"""Interquartile range of a steady period, as a share of its median."""
_AS_LATE = 0.8
"""Share of the delay that a silence, or another delay, must have to explain it."""
_STAMP_NS = 1_000_000
"""Stamps of a steady frame are off by less [ns]."""


def others_as_late(block: Block, pdo: Pdo, begin: int, end: int, late_ns: int) -> bool:
    """Whether steady frames of others, too, came about `late_ns` later across one silence.

    Args:
        block: the frames.
        pdo: the PDO that is late; frames of its own node prove nothing.
        begin, end: rows between which it stayed away.
        late_ns: how much later than its period it came.
    """
    t_ns = block.frames.t_ns
    rows = begin + np.flatnonzero(block.frames.bus[begin : end + 1] == pdo.bus)
    apart = np.diff(t_ns[rows])
    if not len(apart) or int(apart.max()) < _AS_LATE * late_ns:
        return False
    after = int(rows[int(np.argmax(apart)) + 1])
    for bus, can_id in block.batch.ids():
        if bus != pdo.bus or can_id & 0x7F == pdo.node:
            continue
        own = block.batch.rows(bus, can_id)
        at = int(np.searchsorted(own, after))
        if len(own) <= _LEARN or not 0 < at < len(own):
            continue
        periods = np.diff(t_ns[own])
        low, usual, high = np.quantile(periods, (0.25, 0.5, 0.75)).tolist()
        delay_ns = int(periods[at - 1]) - usual
        steady = high - low <= max(_STEADY * usual, _STAMP_NS)
        if steady and delay_ns >= max(_AS_LATE * late_ns, 2 * (high - low), _STAMP_NS):
            return True
    return False
