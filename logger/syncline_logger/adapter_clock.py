"""Stamps of an adapter's own clock mapped onto the recorder's clock.

An adapter's clock starts anywhere, drifts (a crystal by up to 200 ppm, an oscillator without one by
a percent) and may wrap or start anew. A frame reaches the recorder after it was stamped, never
before: in the plane of stamp and arrival the frames lie above a line, the adapter's clock, and the
fastest of them lie on it. The line is found as the edge of the lower convex hull of the fastest
arrivals below which none lies (Moon, Skelly, Towsley: Estimation and removal of clock skew from
network delay measurements, 1999).

What no arrival can tell is the shortest delay itself: t is later than the true time by that much,
which is some 0.1 ms to 1 ms of USB.
"""

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from syncline_logger.clock import RecorderClock

FIRST_BUCKET_NS = 250_000_000
LONGEST_BUCKET_NS = 16_000_000_000
MAX_POINTS = 64
"""The fastest arrival of each bucket is a point; the line goes by the last 64: up to 17 minutes."""
SLOPE_FROM_NS = 8_000_000_000
"""Before so much was seen, the adapter's clock is taken to run as fast as ours."""
TRUSTED_FROM_NS = 30_000_000_000
CRYSTAL_PPB = 300_000
"""Drift that is believed before `TRUSTED_FROM_NS`, and the error it is before `SLOPE_FROM_NS`."""
ANY_PPB = 20_000_000
CATCH_UP_NS = 10_000_000_000
"""An error of the mapping is taken out over so long a time; at once where nothing was heard."""
CATCH_UP_PPB = 20_000_000
AHEAD_NS = 50_000_000
"""Frames that come so much before the line says: the adapter's clock was set or started anew."""
BACK_NS = 1_000_000_000
LATE_NS = 1_000_000_000
"""All frames come so much later than the line says for `LATE_FOR_NS`: its clock stood still."""
LATE_FOR_NS = 10_000_000_000
MANY_ARRIVALS = 20
"""Before so many frames came, all of them may have been late."""
MANY_POINTS = 16
"""With so many points, half of them tell how well the line is known; before, all of them do."""
_PPB = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Knot:
    """How stamps become t, from the stamp `adapter_ns` on until the next knot [ns].

    t = mapped_ns + d + round(d * rate_ppb / 1e9) with d = stamp - adapter_ns.

    Attributes:
        residual_ns: largest error of t that the arrivals allow, their shortest delay left out.
    """

    adapter_ns: int
    mapped_ns: int
    rate_ppb: int
    residual_ns: int

    def t_ns(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """The stamps mapped. stamps_ns: (n,) int64; (n,) int64."""
        passed = stamps_ns - self.adapter_ns
        turn = np.rint(passed * (self.rate_ppb / _PPB)).astype(np.int64)
        t_ns: NDArray[np.int64] = self.mapped_ns + passed + turn
        return t_ns

    def stamps_ns(self, t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """What `t_ns` was made from, to 1 ns. t_ns: (n,) int64; (n,) int64."""
        passed = t_ns - self.mapped_ns
        faster = self.rate_ppb / _PPB
        turn = np.rint(passed * (faster / (1 + faster))).astype(np.int64)
        stamps_ns: NDArray[np.int64] = self.adapter_ns + passed - turn
        return stamps_ns


@dataclass(slots=True)
class _Bucket:
    """The fastest arrival of a stretch of stamps: `offset_ns` = arrival - stamp at `at_ns`."""

    at_ns: int
    offset_ns: int
    total_ns: int = 0
    arrivals: int = 0

    @property
    def mean_excess_ns(self) -> int:
        return self.total_ns // max(self.arrivals, 1) - self.offset_ns


@dataclass(frozen=True, slots=True)
class Line:
    """offset = offset_ns + (stamp - at_ns) * slope_ppb / 1e9.

    `spread_ns` and `typical_ns`: how far the points lie above it, at most and half of them.
    """

    at_ns: int
    offset_ns: int
    slope_ppb: int
    spread_ns: int = 0
    typical_ns: int = 0

    def offset_at(self, stamp_ns: int) -> int:
        """arrival - stamp of the fastest frames at a stamp [ns]."""
        return self.offset_ns + (stamp_ns - self.at_ns) * self.slope_ppb // _PPB


def lower_line(points: list[tuple[int, int]]) -> Line:
    """The line below all points that is closest to them, its slope within what is believable.

    points: (stamp, offset) [ns], ascending in stamp, at least one.

    >>> lower_line([(0, 9), (10**10, 5), (2 * 10**10, 7)])
    Line(at_ns=10000000000, offset_ns=5, slope_ppb=0, spread_ns=4, typical_ns=2)
    """
    span_ns = points[-1][0] - points[0][0]
    slope_ppb = 0
    if span_ns >= SLOPE_FROM_NS:
        limit_ppb = ANY_PPB if span_ns >= TRUSTED_FROM_NS else CRYSTAL_PPB
        left, right = _edge_over(_lower_hull(points), points[0][0] + span_ns // 2)
        slope_ppb = (right[1] - left[1]) * _PPB // (right[0] - left[0])
        slope_ppb = max(-limit_ppb, min(limit_ppb, slope_ppb))
    origin_ns = points[0][0]
    heights = [offset - (at - origin_ns) * slope_ppb // _PPB for at, offset in points]
    lowest = min(range(len(points)), key=heights.__getitem__)
    above = sorted(height - heights[lowest] for height in heights)
    return Line(*points[lowest], slope_ppb, above[-1], above[len(above) // 2])


def _lower_hull(points: list[tuple[int, int]]) -> list[tuple[int, int]]:
    hull: list[tuple[int, int]] = []
    for x, y in points:
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2:]
            if (y1 - y0) * (x - x0) < (y - y0) * (x1 - x0):
                break
            hull.pop()
        hull.append((x, y))
    return hull


def _edge_over(
    hull: list[tuple[int, int]], middle_ns: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    right = bisect_right(hull, middle_ns, key=lambda point: point[0])
    right = max(1, min(right, len(hull) - 1))
    return hull[right - 1], hull[right]


class AdapterClock:
    """Maps stamps onto log time, ever better, never back.

    Args:
        clock: the recorder's clock.
        resolution_ns: step of the adapter's stamps.

    Attributes:
        restarts: how often the adapter's clock was found to have started anew, jumped or stood.
        residual_ns: largest error of t now; None before the first stamp.
    """

    def __init__(self, clock: RecorderClock, resolution_ns: int = 1) -> None:
        self._clock = clock
        self._resolution_ns = resolution_ns
        self._knots: deque[Knot] = deque()
        self._knot: Knot | None = None
        self._mapped_ns = 0
        self.restarts = 0
        self._forget()

    @property
    def residual_ns(self) -> int | None:
        """Largest error of t that the arrivals allow, their shortest delay left out."""
        return None if self._knot is None else self._knot.residual_ns

    @property
    def drift_ppb(self) -> int:
        """How much faster the recorder's clock runs than the adapter's."""
        return self._line.slope_ppb

    def t_ns(self, stamps_ns: NDArray[np.int64], arrival_ns: int) -> NDArray[np.int64]:
        """Log time of stamps that arrived together. stamps_ns: (n,) int64, n > 0; (n,) int64.

        arrival_ns: `RecorderClock.elapsed_ns` at their arrival.
        """
        knot = self._observe(int(stamps_ns[0]), int(stamps_ns[-1]), arrival_ns)
        t_ns = knot.t_ns(stamps_ns)
        self._mapped_ns = max(self._mapped_ns, int(t_ns[-1]))
        return t_ns

    def one_t_ns(self, stamp_ns: int, arrival_ns: int) -> int:
        """The same of a single stamp."""
        knot = self._observe(stamp_ns, stamp_ns, arrival_ns)
        passed = stamp_ns - knot.adapter_ns
        t_ns = knot.mapped_ns + passed + round(passed * (knot.rate_ppb / _PPB))
        self._mapped_ns = max(self._mapped_ns, t_ns)
        return t_ns

    def take_knots(self) -> list[Knot]:
        """The knots made since the last call; from any thread."""
        return [self._knots.popleft() for _ in range(len(self._knots))]

    def _forget(self) -> None:
        self._points: list[_Bucket] = []
        self._bucket: _Bucket | None = None
        self._bucket_ns = FIRST_BUCKET_NS
        self._bucket_end_ns = self._punctual_ns = self._last_ns = 0
        self._line = Line(0, 0, 0)
        self._log_offset_ns = self._clock.offset_ns

    def _observe(self, first_ns: int, last_ns: int, arrival_ns: int) -> Knot:
        """Take in an arrival; the knot that maps its stamps."""
        offset_ns = arrival_ns - last_ns
        bucket, knot = self._bucket, self._knot
        if bucket is None or knot is None or self._is_new(last_ns, offset_ns):
            return self._start(first_ns, last_ns, arrival_ns)
        aim = self._clock.offset_ns != self._log_offset_ns
        if last_ns >= self._bucket_end_ns:
            if self._close(bucket, arrival_ns):
                return self._start(first_ns, last_ns, arrival_ns)
            self._open(last_ns, offset_ns)
            self._line = self._fitted()
            aim = True
        else:
            bucket.total_ns += offset_ns
            bucket.arrivals += 1
            if offset_ns < bucket.offset_ns:
                bucket.at_ns, bucket.offset_ns = last_ns, offset_ns
        if aim:
            knot = self._aimed(knot, first_ns)
        self._last_ns = max(self._last_ns, last_ns)
        return knot

    def _is_new(self, last_ns: int, offset_ns: int) -> bool:
        """Whether the adapter's clock went back, or its stamps come from the future."""
        if last_ns < self._last_ns - BACK_NS:
            self.restarts += 1
            return True
        begin_ns = self._points[0].at_ns if self._points else self._line.at_ns
        unsure_ns = AHEAD_NS + self._line.spread_ns
        unsure_ns += max(self._last_ns - begin_ns, 0) // 100 if self._is_young else 0
        unsure_ns += max(last_ns - self._last_ns, 0) // 1000
        if offset_ns < self._line.offset_at(last_ns) - unsure_ns:
            self.restarts += 1
            return True
        return False

    @property
    def _is_young(self) -> bool:
        return not self._points or self._last_ns - self._points[0].at_ns < 2 * TRUSTED_FROM_NS

    def _start(self, first_ns: int, last_ns: int, arrival_ns: int) -> Knot:
        before = self._knot is not None
        self._forget()
        self._open(last_ns, arrival_ns - last_ns)
        self._punctual_ns = arrival_ns
        self._line = Line(last_ns, arrival_ns - last_ns, 0)
        self._last_ns = last_ns
        mapped_ns = first_ns + self._line.offset_ns + self._log_offset_ns
        if before:
            mapped_ns = max(mapped_ns, self._mapped_ns)
        return self._tied(Knot(first_ns, mapped_ns, 0, AHEAD_NS))

    def _open(self, stamp_ns: int, offset_ns: int) -> None:
        self._bucket = _Bucket(stamp_ns, offset_ns, offset_ns, 1)
        self._bucket_end_ns = stamp_ns + self._bucket_ns

    def _close(self, bucket: _Bucket, arrival_ns: int) -> bool:
        """Make a point of the bucket; whether all of it came too late for the line."""
        if bucket.offset_ns - self._line.offset_at(bucket.at_ns) <= LATE_NS:
            self._punctual_ns = arrival_ns
        elif arrival_ns - self._punctual_ns >= LATE_FOR_NS and bucket.arrivals > 1:
            self.restarts += 1
            return True
        self._points.append(bucket)
        if len(self._points) >= MAX_POINTS:
            if self._bucket_ns < LONGEST_BUCKET_NS:
                self._bucket_ns *= 2
                self._points = [self._lower(*pair) for pair in _pairs(self._points)]
            else:
                del self._points[0]
        return False

    def _lower(self, one: _Bucket, other: _Bucket) -> _Bucket:
        line = self._line
        low = min(one, other, key=lambda each: each.offset_ns - line.offset_at(each.at_ns))
        total, arrivals = one.total_ns + other.total_ns, one.arrivals + other.arrivals
        return _Bucket(low.at_ns, low.offset_ns, total, arrivals)

    def _fitted(self) -> Line:
        buckets = [*self._points, self._bucket] if self._bucket else self._points
        return lower_line([(each.at_ns, each.offset_ns) for each in buckets])

    def _aimed(self, knot: Knot, first_ns: int) -> Knot:
        """A knot from the last mapped stamp on, or from this one after a silence."""
        line, offset_ns = self._line, self._clock.offset_ns
        set_by_ns, self._log_offset_ns = offset_ns - self._log_offset_ns, offset_ns
        last_ns = max(self._last_ns, knot.adapter_ns)
        mapped_ns = int(knot.t_ns(np.array([last_ns]))[0]) + set_by_ns
        silence_ns = first_ns - last_ns
        target_ns = first_ns + line.offset_at(first_ns) + offset_ns
        if silence_ns >= CATCH_UP_NS:
            mapped_ns = max(target_ns, mapped_ns)
            return self._tied(
                Knot(first_ns, mapped_ns, line.slope_ppb, self._error(mapped_ns - target_ns))
            )
        straight_ns = mapped_ns + silence_ns + silence_ns * line.slope_ppb // _PPB
        error_ns = target_ns - straight_ns
        over_ns = max(CATCH_UP_NS, 2 * self._bucket_ns)
        turn_ppb = max(-CATCH_UP_PPB, min(CATCH_UP_PPB, error_ns * _PPB // over_ns))
        return self._tied(
            Knot(last_ns, mapped_ns, line.slope_ppb + turn_ppb, self._error(error_ns))
        )

    def _error(self, missed_ns: int) -> int:
        """What t may be off: how far the points scatter, and what is not yet taken out."""
        points, line = self._points, self._line
        error_ns = abs(missed_ns) + 2 * self._resolution_ns
        span_ns = self._last_ns - points[0].at_ns if points else 0
        if span_ns < SLOPE_FROM_NS:
            error_ns += (span_ns + self._bucket_ns) * CRYSTAL_PPB // _PPB
        if sum(each.arrivals for each in points) < MANY_ARRIVALS:
            return error_ns + AHEAD_NS + line.spread_ns
        if len(points) >= MANY_POINTS:
            return error_ns + 3 * line.typical_ns
        excess = sorted(each.mean_excess_ns for each in points)
        return error_ns + line.spread_ns + excess[len(excess) // 2]

    def _tied(self, knot: Knot) -> Knot:
        self._knot = knot
        self._knots.append(knot)
        return knot


def _pairs(points: list[_Bucket]) -> list[tuple[_Bucket, _Bucket]]:
    return list(zip(points[::2], points[1::2], strict=True))


class Unwrapped:
    """Stamps of a counter that starts again at 0, as one that never does.

    Args:
        wrap: first value that the counter does not reach.
        unit_ns: one step of it.
    """

    def __init__(self, wrap: int, unit_ns: int) -> None:
        self._wrap_ns = wrap * unit_ns
        self._unit_ns = unit_ns
        self._last: tuple[int, int] | None = None

    def stamps_ns(self, counts: NDArray[np.int64], arrival_ns: int) -> NDArray[np.int64]:
        """Stamps that arrived together. counts: (n,) int64, n > 0; (n,) int64 ns, going on.

        How often the counter wrapped in a silence follows from the time between the arrivals.
        """
        raw_ns = counts * self._unit_ns
        steps_ns = np.mod(np.diff(raw_ns, prepend=raw_ns[:1]), self._wrap_ns)
        steps_ns[steps_ns > self._wrap_ns - min(BACK_NS, self._wrap_ns // 4)] -= self._wrap_ns
        first_ns = int(raw_ns[0])
        if self._last is not None:
            last_ns, last_arrival_ns = self._last
            expected_ns = last_ns + (arrival_ns - last_arrival_ns) - int(steps_ns.sum())
            turns = (expected_ns - first_ns + self._wrap_ns // 2) // self._wrap_ns
            first_ns += turns * self._wrap_ns
        stamps_ns = first_ns + np.cumsum(steps_ns)
        self._last = int(stamps_ns[-1]), arrival_ns
        return stamps_ns
