"""Findings and the links of their stories."""

from dataclasses import field
from typing import Literal

from syncline_schemas.records import dataclass

Severity = Literal["error", "warning", "info"]
SEVERITY_RANK: dict[Severity, int] = {"error": 0, "warning": 1, "info": 2}
"""Order in which findings are told."""


@dataclass(frozen=True, slots=True)
class Link:
    """One piece of a story: what followed from the finding that tells it, in order of time."""

    id: str
    bus: str | None
    node: int | None
    start_ns: int
    end_ns: int
    text: str
    evidence: list[int]


@dataclass(frozen=True, slots=True)
class Finding:
    """What a service engineer would write in a report: the root of a story and what followed."""

    id: str
    severity: Severity
    bus: str | None
    node: int | None
    start_ns: int
    end_ns: int
    text: str
    cause: str
    check_next: str
    evidence: list[int]
    chain: list[Link] = field(default_factory=list)
    """What followed from it, in order of time; these are no findings of their own."""
    assumed: list[str] = field(default_factory=list)
    """What it rests on that was only assumed, for example "100Ch = 0 (eds-default)"."""

    def __repr__(self) -> str:
        where = "all buses" if self.bus is None else self.bus
        node = "" if self.node is None else f" node {self.node}"
        frames = f", frames {', '.join(map(str, self.evidence))}" if self.evidence else ""
        return f"<{self.severity} {self.id} on {where}{node}{frames}: {self.text}>"

    def __str__(self) -> str:
        return f"{self.severity}: {self.text} [{self.id}]"

    def _repr_html_(self) -> str:
        from syncline_analyzer.views.notebook import finding_html

        return finding_html(self)

    def as_link(self) -> Link:
        """The finding as a piece of another one's story, without what followed from it."""
        return Link(
            self.id, self.bus, self.node, self.start_ns, self.end_ns, self.text, self.evidence
        )
