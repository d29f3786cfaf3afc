"""What all parts of a simulated bus share."""

from dataclasses import dataclass
from random import Random

from syncline_samples.bus import Bus
from syncline_samples.simulation import Simulation
from syncline_samples.truth import Truth

MS = 1_000_000
"""Nanoseconds of a millisecond."""


@dataclass(frozen=True, slots=True)
class World:
    """Virtual time, the bus, the truth, one source of chance, and the UTC of time 0."""

    simulation: Simulation
    bus: Bus
    truth: Truth
    rng: Random
    epoch_ns: int

    def utc_ns(self, t_ns: int) -> int:
        """UTC of a virtual time."""
        return t_ns + self.epoch_ns


@dataclass(frozen=True, slots=True)
class Delay:
    """How long a device takes: `base_ns` and up to `jitter_ns` more, evenly spread."""

    base_ns: int
    jitter_ns: int = 0

    def draw(self, rng: Random) -> int:
        """One delay [ns]."""
        return self.base_ns + int(self.jitter_ns * rng.random())
