"""How full a loaded bus really was: by loops over its frames, with no help of the analyzer's code."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator
from itertools import accumulate, pairwise

from syncline_samples.loaded import PDO_BASES
from tests.analyzer.timing_truth import SECOND_NS, Measured

WINDOW_100MS_NS = 100_000_000
BURST_NS = 10_000_000
_SHARE_PERCENT = 1e-6
_COARSE_NS = 100_000
_TOLERANCE_BITS = 8
"""A frame may count from its start to the end of its intermission, or that much earlier."""


class Occupation:
    """Busy time of the wire up to any moment: each frame from its start on for all its bits."""

    def __init__(self, case: Measured) -> None:
        bit_ns = SECOND_NS // case.plan.bitrate
        self._starts = [frame.start_ns for frame in case.recorded]
        self._ends = [frame.start_ns + frame.bits * bit_ns for frame in case.recorded]
        lengths = (end - start for start, end in zip(self._starts, self._ends, strict=True))
        self._before = [0, *accumulate(lengths)]

    def until(self, t_ns: int) -> int:
        """Busy time before a moment [ns]."""
        place = bisect_left(self._starts, t_ns)
        after = max(self._ends[place - 1] - t_ns, 0) if place else 0
        return self._before[place] - after

    def fullest(self, starts: list[int], width_ns: int) -> float:
        """Largest share of windows that begin at these moments [%]."""
        return max(100 * (self.until(t + width_ns) - self.until(t)) / width_ns for t in starts)

    def bursts(self) -> list[int]:
        """Moments at which the fullest window may begin."""
        first, last = self._ends[0], self._ends[-1] - BURST_NS
        moments = [*self._starts, *(end - BURST_NS for end in self._ends)]
        return [t_ns for t_ns in moments if first <= t_ns <= last]


def longest_busy(case: Measured) -> tuple[int, int]:
    """(ns, frames) of the longest stretch in which each frame follows the one before at once."""
    bit_ns = SECOND_NS // case.plan.bitrate
    best, begun, count = (0, 0), case.recorded[0].start_ns, 1
    for before, frame in pairwise(case.recorded):
        best = max(best, (before.end_ns - begun, count))
        if frame.start_ns > before.end_ns + 3 * bit_ns:
            begun, count = frame.start_ns, 0
        count += 1
    return max(best, (case.recorded[-1].end_ns - begun, count))


def wrong_peaks(case: Measured) -> Iterator[str]:
    """Peaks that are not those of the wire, on buses without gaps and error frames."""
    (row,) = case.analysis.bus_load
    occupation, step_ns = Occupation(case), case.plan.stamp_resolution_ns
    slack_ns = 2 * step_ns + _TOLERANCE_BITS * SECOND_NS // case.plan.bitrate
    first, last = case.stamp(case.recorded[0].end_ns), case.recorded[-1].end_ns
    for name, told, width_ns in (
        ("1 s", row.peak_percent, SECOND_NS),
        ("100 ms", row.peak_100ms_percent, WINDOW_100MS_NS),
    ):
        starts = list(range(first, last - width_ns - 2 * step_ns, width_ns))
        if starts and told is not None:
            expected = occupation.fullest(starts, width_ns)
            if abs(told - expected) > 100 * slack_ns / width_ns:
                yield f"peak of {name}: {told} %, not {expected} %"
        elif starts:
            yield f"peak of {name}: not told"
    yield from _wrong_burst(case, occupation, row.burst_percent, slack_ns)
    yield from _wrong_stretch(case, row.longest_busy_us, row.longest_busy_frames)


def _wrong_burst(
    case: Measured, occupation: Occupation, told: float | None, slack_ns: int
) -> Iterator[str]:
    if told is None:
        if case.plan.stamp_resolution_ns < _COARSE_NS:
            yield "peak burst: not told"
        return
    expected = occupation.fullest(occupation.bursts(), BURST_NS)
    if abs(told - expected) > 100 * slack_ns / BURST_NS:
        yield f"peak burst: {told} %, not {expected} %"


def _wrong_stretch(case: Measured, told_us: float | None, told_frames: int | None) -> Iterator[str]:
    """With exact stamps the very stretch; a pause of up to four bits is none for the analyzer."""
    if case.plan.stamp_resolution_ns > 1:
        return
    expected_ns, frames = longest_busy(case)
    if told_us is None or told_frames is None:
        yield "longest stretch: not told"
    elif told_us < expected_ns / 1000 - 1e-3 or told_frames < frames:
        yield f"longest stretch: {told_us} us, {told_frames}, not {expected_ns / 1000}, {frames}"


def wrong_shares(case: Measured) -> Iterator[str]:
    """Identifiers and nodes that took another part of the traffic than is told."""
    bits: Counter[int] = Counter()
    frames: Counter[int] = Counter()
    for frame in case.recorded:
        bits[frame.can_id] += frame.bits
        frames[frame.can_id] += 1
    told = {row.cob_id: (row.frames, row.share_percent) for row in case.analysis.bus_shares}
    if set(told) != set(frames):
        yield f"shares: of {len(told)} identifiers, not {len(frames)}"
        return
    for can_id, number in frames.items():
        expected = 100 * bits[can_id] / bits.total()
        if told[can_id][0] != number or abs(told[can_id][1] - expected) > _SHARE_PERCENT:
            yield f"share of {can_id:03X}h: {told[can_id]}, not {number}, {expected} %"
    by_node = {row.node: (row.frames, row.share_percent) for row in case.analysis.node_shares}
    for node in (each.node_id for each in case.plan.nodes):
        sent = [can_id for can_id in frames if can_id in _sent_by(node)]
        number = sum(frames[can_id] for can_id in sent)
        expected = 100 * sum(bits[can_id] for can_id in sent) / bits.total()
        found = by_node.get(node, (0, 0.0))
        if found[0] != number or abs(found[1] - expected) > _SHARE_PERCENT:
            yield f"share of node {node}: {found}, not {number}, {expected} %"


def _sent_by(node: int) -> set[int]:
    return {base + node for base in (*PDO_BASES, 0x580, 0x700)}


def wrong_rate(case: Measured) -> Iterator[str]:
    """A bit rate that nobody told and that is told wrongly."""
    (row,) = case.analysis.bus_load
    if row.bitrate is not None and row.bitrate != case.plan.bitrate:
        yield f"bit rate: {row.bitrate} ({row.bitrate_source}), not {case.plan.bitrate}"
    if row.bitrate is not None and row.bitrate_source != "estimated":
        yield f"source of the bit rate: {row.bitrate_source}"
    if row.bitrate is not None and row.bitrate_confidence != "high":
        yield f"confidence of the bit rate: {row.bitrate_confidence}, but it is used"
