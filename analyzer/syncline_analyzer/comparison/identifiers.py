"""Identifiers on the bus that no other part of the comparison speaks of."""

from collections.abc import Iterator

from syncline_analyzer.comparison.rows import ComparisonRow, NotSeenIn, UnseenRow
from syncline_analyzer.comparison.side import Pair, Side
from syncline_analyzer.results import BusShareRow
from syncline_analyzer.views.words import hex_code

_DUE = 100.0
"""Frames due, none of which came, before an identifier counts as gone or new; they come in bursts."""
_CANOPEN = (range(0x101), range(0x581, 0x680), range(0x701, 0x780), range(0x7E4, 0x7E6))

Key = tuple[int, bool]


def identifier_rows(pair: Pair) -> Iterator[ComparisonRow | UnseenRow]:
    """Data frames of nobody known that only one capture has."""
    golden, capture = _others(pair.golden), _others(pair.capture)
    lone = {key for key in golden if key not in pair.capture.identifiers}
    lone |= {key for key in capture if key not in pair.golden.identifiers}
    for key in sorted(lone):
        row = golden.get(key) or capture[key]
        here, there = (pair.golden, pair.capture) if key in golden else (pair.capture, pair.golden)
        code = f"{hex_code(row.cob_id, 8 if row.extended else 3)}"
        if row.frames / max(here.extent, 1e-9) * there.extent < _DUE:
            side: NotSeenIn = "capture" if key in golden else "golden"
            yield UnseenRow(pair.bus, None, f"identifier {code}", side, "it is too rare to be due")
            continue
        count = f"{row.frames:,} in {here.heard}"
        told = [count, "none"] if key in golden else ["none", count]
        gone = key in golden
        yield pair.row(
            "identifier.gone" if gone else "identifier.new", "info" if gone else "warning",
            None, f"identifier {code}",
            f"Frames with the identifier {code}: {told[1]}; golden: {told[0]}.", *told,
            cob_id=row.cob_id, weight=float(row.frames),
        )  # fmt: skip


def _others(side: Side) -> dict[Key, BusShareRow]:
    """Rows of data frames that are no service of a known node."""
    found: dict[Key, BusShareRow] = {}
    for row in side.of_bus("bus_shares"):
        usual = not row.extended and (
            row.cob_id in side.pdos or any(row.cob_id in ids for ids in _CANOPEN)
        )
        if not (usual or row.remote or row.node is not None or row.cob_id is None):
            found[row.cob_id, row.extended] = row
    return found
