"""What every fold is given besides the frames."""

from collections.abc import Mapping
from dataclasses import field
from typing import Any, Literal

from syncline_analyzer.folds.nmt.events import KeptWaiting
from syncline_analyzer.folds.timing.bit_rate import Estimate
from syncline_analyzer.folds.timing.late_behind import LateBehind
from syncline_analyzer.shadow import Shadow
from syncline_schemas.description import BusDescription
from syncline_schemas.records import dataclass

NEAR = 0.1
"""The spacings know the usual bit rates only: one so near to what is told is the same."""
BitrateSource = Literal["bus-description", "recorded", "command-line", "estimated"]
"""Who says what the bit rate of a bus is."""


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
        data_bitrates: bit rate [bit/s] of the data phase of FD frames by bus name, where known.
        bitrate_sources: who says each of `bitrates`.
        estimates: what the spacing of the frames says, by bus name, also where the bit rate is told.
        impossible_loads: mean load [%] by bus name, where the told bit rate makes it more than a
            bus can carry; complete once the load fold is.
        pdo_lengths: the first `seq` of each length [bytes] that frames of a PDO have, by bus number
            and identifier.
        kept_waiting: heartbeats that waited long for other frames, by bus number and node, in
            order; complete once the timing fold is.
        unproven_stamps: names of buses where too few frames follow one another closely to tell
            whether the stamps are as exact as their step.
        late_behind: late answers that frames of others explain, by bus name and identifier of the
            PDO; complete once the timing fold is.
    """

    buses: list[str]
    shadow: Shadow
    timed: bool = True
    bitrates: dict[str, int] = field(default_factory=dict)
    resolution_ns: int = 1
    description: BusDescription = field(default_factory=BusDescription)
    data_bitrates: dict[str, int] = field(default_factory=dict)
    bitrate_sources: dict[str, BitrateSource] = field(default_factory=dict)
    estimates: dict[str, Estimate] = field(default_factory=dict)
    impossible_loads: dict[str, float] = field(default_factory=dict)
    pdo_lengths: dict[tuple[int, int], dict[int, int]] = field(default_factory=dict)
    kept_waiting: dict[tuple[int, int], list[KeptWaiting]] = field(default_factory=dict)
    unproven_stamps: set[str] = field(default_factory=set)
    late_behind: dict[tuple[str, int], LateBehind] = field(default_factory=dict)

    def assumed_bitrate(self, bus_name: str) -> list[str]:
        """What a finding rests on that needs the bit rate of a bus: nothing where it is told."""
        if self.bitrate_sources.get(bus_name) != "estimated":
            return []
        rate = self.bitrates[bus_name] / 1000
        return [f"the bit rate of {bus_name} is {rate:g} kbit/s (estimated from the frames)"]

    def contradicted(self, bus_name: str) -> bool:
        """Whether the frames rule out the bit rate that is told: nothing is measured with it then."""
        return bus_name in self.impossible_loads or self.contradiction(bus_name) is not None

    def contradiction(self, bus_name: str) -> Estimate | None:
        """What the spacing of the frames says against the bit rate that is told."""
        seen, told = self.estimates.get(bus_name), self.bitrates.get(bus_name)
        if seen is None or told is None or not seen.confident:
            return None
        factor = max(told, seen.bitrate) / min(told, seen.bitrate)
        return seen if factor >= 1 + NEAR else None

    def assumed_wire(self, bus_name: str) -> list[str]:
        """What a finding rests on that tells from the stamps which frame waited for which."""
        stamps = [f"the stamps of {bus_name} are exact (too few frames stand close to tell)"]
        unproven = bus_name in self.unproven_stamps
        return [*self.assumed_bitrate(bus_name), *(stamps if unproven else [])]

    def overrides(self, bus: int, node: int) -> Mapping[str, Any]:
        """Settings of a node's device that the user gave."""
        entry = self.description.node(self.bus_name(bus), node)
        return entry.overrides if entry else {}

    def bus_name(self, bus: int) -> str:
        """Name of a bus by its number."""
        return self.buses[bus] if bus < len(self.buses) else str(bus)
