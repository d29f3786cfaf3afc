"""What the capture holds: frames of every kind, and gaps."""

import numpy as np

from syncline_analyzer.extent import Extent
from syncline_analyzer.fold import IndexedBatch
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap

_COUNTED = FrameFlag.ERROR | FrameFlag.REMOTE | FrameFlag.EXTENDED | FrameFlag.FD


class Census:
    """Counts every frame of the capture, and keeps its gaps.

    Attributes:
        frames: all of them; `remote`, `error` and `extended` are those of each kind.
        fd: CAN FD frames by bus number.
        first_ns: first stamp; None without any frame.
        latest_ns: latest stamp, or end of a gap.
        end_ns: where the capture ends by `seq`: where the clock stepped back, that is not its
            latest stamp, and no node was silent until then.
        extent: the stretches of stamps where the clock was set back.
        gaps: in order.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.remote = 0
        self.error = 0
        self.extended = 0
        self.fd: dict[int, int] = {}
        self.first_ns: int | None = None
        self.latest_ns = 0
        self.end_ns = 0
        self.extent = Extent()
        self.gaps: list[Gap] = []

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        if not len(batch):
            return
        t_ns = batch.frames.t_ns
        self.frames += len(batch)
        if batch.flags_seen & _COUNTED:
            self._count(batch.frames)
        if self.first_ns is None:
            self.first_ns = self.latest_ns = int(t_ns[0])
        self.latest_ns = max(self.latest_ns, int(t_ns.max()))
        self.end_ns = int(t_ns[-1])
        self.extent.update(batch.frames)

    def _count(self, frames: FrameBatch) -> None:
        """Take in a batch that does not consist of plain data frames only."""
        error = (frames.flags & FrameFlag.ERROR) != 0
        self.error += int(np.count_nonzero(error))
        self.remote += int(np.count_nonzero(frames.flags[~error] & FrameFlag.REMOTE))
        self.extended += int(np.count_nonzero(frames.flags[~error] & FrameFlag.EXTENDED))
        for bus, count in enumerate(np.bincount(frames.bus[(frames.flags & FrameFlag.FD) != 0])):
            self.fd[bus] = self.fd.get(bus, 0) + int(count)

    def gap(self, gap: Gap) -> None:
        """Take in that nothing was heard for a while."""
        self.gaps.append(gap)
        self.latest_ns = max(self.latest_ns, gap.end_ns)
        self.end_ns = gap.end_ns
