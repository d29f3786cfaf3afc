"""Rows of a comparison: what differs, and what could not be compared."""

from dataclasses import field
from typing import TYPE_CHECKING, Literal

from syncline_analyzer.results import SEVERITY_RANK, CaptureRow, Severity
from syncline_schemas.records import dataclass
from syncline_schemas.wording import counted

if TYPE_CHECKING:
    import pandas as pd

NotSeenIn = Literal["golden", "capture"]


@dataclass(frozen=True, slots=True)
class ComparisonRow:
    """One difference, with the numbers of both sides and the frames that prove them.

    `bus` is the name in the golden capture where it has the bus. `golden` and `capture` say each
    side in words, `golden_value` and `capture_value` in `unit` where there is a figure.
    `object` is index << 8 | sub. `*_seq` and `*_ns` are evidence in each capture.
    """

    kind: str
    severity: Severity
    bus: str | None
    node: int | None
    subject: str
    text: str
    why: str
    golden: str
    capture: str
    golden_value: float | None = None
    capture_value: float | None = None
    unit: str = ""
    cob_id: int | None = None
    object: int | None = None
    golden_seq: list[int] = field(default_factory=list)
    capture_seq: list[int] = field(default_factory=list)
    golden_ns: int | None = None
    capture_ns: int | None = None
    weight: float = 0.0
    """How far apart both sides are: what ranks rows of one severity and kind, the largest first."""


@dataclass(frozen=True, slots=True)
class UnseenRow:
    """Something that one capture shows and the other could not have shown: no difference."""

    bus: str | None
    node: int | None
    subject: str
    not_seen_in: NotSeenIn
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """What differs, the most serious first, and what was not seen in one of both.

    `golden` and `capture` are the facts of both captures, `golden_heard_s` and `capture_heard_s`
    how long each listened [s], None where a log has no times.
    """

    golden: CaptureRow
    capture: CaptureRow
    rows: list[ComparisonRow]
    unseen: list[UnseenRow]
    golden_heard_s: float | None
    capture_heard_s: float | None

    def __repr__(self) -> str:
        return f"<comparison: {counted(len(self.rows), 'difference')}, {len(self.unseen)} not seen>"

    def to_frame(self) -> "pd.DataFrame":
        """One row per difference, the most serious first; columns are those of `ComparisonRow`."""
        from syncline_analyzer.views.comparison_table import rows_frame

        return rows_frame(self.rows)

    def unseen_frame(self) -> "pd.DataFrame":
        """One row per thing that one of both could not have shown."""
        from syncline_analyzer.views.comparison_table import unseen_frame

        return unseen_frame(self.unseen)


def rank(row: ComparisonRow, order: dict[str, int]) -> tuple[int, int, float, str, int]:
    """Sort key: severity, the kinds in `order`, how far apart, then bus and node."""
    place = order.get(row.kind, len(order))
    return SEVERITY_RANK[row.severity], place, -row.weight, row.bus or "", row.node or 0
