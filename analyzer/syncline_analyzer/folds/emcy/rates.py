"""EMCYs that come too often: storms, and messages inside the inhibit time 1015h."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.named_tuples import NamedTuple

STORM_COUNT = 10
"""More EMCYs of one node than this within one second are a storm (analysis.md 6)."""
STORM_NS = 1_000_000_000
INHIBIT_UNIT_NS = 100_000
"""1015h counts multiples of 100 us (CiA 301 7.5.2.18)."""


class Storm(NamedTuple):
    """A stretch with more than ten EMCYs of a node in every second of it."""

    bus: str
    node: int
    start_ns: int
    end_ns: int
    number: int
    first_seq: int


class TooSoon(NamedTuple):
    """Two EMCYs of a node closer than its inhibit time 1015h, and who said that time."""

    bus: str
    node: int
    seq: int
    t_ns: int
    passed_us: float
    inhibit_us: float
    source: str = ""


class Inhibit(NamedTuple):
    """Inhibit time of a node from a `seq` on."""

    seq: int
    inhibit_ns: int
    source: str


def storms(bus: str, node: int, seqs: Sequence[int], times_ns: Sequence[int]) -> list[Storm]:
    """Runs of messages in which each one has ten others within the second before it."""
    times = np.array(times_ns, np.int64)
    if len(times) <= STORM_COUNT:
        return []
    dense = times[STORM_COUNT:] - times[:-STORM_COUNT]
    ends = np.flatnonzero((dense >= 0) & (dense < STORM_NS)) + STORM_COUNT
    return [
        _storm(bus, node, seqs, times, int(run[0]) - STORM_COUNT, int(run[-1]))
        for run in np.split(ends, np.flatnonzero(np.diff(ends) > 1) + 1)
        if len(run)
    ]


def _storm(
    bus: str, node: int, seqs: Sequence[int], times: NDArray[np.int64], first: int, last: int
) -> Storm:
    number = last - first + 1
    return Storm(bus, node, int(times[first]), int(times[last]), number, seqs[first])


def too_soon(
    bus: str,
    node: int,
    seqs: Sequence[int],
    times_ns: Sequence[int],
    inhibits: Sequence[Inhibit],
    resolution_ns: int,
) -> list[TooSoon]:
    """Messages that follow the one before sooner than the inhibit time that holds at that moment.

    Args:
        inhibits: what is known of 1015h, in order of `seq`; before the first nothing is known.
        resolution_ns: step of the stamps, which may shorten what was measured.
    """
    if not inhibits or len(seqs) < 2:
        return []
    passed = np.diff(np.array(times_ns, np.int64))
    place = np.searchsorted([entry.seq for entry in inhibits], seqs[1:], side="left") - 1
    known = np.array([entry.inhibit_ns for entry in inhibits] + [0], np.int64)[place]
    short = (passed >= 0) & (passed < known - resolution_ns - known // 100)
    return [
        TooSoon(
            bus,
            node,
            seqs[row + 1],
            times_ns[row + 1],
            int(passed[row]) / 1e3,
            inhibits[place[row]].inhibit_ns / 1e3,
            inhibits[place[row]].source,
        )
        for row in np.flatnonzero(short).tolist()
    ]
