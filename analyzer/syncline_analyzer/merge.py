"""Several captures as one stream: files in time order, buses told apart, gaps between segments."""

from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from itertools import chain

import numpy as np

from syncline_analyzer.capture import CaptureReader
from syncline_analyzer.clock_repair import repair_clocks
from syncline_analyzer.offsets import ShiftedReader
from syncline_analyzer.segments import chained, last_place
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.gap_message import DID_NOT_RUN
from syncline_schemas.capture.layout import AFTER_KEY
from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

BETWEEN_FILES = "between two files of the session"


@dataclass(slots=True)
class _Open:
    """One capture on its way through the merge: what comes next, and where its buses went."""

    reader: CaptureReader
    items: Iterator[FrameBatch | Gap]
    head: FrameBatch | Gap | None
    bus_map: dict[int, int]
    before: list[Gap] = field(default_factory=list)
    """What the file says of the time before it: the recorder did not run, or could not write."""
    place: str = ""
    """Of its last segment."""

    @property
    def next_ns(self) -> int:
        head = self.head
        assert head is not None
        return head.start_ns if isinstance(head, Gap) else int(head.t_ns[0])

    def begin(self) -> None:
        """Find the first item; what the file says of the time before it is no part of it."""
        self.place = last_place(self.reader)
        leading: list[FrameBatch | Gap] = []
        self.advance()
        while isinstance(self.head, Gap):
            leading.append(self.head)
            self.advance()
        ends = [n + 1 for n, gap in enumerate(leading) if self._is_before(gap)]
        cut = max(ends, default=0)
        self.before = [gap for gap in leading[:cut] if isinstance(gap, Gap)]
        head = [] if self.head is None else [self.head]
        self.items = chain(leading[cut:], head, self.items)
        self.advance()

    def _is_before(self, item: FrameBatch | Gap) -> bool:
        created = self.reader.facts.metadata.get("created_ns", "")
        begun_ns = int(created) if created.isdecimal() else 0
        return isinstance(item, Gap) and (item.reason == DID_NOT_RUN or item.end_ns <= begun_ns)

    def told(self, bus: int, last_ns: int, *, directly: bool) -> Iterator[Gap]:
        """What lies between the last frame of a bus before the file and the file.

        directly: nothing but what the file tells of; else somebody else may have been blind too.
        """
        told = [gap for gap in self.before if gap.bus in (None, bus)]
        pauses = [gap for gap in told if gap.reason == DID_NOT_RUN]
        reason = DID_NOT_RUN if pauses else BETWEEN_FILES
        directly = directly and bool(pauses)
        at_ns = last_ns
        for gap in told if directly else [each for each in told if each not in pauses]:
            start_ns = max(gap.start_ns, at_ns)
            if pauses and gap is pauses[-1]:
                at_ns = start_ns
                break
            if start_ns > at_ns and not directly:
                yield Gap(at_ns, start_ns, reason)
            at_ns = max(gap.end_ns, start_ns)
            yield replace(gap, start_ns=start_ns, end_ns=at_ns)
        if self.next_ns > at_ns:
            yield Gap(at_ns, self.next_ns, reason)

    def advance(self) -> None:
        self.head = next((item for item in self.items if isinstance(item, Gap) or len(item)), None)


def _check_order(readers: Sequence[CaptureReader]) -> None:
    """Raises: UsageError where nothing tells how the times of files lie to each other."""
    undated = [each for each in readers if each.facts.time_base != "utc"]
    placed = all(isinstance(each, ShiftedReader) for each in readers)
    if not undated or len(readers) == 1 or (placed and len(undated) == len(readers)):
        return
    name = undated[0].facts.path.name
    if undated[0].facts.time_base == "none":
        raise UsageError(
            f"{undated[0].facts.path} has no times, so it cannot be put in order with other files:"
            " analyze it alone"
        )
    if len(undated) == len(readers):
        options = " ".join(f"--offset {each.facts.path.name}=0" for each in readers)
        raise UsageError(
            f"{undated[0].facts.path} has no dates, and no other file has: analyze each alone, or say"
            f" by how many seconds each is to be moved: {options}"
        )
    given = isinstance(undated[0], ShiftedReader)
    dated = next(each.facts.path.name for each in readers if each.facts.time_base == "utc")
    raise UsageError(
        f"{undated[0].facts.path} has no dates, but {dated} has:"
        f" {'seconds do not place it there; ' if given else 'analyze it alone, or '}"
        f"say when its first frame was recorded: --offset {name}=2026-03-01T12:00:00Z"
    )


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
        _check_order([source.reader for source in self._open])
        self._last_ns: dict[int, int] = {}
        self._last_place: dict[int, str] = {}
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
                follows = source.reader.facts.metadata.get(AFTER_KEY)
                directly = bool(follows) and follows == self._last_place.get(mapped)
                for gap in source.told(number, last_ns, directly=directly):
                    yield replace(gap, bus=mapped)

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
        table = np.arange(256, dtype=np.uint8)
        numbers = batch.buses
        for number in numbers:
            mapped = self._map_bus(source, number, set())
            table[number] = mapped
            self._last_ns[mapped] = int(batch.t_ns[-1])
            self._last_place[mapped] = source.place
        if all(table[number] == number for number in numbers):
            return batch
        return replace(batch, bus=table[batch.bus])
