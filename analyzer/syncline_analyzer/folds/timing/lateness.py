"""Frames that come late all at once: then the bus was not heard, or the clock was set."""

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distinct import distinct
from syncline_analyzer.distribution import quantile_of
from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.pdo_binding import Pdo
from syncline_schemas.named_tuples import NamedTuple

_LEARN = 8
_STEADY = 0.1
"""Interquartile range of a steady period, as a share of its median."""
_AS_LATE = 0.8
"""Share of the delay that a silence, or another delay, must have to explain it."""
_STAMP_NS = 1_000_000
"""Stamps of a steady frame are off by less [ns]."""
_MANY = 100
"""So many periods of SYNC that may hold a step of the clock are looked at in a block."""
_ANSWERS = 64
"""So many frames behind the step are looked at."""
_STAYS = 0.5
"""Share of the delay by which the next SYNC may come early; more, and it was only late."""


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


class ClockSet(NamedTuple):
    """The recorder's clock was set forward between two frames, as so many identifiers show.

    `sync` is the place of the SYNC before among those of the block; `start` and `end` are rows.
    """

    sync: int
    by_ns: int
    start: int
    end: int
    witnesses: int


def clock_set(block: Block, bus: int, syncs: NDArray[np.intp]) -> list[ClockSet]:
    """Where the recorder's clock was set forward between a SYNC and its answers.

    After a silence in that period the answers of two nodes and the next SYNC come later by the same
    time, and SYNC stays with it. A SYNC that only came late would be followed by a short period, and
    no answer waits as long as the SYNC after it.

    Args:
        block: the frames.
        bus: its number.
        syncs: (m,) rows of the SYNCs.
    """
    t_ns = block.frames.t_ns[syncs]
    periods = t_ns[1:] - t_ns[:-1]
    if len(periods) <= _LEARN or int(periods.max()) - int(periods.min()) <= _STAMP_NS:
        return []
    low, usual, high = (quantile_of(periods, share) for share in (0.05, 0.5, 0.95))
    late = periods - usual
    after = np.append(periods[1:], usual)
    may = (late > max(_STAMP_NS, 2 * (high - low))) & (np.abs(after - usual) <= _STAYS * late)
    if not may.any():
        return []
    rows = np.arange(len(block.frames))[block.by_bus[bus]]
    found = []
    for at in np.flatnonzero(may)[:_MANY].tolist():
        first, stop = np.searchsorted(rows, (syncs[at], syncs[at + 1])).tolist()
        between = rows[first:stop]
        apart = np.diff(block.frames.t_ns[between])
        if not len(apart) or int(apart.max()) < _AS_LATE * late[at]:
            continue
        start = int(np.argmax(apart))
        as_late = _as_late(block, bus, between[start + 1 :][:_ANSWERS], int(late[at]))
        if len({can_id & 0x7F for can_id in as_late}) > 1:
            rows_around = int(between[start]), int(between[start + 1])
            found.append(ClockSet(at, int(late[at]), *rows_around, len(as_late) + 1))
    return found


def _as_late(block: Block, bus: int, behind: NDArray[np.intp], late_ns: int) -> list[int]:
    """Identifiers of steady frames behind a silence; none unless all of them are as late."""
    as_late = []
    for can_id in distinct(block.frames.can_id[behind]):
        own = block.batch.rows(bus, can_id)
        at = int(np.searchsorted(own, behind[0]))
        if len(own) <= _LEARN or not 0 < at < len(own):
            continue
        periods = np.diff(block.frames.t_ns[own])
        low, usual, high = np.quantile(periods, (0.25, 0.5, 0.75)).tolist()
        if high - low > max(_STEADY * usual, _STAMP_NS):
            continue
        off_ns = abs(int(periods[at - 1]) - usual - late_ns)
        if off_ns > max((1 - _AS_LATE) * late_ns, 2 * (high - low)):
            return []
        as_late.append(can_id)
    return as_late
