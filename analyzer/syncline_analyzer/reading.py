"""Captures opened as one stream of frames, in this process."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from syncline_analyzer.capture import CaptureFacts, CaptureReader
from syncline_analyzer.deafness import Numbered
from syncline_analyzer.merge import Merge
from syncline_analyzer.moments import Moment
from syncline_analyzer.offsets import shifted
from syncline_analyzer.preparing import Preparation, Prepared
from syncline_analyzer.readers import open_capture
from syncline_analyzer.readers.own import own_captures
from syncline_analyzer.reading_request import Request
from syncline_analyzer.redaction import Redaction, Veil
from syncline_analyzer.segments import in_segment_order
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

_EARLIEST_NS, _LATEST_NS = int(np.iinfo(np.int64).min), int(np.iinfo(np.int64).max)


@dataclass(frozen=True, slots=True)
class Stretch:
    """The half-open stretch of time [low_ns, high_ns) that is wanted."""

    low_ns: int = _EARLIEST_NS
    high_ns: int = _LATEST_NS

    def common(self, other: "Stretch") -> "Stretch":
        """What lies in both."""
        return Stretch(max(self.low_ns, other.low_ns), min(self.high_ns, other.high_ns))


EVERYTHING = Stretch()


class Captures:
    """Captures of one machine as one stretch of time, to be gone through once.

    Attributes:
        facts: of every file; complete once all is read.
        buses: names by bus number; grows while frames are read.
        first_ns: first stamp of all captures, None when they hold nothing.

    Raises:
        CaptureError: a file is no capture that can be read.
        UsageError: the captures cannot be put in order.
    """

    def __init__(self, paths: Sequence[Path], offsets: Mapping[str, str] | None = None) -> None:
        opened: list[CaptureReader] = in_segment_order([open_capture(path) for path in paths])
        self._readers = shifted(opened, offsets or {})
        self._merge = Merge(self._readers)
        self.facts: list[CaptureFacts] = [reader.facts for reader in self._readers]
        self.buses = self._merge.buses
        self.first_ns = self._merge.first_ns

    def stretch(self, start: Moment | None, end: Moment | None) -> Stretch:
        """A range as a user gives it."""
        origin_ns = self.first_ns or 0
        return Stretch(
            start.resolved(origin_ns) if start else _EARLIEST_NS,
            end.resolved(origin_ns) if end else _LATEST_NS,
        )

    def numbered(self, stretch: Stretch) -> Iterator[Numbered]:
        """Batches and gaps of a stretch, each with the place of its first frame in all captures."""
        if stretch == EVERYTHING:
            return self._numbered(_Skipped())
        # Of our own captures only the chunks are read that the stretch needs.
        skipped = _Skipped()
        for reader in own_captures(self._readers):
            reader.limit(stretch.low_ns, stretch.high_ns, skipped.add)
        return _cut(self._numbered(skipped), stretch)

    def _numbered(self, skipped: "_Skipped") -> Iterator[Numbered]:
        """The merged stream; outside the stretch the places may be wrong."""
        seq = 0
        for item in self._merge.stream():
            yield seq + skipped.frames, item
            seq += len(item) if isinstance(item, FrameBatch) else 0


class Reading(Prepared, Protocol):
    """The frames of a session on their way to the analyses.

    Attributes:
        origin_ns: first stamp of all captures, also where a stretch of them is read.
        veil: what redaction hides; complete at the end.
    """

    origin_ns: int | None
    veil: Veil


class LocalReading(Preparation):
    """A `Reading` in this process.

    Raises:
        CaptureError: a file is no capture that can be read.
        UsageError: the captures cannot be put in order, or the range cannot hold anything.
    """

    def __init__(self, request: Request) -> None:
        captures = Captures(request.paths, request.offsets)
        check_range(request, captures.facts)
        self.origin_ns = captures.first_ns
        self.veil = Veil(Redaction.of_metadata(each.metadata for each in captures.facts))
        stretch = captures.stretch(request.start, request.end)
        stream = self.veil.over(captures.numbered(stretch))
        super().__init__(stream, captures.facts, captures.buses)


def check_range(request: Request, facts: Sequence[CaptureFacts]) -> None:
    """Raises: UsageError where the range cannot hold anything."""
    start, end = request.start, request.end
    if start and end and start.relative == end.relative and start.ns >= end.ns:
        raise UsageError("the range is empty: --from is not before --to")
    absolute = any(moment and not moment.relative for moment in (start, end))
    if absolute and any(each.time_base != "utc" for each in facts):
        raise UsageError("these logs have no dates: write times as 90s or 1m30s into them")


class _Skipped:
    """Counts the frames before a stretch that were not read."""

    def __init__(self) -> None:
        self.frames = 0

    def add(self, frames: int) -> None:
        """Count some more."""
        self.frames += frames


def _cut(stream: Iterator[Numbered], stretch: Stretch) -> Iterator[Numbered]:
    """The rows within a stretch; `seq` stays the place in the whole capture."""
    for seq, item in stream:
        if isinstance(item, Gap):
            if item.start_ns < stretch.high_ns and item.end_ns > stretch.low_ns:
                yield seq, item
        else:
            inside = (item.t_ns >= stretch.low_ns) & (item.t_ns < stretch.high_ns)
            yield from _runs(seq, item, inside)


def _runs(seq: int, batch: FrameBatch, inside: np.ndarray) -> Iterator[Numbered]:
    """Unbroken runs of the chosen rows, so that each piece keeps its `seq`."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], inside, [False])).astype(np.int8)))
    for begin, stop in edges.reshape(-1, 2).tolist():
        yield seq + begin, batch[begin:stop]
