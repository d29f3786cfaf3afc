"""What another process reads of captures, as the analyses take it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from syncline_analyzer.batch_transfer import unpacked
from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.census import Census
from syncline_analyzer.echo import Doubling
from syncline_analyzer.folds.timing.silence import SilenceFold
from syncline_analyzer.preparing import Step
from syncline_analyzer.reading_child import ReadingChild
from syncline_analyzer.reading_messages import End, News, Opened
from syncline_schemas.memory import keep_freed_memory


class RemoteReading:
    """A `Reading` of what a child sends."""

    def __init__(self, opened: Opened, child: ReadingChild) -> None:
        self.facts: Sequence[CaptureFacts] = opened.facts
        self.buses = opened.buses
        self.origin_ns = opened.origin_ns
        self.census = Census()
        self.doubled: dict[int, Doubling] = {}
        self.silence = SilenceFold()
        self.veil = opened.veil
        self._child = child

    def steps(self) -> Iterator[Step]:
        """All steps, once."""
        keep_freed_memory()
        while not isinstance(message := self._child.message(), End):
            self._learn(message.news)
            yield replace(message.step, batches=[unpacked(each) for each in message.batches])
        self._learn(message.news)
        self.census, self.doubled, self.veil = message.census, message.doubled, message.veil
        self.silence = message.silence

    def _learn(self, news: News) -> None:
        self.buses[:] = news.buses
        for number, changed in news.facts.items():
            for name, value in changed.items():
                setattr(self.facts[number], name, value)
