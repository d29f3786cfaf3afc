"""The silences of every bus of a stream: they need its frames alone, and no other analysis."""

from collections.abc import Iterable, Iterator

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.timing.block import BLOCK_FRAMES, Block, Blocks
from syncline_analyzer.folds.timing.silence import SilenceFold
from syncline_schemas.batch import Gap


class Silences:
    """Feeds a `SilenceFold`, wherever the frames are prepared.

    Attributes:
        found: the fold; complete once the stream is closed.

    Args:
        timed: whether the stamps mean anything; nothing is found where they do not.
        block_frames: frames of a block.
    """

    def __init__(self, *, timed: bool, block_frames: int = BLOCK_FRAMES) -> None:
        self.found = SilenceFold()
        self._timed = timed
        self._blocks = Blocks(block_frames)

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        if self._timed:
            self._take(self._blocks.add(batch))

    def through(self, batches: Iterable[IndexedBatch]) -> Iterator[IndexedBatch]:
        """The batches, each taken in."""
        for batch in batches:
            self.update(batch)
            yield batch

    def gap(self, gap: Gap) -> None:
        """A gap is no silence."""
        self.close()
        self.found.gap(gap.bus)

    def close(self) -> None:
        """Take in what waits for more frames."""
        self._take(self._blocks.flush())

    def _take(self, blocks: list[Block]) -> None:
        for block in blocks:
            for bus in block.by_bus:
                self.found.update(block, bus)
