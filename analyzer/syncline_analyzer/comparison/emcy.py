"""Errors that nodes report."""

from collections.abc import Iterator

from syncline_analyzer.comparison.chance import more_often
from syncline_analyzer.comparison.found import proofs
from syncline_analyzer.comparison.rows import ComparisonRow, UnseenRow
from syncline_analyzer.comparison.side import Pair, Side
from syncline_analyzer.results import EmcyRow
from syncline_analyzer.views.words import hex_code

_TOLD = ("raised", "further")
_DUE = 8.0
"""Messages due, none of which came, before an error counts as gone."""


def emcy_rows(pair: Pair) -> Iterator[ComparisonRow | UnseenRow]:
    """Codes that are new, more frequent or gone, by node; new ones that a finding tells are told there."""
    golden, capture, proven = _by_code(pair.golden), _by_code(pair.capture), proofs(pair.capture)
    for node, code in sorted(golden.keys() | capture.keys()):
        before, now = golden.get((node, code), []), capture.get((node, code), [])
        told = {row.seq for row in now} <= proven.get(node, set())
        if now and ((not before and not told) or _more(pair, now, before)):
            yield _row(pair, node, code, before, now)
        elif before and not now:
            yield _gone(pair, node, code, before)


def _by_code(side: Side) -> dict[tuple[int, int], list[EmcyRow]]:
    found: dict[tuple[int, int], list[EmcyRow]] = {}
    for row in side.of_bus("emcy"):
        if row.transition in _TOLD and row.code is not None:
            found.setdefault((row.node, row.code), []).append(row)
    return found


def _more(pair: Pair, now: list[EmcyRow], before: list[EmcyRow]) -> bool:
    return more_often(len(now), pair.capture.extent, len(before), pair.golden.extent)


def _count(rows: list[EmcyRow], side: Side) -> str:
    return f"{len(rows):,} in {side.heard}" if rows else f"none in {side.heard}"


def _row(
    pair: Pair, node: int, code: int, before: list[EmcyRow], now: list[EmcyRow]
) -> ComparisonRow:
    told = [_count(before, pair.golden), _count(now, pair.capture)]
    active = any(
        row.node == node and row.code == code and row.status == "still active"
        for row in pair.capture.of_bus("errors")
    )
    left = ", still active at the end" if active else ""
    return pair.row(
        "emcy.more" if before else "emcy.new", "error" if active and not before else "warning",
        node, f"EMCY {hex_code(code)}",
        f"{pair.who(node)}: EMCY {hex_code(code)} ({now[0].meaning}): {told[1]}{left};"
        f" golden: {told[0]}.",
        *told, golden_value=float(len(before)), capture_value=float(len(now)), unit="messages",
        golden_seq=[row.seq for row in before[:20]], capture_seq=[row.seq for row in now[:20]],
        golden_ns=before[0].t_ns if before else None, capture_ns=now[0].t_ns,
        weight=float(len(now)),
    )  # fmt: skip


def _gone(pair: Pair, node: int, code: int, before: list[EmcyRow]) -> ComparisonRow | UnseenRow:
    subject = f"EMCY {hex_code(code)} of {pair.who(node).replace('Node', 'node')}"
    if len(before) / max(pair.golden.extent, 1e-9) * pair.capture.extent < _DUE:
        reason = "it came too seldom in golden to be due in a capture of this length"
        return UnseenRow(pair.bus, node, subject, "capture", reason)
    told = [_count(before, pair.golden), _count([], pair.capture)]
    return pair.row(
        "emcy.gone", "info", node, f"EMCY {hex_code(code)}",
        f"{pair.who(node)}: EMCY {hex_code(code)} ({before[0].meaning}): {told[1]};"
        f" golden: {told[0]}.",
        *told, golden_value=float(len(before)), capture_value=0.0, unit="messages",
        golden_seq=[row.seq for row in before[:20]], golden_ns=before[0].t_ns,
    )  # fmt: skip
