"""What angle sensors show: settings, noise at rest, how far they move."""

from collections.abc import Iterator

from syncline_analyzer.comparison.rows import ComparisonRow
from syncline_analyzer.comparison.side import Pair
from syncline_analyzer.results import TraceRow
from syncline_analyzer.views.words import number, trace_object

_REST = 1000
"""Samples at rest that tell the noise."""
_NOISIER = 3.0
_TURNS = 6
"""Turns back after which the usual range of an axis is known: it went to and fro three times."""
_BEYOND = 0.25
"""Share of the usual range that it must leave it by."""
_WHOLE_TURN = 360.0


def angle_rows(pair: Pair) -> Iterator[ComparisonRow]:
    """Differences of the traces that both captures have."""
    golden: dict[tuple[int, int], TraceRow] = {
        (row.node, row.object): row for row in pair.golden.of_bus("traces")
    }
    for row in pair.capture.of_bus("traces"):
        before = golden.get((row.node, row.object))
        if before is not None and before.unit == row.unit:
            yield from _clockwise(pair, before, row)
            yield from _noise(pair, before, row)
            yield from _range(pair, before, row)


def _subject(row: TraceRow) -> str:
    return f"{trace_object(row.object)} {row.name}"


def _clockwise(pair: Pair, before: TraceRow, now: TraceRow) -> Iterator[ComparisonRow]:
    assumed = {*before.assumed, *now.assumed}
    if assumed or None in (before.clockwise, now.clockwise) or before.clockwise == now.clockwise:
        return
    told = ["clockwise" if row.clockwise else "counterclockwise" for row in (before, now)]
    yield pair.row(
        "angle.setting", "error", now.node, _subject(now),
        f"{pair.who(now.node)}: {now.name} rises {told[1]}; golden: {told[0]}.", *told,
        object=now.object,
    )  # fmt: skip


def _noise(pair: Pair, before: TraceRow, now: TraceRow) -> Iterator[ComparisonRow]:
    golden, capture = before.noise_deg, now.noise_deg
    if not golden or not capture or min(before.rest_samples, now.rest_samples) < _REST:
        return
    if capture < _NOISIER * golden:
        return
    told = [number(value, "deg") for value in (golden, capture)]
    yield pair.row(
        "angle.noise", "warning", now.node, _subject(now),
        f"{pair.who(now.node)}: {now.name} is noisy by {told[1]} at rest; golden: {told[0]}.",
        *told, golden_value=golden, capture_value=capture, unit="deg", object=now.object,
        weight=capture / golden,
    )  # fmt: skip


def _range(pair: Pair, before: TraceRow, now: TraceRow) -> Iterator[ComparisonRow]:
    """An axis that goes to and fro within less than a turn, and now beyond."""
    if (before.direction_changes or 0) < _TURNS or not before.samples or not now.samples:
        return
    ends = [(row.unwrapped_min_deg, row.unwrapped_max_deg) for row in (before, now)]
    (low, high), (now_low, now_high) = ends
    if low is None or high is None or now_low is None or now_high is None:
        return
    span = high - low
    if not 1.0 <= span < _WHOLE_TURN or before.cuts:
        return
    if now_low >= low - _BEYOND * span and now_high <= high + _BEYOND * span:
        return
    told = [f"{a:.4g} to {b:.4g} deg" for a, b in ((low, high), (now_low, now_high))]
    yield pair.row(
        "angle.range", "info", now.node, _subject(now),
        f"{pair.who(now.node)}: {now.name} goes from {told[1]}; golden: from {told[0]}.", *told,
        golden_value=span, capture_value=now_high - now_low, unit="deg", object=now.object,
        weight=(now_high - now_low) / span,
    )  # fmt: skip
