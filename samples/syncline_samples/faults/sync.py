"""SYNC that goes wrong."""

from dataclasses import dataclass

from syncline_samples.machine import Machine
from syncline_samples.master import SyncProducer

_PHASE = 0.37
"""Of the first producer's period, between its SYNC and the second one."""


@dataclass(frozen=True, slots=True)
class MissingSyncs:
    """The SYNC producer leaves out some SYNCs."""

    at_s: float
    count: int = 3

    def arm(self, machine: Machine) -> None:
        """Leave them out."""
        machine.at(self.at_s, setattr, machine.sync, "skip", self.count)
        machine.expect("sync.missing", None, self.at_s, what=f"{self.count} SYNCs missing")


@dataclass(frozen=True, slots=True)
class SyncJitter:
    """The SYNC producer is late by up to `jitter_us` for a while."""

    at_s: float
    for_s: float
    jitter_us: int

    def arm(self, machine: Machine) -> None:
        """Disturb the producer."""
        usual_ns = machine.scenario.sync_jitter_us * 1000
        machine.at(self.at_s, setattr, machine.sync, "jitter_ns", self.jitter_us * 1000)
        machine.at(self.at_s + self.for_s, setattr, machine.sync, "jitter_ns", usual_ns)
        machine.expect("sync.jitter", None, self.at_s, self.for_s, what="SYNC jitter")


@dataclass(frozen=True, slots=True)
class SyncOutage:
    """The SYNC producer stops for a while."""

    at_s: float
    for_s: float = 1.0

    def arm(self, machine: Machine) -> None:
        """Stop it and start it again."""
        machine.at(self.at_s, setattr, machine.sync, "running", False)
        machine.at(self.at_s + self.for_s, setattr, machine.sync, "running", True)
        machine.expect("sync.missing", None, self.at_s, self.for_s, what="no SYNC")


@dataclass(frozen=True, slots=True)
class SecondSyncProducer:
    """Somebody else produces SYNCs, too, with the same period as the first producer or another."""

    at_s: float
    for_s: float = 3.0
    period_us: int | None = None

    def arm(self, machine: Machine) -> None:
        """Start the second producer and stop it."""
        usual_us = machine.scenario.sync_us
        period_us = self.period_us or usual_us
        second = SyncProducer(machine.world, period_us * 1000)
        raster_s = usual_us / 1e6
        begin_s = (self.at_s // raster_s + _PHASE) * raster_s
        machine.at(begin_s, second.start)
        machine.at(self.at_s + self.for_s, setattr, second, "running", False)
        machine.expect("sync.two_producers", None, self.at_s, self.for_s, what="two SYNC producers")
        for finding in ("sync.jitter", "sync.period", "sync.missing", "pdo.missed", "pdo.extra"):
            machine.expect(finding, None, self.at_s, self.for_s, required=False)
