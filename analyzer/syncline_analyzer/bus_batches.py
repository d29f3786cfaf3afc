"""Frames of a capture put together by bus: what is told of one does not depend on the others."""

from collections.abc import Iterator

import numpy as np

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.joining import JOINED_FRAMES
from syncline_schemas.batch import FrameBatch


class BusBatches:
    """Gathers the frames of each bus to batches of equal length.

    Only a gap of the bus itself, and the end, leave one shorter. The frames of another bus, or its
    gaps, thus never change where the frames of a bus are cut.

    Args:
        timed: whether the stamps mean anything.
        frames: frames of a batch.
    """

    def __init__(self, *, timed: bool, frames: int = JOINED_FRAMES) -> None:
        self._timed = timed
        self._wanted = frames
        self._waiting: dict[int, list[IndexedBatch]] = {}

    def add(self, seq: int, frames: FrameBatch) -> Iterator[IndexedBatch]:
        """Take in the next frames, the first of which is at `seq`; the batches that are full now."""
        for bus, part in self._parts(IndexedBatch(frames, seq, timed=self._timed)):
            waiting = self._waiting.setdefault(bus, [])
            waiting.append(part)
            if sum(map(len, waiting)) >= self._wanted:
                whole = IndexedBatch.joined(waiting)
                full = len(whole) - len(whole) % self._wanted
                if full == len(whole) == self._wanted:
                    yield whole
                else:
                    for at in range(0, full, self._wanted):
                        yield whole.part(slice(at, at + self._wanted))
                self._waiting[bus] = [whole.part(slice(full, None))] if full < len(whole) else []

    def flush(self, bus: int | None = None) -> Iterator[IndexedBatch]:
        """What is left of a bus, or of all of them: before a gap, and at the end."""
        for number in sorted(self._waiting) if bus is None else [bus]:
            if waiting := self._waiting.pop(number, []):
                yield IndexedBatch.joined(waiting)

    @staticmethod
    def _parts(batch: IndexedBatch) -> Iterator[tuple[int, IndexedBatch]]:
        """The frames of each bus."""
        numbers = batch.frames.bus
        if not len(numbers):
            return
        if bool((numbers == numbers[0]).all()):
            yield int(numbers[0]), batch
            return
        for bus in np.unique(numbers).tolist():
            yield bus, batch.part(np.flatnonzero(numbers == bus))
