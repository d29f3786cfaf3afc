"""Two analyses of one machine, part by part."""

from collections.abc import Callable, Iterable, Iterator

from syncline_analyzer.comparison.angles import angle_rows
from syncline_analyzer.comparison.bus import bus_rows
from syncline_analyzer.comparison.emcy import emcy_rows
from syncline_analyzer.comparison.found import finding_rows
from syncline_analyzer.comparison.identifiers import identifier_rows
from syncline_analyzer.comparison.kinds import KINDS, ORDER
from syncline_analyzer.comparison.node_presence import presence_rows
from syncline_analyzer.comparison.node_states import state_rows
from syncline_analyzer.comparison.parameters import parameter_rows
from syncline_analyzer.comparison.pdos import pdo_rows
from syncline_analyzer.comparison.periods import period_rows
from syncline_analyzer.comparison.rows import Comparison, ComparisonRow, NotSeenIn, UnseenRow, rank
from syncline_analyzer.comparison.sdo import sdo_rows
from syncline_analyzer.comparison.side import Pair, Side
from syncline_analyzer.redaction import Redaction
from syncline_analyzer.results import Analysis

Row = ComparisonRow | UnseenRow

PARTS: tuple[Callable[[Pair], Iterable[Row]], ...] = (
    bus_rows,
    presence_rows,
    state_rows,
    period_rows,
    pdo_rows,
    emcy_rows,
    parameter_rows,
    sdo_rows,
    angle_rows,
    identifier_rows,
    finding_rows,
)
"""What is compared of each bus."""

_MIN_LIKENESS = 0.2
"""Buses of different names are one where so many of their identifiers are the same."""


def compare(golden: Analysis, capture: Analysis) -> Comparison:
    """What is different in a capture from a healthy one of the same machine, ranked.

    Counts are compared as rates, times against their spread and the step of the stamps. What one of
    both could not have shown (it was cut, in a gap, or nobody asked) is not seen, never gone.
    """
    rows: list[ComparisonRow] = []
    unseen: list[UnseenRow] = []
    pairs = _paired(golden, capture)
    veiled = [Redaction.of_analysis(each) for each in (golden, capture)]
    for row in (*_lone_buses(golden, capture, pairs), *_all(pairs)):
        if isinstance(row, ComparisonRow) and any(_is_veiled(row, each) for each in veiled):
            side: NotSeenIn = "golden" if _is_veiled(row, veiled[0]) else "capture"
            reason = "payloads of this node or identifier were redacted"
            unseen.append(UnseenRow(row.bus, row.node, row.subject, side, reason))
        elif isinstance(row, ComparisonRow):
            rows.append(row)
        else:
            unseen.append(row)
    rows.sort(key=lambda row: rank(row, ORDER))
    return Comparison(
        golden.capture, capture.capture, rows, unseen, _heard_s(golden), _heard_s(capture)
    )


def _is_veiled(row: ComparisonRow, redaction: Redaction) -> bool:
    """Whether a difference may come of payloads that were dropped."""
    services = [base + row.node for base in (0x080, 0x580, 0x600, 0x700)] if row.node else []
    ids = [*services, *([] if row.cob_id is None else [row.cob_id])]
    return any(redaction.contains(can_id) for can_id in ids)


def _all(pairs: Iterable[Pair]) -> Iterator[Row]:
    for pair in pairs:
        for part in PARTS if pair.capture.frames and pair.golden.frames else ():
            yield from part(pair)


def _heard_s(analysis: Analysis) -> float | None:
    if analysis.capture.time_base == "none":
        return None
    sides = (Side(analysis, bus) for bus in analysis.capture.buses)
    return max((side.heard_ns for side in sides), default=0) / 1e9


def _paired(golden: Analysis, capture: Analysis) -> list[Pair]:
    """Buses of the same name, then those that carry the same identifiers."""
    left, right = list(golden.capture.buses), list(capture.capture.buses)
    if len(left) == len(right) == 1:
        return [_pair(golden, capture, left[0], right[0])]
    pairs = [_pair(golden, capture, bus, bus) for bus in left if bus in right]
    left, right = [b for b in left if b not in right], [b for b in right if b not in left]
    alike = sorted(
        ((_likeness(golden, a, capture, b), a, b) for a in left for b in right), reverse=True
    )
    for likeness, a, b in alike:
        if likeness >= _MIN_LIKENESS and a in left and b in right:
            pairs.append(_pair(golden, capture, a, b))
            left.remove(a)
            right.remove(b)
    return pairs


def _pair(golden: Analysis, capture: Analysis, left: str, right: str) -> Pair:
    return Pair(left, Side(golden, left), Side(capture, right))


def _likeness(golden: Analysis, left: str, capture: Analysis, right: str) -> float:
    ours = {row.cob_id for row in golden.bus_shares if row.bus == left}
    theirs = {row.cob_id for row in capture.bus_shares if row.bus == right}
    return len(ours & theirs) / max(len(ours | theirs), 1)


def _lone_buses(golden: Analysis, capture: Analysis, pairs: list[Pair]) -> Iterator[Row]:
    """Buses that only one capture has, or that only one heard something on."""
    for bus in golden.capture.buses:
        if all(pair.golden.bus != bus for pair in pairs):
            yield UnseenRow(bus, None, f"bus {bus}", "capture", "the capture has no such bus")
    for bus in capture.capture.buses:
        if all(pair.capture.bus != bus for pair in pairs):
            reason = "the golden capture has no such bus"
            yield UnseenRow(bus, None, f"bus {bus}", "golden", reason)
    for pair in pairs:
        if pair.golden.frames and not pair.capture.frames:
            yield _silent(pair)
        elif pair.capture.frames and not pair.golden.frames:
            reason = "nothing was heard on it in the golden capture"
            yield UnseenRow(pair.bus, None, f"bus {pair.bus}", "golden", reason)


def _silent(pair: Pair) -> Row:
    heard = pair.capture.heard if pair.capture.timed and pair.capture.heard_ns else "all of it"
    return ComparisonRow(
        kind="bus.silent",
        severity="error",
        bus=pair.bus,
        node=None,
        subject=f"bus {pair.bus}",
        text=f"No frame was heard on {pair.bus} in {heard}; golden: {pair.golden.frames:,} frames"
        f" in {pair.golden.heard}.",
        why=KINDS["bus.silent"],
        golden=f"{pair.golden.frames:,} frames",
        capture="nothing",
    )
