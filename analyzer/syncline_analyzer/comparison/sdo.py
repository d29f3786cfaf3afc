"""SDO transfers that fail, and how fast devices answer."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import field
from statistics import median

from syncline_analyzer.comparison.chance import more_often
from syncline_analyzer.comparison.rows import ComparisonRow, UnseenRow
from syncline_analyzer.comparison.side import Pair, Side
from syncline_analyzer.results import SdoRow
from syncline_analyzer.views.words import number, object_name, sdo_result
from syncline_schemas.records import dataclass

_ANSWERS = 30
"""Answers that tell how fast a device is."""
_KEPT = 10_000
"""Answers of a node that are looked at."""
_SLOWER, _SLOWER_US = 2.0, 2000.0

Request = tuple[int | None, int | None, str]
"""Index, sub-index, direction."""


@dataclass(slots=True)
class _Node:
    """What was asked of one node."""

    transfers: int = 0
    failed: int = 0
    ok: set[Request] = field(default_factory=set)
    failures: dict[tuple[Request, str], list[SdoRow]] = field(default_factory=dict)
    answers_us: list[float] = field(default_factory=list)
    first_failed: list[int] = field(default_factory=list)


def sdo_rows(pair: Pair) -> Iterator[ComparisonRow | UnseenRow]:
    """Requests that fail now, or more often; nodes that only one capture has are told elsewhere."""
    golden, capture = _by_node(pair.golden), _by_node(pair.capture)
    for node in sorted(golden.keys() & capture.keys()):
        yield from _new_failures(pair, node, golden[node], capture[node])
        yield from _share(pair, node, golden[node], capture[node])
        if pair.timed:
            yield from _speed(pair, node, golden[node], capture[node])


def _by_node(side: Side) -> dict[int, _Node]:
    found: defaultdict[int, _Node] = defaultdict(_Node)
    for row in side.analysis.sdo:
        if row.bus != side.bus or row.node not in side.nodes:
            continue
        node, request = found[row.node], (row.index, row.sub, row.direction)
        node.transfers += 1
        if row.result == "ok":
            node.ok.add(request)
            if row.answer_us is not None and len(node.answers_us) < _KEPT:
                node.answers_us.append(row.answer_us)
        elif row.result != "interrupted":
            node.failed += 1
            node.first_failed = [*node.first_failed, row.seq][:20]
            node.failures.setdefault((request, sdo_result(row)), []).append(row)
    return found


def _new_failures(
    pair: Pair, node: int, golden: _Node, capture: _Node
) -> Iterator[ComparisonRow | UnseenRow]:
    for (request, result), rows in capture.failures.items():
        if any(request == before for before, _ in golden.failures):
            continue
        first = rows[0]
        what = (
            f"{'reading' if first.direction == 'upload' else 'writing'} {object_name(*request[:2])}"
        )
        subject = f"{what}{f' {first.name}' if first.name else ''}"
        if request not in golden.ok:
            reason = f"nobody tried it there; in the capture: {result}"
            yield UnseenRow(pair.bus, node, f"{pair.who(node)}: {subject}", "golden", reason)
            continue
        times = f"{len(rows)} times" if len(rows) > 1 else "once"
        yield pair.row(
            "sdo.new_failure", "warning", node, subject,
            f"{pair.who(node)}: {subject} failed {times}: {result}; golden: it worked.",
            "ok", result, golden_value=0.0, capture_value=float(len(rows)), unit="transfers",
            object=(request[0] or 0) << 8 | (request[1] or 0),
            capture_seq=[row.seq for row in rows[:20]], capture_ns=first.start_ns,
            weight=float(len(rows)),
        )  # fmt: skip


def _share(pair: Pair, node: int, golden: _Node, capture: _Node) -> Iterator[ComparisonRow]:
    if not more_often(capture.failed, capture.transfers, golden.failed, golden.transfers):
        return
    told = [f"{each.failed:,} of {each.transfers:,} transfers" for each in (golden, capture)]
    yield pair.row(
        "sdo.more_failures", "warning", node, "SDO transfers that failed",
        f"{pair.who(node)}: {told[1]} failed; golden: {told[0]}.", *told,
        golden_value=float(golden.failed), capture_value=float(capture.failed), unit="transfers",
        capture_seq=capture.first_failed, weight=capture.failed / capture.transfers,
    )  # fmt: skip


def _speed(pair: Pair, node: int, golden: _Node, capture: _Node) -> Iterator[ComparisonRow]:
    if min(len(golden.answers_us), len(capture.answers_us)) < _ANSWERS:
        return
    before, now = median(golden.answers_us), median(capture.answers_us)
    steps = pair.golden.analysis.capture.resolution_ns + pair.capture.analysis.capture.resolution_ns
    if now < _SLOWER * before or now - before < max(_SLOWER_US, steps / 1000):
        return
    yield pair.row(
        "sdo.slower", "info", node, "SDO answers",
        f"{pair.who(node)} answers a request after {number(now, 'us')}; golden:"
        f" {number(before, 'us')}.",
        number(before, "us"), number(now, "us"), golden_value=before, capture_value=now, unit="us",
        weight=now / before,
    )  # fmt: skip
