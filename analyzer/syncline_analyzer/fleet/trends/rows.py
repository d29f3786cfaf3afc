"""The row of a trend: what became different over the captures of weeks."""

from dataclasses import field
from typing import Literal

from syncline_analyzer.results import SEVERITY_RANK
from syncline_analyzer.results.finding import Severity
from syncline_schemas.records import dataclass

TrendId = Literal[
    "trend.drift",
    "trend.step",
    "trend.rate_rising",
    "trend.wear_out",
    "trend.fleet_drift",
    "trend.fleet_step",
    "trend.fleet_rate_rising",
]
MEANINGS: dict[TrendId, str] = {
    "trend.drift": "A quantity of a node moves away slowly, and the fleet does not.",
    "trend.step": "A quantity of a node is another one from a day on, and the fleet's is not.",
    "trend.rate_rising": "Resets, EMCYs or EEPROM writes of a node come more often than before.",
    "trend.wear_out": "An EEPROM reaches the writes that it is rated for within a year.",
    "trend.fleet_drift": "A quantity moves away slowly on most machines alike.",
    "trend.fleet_step": "A quantity is another one from the same day on on many machines.",
    "trend.fleet_rate_rising": "Resets or EMCYs come more often on many machines from a day on.",
}
"""One sentence each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrendFinding:
    """What became different of a quantity: of a node of a machine, or of many machines alike.

    Stamps are UTC [ns since 1970]. `machine` is None for what concerns many machines, `node` None
    where several nodes (or none) are concerned, `part` None where several PDOs or traces are.
    """

    id: TrendId
    severity: Severity
    quantity: str
    """Name in `quantities.QUANTITIES`."""
    machine: str | None
    bus: str | None
    node: int | None
    name: str | None
    """The node's described name."""
    device: str | None
    part: str | None
    """"TPDO2", "SYNC 080h", a trace ..."""
    unit: str
    """Of `before`, `after`, `change`; slopes are in it per day."""
    onset_ns: int
    """A step: when the first capture with the new value began. A drift: when it began to move; the
    first capture where it always did."""
    first_ns: int
    last_ns: int
    """When the first and the last capture began that were compared."""
    before: float | None
    after: float | None
    """Medians on either side of a step, rates before and after; where a drift stood at its
    beginning and stands at the end of the captures."""
    change: float
    """`after` less `before`; of many machines the median over them."""
    slope_per_day: float | None
    """Of a drift; None for steps."""
    q: float
    """False discovery rate at which it is told, over all tracks that were judged with it."""
    captures: int
    captures_before: int
    captures_after: int
    machines: int
    """How many show it; 1 for what is of one machine."""
    text: str
    cause: str
    check_next: str
    evidence: list[str]
    """`capture_id` of the first capture, of the last before and the first after the onset, and of
    the last one; of many machines those of the clearest three."""
    nodes: list[int] = field(default_factory=list)
    """All nodes that are concerned."""
    parts: list[str] = field(default_factory=list)
    """All PDOs or traces that are concerned, "node 3 TPDO2"."""
    machine_names: list[str] = field(default_factory=list)
    """All machines that are concerned, the clearest first."""
    reaches: str = ""
    """What is reached when it goes on so: "100000 writes"; "" where that means nothing."""
    reaches_ns: int | None = None
    """When."""
    assumed: list[str] = field(default_factory=list)
    """What it rests on that was only assumed."""

    def __str__(self) -> str:
        return f"{self.severity}: {self.text} [{self.id}]"

    @property
    def rank(self) -> tuple[int, bool, float, str]:
        """Order in which trends are told: severity, those of the fleet first, the surest first."""
        return SEVERITY_RANK[self.severity], self.machine is not None, self.q, self.machine or ""
