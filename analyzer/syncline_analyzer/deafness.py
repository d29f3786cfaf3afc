"""Stretches in which the recorder's own controller heard nothing, put into the stream as gaps."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.can_errors import (
    ERROR_BYTES,
    RECORDER_OFF,
    RECORDER_OVERFLOW,
    Controller,
    ErrorClass,
    classes_of,
)

Numbered = tuple[int, FrameBatch | Gap]
"""A batch or gap with the `seq` of its first row, or of the first row after it."""

OVERFLOW_APART_NS = 100_000_000
"""Overruns that follow one another sooner are one gap [ns]."""
MAX_OVERFLOWS = 1000
"""Gaps by overruns per bus."""


def with_deafness(stream: Iterable[Numbered]) -> Iterator[Numbered]:
    """The stream with a Gap of its bus for every stretch that the recorder did not hear.

    That is from bus-off to the first frame heard, and from the frame before an overrun to the error
    frame that tells of it. Batches are cut where a gap belongs; rows and their `seq` stay as they
    are. A controller that is never heard again is deaf up to the latest stamp of the stream. The
    classes are those of linux/can/error.h. Gaps that the recorder made of the same error frames are
    left out.
    """
    deafness = _Deafness()
    seq, last_ns = 0, 0
    for seq, item in stream:
        if isinstance(item, Gap):
            last_ns = max(last_ns, item.end_ns)
            if item.reason not in (RECORDER_OFF, RECORDER_OVERFLOW):
                yield seq, item
            continue
        begin = 0
        for row, gap in deafness.gaps(item):
            if row > begin:
                yield seq + begin, item[begin:row]
            yield seq + row, gap
            begin = row
        yield seq + begin, item[begin:] if begin else item
        last_ns = max(last_ns, int(item.t_ns.max(initial=0)))
        seq += len(item)
    for bus, since_ns in sorted(deafness.off_ns.items()):
        if last_ns > since_ns:
            yield seq, Gap(since_ns, last_ns, RECORDER_OFF, None, bus)


def without_classes(batch: FrameBatch, buses: Collection[int]) -> FrameBatch:
    """The batch with the error frames of these buses saying only that there was one.

    So do those without eight bytes: SocketCAN's always have them (linux/can/error.h), those that
    other drivers hand to python-can often have not.
    """
    if not batch.flags_seen & FrameFlag.ERROR:
        return batch
    rows = (batch.flags & FrameFlag.ERROR) != 0
    rows &= np.isin(batch.bus, list(buses)) | (batch.dlc != ERROR_BYTES)
    if not rows.any():
        return batch
    data = np.where(rows[:, np.newaxis], np.uint8(0), batch.data)
    return replace(batch, can_id=np.where(rows, np.uint32(0), batch.can_id), data=data)


_NONE = np.zeros(0, np.intp)


class _Deafness:
    """Finds the gaps of each batch; `off_ns` holds since when each bus is deaf."""

    def __init__(self) -> None:
        self.off_ns: dict[int, int] = {}
        self._overflows: dict[int, tuple[int, int]] = {}
        """Time of the last overrun and number of gaps made of them, by bus."""
        self._last_ns: dict[int, int] = {}
        """Time of the last frame of each bus."""

    def gaps(self, batch: FrameBatch) -> list[tuple[int, Gap]]:
        """(row before which it belongs, gap) in order."""
        any_error = batch.flags_seen & FrameFlag.ERROR
        errors = np.flatnonzero(batch.flags & FrameFlag.ERROR) if any_error else _NONE
        found: list[tuple[int, Gap]] = []
        if len(errors) or self.off_ns:
            classes = classes_of(batch.can_id[errors])
            switched = errors[(classes & ErrorClass.BUS_OFF) != 0]
            started = errors[
                (classes & (ErrorClass.BUS_OFF | ErrorClass.RESTARTED)) == ErrorClass.RESTARTED
            ]
            for bus in sorted({*self.off_ns, *batch.bus[switched].tolist()}):
                off_rows = switched[batch.bus[switched] == bus]
                found.extend(self._off(batch, bus, off_rows, started))
            overrun = (batch.data[errors, 1] & Controller.RX_OVERFLOW) != 0
            overrun &= (classes & ErrorClass.CONTROLLER) != 0
            found.extend(self._overrun(batch, errors[overrun]))
        self._last_ns |= _last_ns(batch)
        return sorted(found, key=lambda entry: entry[0])

    def _off(
        self,
        batch: FrameBatch,
        bus: int,
        off_rows: NDArray[np.intp],
        started: NDArray[np.intp],
    ) -> Iterator[tuple[int, Gap]]:
        hearing = (batch.bus == bus) & ((batch.flags & FrameFlag.ERROR) == 0)
        hearing[started[batch.bus[started] == bus]] = True
        heard = np.flatnonzero(hearing)
        row = 0
        while True:
            if bus not in self.off_ns:
                later = off_rows[np.searchsorted(off_rows, row) :]
                if not len(later):
                    return
                row = int(later[0])
                self.off_ns[bus] = int(batch.t_ns[row])
            back = heard[np.searchsorted(heard, row) :]
            if not len(back):
                return
            row = int(back[0])
            since_ns = self.off_ns.pop(bus)
            if batch.t_ns[row] > since_ns:
                yield row, Gap(since_ns, int(batch.t_ns[row]), RECORDER_OFF, None, bus)

    def _overrun(self, batch: FrameBatch, rows: NDArray[np.intp]) -> Iterator[tuple[int, Gap]]:
        for row in rows.tolist():
            bus, t_ns = int(batch.bus[row]), int(batch.t_ns[row])
            last_ns, count = self._overflows.get(bus, (None, 0))
            if count >= MAX_OVERFLOWS or (
                last_ns is not None and 0 <= t_ns - last_ns < OVERFLOW_APART_NS
            ):
                continue
            self._overflows[bus] = t_ns, count + 1
            before = np.flatnonzero(batch.bus[:row] == bus)
            start_ns = int(batch.t_ns[before[-1]]) if len(before) else self._last_ns.get(bus)
            if start_ns is not None and start_ns < t_ns:
                yield row, Gap(start_ns, t_ns, RECORDER_OVERFLOW, None, bus)


def _last_ns(batch: FrameBatch) -> dict[int, int]:
    """Time of the last frame of each bus."""
    if not len(batch):
        return {}
    if (batch.bus == batch.bus[0]).all():
        return {int(batch.bus[0]): int(batch.t_ns[-1])}
    buses = np.flatnonzero(np.bincount(batch.bus)).tolist()
    return {bus: int(batch.t_ns[batch.bus == bus][-1]) for bus in buses}
