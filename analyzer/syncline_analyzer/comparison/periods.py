"""Periods of SYNC, heartbeats, guard requests and cyclic PDOs."""

from collections.abc import Iterator
from typing import Any

from syncline_analyzer.comparison.chance import Sample, shifted, wider
from syncline_analyzer.comparison.node_presence import ENOUGH
from syncline_analyzer.comparison.rows import ComparisonRow, NotSeenIn, UnseenRow
from syncline_analyzer.comparison.side import Pair, Side, cyclic
from syncline_analyzer.results import PdoRow, Quantiles, Severity, SyncRow
from syncline_analyzer.views.words import hex_code, number

_LEAST = 0.01
"""A median this far off is another period; clocks of devices differ by less."""
_MUCH, _ANOTHER = 0.05, 0.2
"""Shares of the period from which on it is serious, for SYNC from the second."""
_FEW = 10
"""Periods that tell a median."""
_JITTER = 0.05
"""Scatter below this share of the period is of no concern."""


def period_rows(pair: Pair) -> Iterator[ComparisonRow | UnseenRow]:
    """Differences of rhythms; nothing on logs without times."""
    yield from _syncs(pair)
    if not pair.timed:
        return
    for golden, capture in _error_controls(pair):
        name = f"{golden.kind} of {pair.who(golden.node).replace('Node', 'node')}"
        yield from _period(pair, "period", golden.node, None, name, golden, capture)
    for golden, capture in pair.both("pdos", "cob_id"):
        if cyclic(golden) and cyclic(capture):
            name = f"{golden.pdo or 'PDO'} ({hex_code(golden.cob_id, 3)})"
            yield from _period(pair, "period", golden.node, golden.cob_id, name, golden, capture)


def _error_controls(pair: Pair) -> Iterator[tuple[Any, Any]]:
    golden = {(row.node, row.kind): row for row in pair.golden.of_bus("error_control_periods")}
    for row in pair.capture.of_bus("error_control_periods"):
        if (row.node, row.kind) in golden:
            yield golden[row.node, row.kind], row


def _syncs(pair: Pair) -> Iterator[ComparisonRow | UnseenRow]:
    golden: dict[int, SyncRow] = {row.cob_id: row for row in pair.golden.of_bus("sync")}
    capture: dict[int, SyncRow] = {row.cob_id: row for row in pair.capture.of_bus("sync")}
    for cob_id in sorted(golden.keys() | capture.keys()):
        before, now = golden.get(cob_id), capture.get(cob_id)
        name = f"SYNC ({hex_code(cob_id, 3)})"
        if before is None or now is None:
            yield from _lone_sync(pair, cob_id, name, before, now)
        elif pair.timed:
            rows = list(_period(pair, "sync.period", None, cob_id, name, before, now))
            yield from rows or _extreme(pair, None, cob_id, f"Period of {name}", before, now)


def _lone_sync(
    pair: Pair, cob_id: int, name: str, before: SyncRow | None, now: SyncRow | None
) -> Iterator[ComparisonRow | UnseenRow]:
    """A SYNC that only one capture has."""
    row, here, there = (
        (before, pair.golden, pair.capture) if before else (now, pair.capture, pair.golden)
    )
    assert row is not None
    if (cob_id, False) in there.identifiers:
        return
    if row.count / max(here.extent, 1e-9) * _running(here, there) < 2 * ENOUGH:
        side: NotSeenIn = "capture" if before else "golden"
        yield UnseenRow(pair.bus, None, name, side, "it is too short, or the machine did not run")
        return
    count = f"{row.count:,} in {here.heard}"
    told = [count, "none"] if before else ["none", count]
    yield pair.row(
        "sync.gone" if before else "sync.new", "error" if before else "warning", None, name,
        f"{name}: {told[1]}{f' in {there.heard}' if before else ''}; golden: {told[0]}.", *told,
        cob_id=cob_id, golden_value=float(before.count if before else 0),
        capture_value=float(now.count if now else 0), unit="SYNCs",
    )  # fmt: skip


