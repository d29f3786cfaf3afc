"""What the capture holds: frames of every kind, gaps, and what reading it told."""

from collections.abc import Sequence

import numpy as np

from syncline_analyzer.capture import CaptureFacts, TimeBase
from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.results import CaptureRow, GapRow, MarkRow
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.wording import counted

_COUNTED = FrameFlag.ERROR | FrameFlag.REMOTE | FrameFlag.EXTENDED | FrameFlag.FD


def time_base(facts: Sequence[CaptureFacts]) -> TimeBase:
    """What the stamps of all files count from, "none" where the files do not agree."""
    bases: set[TimeBase] = {each.time_base for each in facts}
    return bases.pop() if len(bases) == 1 else "none"


class Census:
    """Counts every frame of the capture, and keeps its gaps.

    `end_ns` is where the capture ends by `seq`: where the clock stepped back, that is not its
    latest stamp, and no node was silent until then.
    """

    def __init__(self) -> None:
        self.frames = 0
        self._remote = 0
        self._error = 0
        self._extended = 0
        self._fd: dict[int, int] = {}
        self._first_ns: int | None = None
        self._latest_ns = 0
        self.end_ns = 0
        self._gaps: list[Gap] = []

    def update(self, batch: IndexedBatch) -> None:
        if not len(batch):
            return
        t_ns = batch.frames.t_ns
        self.frames += len(batch)
        if batch.flags_seen & _COUNTED:
            self._count(batch.frames)
        if self._first_ns is None:
            self._first_ns = self._latest_ns = int(t_ns[0])
        self._latest_ns = max(self._latest_ns, int(t_ns.max()))
        self.end_ns = int(t_ns[-1])

    def _count(self, frames: FrameBatch) -> None:
        """Take in a batch that does not consist of plain data frames only."""
        error = (frames.flags & FrameFlag.ERROR) != 0
        self._error += int(np.count_nonzero(error))
        self._remote += int(np.count_nonzero(frames.flags[~error] & FrameFlag.REMOTE))
        self._extended += int(np.count_nonzero(frames.flags[~error] & FrameFlag.EXTENDED))
        for bus, count in enumerate(np.bincount(frames.bus[(frames.flags & FrameFlag.FD) != 0])):
            self._fd[bus] = self._fd.get(bus, 0) + int(count)

    def gap(self, gap: Gap) -> None:
        self._gaps.append(gap)
        self._latest_ns = max(self._latest_ns, gap.end_ns)
        self.end_ns = gap.end_ns

    def row(
        self, facts: Sequence[CaptureFacts], context: Context, origin_ns: int | None
    ) -> CaptureRow:
        first_ns = self._first_ns or 0
        dated = time_base(facts) == "utc" and self._first_ns is not None
        return CaptureRow(
            files=[str(each.path) for each in facts],
            frames=self.frames,
            data_frames=self.frames - self._remote - self._error,
            remote_frames=self._remote,
            error_frames=self._error,
            extended_frames=self._extended,
            unparsed_lines=sum(each.unparsed_count for each in facts),
            start_utc_ns=first_ns if dated else None,
            duration_ns=self._latest_ns - first_ns if self.frames else 0,
            buses=list(context.buses),
            gaps=[_gap_row(gap, context) for gap in self._gaps],
            first_ns=first_ns if origin_ns is None else origin_ns,
            cut_ns=self._first_ns if origin_ns not in (None, self._first_ns) else None,
            time_base=time_base(facts),
            resolution_ns=context.resolution_ns,
            notes=[note for each in facts for note in each.notes]
            + _strangers(context)
            + self._fd_notes(context),
            damage=[f"{each.path}: {each.damage}" for each in facts if each.damage],
            marks=_marks(facts),
        )

    def _fd_notes(self, context: Context) -> list[str]:
        return [
            f"CAN FD on {context.bus_name(bus)} ({counted(count, 'frame')}) counts as load only:"
            " CANopen FD is not read"
            for bus, count in sorted(self._fd.items())
            if count
        ]


def _marks(facts: Sequence[CaptureFacts]) -> list[MarkRow]:
    """What the recorder marked, in order of time."""
    rows = [
        MarkRow(each.t_ns, each.reason, _name(about.buses, each.bus), each.node)
        for about in facts
        for each in about.marks
    ]
    return sorted(rows, key=lambda row: row.t_ns)


def _name(buses: Sequence[str], number: int | None) -> str | None:
    return buses[number] if number is not None and number < len(buses) else None


def _strangers(context: Context) -> list[str]:
    """Buses that the description names and the capture does not hold: most likely a slip."""
    described = {
        *context.description.bitrates,
        *(bus for bus, _ in context.description.nodes if bus),
    }
    return [
        f"the bus description names {bus}, which is not in this capture"
        for bus in sorted(described - set(context.buses))
    ]


def _gap_row(gap: Gap, context: Context) -> GapRow:
    bus = None if gap.bus is None else context.bus_name(gap.bus)
    return GapRow(gap.start_ns, gap.end_ns, gap.reason, gap.lost_frames, bus)
