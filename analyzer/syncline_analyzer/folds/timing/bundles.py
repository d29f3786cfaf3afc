"""Frames that a recorder hands over in bundles: single stamps tell little, many together do."""

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.block import Block
from syncline_schemas import native

CLOSER_NS = 40_000
"""No two frames can follow one another so soon on any bus: 44 bits at 1 Mbit/s and more [ns]."""
_SHARE = 0.2
"""So many of a bus's frames make the stamps those of bundles."""
_TOGETHER = 32
"""Periods that are looked at together."""
_BESIDE = 8
"""Periods on either side that may make up for a long one."""

Ints = NDArray[np.int64]


def bundled(block: Block, bus: int) -> bool:
    """Whether the frames of a bus are stamped closer than any wire can carry them."""
    if bus not in block.by_bus:
        return False
    t_ns = block.frames.t_ns[block.by_bus[bus]]
    return len(t_ns) > 1 and _sooner(t_ns) / (len(t_ns) - 1) > _SHARE


def _sooner(t_ns: Ints) -> int:
    """How many of (n,) stamps come closer after the one before than frames can."""
    if native.available():
        return native.sooner(t_ns, CLOSER_NS)
    apart = t_ns[1:] - t_ns[:-1]
    # As unsigned numbers, negative times are longer than any other.
    return int(np.count_nonzero(apart.view(np.uint64) < CLOSER_NS))


def paced(periods: Ints) -> float:
    """The period [ns] by the time of many together, which bundles do not change; 0 without any."""
    count = min(_TOGETHER, len(periods))
    if not count:
        return 0.0
    total = np.concatenate(([0], np.cumsum(periods)))
    return float(np.median(total[count:] - total[:-count])) / count


def lacking(cycles: NDArray[np.float64], blur: float = 0.0) -> Ints:
    """(n,) how many more cycles the time around each period holds than there are periods.

    Args:
        cycles: (n,) periods in cycles.
        blur: how many cycles the first and the last stamp may be off.

    >>> lacking(np.array([1, 1, 3, 1.0])), lacking(np.array([1, 2.8, 0.2, 0, 1]))
    (array([2, 2, 2, 2]), array([0, 0, 0, 0, 0]))
    """
    at = np.arange(len(cycles))
    first, stop = np.maximum(at - _BESIDE, 0), np.minimum(at + _BESIDE + 1, len(cycles))
    total = np.concatenate(([0.0], np.cumsum(cycles)))
    more: Ints = np.rint(total[stop] - total[first] - blur).astype(np.int64) - (stop - first)
    return np.maximum(more, 0)
