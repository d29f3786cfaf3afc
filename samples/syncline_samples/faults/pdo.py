"""PDOs that go missing."""

from dataclasses import dataclass

from syncline_samples.bus import Frame
from syncline_samples.machine import Machine
from syncline_samples.sdo_client import read, write

_MANY = 1 << 30
_STOPPED = ("pdo.missed", "pdo.stopped", "pdo.silent")


@dataclass(frozen=True, slots=True)
class MissedPdos:
    """The node forgets its next due frames of one TPDO."""

    node: int
    at_s: float
    pdo: int = 2
    count: int = 5

    def arm(self, machine: Machine) -> None:
        """Let the node forget."""
        tpdo = machine.nodes[self.node].tpdos[self.pdo]
        machine.at(self.at_s, setattr, tpdo, "skip", self.count)
        machine.expect(
            "pdo.missed", self.node, self.at_s, what=f"TPDO{self.pdo} missed {self.count} times"
        )


@dataclass(frozen=True, slots=True)
class TpdoStops:
    """One TPDO stops for a while; heartbeat and everything else of the node go on."""

    node: int
    at_s: float
    pdo: int = 2
    for_s: float = 2.0

    def arm(self, machine: Machine) -> None:
        """Let the node forget all its due frames."""
        tpdo = machine.nodes[self.node].tpdos[self.pdo]
        machine.at(self.at_s, setattr, tpdo, "skip", _MANY)
        machine.at(self.at_s + self.for_s, setattr, tpdo, "skip", 0)
        first, *others = _STOPPED
        machine.expect(
            first,
            self.node,
            self.at_s,
            self.for_s,
            what=f"TPDO{self.pdo} stops",
            or_as=tuple(others),
        )
        for finding in others:
            machine.expect(finding, self.node, self.at_s, self.for_s, required=False)


@dataclass(frozen=True, slots=True)
class ExtraPdos:
    """The node sends a synchronous TPDO once more, beside the one that answers the SYNC."""

    node: int
    at_s: float
    pdo: int = 2
    count: int = 5
    every_ms: int = 200

    def arm(self, machine: Machine) -> None:
        """Send them."""
        tpdos = machine.nodes[self.node].tpdos
        for number in range(self.count):
            machine.at(self.at_s + number * self.every_ms / 1000, tpdos.trigger, self.pdo)
        for_s = self.count * self.every_ms / 1000
        machine.expect("pdo.extra", self.node, self.at_s, for_s, what="extra PDOs")


@dataclass(frozen=True, slots=True)
class PdoInhibitTime:
    """The master writes 180xh:3, then the TPDO is due more often than that.

    A device that keeps its inhibit time delays the frames: no finding; a `hasty` one does not.
    """

    node: int
    at_s: float
    pdo: int = 1
    inhibit_ms: int = 50
    count: int = 6
    every_ms: int = 20
    hasty: bool = True

    def arm(self, machine: Machine) -> None:
        """Write the inhibit time, then let the PDO go out again and again."""
        tpdos = machine.nodes[self.node].tpdos
        index = 0x17FF + self.pdo
        jobs = (read(index, 2), write(index, 3, self.inhibit_ms * 10, 2))
        machine.at(self.at_s, machine.master.sdo(self.node).run, *jobs)
        machine.at(self.at_s, setattr, tpdos[self.pdo], "hasty", self.hasty)
        for number in range(self.count):
            machine.at(self.at_s + 0.1 + number * self.every_ms / 1000, tpdos.trigger, self.pdo)
        for_s = 0.1 + self.count * max(self.every_ms, self.inhibit_ms) / 1000
        if self.hasty:
            machine.expect("pdo.inhibit_time", self.node, self.at_s, for_s, what="too quick")
        machine.expect("pdo.extra", self.node, self.at_s, for_s, required=False)


@dataclass(frozen=True, slots=True)
class WrongLengthPdos:
    """The master reads the mapping of a TPDO, which the node then sends shorter than that."""

    node: int
    at_s: float
    pdo: int = 2
    dlc: int = 2
    for_s: float = 2.0

    def arm(self, machine: Machine) -> None:
        """Cut the frames."""
        tpdo = machine.nodes[self.node].tpdos[self.pdo]
        mapping = 0x19FF + self.pdo
        entries = machine.nodes[self.node].objects.number(mapping)
        jobs = [read(mapping, sub) for sub in range(entries + 1)]
        machine.at(self.at_s - 0.2, machine.master.sdo(self.node).run, *jobs)
        machine.at(self.at_s, setattr, tpdo, "cut_to", self.dlc)
        machine.at(self.at_s + self.for_s, setattr, tpdo, "cut_to", None)
        machine.expect(
            "config.pdo_length", self.node, self.at_s, self.for_s, what=f"PDOs of {self.dlc} bytes"
        )


@dataclass(frozen=True, slots=True)
class PdoRequests:
    """The master asks for a TPDO by remote frames; a JN2100 answers in any state: no finding."""

    node: int
    at_s: float
    pdo: int = 1
    count: int = 3
    every_ms: int = 333

    def arm(self, machine: Machine) -> None:
        """Send the remote frames."""
        bus, tpdo = machine.world.bus, machine.nodes[self.node].tpdos[self.pdo]
        for number in range(self.count):
            at_s = self.at_s + number * self.every_ms / 1000
            machine.at(at_s, bus.send, Frame(tpdo.can_id, b"", 0), self)
