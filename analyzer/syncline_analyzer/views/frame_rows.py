"""Which frames of a capture a view lists: all of a short one, of a long one those around events."""

from collections.abc import Callable, Iterable, Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis, CaptureRow
from syncline_analyzer.views.events import CLEARING, RESET
from syncline_schemas.batch import FrameBatch
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.records import dataclass

ReadFrames = Callable[[int | None, int | None], Iterator[FrameBatch]]
"""Frames of a half-open stretch [t_ns, t_ns) of the capture; None for its start or end."""

ALL_FRAMES = 100_000
"""So many frames are listed one by one."""
ONE_PASS_FRAMES = 200_000
"""A capture with so many is read once; of a longer one only the stretches around the events."""
MAX_OPENED = 900
"""Files that may be opened in all: those of a long session are opened anew for each event."""
_LEAST_EVENTS = 3
AROUND = 100
"""Frames listed before an event, and as many from it on."""
MAX_EVENTS = 60
_LONGEST_NS = 10_000_000_000
"""Nothing further away than this belongs to an event."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Frames that are not listed, half-open in time; `count` is None where nobody counted them."""

    start_ns: int
    end_ns: int
    count: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """Frames that are listed; `seq` (n,) int64 are their places, None where they are not known."""

    frames: FrameBatch
    seq: NDArray[np.int64] | None


def frame_rows(analysis: Analysis, read: ReadFrames) -> Iterator[Shown | LeftOut]:
    """The frames to list, in order, and between them what is left out."""
    capture = analysis.capture
    if capture.frames <= ONE_PASS_FRAMES:
        yield from _of_all(analysis, read)
    elif capture.time_base != "none" and _is_indexed(capture):
        yield from _around_events(analysis, read)
    else:
        yield LeftOut(capture.begin_ns, capture.end_ns + 1, capture.frames)


def _is_indexed(capture: CaptureRow) -> bool:
    """Whether a stretch can be read without all that comes before it."""
    return all(file.endswith(".mcap") for file in capture.files)


def events_of(analysis: Analysis, most: int = MAX_EVENTS) -> list[int]:
    """Moments worth a look: the start, and where findings start, the worst first, EMCY, lost nodes."""
    rank = {"error": 0, "warning": 1, "info": 3}
    told = [(rank[row.severity], row.start_ns) for row in analysis.findings]
    told += [(2, row.t_ns) for row in analysis.emcy if row.transition not in (*CLEARING, RESET)]
    told += [(1, row.start_ns) for row in analysis.nmt_states if row.state == NmtState.LOST]
    moments = dict.fromkeys(t_ns for _, t_ns in sorted(told))
    return sorted([analysis.capture.begin_ns, *islice(moments, most)])


def _of_all(analysis: Analysis, read: ReadFrames) -> Iterator[Shown | LeftOut]:
    frames = FrameBatch.concat(list(read(None, None)))
    seq = np.arange(len(frames))
    if len(frames) <= ALL_FRAMES or analysis.capture.time_base == "none":
        yield Shown(frames[:ALL_FRAMES], seq[:ALL_FRAMES])
        if len(frames) > ALL_FRAMES:
            yield LeftOut(0, 0, len(frames) - ALL_FRAMES)
        return
    end_ns = analysis.capture.end_ns + 1
    passed = 0
    for first, last in _stretches(np.searchsorted(frames.t_ns, events_of(analysis)), len(frames)):
        if first > passed:
            since, until = int(frames.t_ns[passed]), int(frames.t_ns[first])
            yield LeftOut(since, until, first - passed)
        yield Shown(frames[first:last], seq[first:last])
        passed = last
    if passed < len(frames):
        yield LeftOut(int(frames.t_ns[passed]), end_ns, len(frames) - passed)


def _stretches(places: Iterable[int], count: int) -> Iterator[tuple[int, int]]:
    """Half-open stretches of rows around places, those that touch joined."""
    first, last = 0, 0
    for place in places:
        begin, end = max(int(place) - AROUND, 0), min(int(place) + AROUND, count)
        if begin > last:
            yield first, last
            first = begin
        last = end
    yield first, last


def _around_events(analysis: Analysis, read: ReadFrames) -> Iterator[Shown | LeftOut]:
    capture = analysis.capture
    usual_ns = capture.duration_ns // capture.frames
    reach_ns = min(4 * AROUND * usual_ns, _LONGEST_NS)
    passed_ns = capture.begin_ns
    most = min(max(MAX_OPENED // len(capture.files), _LEAST_EVENTS), MAX_EVENTS)
    for t_ns in events_of(analysis, most):
        begin_ns, end_ns = max(t_ns - reach_ns, passed_ns), t_ns + reach_ns
        if begin_ns >= end_ns:
            continue
        frames = FrameBatch.concat(list(read(begin_ns, end_ns)) or [FrameBatch.empty()])
        place = int(np.searchsorted(frames.t_ns, t_ns))
        frames = frames[max(place - AROUND, 0) : place + AROUND]
        if not len(frames):
            continue
        if frames.t_ns[0] > passed_ns:
            yield LeftOut(passed_ns, int(frames.t_ns[0]), None)
        yield Shown(frames, None)
        passed_ns = int(frames.t_ns[-1]) + 1
    if passed_ns <= capture.end_ns:
        yield LeftOut(passed_ns, capture.end_ns + 1, None)
