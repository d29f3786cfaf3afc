"""Frames of a capture put together by bus: what is told of one does not depend on the others."""

from collections.abc import Iterator

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.joining import JOINED_FRAMES, Joiner


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
        self._joiners: dict[int, Joiner] = {}

    def add(self, batch: IndexedBatch) -> Iterator[IndexedBatch]:
        """Take in the next frames; the batches that are full now."""
        for bus in batch.buses:
            if bus not in self._joiners:
                self._joiners[bus] = Joiner(timed=self._timed, frames=self._wanted)
            yield from self._joiners[bus].add(batch.of_bus(bus))

    def flush(self, bus: int | None = None) -> Iterator[IndexedBatch]:
        """What is left of a bus, or of all of them: before a gap, and at the end."""
        for number in sorted(self._joiners) if bus is None else [bus]:
            if number in self._joiners:
                yield from self._joiners[number].flush()
