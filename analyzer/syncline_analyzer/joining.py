"""Batches joined to the size at which the analyses are fastest."""

from collections.abc import Iterable, Iterator

from syncline_analyzer.deafness import Numbered
from syncline_schemas.batch import FrameBatch, Gap

JOINED_FRAMES = 65_536
"""Frames from which on nothing more is joined: 2 MB of columns, and each fold costs by the batch."""


def joined(stream: Iterable[Numbered], frames: int = JOINED_FRAMES) -> Iterator[Numbered]:
    """The stream with batches that follow one another in `seq` joined; gaps stay where they are."""
    waiting: list[FrameBatch] = []
    first = held = 0
    for seq, item in stream:
        if waiting and (isinstance(item, Gap) or seq != first + held or held >= frames):
            yield first, FrameBatch.concat(waiting)
            waiting, held = [], 0
        if isinstance(item, Gap):
            yield seq, item
        elif len(item):
            first = first if waiting else seq
            waiting.append(item)
            held += len(item)
    if waiting:
        yield first, FrameBatch.concat(waiting)
