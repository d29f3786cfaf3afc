"""Batches joined to the size at which the analyses are fastest."""

from collections.abc import Iterable, Iterator

from syncline_analyzer.deafness import Numbered
from syncline_schemas.batch import FrameBatch, Gap

JOINED_FRAMES = 65_536
"""Frames of a joined batch: 2 MB of columns, and each fold costs by the batch."""


def joined(stream: Iterable[Numbered], frames: int = JOINED_FRAMES) -> Iterator[Numbered]:
    """The stream in batches of so many frames; fewer only before a gap or break in `seq`, and last.

    How a reader cuts its frames thus never shows in what is told of them.
    """
    waiting: list[FrameBatch] = []
    first = held = 0
    for seq, item in stream:
        if waiting and (isinstance(item, Gap) or seq != first + held):
            yield first, FrameBatch.concat(waiting)
            waiting, held = [], 0
        if isinstance(item, Gap):
            yield seq, item
        elif len(item):
            first = first if waiting else seq
            waiting.append(item)
            held += len(item)
        if held >= frames:
            whole = FrameBatch.concat(waiting)
            for at in range(0, held - frames + 1, frames):
                yield first + at, whole[at : at + frames]
            first, held = first + held - held % frames, held % frames
            waiting = [whole[len(whole) - held :]] if held else []
    if waiting:
        yield first, FrameBatch.concat(waiting)
