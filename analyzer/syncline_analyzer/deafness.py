"""Stretches in which the recorder's own controller was bus-off, put into the stream as gaps."""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag, Gap

Numbered = tuple[int, FrameBatch | Gap]
"""A batch or gap with the `seq` of its first row, or of the first row after it."""

BUS_OFF = 0x40
"""Error class of SocketCAN: the controller has switched itself off and hears nothing."""
RESTARTED = 0x100
"""Error class of SocketCAN: the controller takes part again."""
RECORDER_OFF = "recorder bus-off"
"""`reason` of the gaps that are put in."""


def with_deafness(stream: Iterable[Numbered]) -> Iterator[Numbered]:
    """The stream with a Gap of its bus for every stretch from bus-off to the first frame heard.

    Batches are cut where a gap belongs; rows and their `seq` stay as they are. A controller that
    is never heard again is deaf up to the latest stamp of the stream. The classes are those of
    linux/can/error.h.
    """
    off_ns: dict[int, int] = {}
    seq, last_ns = 0, 0
    for seq, item in stream:
        if isinstance(item, Gap):
            last_ns = max(last_ns, item.end_ns)
            yield seq, item
            continue
        begin = 0
        for row, gap in _gaps(item, off_ns):
            if row > begin:
                yield seq + begin, item[begin:row]
            yield seq + row, gap
            begin = row
        yield seq + begin, item[begin:] if begin else item
        last_ns = max(last_ns, int(item.t_ns.max(initial=0)))
        seq += len(item)
    for bus, since_ns in sorted(off_ns.items()):
        if last_ns > since_ns:
            yield seq, Gap(since_ns, last_ns, RECORDER_OFF, None, bus)


def _gaps(batch: FrameBatch, off_ns: dict[int, int]) -> list[tuple[int, Gap]]:
    """(row before which it belongs, gap) in order; `off_ns` holds since when each bus is deaf."""
    errors = np.flatnonzero(batch.flags & FrameFlag.ERROR)
    switched = errors[(batch.can_id[errors] & BUS_OFF) != 0]
    if not len(switched) and not off_ns:
        return []
    found: list[tuple[int, Gap]] = []
    for bus in {*off_ns, *batch.bus[switched].tolist()}:
        off_rows = switched[batch.bus[switched] == bus]
        found.extend(_gaps_of(batch, bus, off_rows, off_ns))
    return sorted(found, key=lambda entry: entry[0])


def _gaps_of(
    batch: FrameBatch, bus: int, off_rows: NDArray[np.intp], off_ns: dict[int, int]
) -> Iterator[tuple[int, Gap]]:
    hearing = (batch.bus == bus) & ((batch.flags & FrameFlag.ERROR) == 0)
    restarted = (batch.flags & FrameFlag.ERROR) != 0
    restarted &= (batch.can_id & (RESTARTED | BUS_OFF)) == RESTARTED
    heard = np.flatnonzero(hearing | (restarted & (batch.bus == bus)))
    row = 0
    while True:
        if bus not in off_ns:
            later = off_rows[np.searchsorted(off_rows, row) :]
            if not len(later):
                return
            row = int(later[0])
            off_ns[bus] = int(batch.t_ns[row])
        back = heard[np.searchsorted(heard, row) :]
        if not len(back):
            return
        row = int(back[0])
        since_ns = off_ns.pop(bus)
        if batch.t_ns[row] > since_ns:
            yield row, Gap(since_ns, int(batch.t_ns[row]), RECORDER_OFF, None, bus)
