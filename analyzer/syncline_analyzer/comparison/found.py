"""Findings that only one capture has, or that come more often."""

from collections.abc import Iterator

from syncline_analyzer.comparison.chance import more_often
from syncline_analyzer.comparison.rows import ComparisonRow, UnseenRow
from syncline_analyzer.comparison.side import Pair, Side
from syncline_analyzer.results import Finding

_DUE = 8.0
"""Findings due, none of which came, before one counts as gone."""

Key = tuple[str, int | None]


def finding_rows(pair: Pair) -> Iterator[ComparisonRow | UnseenRow]:
    """Findings by rule and node; those of all buses are told once, with the first one.

    A note that only one capture has is no difference: it may hang on what was asked or started there.
    """
    golden, capture = _by_rule(pair.golden), _by_rule(pair.capture)
    for key in sorted(golden.keys() | capture.keys(), key=str):
        before, now = golden.get(key, []), capture.get(key, [])
        if now and not before:
            yield _new(pair, now)
        elif before and now:
            yield from _more(pair, before, now)
        else:
            yield _gone(pair, before)


def _by_rule(side: Side) -> dict[Key, list[Finding]]:
    found: dict[Key, list[Finding]] = {}
    first = side.analysis.capture.buses[:1] == [side.bus]
    for finding in side.analysis.findings:
        if finding.bus == side.bus or (finding.bus is None and first):
            found.setdefault((finding.id, finding.node), []).append(finding)
    return found


def _count(rows: list[Finding], side: Side) -> str:
    return f"{len(rows):,} in {side.heard}" if rows else f"none in {side.heard}"


def _new(pair: Pair, now: list[Finding]) -> ComparisonRow | UnseenRow:
    first = now[0]
    if first.severity == "info":
        reason = f"a note that may hang on what happened there: {first.text}"
        return UnseenRow(pair.bus, first.node, first.id, "golden", reason)
    more = f" ({len(now)} times)" if len(now) > 1 else ""
    return pair.row(
        "finding.new", first.severity, first.node, first.id,
        f"{first.text}{more} Golden: none in {pair.golden.heard}.",
        _count([], pair.golden), _count(now, pair.capture),
        golden_value=0.0, capture_value=float(len(now)), unit="findings",
        capture_seq=first.evidence[:20], capture_ns=first.start_ns, weight=float(len(now)),
        why=f"Likely cause: {first.cause} Check next: {first.check_next}",
    )  # fmt: skip


def proofs(side: Side) -> dict[int | None, set[int]]:
    """Frames of findings that are no mere notes, and of what followed from them, by node."""
    found: dict[int | None, set[int]] = {}
    for finding in side.analysis.findings:
        if finding.severity != "info" and finding.bus == side.bus:
            for piece in (finding.as_link(), *finding.chain):
                found.setdefault(piece.node, set()).update(piece.evidence)
    return found


def _more(pair: Pair, before: list[Finding], now: list[Finding]) -> Iterator[ComparisonRow]:
    first = now[0]
    if not more_often(len(now), pair.capture.extent, len(before), pair.golden.extent):
        return
    told = [_count(before, pair.golden), _count(now, pair.capture)]
    yield pair.row(
        "finding.more", first.severity, first.node, first.id,
        f"{first.id}: {told[1]}; golden: {told[0]}. First: {first.text}", *told,
        golden_value=float(len(before)), capture_value=float(len(now)), unit="findings",
        golden_seq=before[0].evidence[:20], capture_seq=first.evidence[:20],
        golden_ns=before[0].start_ns, capture_ns=first.start_ns, weight=float(len(now)),
    )  # fmt: skip


def _gone(pair: Pair, before: list[Finding]) -> ComparisonRow | UnseenRow:
    first = before[0]
    due = len(before) / max(pair.golden.extent, 1e-9) * pair.capture.extent
    if first.severity == "info" or due < _DUE:
        reason = f"it came too seldom to be due again: {first.text}"
        return UnseenRow(pair.bus, first.node, first.id, "capture", reason)
    return pair.row(
        "finding.gone", "info", first.node, first.id,
        f"Not found in {pair.capture.heard}: {first.text}",
        _count(before, pair.golden), _count([], pair.capture),
        golden_value=float(len(before)), capture_value=0.0, unit="findings",
        golden_seq=first.evidence[:20], golden_ns=first.start_ns,
    )  # fmt: skip
