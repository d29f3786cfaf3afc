"""States of nodes, how they start, and who watches over them."""

from collections.abc import Iterator

from syncline_analyzer.comparison.chance import more_often
from syncline_analyzer.comparison.node_presence import ENOUGH
from syncline_analyzer.comparison.rows import ComparisonRow
from syncline_analyzer.comparison.side import OPERATIONAL, Pair, Side
from syncline_analyzer.results import NmtStateRow, NodeRow, Quantiles
from syncline_analyzer.views.words import duration

_UNKNOWN = "UNKNOWN"
_START_NS = 10_000_000_000
"""For so long after a boot-up a node may still be on its way to its usual state."""
_HELD_NS = 1_000_000_000
_BOOT_MS, _BOOT_SHARE = 100.0, 0.25
"""A boot time differs where it is so much off, absolutely and relatively."""


def state_rows(pair: Pair) -> Iterator[ComparisonRow]:
    """Nodes that both captures have and that are in other states, or start otherwise."""
    for number in sorted(pair.golden.nodes.keys() & pair.capture.nodes.keys()):
        if pair.timed:
            yield from _state(pair, number)
            yield from _boot_time(pair, number)
        yield from _boot_ups(pair, number)
        yield from _supervision(pair, pair.golden.nodes[number], pair.capture.nodes[number])


def usual_state(side: Side, node: int) -> NmtStateRow | None:
    """The state in which a node is at the end, None while it may still be starting.

    A node that was not heard in the end has none, except where it is LOST.
    """
    rows: list[NmtStateRow] = [row for row in side.of_bus("nmt_states") if row.node == node]
    if not rows or rows[-1].state in (_UNKNOWN, "INITIALISING"):
        return None
    last = rows[-1]
    held = last.end_ns - last.start_ns
    starting = any(
        row.state == "INITIALISING" or row.cause.startswith("boot-up") for row in rows[-3:-1]
    )
    starting |= last.cause.startswith("boot-up") or rows[0] is last
    if last.state == OPERATIONAL or held >= (_START_NS if starting else _HELD_NS):
        return last
    return None


def _state(pair: Pair, number: int) -> Iterator[ComparisonRow]:
    golden, capture = usual_state(pair.golden, number), usual_state(pair.capture, number)
    if golden is None or capture is None or golden.state == capture.state:
        return
    held = duration(capture.end_ns - capture.start_ns)
    yield pair.row(
        "node.state", "error" if golden.state == OPERATIONAL else "warning", number, "NMT state",
        f"{pair.who(number)} is {capture.state} in the end, for {held} ({capture.cause});"
        f" golden: {golden.state}.",
        golden.state, capture.state,
        golden_seq=[] if golden.evidence is None else [golden.evidence],
        capture_seq=[] if capture.evidence is None else [capture.evidence],
        golden_ns=golden.start_ns, capture_ns=capture.start_ns,
    )  # fmt: skip


def _boot_time(pair: Pair, number: int) -> Iterator[ComparisonRow]:
    golden, capture = pair.golden.nodes[number].boot_ms, pair.capture.nodes[number].boot_ms
    if golden is None or capture is None:
        return
    steps = pair.golden.analysis.capture.resolution_ns + pair.capture.analysis.capture.resolution_ns
    off = capture.median - golden.median
    scatter = max(golden.max - golden.min, capture.max - capture.min)
    if abs(off) <= max(_BOOT_MS, _BOOT_SHARE * golden.median, 2 * scatter, 2 * steps / 1e6):
        return
    yield pair.row(
        "node.boot_time", "warning" if off > 0 else "info", number, "boot time",
        f"{pair.who(number)} takes {_ms(capture)} from the reset to its boot-up;"
        f" golden: {_ms(golden)}.",
        _ms(golden), _ms(capture),
        golden_value=golden.median, capture_value=capture.median, unit="ms",
        weight=abs(off) / golden.median,
    )  # fmt: skip


def _ms(quantiles: Quantiles) -> str:
    return f"{quantiles.median:.0f} ms"


def _boot_ups(pair: Pair, number: int) -> Iterator[ComparisonRow]:
    golden, capture = pair.golden.nodes[number].boot_ups, pair.capture.nodes[number].boot_ups
    if not more_often(capture, pair.capture.extent, golden, pair.golden.extent):
        return
    told = [f"{golden} in {pair.golden.heard}", f"{capture} in {pair.capture.heard}"]
    yield pair.row(
        "node.boot_ups", "warning", number, "boot-ups",
        f"{pair.who(number)} booted {told[1]}; golden: {told[0]}.", *told,
        golden_value=float(golden), capture_value=float(capture), unit="boot-ups",
        weight=float(capture),
    )  # fmt: skip


def _supervision(pair: Pair, golden: NodeRow, capture: NodeRow) -> Iterator[ComparisonRow]:
    """Heartbeat or guarding that only one of both shows, the node being heard in both."""
    for what, before, now in (
        ("heartbeat", golden.heartbeats, capture.heartbeats),
        ("guarding", golden.guard_requests, capture.guard_requests),
    ):
        if before and now:
            continue
        here, there = (pair.golden, pair.capture) if before else (pair.capture, pair.golden)
        # As long as the node runs, the master has settled how it watches over it.
        runs = min(here.operational(golden.node), there.operational(golden.node))
        count = before or now
        if count < ENOUGH or count / here.extent * runs < 2 * ENOUGH:
            continue
        told = [f"{n:,} in {s.heard}" for n, s in ((before, pair.golden), (now, pair.capture))]
        kind = "error_control.gone" if before else "error_control.new"
        unit = "heartbeats" if what == "heartbeat" else "guard requests"
        yield pair.row(
            kind, "warning" if before else "info", golden.node, what,
            f"{pair.who(golden.node)}: {unit} {told[1]}; golden: {told[0]}.", *told,
            golden_value=float(before), capture_value=float(now), unit=unit,
        )  # fmt: skip