def _running(here: Side, there: Side) -> float:
    """How much of the other capture a SYNC would have been in: all, or while nodes run."""
    return there.operational(None) if here.operational(None) else there.extent


def _sample(row: Any) -> Sample | None:
    count = row.frames if isinstance(row, PdoRow) else row.count
    jitter = row.period_jitter_us if isinstance(row, PdoRow) else row.jitter_us
    if row.period_us is None or count < _FEW:
        return None
    return Sample(row.period_us, jitter, count, row.resolution_us, row.quantile_error)


def _period(
    pair: Pair, kind: str, node: int | None, cob_id: int | None, name: str, before: Any, now: Any
) -> Iterator[ComparisonRow]:
    golden, capture = _sample(before), _sample(now)
    if golden is None or capture is None:
        return
    told = [period_words(golden.quantiles), period_words(capture.quantiles)]
    usual = golden.quantiles.median
    off = shifted(golden, capture, _LEAST * usual)
    common: dict[str, Any] = {"cob_id": cob_id, "unit": "us"}
    if off is not None:
        yield pair.row(
            kind, _severity(kind, abs(off) / usual), node, name,
            f"{name}: every {number(capture.quantiles.median / 1000, 'ms')}, {off / usual:+.1%};"
            f" golden: every {number(usual / 1000, 'ms')}.",
            *told, golden_value=usual, capture_value=capture.quantiles.median,
            weight=abs(off) / usual, golden_seq=_worst(pair.golden, before), capture_seq=_worst(pair.capture, now), **common,
        )  # fmt: skip
    elif wider(golden, capture, _JITTER * usual):
        yield pair.row(
            "jitter", "warning" if capture.spread_us > 0.1 * usual else "info", node, name,
            f"{name}: 98 of 100 periods lie within {number(capture.spread_us, 'us')};"
            f" golden: within {number(golden.spread_us, 'us')}.",
            *told, golden_value=golden.spread_us, capture_value=capture.spread_us,
            weight=capture.spread_us / usual, golden_seq=_worst(pair.golden, before), capture_seq=_worst(pair.capture, now), **common,
        )  # fmt: skip


def _severity(kind: str, share: float) -> Severity:
    if kind == "sync.period":
        return "error" if share >= _ANOTHER else "warning"
    return "warning" if share >= _MUCH else "info"


def _worst(side: Side, row: Any) -> list[int]:
    """Frames that ended the longest and shortest periods."""
    if (seq := getattr(row, "worst_seq", None)) is not None:
        return [seq]
    cob_id = getattr(row, "cob_id", None)
    found = [each for each in side.of_bus("worst") if each.cob_id == cob_id]
    return [each.seq for each in found if each.quantity.endswith("period")][:5]


def _extreme(
    pair: Pair, node: int | None, cob_id: int, name: str, before: SyncRow, now: SyncRow
) -> Iterator[ComparisonRow]:
    """A single period far outside of what golden shows, where golden is long enough to show it."""
    golden, capture = before.period_us, now.period_us
    if golden is None or capture is None or pair.capture.extent > 4 * pair.golden.extent:
        return
    far = (
        capture.max > golden.max + golden.median / 2 or capture.min < golden.min - golden.median / 2
    )
    if far and min(before.count, now.count) >= 100:
        yield pair.row(
            "extreme", "info", node, name,
            f"{name}: from {number(capture.min, 'us')} to {number(capture.max, 'us')};"
            f" golden: from {number(golden.min, 'us')} to {number(golden.max, 'us')}.",
            period_words(golden), period_words(capture),
            golden_value=golden.max, capture_value=capture.max, unit="us", cob_id=cob_id,
            golden_seq=_worst(pair.golden, before), capture_seq=_worst(pair.capture, now),
        )  # fmt: skip


def period_words(quantiles: Quantiles) -> str:
    """Median, 99th percentile and both ends [us]."""
    q = quantiles
    return (
        f"median {number(q.median, 'us')}, p99 {number(q.p99, 'us')},"
        f" {number(q.min)} to {number(q.max, 'us')}"
    )
