"""Bit rate, load and error frames of a bus."""

from collections import Counter
from collections.abc import Iterator
from statistics import median

import numpy as np

from syncline_analyzer.comparison.chance import more_often
from syncline_analyzer.comparison.rows import ComparisonRow
from syncline_analyzer.comparison.side import Pair, Side
from syncline_analyzer.results import BusLoadRow, Severity

_SETTLING_NS = 1_000_000_000
_LOAD_POINTS, _LOAD_SHARE = 3.0, 0.2
"""A load differs where it is so many percent of the bus off, and so much of the larger one."""
_SECONDS = 5
"""Whole seconds of a settled bus that tell its load."""
_FULL = 70.0
"""Load [%] from which on low priorities wait noticeably."""


def bus_rows(pair: Pair) -> Iterator[ComparisonRow]:
    """Differences of one bus as a whole."""
    yield from _bit_rate(pair)
    if pair.timed:
        yield from _load(pair)
    yield from _error_frames(pair)


def _load_row(side: Side) -> BusLoadRow | None:
    rows: list[BusLoadRow] = side.of_bus("bus_load")
    return rows[0] if rows else None


def _bit_rate(pair: Pair) -> Iterator[ComparisonRow]:
    golden, capture = _load_row(pair.golden), _load_row(pair.capture)
    if golden is None or capture is None or not (golden.bitrate and capture.bitrate):
        return
    if golden.bitrate == capture.bitrate:
        return
    told = [f"{row.bitrate / 1000:g} kbit/s ({row.bitrate_source})" for row in (golden, capture)]  # type: ignore[operator]
    yield pair.row(
        "bus.bitrate", "error", None, "bit rate",
        f"The bit rate is {told[1]}; golden: {told[0]}.", *told,
        golden_value=float(golden.bitrate), capture_value=float(capture.bitrate), unit="bit/s",
    )  # fmt: skip


def _load(pair: Pair) -> Iterator[ComparisonRow]:
    golden, capture = settled_load(pair.golden), settled_load(pair.capture)
    if golden is None or capture is None:
        return
    off = capture - golden
    if abs(off) < max(_LOAD_POINTS, _LOAD_SHARE * max(golden, capture)):
        return
    severity: Severity = "warning" if capture >= _FULL or abs(off) >= 2 * _LOAD_POINTS else "info"
    yield pair.row(
        "bus.load", severity, None, "bus load",
        f"The bus carries {capture:.1f} % in a usual second; golden: {golden:.1f} %.",
        f"{golden:.1f} %", f"{capture:.1f} %",
        golden_value=golden, capture_value=capture, unit="%", weight=abs(off),
    )  # fmt: skip


def settled_load(side: Side) -> float | None:
    """Load of a usual second once every node is in the state in which it stays [%]."""
    row = _load_row(side)
    if row is None or row.bitrate is None or row.mean_percent is None:
        return None
    ends = [state.start_ns for state in side.of_bus("nmt_states")]
    since_ns = max(ends, default=0) + _SETTLING_NS
    for series in side.of_bus("series"):
        if series.name == "bus load":
            chosen = series.value[series.t_ns >= since_ns]
            chosen = chosen[np.isfinite(chosen)][:-1]
            return float(median(chosen.tolist())) if len(chosen) >= _SECONDS else None
    return None


def _error_frames(pair: Pair) -> Iterator[ComparisonRow]:
    golden, capture = _by_kind(pair.golden), _by_kind(pair.capture)
    for kind in sorted(golden.keys() | capture.keys()):
        counts = golden[kind], capture[kind]
        extents = pair.golden.extent, pair.capture.extent
        more = more_often(counts[1], extents[1], counts[0], extents[0])
        fewer = more_often(counts[0], extents[0], counts[1], extents[1])
        if not (more or fewer or (counts[1] and not counts[0])):
            continue
        told = [
            f"{count:,} in {side.heard}"
            for count, side in zip(counts, (pair.golden, pair.capture), strict=True)
        ]
        evidence = [row for row in pair.capture.of_bus("bus_errors") if row.kind == kind]
        yield pair.row(
            "error_frames.fewer" if fewer else "error_frames.more",
            "warning" if more else "info", None, f"error frames: {kind}",
            f"Error frames ({kind}): {told[1]}; golden: {told[0]}.", *told,
            golden_value=float(counts[0]), capture_value=float(counts[1]), unit="frames",
            capture_seq=[seq for row in evidence for seq in row.evidence],
            capture_ns=evidence[0].first_ns if evidence else None, weight=float(counts[1]),
        )  # fmt: skip


def _by_kind(side: Side) -> Counter[str]:
    return Counter({row.kind: row.count for row in side.of_bus("bus_errors")})
