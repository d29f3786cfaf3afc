"""A session frame by frame, in words."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from syncline_analyzer.capture import CaptureFacts, time_base
from syncline_analyzer.deafness import Numbered, with_deafness, without_classes
from syncline_analyzer.decode.choice import Choice
from syncline_analyzer.decode.decoder import FrameDecoder
from syncline_analyzer.decode.part import Part
from syncline_analyzer.engine import Progress
from syncline_analyzer.first_context import first_context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.joining import joined
from syncline_analyzer.opened import Opened
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.records import dataclass

FRAMES = 16_384
"""Frames of a batch: the first lines come soon, and equal frames are still put into words once."""


@dataclass(frozen=True, slots=True, eq=False)
class DecodedBatch:
    """Frames, and the words for those of them that are wanted."""

    batch: IndexedBatch
    parts: list[Part]


class Decoding:
    """The words of a session's frames.

    Everything is read from the start on, whatever is wanted: what a PDO carries may have been
    told long before.
    """

    def __init__(self, opened: Opened, choice: Choice) -> None:
        self._opened = opened
        self._choice = replace(
            choice,
            low_ns=max(choice.low_ns, opened.low_ns),
            high_ns=min(choice.high_ns, opened.high_ns),
        )
        self._context = first_context(
            opened.facts, opened.buses, opened.description, opened.devices
        )
        self._decoder = FrameDecoder(self._context, opened.redaction)

    @property
    def timed(self) -> bool:
        """Whether the stamps mean anything."""
        return self._context.timed

    @property
    def live(self) -> bool:
        """Whether frames come while they happen."""
        return self._opened.live

    @property
    def dated(self) -> bool:
        """Whether the stamps are UTC."""
        return time_base(self._opened.facts) == "utc"

    @property
    def buses(self) -> int:
        """How many buses there are, as far as is known by now."""
        return len(
            {*self._opened.buses, *(bus for each in self._opened.facts for bus in each.buses)}
        )

    def bus_name(self, bus: int) -> str:
        """Name of a bus by its number."""
        return self._context.bus_name(bus)

    def label(self, bus: int, node: int) -> str:
        """A node by number and name."""
        return self._decoder.label(bus, node)

    def items(self, progress: Progress | None = None) -> Iterator[DecodedBatch | Gap]:
        """Batches and gaps in the order of the capture."""
        choice, frames = self._choice, 0
        stream = with_deafness(_told_errors(self._opened))
        batches = _single(stream, self.timed) if self._opened.live else None
        for item in batches or joined(stream, timed=self.timed, frames=FRAMES):
            if isinstance(item, Gap):
                self._decoder.gap(item)
                if choice.gap(item.start_ns, item.end_ns):
                    yield item
                continue
            if choice.over(item):
                return
            yield DecodedBatch(item, list(self._decoder.update(item, choice)))
            frames += len(item)
            if progress:
                progress(frames)


def _single(stream: Iterator[Numbered], timed: bool) -> Iterator[IndexedBatch | Gap]:
    """The stream in batches as they come, none of which waits for the next."""
    for seq, item in stream:
        if isinstance(item, Gap):
            yield item
        elif len(item):
            yield IndexedBatch(item, seq, timed=timed)


def _told_errors(opened: Opened) -> Iterator[Numbered]:
    """The stream without error classes that are not SocketCAN's."""
    facts: Sequence[CaptureFacts] = opened.facts
    for seq, item in opened.stream:
        if isinstance(item, FrameBatch):
            names = {name for each in facts for name in each.foreign_errors}
            foreign = [number for number, name in enumerate(opened.buses) if name in names]
            yield seq, without_classes(item, foreign)
        else:
            yield seq, item
