"""SYNCs that a recorder had kept and delivered at once: their stamps tell nothing of the bus."""

import numpy as np
from numpy.typing import NDArray

MANY = 3
"""So many periods in a row make a backlog."""
TOO_SHORT = 0.5
"""A period shorter than this share of the median leaves a PDO no time, or is no true period."""
PAUSE = 10.0
"""A period longer than this many medians is a pause of the producer or of the whole bus."""
_FULL = 1.5
"""Frames that follow one another on the wire take no longer than this many times their length."""
_IDLE = 2.0
"""A pause lasts longer than this many times its frames, or the bus was busy meanwhile."""
_FASTEST_BIT_NS = 1000
"""No CAN bus is faster, and none of CANopen needs to be."""

Ints = NDArray[np.int64]


def backlog(
    periods: Ints,
    bits: Ints,
    median_ns: float,
    *,
    begins: bool,
    bit_ns: float | None = None,
    resolution_ns: int = 1,
) -> NDArray[np.bool_]:
    """Which SYNC periods were delivered at once, at the start of listening or after a pause.

    They are much shorter than the median, one after the other, and full of frames at the spacing
    of the wire or closer. The period that leads from them to the first true one belongs to them.
    In a pause of the recorder there are few frames: where the bus was full meanwhile, it was SYNC
    that had to wait.

    Args:
        periods: (n,) SYNC periods [ns].
        bits: (n,) bits of all frames in each period.
        median_ns: median of the true periods; 0 when it is not known.
        begins: whether listening began with the first period.
        bit_ns: length of a bit, where the bit rate is known.
        resolution_ns: step of the stamps.
    """
    found = np.zeros(len(periods), np.bool_)
    if not len(periods) or not median_ns > 0:
        return found
    starts = np.flatnonzero(periods > PAUSE * median_ns) + 1
    for start in [0, *starts.tolist()] if begins else starts.tolist():
        count = _leading(periods[start:] < TOO_SHORT * median_ns)
        per_bit = periods[start : start + count] / np.maximum(bits[start : start + count], 1)
        wire_ns = bit_ns or (float(np.median(per_bit)) if count else 0.0)
        step = resolution_ns / np.maximum(bits[start : start + count], 1)
        full = _leading(per_bit - step <= np.maximum(_FULL * wire_ns, _FASTEST_BIT_NS))
        if start and periods[start - 1] < _IDLE * bits[start - 1] * wire_ns:
            continue
        if full >= MANY:
            found[start : start + full + 1] = True
    return found


def _leading(yes: NDArray[np.bool_]) -> int:
    """How many are True before the first that is not.

    >>> _leading(np.array([True, True, False, True]))
    2
    """
    return int(np.argmin(yes)) if len(yes) and not yes.all() else len(yes)
