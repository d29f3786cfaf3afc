"""Several captures as one stream: files in time order, buses told apart, gaps between segments."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from syncline_analyzer.capture import CaptureReader
from syncline_analyzer.clock_repair import repair_clocks
from syncline_analyzer.segments import chained
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.gap_message import DID_NOT_RUN
from syncline_schemas.errors import UsageError

BETWEEN_FILES = "between two files of the session"


@dataclass(slots=True)
class _Open:
    """One capture on its way through the merge: what comes next, and where its buses went."""

    reader: CaptureReader
    items: Iterator[FrameBatch | Gap]
    head: FrameBatch | Gap | None
    bus_map: dict[int, int]
    pause: Gap | None = None
    """The stretch before the file in which, as it says, its recorder did not run."""

    @property
    def next_ns(self) -> int:
        head = self.head
        assert head is not None
        return head.start_ns if isinstance(head, Gap) else int(head.t_ns[0])

    def begin(self) -> None:
        """Find the first item; what the file says of the time before it is no part of it."""
        self.advance()
        while isinstance(self.head, Gap) and self.head.reason == DID_NOT_RUN:
            self.pause = self.head
            self.advance()

    def advance(self) -> None:
        self.head = next((item for item in self.items if isinstance(item, Gap) or len(item)), None)


class Merge:
    """The frames of several captures in one stream.

    Segments of one recording are one file. Files that follow each other join: the same bus name is
    the same bus, and what lies between them is a Gap. Where files overlap in time, a bus name that is already in use gets the file's
    name behind it, because it must be another bus.

    Attributes:
        buses: names by bus number; grows while the stream is read.
        first_ns: first stamp of all captures, None when they hold nothing.
    """

    def __init__(self, readers: Sequence[CaptureReader]) -> None:
        repair_clocks(readers)
        self.buses: list[str] = []
        self._open = [_Open(reader, reader.batches(), None, {}) for reader in chained(readers)]
        for source in self._open:
            source.begin()
        undated = [s.reader for s in self._open if s.reader.facts.time_base != "utc"]
        if undated and len(readers) > 1:
            raise UsageError(
                f"{undated[0].facts.path} has no dates, so it cannot be put in order with other"
                " files: analyze it alone"
            )
        self._last_ns: dict[int, int] = {}
        self.first_ns = min((s.next_ns for s in self._open if s.head is not None), default=None)

    def stream(self) -> Iterator[FrameBatch | Gap]:
        """Batches and gaps of all captures in order of time."""
        waiting = sorted((s for s in self._open if s.head is not None), key=lambda s: s.next_ns)
        running: list[_Open] = []
        while waiting or running:
            if waiting and (not running or waiting[0].next_ns < min(s.next_ns for s in running)):
                running.append(waiting.pop(0))
                yield from self._start(running[-1], running[:-1])
            source = min(running, key=lambda s: s.next_ns)
            others = [s.next_ns for s in (*running, *waiting[:1]) if s is not source]
            yield self._take(source, min(others, default=None))
            if source.head is None:
                running.remove(source)

    def _start(self, source: _Open, running: Sequence[_Open]) -> Iterator[Gap]:
        """Map the buses of a file that begins; a Gap for those that go on after a pause."""
        taken = {number for other in running for number in other.bus_map.values()}
        for number in range(len(source.reader.facts.buses)):
            mapped = self._map_bus(source, number, taken)
            last_ns = self._last_ns.get(mapped)
            if last_ns is not None and source.next_ns > last_ns:
                reason = source.pause.reason if source.pause else BETWEEN_FILES
                yield Gap(last_ns, source.next_ns, reason, None, mapped)

    def _map_bus(self, source: _Open, number: int, taken: set[int]) -> int:
        if number not in source.bus_map:
            facts = source.reader.facts
            name = facts.buses[number] if number < len(facts.buses) else f"bus{number}"
            if name in self.buses and self.buses.index(name) in taken:
                name = f"{name} ({facts.path.name})"
            if name not in self.buses:
                self.buses.append(name)
            source.bus_map[number] = self.buses.index(name)
        return source.bus_map[number]

    def _take(self, source: _Open, until_ns: int | None) -> FrameBatch | Gap:
        """The next piece of one file, cut where another file's frames come first."""
        head = source.head
        assert head is not None
        if isinstance(head, Gap):
            source.advance()
            bus = None if head.bus is None else self._map_bus(source, head.bus, set())
            return replace(head, bus=bus)
        later = (
            np.flatnonzero(head.t_ns > until_ns) if until_ns is not None else np.zeros(0, np.intp)
        )
        cut = int(later[0]) if len(later) and later[0] > 0 else len(head)
        part = head[:cut]
        if cut < len(head):
            source.head = head[cut:]
        else:
            source.advance()
        return self._renumbered(source, part)

    def _renumbered(self, source: _Open, batch: FrameBatch) -> FrameBatch:
        table = np.zeros(256, np.uint8)
        for number in np.unique(batch.bus):
            mapped = self._map_bus(source, int(number), set())
            table[number] = mapped
            self._last_ns[mapped] = int(batch.t_ns[-1])
        return replace(batch, bus=table[batch.bus])
