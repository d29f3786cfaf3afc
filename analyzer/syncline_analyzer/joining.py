"""Batches joined to the size at which the analyses are fastest."""

from collections.abc import Iterable, Iterator

from syncline_analyzer.deafness import Numbered
from syncline_analyzer.fold import IndexedBatch
from syncline_schemas.batch import Gap

JOINED_FRAMES = 131_072
"""Frames of a joined batch: 3 MB of columns, and each fold costs by the batch."""


class Joiner:
    """Gathers frames to batches of equal length.

    Args:
        timed: whether the stamps mean anything.
        frames: frames of a batch.
    """

    def __init__(self, *, timed: bool, frames: int = JOINED_FRAMES) -> None:
        self._timed = timed
        self._wanted = frames
        self._waiting: list[IndexedBatch] = []
        self._held = 0

    def add(self, batch: IndexedBatch) -> Iterator[IndexedBatch]:
        """Take in the next frames; the batches that are full now."""
        begin = 0
        while self._held + len(batch) - begin >= self._wanted:
            stop = begin + self._wanted - self._held
            self._waiting.append(batch.part(slice(begin, stop)))
            yield from self.flush()
            begin = stop
        if begin < len(batch):
            self._waiting.append(batch.part(slice(begin, len(batch))))
            self._held += len(batch) - begin

    def flush(self) -> Iterator[IndexedBatch]:
        """What is left, as one batch."""
        if self._waiting:
            waiting, self._waiting, self._held = self._waiting, [], 0
            yield IndexedBatch.joined(waiting)

    @property
    def next_seq(self) -> int | None:
        """The `seq` after the frames that wait; None where none do."""
        return self._waiting[-1].last_seq + 1 if self._waiting else None


def joined(
    stream: Iterable[Numbered], *, timed: bool = True, frames: int = JOINED_FRAMES
) -> Iterator[IndexedBatch | Gap]:
    """The stream in batches of so many frames; fewer only before a gap or break in `seq`, and last.

    How a reader cuts its frames thus never shows in what is told of them.
    """
    joiner = Joiner(timed=timed, frames=frames)
    for seq, item in stream:
        if isinstance(item, Gap) or joiner.next_seq not in (None, seq):
            yield from joiner.flush()
        if isinstance(item, Gap):
            yield item
        else:
            yield from joiner.add(IndexedBatch(item, seq, timed=timed))
    yield from joiner.flush()
