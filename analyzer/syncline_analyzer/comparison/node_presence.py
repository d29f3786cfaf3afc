"""Which nodes there are, and which devices they are."""

from collections.abc import Iterator

from syncline_analyzer.comparison.rows import ComparisonRow, UnseenRow
from syncline_analyzer.comparison.side import Pair, Side, rhythmic
from syncline_analyzer.results import NodeRow, ObjectRow, Severity
from syncline_analyzer.views.words import object_name

ENOUGH = 4
"""Signs of life that are due, none of which came, before a node counts as missing."""
_SILENT_S = 5.0
"""For so long a device may be silent while it starts (LIR: 4 s after a reset)."""
_IDENTITY: dict[tuple[int, int], tuple[str, Severity, str]] = {
    (0x1000, 0): ("node.identity", "error", "device type"),
    (0x1008, 0): ("node.identity", "error", "device name"),
    (0x1018, 1): ("node.identity", "error", "vendor"),
    (0x1018, 2): ("node.identity", "error", "product code"),
    (0x1009, 0): ("node.firmware", "warning", "hardware version"),
    (0x100A, 0): ("node.firmware", "warning", "software version"),
    (0x1018, 3): ("node.firmware", "warning", "revision number"),
    (0x1018, 4): ("node.serial", "warning", "serial number"),
}
"""Objects that tell which device it is: kind of the difference, severity, words."""
IDENTITY_OBJECTS = _IDENTITY.keys()
SEEN = ("sdo-read", "sdo-write")
"""Sources of a value that the bus itself told."""


def presence_rows(pair: Pair) -> Iterator[ComparisonRow | UnseenRow]:
    """Nodes that are missing, new, or others than before."""
    golden, capture = pair.golden, pair.capture
    for number in sorted(golden.nodes.keys() - capture.nodes.keys()):
        yield _missing(pair, golden.nodes[number])
    for number in sorted(capture.nodes.keys() - golden.nodes.keys()):
        yield _new(pair, capture.nodes[number])
    if pair.golden.nodes.keys() & pair.capture.nodes.keys():
        yield from _identities(pair)


def due(row: NodeRow, here: Side, there: Side) -> float:
    """Signs of life of a node that the other capture should hold, had it been there."""
    listened = there.extent - _SILENT_S if there.timed else there.extent
    if not here.extent or listened <= 0:
        return 0.0
    signs = [row.heartbeats / here.extent * listened if row.heartbeats >= ENOUGH else 0.0]
    if row.guard_answers:
        signs.append(there.guard_requests.get(row.node, 0) / there.extent * listened)
    share = here.operational(row.node)
    frames = sum(p.frames for p in here.pdos.values() if p.node == row.node and rhythmic(p))
    if share and frames >= ENOUGH:
        signs.append(frames / share * min(there.operational(None), listened))
    return max(signs)


def _signs(row: NodeRow) -> str:
    counts = (
        (row.heartbeats, "heartbeats"),
        (row.guard_answers, "guard answers"),
        (row.pdo_frames, "PDOs"),
        (row.sdo_transfers, "SDO transfers"),
        (row.emcy, "EMCYs"),
    )
    return ", ".join(f"{count:,} {what}" for count, what in counts if count) or "boot-up only"


def _missing(pair: Pair, row: NodeRow) -> ComparisonRow | UnseenRow:
    calls = [
        each for each in pair.capture.of_bus("sdo")
        if each.node == row.node and each.result == "no answer"
    ]  # fmt: skip
    called = calls and (pair.capture.extent > _SILENT_S or not pair.capture.timed)
    if due(row, pair.golden, pair.capture) < ENOUGH and not called:
        reason = "nothing of it was due: it is not heard regularly, or the capture is too short"
        return UnseenRow(pair.bus, row.node, pair.who(row.node), "capture", reason)
    asked = pair.capture.guard_requests.get(row.node, 0) + len(calls)
    unanswered = f", {asked} requests to it got no answer" if asked else ""
    return pair.row(
        "node.missing", "error", row.node, "node",
        f"{pair.who(row.node)} is missing: not one message of it in {pair.capture.heard}"
        f"{unanswered}; golden: {_signs(row)} in {pair.golden.heard}.",
        _signs(row), "not heard", golden_seq=_states(pair.golden, row.node),
        capture_seq=[each.seq for each in calls[:20]], weight=float(row.pdo_frames),
        capture_ns=calls[0].start_ns if calls else None,
    )  # fmt: skip


def _new(pair: Pair, row: NodeRow) -> ComparisonRow | UnseenRow:
    if due(row, pair.capture, pair.golden) < ENOUGH:
        reason = "nothing of it was due there: it is not heard regularly, or golden is too short"
        return UnseenRow(pair.bus, row.node, pair.who(row.node), "golden", reason)
    states = [s for s in pair.capture.of_bus("nmt_states") if s.node == row.node]
    return pair.row(
        "node.new", "warning", row.node, "node",
        f"{pair.who(row.node)} is new: {_signs(row)} in {pair.capture.heard}; golden: none in"
        f" {pair.golden.heard}.",
        "not there", _signs(row), capture_seq=_states(pair.capture, row.node),
        capture_ns=next((s.start_ns for s in states if s.evidence is not None), None),
    )  # fmt: skip


def _states(side: Side, node: int) -> list[int]:
    """The first frames that prove states of a node."""
    rows = [row for row in side.of_bus("nmt_states") if row.node == node]
    return [row.evidence for row in rows if row.evidence is not None][:5]


def _identities(pair: Pair) -> Iterator[ComparisonRow]:
    capture = identity_of(pair.capture)
    for key, before in identity_of(pair.golden).items():
        now = capture.get(key)
        if now is None or now.value == before.value:
            continue
        kind, severity, what = _IDENTITY[now.index, now.sub]
        told = [_shown(before), _shown(now)]
        yield pair.row(
            kind, severity, now.node, what,
            f"{pair.who(now.node)}: {what} is {told[1]}; golden: {told[0]}"
            f" ({object_name(now.index, now.sub)}).",
            *told, object=now.index << 8 | now.sub,
            golden_seq=[before.seq or 0], capture_seq=[now.seq or 0],
            golden_ns=before.t_ns, capture_ns=now.t_ns,
        )  # fmt: skip


def identity_of(side: Side) -> dict[tuple[int, int, int], ObjectRow]:
    """What nodes answered to who they are, by (node, index, sub)."""
    return {
        (row.node, row.index, row.sub): row
        for row in side.of_bus("objects")
        if (row.index, row.sub) in _IDENTITY and row.source in SEEN
    }


def _shown(row: ObjectRow) -> str:
    if isinstance(row.value, int):
        return f"{row.meaning} ({row.value:X}h)" if row.meaning else f"{row.value:X}h"
    return str(row.value)
