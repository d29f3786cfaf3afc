"""The two captures of a comparison: what each could have shown, on which bus, for how long."""

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

from syncline_analyzer.comparison.kinds import KINDS
from syncline_analyzer.comparison.rows import ComparisonRow
from syncline_analyzer.results import Analysis, GapRow, NodeRow, PdoRow, Severity
from syncline_analyzer.views.words import duration, printable
from syncline_schemas.records import dataclass

OPERATIONAL = "OPERATIONAL"
_GUESS = ["pdo (guess)"]


@dataclass(frozen=True)
class Side:
    """One capture, seen through one of its buses."""

    analysis: Analysis
    bus: str

    @property
    def timed(self) -> bool:
        """Whether the log has times."""
        return self.analysis.capture.time_base != "none"

    @cached_property
    def heard_ns(self) -> int:
        """How long the recorder listened to the bus [ns]: without gaps."""
        capture = self.analysis.capture
        return capture.duration_ns - _covered(
            [gap for gap in capture.gaps if gap.bus in (None, self.bus)],
            capture.begin_ns,
            capture.end_ns,
        )

    @cached_property
    def frames(self) -> int:
        """Frames on the bus."""
        return sum(row.frames for row in self.analysis.bus_shares if row.bus == self.bus)

    @property
    def extent(self) -> float:
        """How much was heard: seconds, or frames where the log has no times."""
        return self.heard_ns / 1e9 if self.timed else float(self.frames)

    @property
    def heard(self) -> str:
        """The same in words: "2 h 3 min"."""
        return duration(self.heard_ns) if self.timed else f"{self.frames:,} frames"

    def of_bus(self, table: str) -> list[Any]:
        """Rows of a table that are about this bus."""
        return [row for row in getattr(self.analysis, table) if row.bus == self.bus]

    @cached_property
    def nodes(self) -> dict[int, NodeRow]:
        """Nodes that are no guess, by number."""
        rows: list[NodeRow] = self.of_bus("nodes")
        return {row.node: row for row in rows if row.proof != _GUESS}

    @cached_property
    def pdos(self) -> dict[int, PdoRow]:
        """PDOs that were sent, by identifier."""
        rows: list[PdoRow] = self.of_bus("pdos")
        return {row.cob_id: row for row in rows}

    @cached_property
    def identifiers(self) -> dict[tuple[int, bool], int]:
        """Data frames by identifier, and whether it has 29 bits; whoever may have sent them."""
        return {
            (row.cob_id, row.extended): row.frames
            for row in self.of_bus("bus_shares")
            if row.cob_id is not None and not row.remote
        }

    @cached_property
    def guard_requests(self) -> dict[int, int]:
        """Guard requests by node."""
        found: Counter[int] = Counter()
        for row in self.of_bus("bus_shares"):
            if row.remote and row.cob_id is not None and 0x701 <= row.cob_id <= 0x77F:
                found[row.cob_id - 0x700] += row.frames
        return found

    def operational(self, node: int | None) -> float:
        """How much of `extent` a node was OPERATIONAL; of the longest of all where None."""
        shares = [
            row.state_share.get(OPERATIONAL, 0.0)
            for number, row in self.nodes.items()
            if node in (None, number)
        ]
        return max(shares, default=0.0) * self.extent


def rhythmic(pdo: PdoRow) -> bool:
    """Whether a PDO comes by a rhythm: at SYNCs, or by a timer."""
    if pdo.transmission_type is not None and 1 <= pdo.transmission_type <= 240:
        return True
    return bool(pdo.event_timer_us) or cyclic(pdo) or pdo.every is not None


def cyclic(pdo: PdoRow) -> bool:
    """Whether a PDO comes by a timer of its own."""
    return bool(pdo.event_timer_us) or pdo.type_source.startswith("inferred: cyclic")


@dataclass(frozen=True)
class Pair:
    """One bus in both captures; `bus` is its name in the rows."""

    bus: str
    golden: Side
    capture: Side

    @property
    def timed(self) -> bool:
        """Whether both logs have times."""
        return self.golden.timed and self.capture.timed

    def who(self, node: int | None) -> str:
        """A node by number and name."""
        rows = [self.golden.nodes.get(node or 0), self.capture.nodes.get(node or 0)]
        name = next((row.name for row in rows if row is not None and row.name), None)
        if not node:
            return "The master"
        return f"Node {node} ({printable(name)})" if name else f"Node {node}"

    def both(self, table: str, key: str) -> Iterator[tuple[Any, Any]]:
        """Rows of a table with the same key in both."""
        golden = {getattr(row, key): row for row in self.golden.of_bus(table)}
        for row in self.capture.of_bus(table):
            if getattr(row, key) in golden:
                yield golden[getattr(row, key)], row

    def row(
        self,
        kind: str,
        severity: Severity,
        node: int | None,
        subject: str,
        text: str,
        golden: str,
        capture: str,
        **more: Any,
    ) -> ComparisonRow:
        """A difference on this bus."""
        why = more.pop("why", KINDS[kind])
        return ComparisonRow(
            kind, severity, self.bus, node, subject, text, why, golden, capture, **more
        )


def _covered(gaps: Sequence[GapRow], begin_ns: int, end_ns: int) -> int:
    """How much of a stretch lies in gaps, which may overlap."""
    total, reached = 0, begin_ns
    for gap in sorted(gaps, key=lambda gap: gap.start_ns):
        start, end = max(gap.start_ns, reached), min(gap.end_ns, end_ns)
        if end > start:
            total += end - start
            reached = end
    return total
