"""Two encoders on one shaft: whether they keep telling the same."""

from dataclasses import field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from syncline_analyzer.context import Context
from syncline_analyzer.folds.angle.lines import Floats, Integers, Line, Waiting
from syncline_analyzer.folds.angle.samples import Key, Samples
from syncline_analyzer.folds.angle.trace import Encoder
from syncline_analyzer.results import ShaftRow, ShaftTrace, TraceEventRow
from syncline_analyzer.series import Thinner
from syncline_schemas.records import dataclass

TOLERANCE_DEG = 2.0
"""Distance that is allowed at standstill where the user states none."""
LAG_NS = 50_000_000
"""Filters and transmission of the two may differ by this much: at another speed more is allowed."""
LATE_NS = 5_000_000
"""A stamp may be off by this much: the faster it turns, the more is allowed."""
SPEED_NS = 100_000_000
"""So long before and after a sample its speed is taken."""
TAIL = 32
"""Samples that are kept for the speed of those after them."""
MOST_KNOWN = 12
"""Speeds at which the offset is learned."""
FAR_NS = 1_000_000_000
"""No line is drawn between samples further apart than this."""
FOR_GOOD = 16
"""Samples in a row that must be too far off, over at least `FOR_GOOD_NS`."""
FOR_GOOD_NS = 500_000_000
MAX_EVENTS = 1000
MAX_SAMPLES = 100_000
"""Differences that are kept for plots; beyond, the extremes of runs of them."""

_Member = tuple[int, int]
"""(bus number, node)"""


@dataclass(frozen=True, slots=True)
class _Known:
    """The offset as it was at one speed; filters move it by their lag times the speed."""

    deg: float
    speed: float
    """In degrees of the first one per ns."""
    doubt_deg: float


