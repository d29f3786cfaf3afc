"""Error frames: what the recorder's own controller said of the bus (SocketCAN error classes)."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from syncline_analyzer.context import Context
from syncline_analyzer.deafness import BUS_OFF, RESTARTED
from syncline_analyzer.fold import IndexedBatch
from syncline_schemas.batch import FrameFlag

MAX_EVENTS = 10_000


class BusError(NamedTuple):
    """The recorder's controller went bus-off, or started again."""

    bus: str
    seq: int
    t_ns: int
    restarted: bool


@dataclass(frozen=True, slots=True)
class BusErrorTable:
    """Changes in order of `seq`, and the number of error frames by bus."""

    events: list[BusError] = field(default_factory=list)
    frames: dict[str, int] = field(default_factory=dict)


class BusErrorFold:
    """Counts error frames and keeps those that tell of bus-off."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._table = BusErrorTable()

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        frames, table = batch.frames, self._table
        rows = np.flatnonzero(frames.flags & FrameFlag.ERROR)
        for bus, count in zip(*np.unique(frames.bus[rows], return_counts=True), strict=True):
            name = self._context.bus_name(int(bus))
            table.frames[name] = table.frames.get(name, 0) + int(count)
        telling = rows[(frames.can_id[rows] & (BUS_OFF | RESTARTED)) != 0]
        for row in telling[: max(0, MAX_EVENTS - len(table.events))].tolist():
            name = self._context.bus_name(int(frames.bus[row]))
            restarted = not frames.can_id[row] & BUS_OFF
            table.events.append(
                BusError(name, batch.seq(row), int(frames.t_ns[row]), bool(restarted))
            )

    def finish(self) -> BusErrorTable:
        """Everything seen."""
        return self._table
