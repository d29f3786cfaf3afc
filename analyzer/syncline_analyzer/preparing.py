"""From the frames of captures to what the analyses are fed with: all that needs no analysis yet."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import field
from typing import Protocol

from syncline_analyzer.bus_batches import BusBatches
from syncline_analyzer.capture import CaptureFacts, time_base
from syncline_analyzer.census import Census
from syncline_analyzer.deafness import Numbered, with_deafness, without_classes
from syncline_analyzer.echo import Doubling, Echoes, hidden
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.timing.silence import SilenceFold
from syncline_analyzer.folds.timing.silences import Silences
from syncline_analyzer.joining import joined
from syncline_analyzer.spacings import SpacingGauge, Spacings
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class Step:
    """What the next frames, or the next gap, of a stream bring the analyses.

    Attributes:
        frames: all frames of the stream up to here.
        batches: of one bus each, as they become full; before a gap also those that are not.
        gap: comes after the batches.
        spacings: of the first frames of each bus.
        last: whether this is the end of the stream; every stream has one.
    """

    frames: int
    batches: list[IndexedBatch]
    gap: Gap | None = None
    spacings: list[Spacings] = field(default_factory=list)
    last: bool = False


class Prepared(Protocol):
    """A stream on its way to the analyses.

    Attributes:
        facts: of every file; complete once the steps are gone through.
        buses: names by bus number; may grow with every step.
        census: what was counted; complete at the end, like `doubled` and `silence`.
        doubled: by bus number, what the capture holds twice.
        silence: stretches in which nothing was heard of a whole bus.
    """

    facts: Sequence[CaptureFacts]
    buses: list[str]
    census: Census
    doubled: dict[int, Doubling]
    silence: SilenceFold

    def steps(self) -> Iterator[Step]:
        """All steps, once."""
        ...


class Preparation:
    """The stream of one process as `Prepared`: joined, parted by bus, copies hidden.

    Args:
        stream: batches and gaps in capture order.
        facts, buses: as in `Prepared`.
    """

    def __init__(
        self, stream: Iterable[Numbered], facts: Sequence[CaptureFacts], buses: list[str]
    ) -> None:
        self.facts = facts
        self.buses = buses
        self.census = Census()
        self._echoes = Echoes(lambda: max((each.resolution_ns for each in facts), default=1))
        self.doubled = self._echoes.doubled
        self.silence = SilenceFold()
        self._stream = stream

    def steps(self) -> Iterator[Step]:
        """All steps, once."""
        timed = time_base(self.facts) != "none"
        items = joined(with_deafness(self._told_errors()), timed=timed)
        batches, gauge = BusBatches(timed=timed), SpacingGauge(timed)
        silences = Silences(timed=timed)
        self.silence = silences.found
        for item in self._echoes.marked(items) if timed else items:
            if isinstance(item, Gap):
                gauge.gap(item)
                self.census.gap(item)
                left = list(silences.through(batches.flush(item.bus)))
                silences.gap(item)
                yield Step(self.census.frames, left, item)
            else:
                self.census.update(item)
                spacings = gauge.measured(item)
                full = list(silences.through(batches.add(item.showing(hidden(item.frames)))))
                yield Step(self.census.frames, full, spacings=spacings)
        left = list(silences.through(batches.flush()))
        silences.close()
        yield Step(self.census.frames, left, last=True)

    def _told_errors(self) -> Iterator[Numbered]:
        """The stream without error classes that are not SocketCAN's."""
        for seq, item in self._stream:
            if isinstance(item, FrameBatch):
                names = {name for each in self.facts for name in each.foreign_errors}
                foreign = [number for number, name in enumerate(self.buses) if name in names]
                yield seq, without_classes(item, foreign)
            else:
                yield seq, item