@dataclass(slots=True)
class _Pair:
    """Two encoders, and how far they are from one another."""

    member: _Member
    other: _Member
    ratio: float
    tolerance_deg: float
    own: Waiting = field(default_factory=Waiting)
    foreign: Waiting = field(default_factory=Waiting)
    object: int = 0
    """index << 8 | sub of what is compared, the first position heard; 0 before."""
    other_object: int = 0
    done_ns: int | None = None
    compared: int = 0
    left_out: int = 0
    first_deg: float | None = None
    widest_deg: float | None = None
    known: list[_Known] = field(default_factory=list)
    """Offsets that hold in this stretch, none before it was learned."""
    segments: tuple[int, int] | None = None
    learned: list[tuple[float, float]] = field(default_factory=list)
    """(difference, speed) of the samples that the first offset is learned from."""
    off: list[tuple[int, int, float]] = field(default_factory=list)
    """(t_ns, seq, distance) of the samples too far off since the last good one, the first ones."""
    parted: list[tuple[int, int, float]] = field(default_factory=list)
    count: int = 0
    before: _Known | None = None
    """Offset before the first parting of this stretch."""
    shifted_deg: float | None = None
    stretches: int = 0
    """Stretches so far in which neither line breaks."""
    kept: Thinner = field(default_factory=lambda: Thinner("difference", MAX_SAMPLES))

    @property
    def heard(self) -> bool:
        """Whether both encoders have sent anything."""
        return self.own.segment >= 0 and self.foreign.segment >= 0

    def join(self) -> None:
        """Compare what both have sent since the last call."""
        if not len(self.own.waiting.t_ns) or not len(self.foreign.waiting.t_ns):
            return
        until_ns = int(min(self.own.waiting.t_ns[-1], self.foreign.waiting.t_ns[-1]))
        lines = []
        for each in (self.own, self.foreign):
            stop = int(np.searchsorted(each.waiting.t_ns, until_ns, side="right"))
            # One sample more, so that a line leads up to the last one of the other.
            lines.append(each.waiting.of(slice(0, stop + 1)))
            each.waiting = each.waiting.of(slice(max(stop - TAIL, 0), None))
        self._compare(lines[0], lines[1], until_ns)
        self.done_ns = until_ns

    def _compare(self, one: Line, two: Line, until_ns: int) -> None:
        """Lay the samples of the encoder with fewer of them against the line of the other one."""
        swap = len(one.t_ns) > len(two.t_ns)
        few, many = (two, one) if swap else (one, two)
        since_ns = -1 if self.done_ns is None else self.done_ns
        first, stop = np.searchsorted(few.t_ns, [since_ns, until_ns], side="right").tolist()
        few = few.of(slice(first, stop))
        if not len(few.t_ns) or len(many.t_ns) < 2:
            self.left_out += len(few.t_ns)
            return
        after = np.clip(np.searchsorted(many.t_ns, few.t_ns), 1, len(many.t_ns) - 1)
        span = many.t_ns[after] - many.t_ns[after - 1]
        inside = (few.t_ns >= many.t_ns[after - 1]) & (few.t_ns <= many.t_ns[after])
        whole = many.segment[after] == many.segment[after - 1]
        good = inside & whole & (span > 0) & (span <= FAR_NS)
        step = many.deg[after] - many.deg[after - 1]
        part = (few.t_ns - many.t_ns[after - 1]) / np.maximum(span, 1)
        line = many.deg[after - 1] + part * step
        bend = np.abs(step - np.diff(many.deg, prepend=many.deg[0])[after - 1])
        speed = _speed(many, few.t_ns)
        mine, its = (line, few.deg) if swap else (few.deg, line)
        scale = 1.0 if swap else abs(self.ratio)
        circles = (many.circle_deg[after], few.circle_deg)
        own, foreign = circles if swap else circles[::-1]
        circle = self._circle(own, foreign)
        segments = np.stack(
            (many.segment[after], few.segment) if swap else (few.segment, many.segment[after])
        )
        good &= circle > 0
        self.left_out += int(np.count_nonzero(~good))
        self._judge(
            few.t_ns[good],
            few.seq[good],
            (mine - self.ratio * its)[good],
            np.stack((speed, bend))[:, good] * scale,
            circle[good],
            segments[:, good],
        )

    def _circle(self, own: Floats, foreign: Floats) -> Floats:
        """What the difference is known modulo [deg]; 0 where it is not known at all."""
        theirs = foreign * abs(self.ratio)
        both = np.isfinite(own) & np.isfinite(theirs)
        alike = abs(self.ratio) == 1.0
        return np.where(both & (not alike), 0.0, np.minimum(own, theirs))

    def _judge(
        self,
        t_ns: Integers,
        seq: Integers,
        difference: Floats,
        motion: Floats,
        circle: Floats,
        segments: Integers,
    ) -> None:
        edges = np.flatnonzero(np.any(np.diff(segments, axis=1) != 0, axis=0)) + 1
        for part in np.split(np.arange(len(t_ns)), edges):
            if not len(part):
                continue
            now = int(segments[0, part[0]]), int(segments[1, part[0]])
            if now != self.segments:
                self.segments, self.before = now, None
                self.known.clear()
                self.stretches += 1
                self.learned.clear()
                self.off.clear()
            self.compared += len(part)
            self._keep(t_ns[part], seq[part], difference[part], circle[part])
            at = 0
            while at < len(part):
                rows = part[at:]
                at += self._stretch(
                    t_ns[rows], seq[rows], difference[rows], motion[:, rows], circle[rows]
                )

    def _keep(self, t_ns: Integers, seq: Integers, difference: Floats, circle: Floats) -> None:
        """Keep differences for the plot."""
        self.kept.add(
            {
                "t_ns": t_ns,
                "seq": seq,
                "difference": difference,
                "circle": circle,
                "segment": np.full(len(seq), self.stretches, np.int32),
            }
        )

    def _stretch(
        self, t_ns: Integers, seq: Integers, difference: Floats, motion: Floats, circle: Floats
    ) -> int:
        """Judge samples up to the next parting, or a new offset; how many were taken."""
        speed, bend = motion
        if not self.known:
            return self._learn(difference, speed, circle)
        away, beyond, excuse = self._against(difference, speed, bend, circle)
        bad = beyond > 0.0
        stop = self._parting(t_ns, bad)
        fresh = self._fresh(speed, bad, excuse)[:stop]
        if fresh.any():
            stop = int(np.flatnonzero(fresh)[0]) + 1
        for row in np.flatnonzero(bad[:stop]).tolist():
            # Only the first ones since the last good one are of interest.
            if row and not bad[row - 1]:
                self.off.clear()
            if len(self.off) < FOR_GOOD:
                self.off.append((int(t_ns[row]), int(seq[row]), float(away[row])))
        fits = np.abs(away[:stop][~bad[:stop]])
        if len(fits):
            self.widest_deg = max(self.widest_deg or 0.0, float(fits.max()))
        self._shift(difference[:stop], speed[:stop], circle[:stop], ~bad[:stop])
        if not bad[stop - 1]:
            self.off.clear()
        elif self._long(int(t_ns[stop - 1])):
            self._part()
            return stop
        if fresh.any():
            rows = slice(stop - FOR_GOOD, stop)
            self._know(difference[rows], speed[rows], circle[rows])
        return stop

    def _against(
        self, difference: Floats, speed: Floats, bend: Floats, circle: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """(distance, what of it nothing excuses, least excuse of the speed), all (n,).

        A lag that does not change moves the difference only where the speed changes: so what was
        learned at each speed holds there, and a step at an even speed is told.
        """
        away = np.zeros(len(difference))
        beyond, excuse = np.full((2, len(difference)), [[-np.inf], [np.inf]])
        for known in self.known:
            distance = _around(difference - known.deg, circle)
            lag = np.abs(speed - known.speed) * LAG_NS + known.doubt_deg
            over = np.abs(distance) - (self.tolerance_deg + lag + np.abs(speed) * LATE_NS + bend)
            away = np.where(over > beyond, distance, away)
            beyond, excuse = np.maximum(over, beyond), np.minimum(lag, excuse)
        return away, beyond, excuse

    def _shift(
        self, difference: Floats, speed: Floats, circle: Floats, good: NDArray[np.bool_]
    ) -> None:
        """Note how far off they are since they parted, where the speed is that of before."""
        if self.before is None:
            return
        like = good & (np.abs(speed - self.before.speed) * LAG_NS <= self.tolerance_deg)
        last = np.flatnonzero(like)[-FOR_GOOD:]
        if len(last):
            away = _around(difference[last] - self.before.deg, circle[last])
            self.shifted_deg = float(np.median(away))

    def _fresh(self, speed: Floats, bad: NDArray[np.bool_], excuse: Floats) -> NDArray[np.bool_]:
        """Rows (n,) that end enough samples of an even speed at which no offset is known."""
        fresh = np.zeros(len(speed), np.bool_)
        if len(speed) < FOR_GOOD or len(self.known) >= MOST_KNOWN:
            return fresh
        new = ~bad & (excuse > self.tolerance_deg)
        run = sliding_window_view(new, FOR_GOOD).all(axis=1)
        even = np.ptp(sliding_window_view(speed, FOR_GOOD)[run], axis=1) * LAG_NS
        fresh[np.flatnonzero(run)[even <= self.tolerance_deg / 2] + FOR_GOOD - 1] = True
        return fresh

    def _learn(self, difference: Floats, speed: Floats, circle: Floats) -> int:
        """Learn the first offset of a stretch."""
        wanted = FOR_GOOD - len(self.learned)
        self.learned += zip(difference[:wanted].tolist(), speed[:wanted].tolist(), strict=True)
        if len(self.learned) == FOR_GOOD:
            pairs = np.array(self.learned)
            self._know(pairs[:, 0], pairs[:, 1], circle[0])
            self.learned.clear()
        return min(wanted, len(difference))

    def _know(self, difference: Floats, speed: Floats, circle: Floats | float) -> None:
        """Take the offset that samples tell; the less evenly they turned, the less is it worth."""
        base = float(difference[0])
        around = base + _around(difference - base, circle)
        offset = float(np.median(around))
        uneven = float(np.ptp(speed)) / 2 * LAG_NS
        scatter = float(np.abs(around - offset).max())
        self.first_deg = offset if self.first_deg is None else self.first_deg
        self.known.append(_Known(offset, float(np.median(speed)), max(uneven, scatter)))

    def _long(self, t_ns: int) -> bool:
        return len(self.off) == FOR_GOOD and t_ns - self.off[0][0] >= FOR_GOOD_NS

    def _parting(self, t_ns: Integers, bad: NDArray[np.bool_]) -> int:
        """Number of samples up to and with the one that makes a parting sure, else all."""
        rows = np.arange(len(bad))
        good = np.maximum.accumulate(np.where(bad, -1, rows))
        carried = len(self.off) if len(bad) and bad[0] else 0
        length = rows - good + np.where(good < 0, carried, 0)
        since = t_ns[np.minimum(good + 1, len(bad) - 1)]
        if carried:
            since = np.where(good < 0, self.off[0][0], since)
        sure = np.flatnonzero(bad & (length >= FOR_GOOD) & (t_ns - since >= FOR_GOOD_NS))
        return int(sure[0]) + 1 if len(sure) else len(bad)

    def _part(self) -> None:
        t_ns, seq, _ = self.off[0]
        self.count += 1
        self.before = self.known[0] if self.before is None else self.before
        if len(self.parted) < MAX_EVENTS:
            distance = float(np.median([each for _, _, each in self.off]))
            self.parted.append((t_ns, seq, distance))
        self.widest_deg = max(self.widest_deg or 0.0, *(abs(each) for _, _, each in self.off))
        self.known.clear()
        self.learned.clear()
        self.off.clear()


def _speed(line: Line, t_ns: Integers) -> Floats:
    """Speed [deg / ns] of a line about each of the stamps (n,), over some time: single steps may
    be those of a device that measures less often than it sends."""
    near = [np.searchsorted(line.t_ns, t_ns + away) for away in (-SPEED_NS, SPEED_NS)]
    first, last = (np.clip(rows, 0, len(line.t_ns) - 1) for rows in near)
    middle = np.clip(np.searchsorted(line.t_ns, t_ns), 1, len(line.t_ns) - 1)
    first = np.where(line.segment[first] == line.segment[middle], first, middle - 1)
    last = np.where(line.segment[last] == line.segment[middle], last, middle)
    first, last = np.minimum(first, middle - 1), np.maximum(last, middle)
    span = line.t_ns[last] - line.t_ns[first]
    speed: Floats = (line.deg[last] - line.deg[first]) / np.maximum(span, 1)
    return speed


def _around(deg: Floats | float, circle: Floats | float) -> Floats:
    """The shortest way on a circle of so many degrees; all the way where it is infinite."""
    finite = np.where(np.isfinite(circle), circle, 1.0)
    short = (deg + finite / 2) % finite - finite / 2
    return np.where(np.isfinite(circle), short, deg)


class Shafts:
    """All pairs of encoders that the bus description places on one shaft."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._pairs: list[_Pair] = []
        self._seen = 0

    def take(
        self, key: Key, piece: Samples, unwrapped_deg: Floats, segment: int, converter: Encoder
    ) -> None:
        """Take in an unbroken piece of an encoder."""
        circle_deg, max_rpm = converter.range_deg, converter.scale.max_rpm
        if not self._context.timed or not np.isfinite(circle_deg) or not len(piece.seq):
            return
        for pair in self._all():
            if key[:2] == pair.member and pair.object in (0, key[2]):
                pair.object = key[2]
                pair.own.add(piece, unwrapped_deg, segment, circle_deg, max_rpm)
            elif key[:2] == pair.other and pair.other_object in (0, key[2]):
                pair.other_object = key[2]
                pair.foreign.add(piece, unwrapped_deg, segment, circle_deg, max_rpm)

    def join(self) -> None:
        """Compare what both encoders of each pair have sent."""
        for pair in self._all():
            pair.join()

    def rows(self) -> list[ShaftRow]:
        """What came of each pair of which both were heard."""
        return [self._row(pair) for pair in self._all() if pair.heard]

    def traces(self) -> list[ShaftTrace]:
        """The differences over time of each pair that could be compared."""
        return [self._trace(pair) for pair in self._all() if pair.compared]

    def events(self) -> list[TraceEventRow]:
        """Every parting, at the encoder whose entry names the other one."""
        return [
            TraceEventRow(
                self._context.bus_name(pair.member[0]),
                pair.member[1],
                pair.object,
                "parted",
                seq,
                t_ns,
                None,
                None,
                f"{abs(distance):.4g} deg {'ahead of' if distance > 0 else 'behind'} node"
                f" {pair.other[1]} on the same shaft",
            )
            for pair in self._all()
            for t_ns, seq, distance in pair.parted
        ]

    def _row(self, pair: _Pair) -> ShaftRow:
        t_ns, seq, distance = pair.parted[0] if pair.parted else (None, None, None)
        return ShaftRow(
            self._context.bus_name(pair.member[0]),
            pair.member[1],
            self._context.bus_name(pair.other[0]),
            pair.other[1],
            pair.ratio,
            pair.compared,
            pair.left_out,
            pair.first_deg,
            pair.widest_deg,
            pair.tolerance_deg,
            pair.count,
            t_ns,
            seq,
            distance,
            pair.shifted_deg,
        )

    def _trace(self, pair: _Pair) -> ShaftTrace:
        columns = pair.kept.columns()
        difference = columns["difference"]
        base = float(difference[0]) if pair.first_deg is None else pair.first_deg
        return ShaftTrace(
            self._context.bus_name(pair.member[0]),
            pair.member[1],
            self._context.bus_name(pair.other[0]),
            pair.other[1],
            columns["t_ns"],
            columns["seq"],
            base + _around(difference - base, columns["circle"]),
            columns["segment"],
        )

    def _all(self) -> list[_Pair]:
        """The pairs; more where a bus was added."""
        if len(self._context.buses) != self._seen:
            self._seen = len(self._context.buses)
            self._pairs += self._described({pair.member for pair in self._pairs})
        return self._pairs

    def _described(self, known: set[_Member]) -> list[_Pair]:
        return [
            _Pair(
                (bus, node),
                (bus, entry.same_shaft_as),
                entry.ratio,
                entry.tolerance_deg if entry.tolerance_deg is not None else TOLERANCE_DEG,
            )
            for bus, name in enumerate(self._context.buses)
            for node, entry in self._context.description.described(name).items()
            if entry.same_shaft_as is not None and (bus, node) not in known
        ]
