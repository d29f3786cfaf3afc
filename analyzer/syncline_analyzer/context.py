"""What every fold is given besides the frames."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from syncline_analyzer.shadow import Shadow
from syncline_schemas.description import BusDescription


@dataclass(slots=True)
class Context:
    """Facts of the capture that all folds share.

    Attributes:
        buses: names of the buses by number.
        shadow: object-dictionary shadow, filled by the SDO fold ahead of the others.
        timed: False for a log without times: nothing that needs a duration is told.
        bitrates: bit rate [bit/s] by bus name, where it is known.
        resolution_ns: step of the stamps; nothing finer is claimed.
        description: what the user says of the buses and nodes.
    """

    buses: list[str]
    shadow: Shadow
    timed: bool = True
    bitrates: dict[str, int] = field(default_factory=dict)
    resolution_ns: int = 1
    description: BusDescription = field(default_factory=BusDescription)

    def overrides(self, bus: int, node: int) -> Mapping[str, Any]:
        """Settings of a node's device that the user gave."""
        entry = self.description.node(self.bus_name(bus), node)
        return entry.overrides if entry else {}

    def bus_name(self, bus: int) -> str:
        """Name of a bus by its number."""
        return self.buses[bus] if bus < len(self.buses) else str(bus)
