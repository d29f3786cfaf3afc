"""What is planted in the captures of a simulated month of a fleet (`fleet.write_capture`).

One thing on a machine, at most; days differ a little on all. What is planted shows on the nodes
that `fleet` names, so that a fleet-wide change and those of single machines lie on one another.
"""

from dataclasses import dataclass, replace

import numpy as np

from syncline_samples.fleet import (
    EMCY_NODE,
    HEARTBEAT_NODE,
    LATE_NODE,
    NOISY_NODE,
    RESET_NODE,
    WORN_NODE,
    Planted,
    machine_name,
)
from syncline_samples.fleet_weeks import Lure, Truth

_KINDS = (
    "late step", "late drift", "jitter step", "slow heartbeat", "noise step", "noise drift",
    "resets", "emcys", "saves", "worn out",
)  # fmt: skip
_LURES = (
    "one bad day",
    "weekly rhythm",
    "one storm",
    "too small",
    "counter set back",
    "gap",
    "shorter",
)


@dataclass(frozen=True, slots=True)
class Month:
    """What is planted on each machine and day; None where nothing was recorded."""

    planted: list[list[Planted | None]]
    truths: list[Truth]
    lures: list[Lure]

    def plan(self, machine: int, day: int) -> Planted | None:
        """For `fleet.fleet_captures`."""
        return self.planted[machine][day]


def simulate_month(machines: int = 200, days: int = 30, seed: int = 0) -> Month:
    """A month: 2 of 5 machines have a trend, 1 of 4 what only looks like one; node 3 of all answers
    later from a day on."""
    rng = np.random.default_rng(seed)
    rolled, late_us = int(rng.integers(9, days - 9)), float(rng.uniform(90, 140))
    truths = [Truth("step", "pdo-latency", None, LATE_NODE, rolled, late_us)]
    lures: list[Lure] = []
    fleet: list[list[Planted | None]] = []
    for number in range(machines):
        own = _healthy(rng, days)
        chance = rng.random()
        if chance < 0.4:
            own = _with_trend(rng, own, machine_name(number), str(rng.choice(_KINDS)), truths)
        elif chance < 0.65:
            own = _with_lure(rng, own, machine_name(number), str(rng.choice(_LURES)), lures)
        for day in range(rolled, days):
            own[day] = replace(own[day], late_us=own[day].late_us + late_us)
        recorded = rng.random(days) > 0.06
        if any(lure.machine == machine_name(number) and lure.what == "gap" for lure in lures):
            recorded[10:20] = False
        fleet.append([each if seen else None for each, seen in zip(own, recorded, strict=True)])
    return Month(fleet, truths, lures)


def _healthy(rng: np.random.Generator, days: int) -> list[Planted]:
    """Days of a machine in which nothing happens but that they differ."""
    writes = float(rng.integers(100, 20_000))
    pace = float(rng.uniform(1, 10))
    found = []
    for _ in range(days):
        writes += rng.poisson(pace)
        found.append(
            Planted(
                resets=int(rng.random() < 0.02),
                emcys=int(rng.random() < 0.03),
                late_us=5.0 + abs(float(rng.standard_t(4))) * 2.0,
                sync_jitter_us=20.0 + float(rng.normal(0, 2)),
                noise_counts=2.0 + float(rng.uniform(0, 0.5)),
                eeprom_writes=int(writes),
                share=float(rng.uniform(0.9, 1.0)),
            )
        )
    return found


def _with_trend(
    rng: np.random.Generator, own: list[Planted], machine: str, kind: str, truths: list[Truth]
) -> list[Planted]:
    days = len(own)
    at = int(rng.integers(9, days - 9))
    share = np.arange(days) / (days - 1)
    late = np.arange(days) >= at

    def plant(kind: str, quantity: str, node: int | None, day: int, change: float) -> None:
        truths.append(Truth(kind, quantity, machine, node, day, change))  # type: ignore[arg-type]

    match kind:
        case "late step":
            size = float(rng.uniform(70, 400))
            plant("step", "pdo-latency", LATE_NODE, at, size)
            return [
                replace(p, late_us=p.late_us + size * on) for p, on in zip(own, late, strict=True)
            ]
        case "late drift":
            size = float(rng.uniform(110, 500))
            plant("drift", "pdo-latency", LATE_NODE, 0, size)
            return [
                replace(p, late_us=p.late_us + size * x) for p, x in zip(own, share, strict=True)
            ]
        case "jitter step":
            size = float(rng.uniform(50, 200))
            plant("step", "sync-jitter", None, at, size)
            return [
                replace(p, sync_jitter_us=20 + size * on) for p, on in zip(own, late, strict=True)
            ]
        case "slow heartbeat":
            size = float(rng.uniform(0.03, 0.2))
            plant("step", "heartbeat", HEARTBEAT_NODE, at, size)
            return [replace(p, slower_heartbeat=size * on) for p, on in zip(own, late, strict=True)]
        case "noise step":
            size = float(rng.uniform(8, 40))
            plant("step", "encoder-noise", NOISY_NODE, at, size)
            return [
                replace(p, noise_counts=p.noise_counts + size * on)
                for p, on in zip(own, late, strict=True)
            ]
        case "noise drift":
            size = float(rng.uniform(12, 50))
            plant("drift", "encoder-noise", NOISY_NODE, 0, size)
            return [
                replace(p, noise_counts=p.noise_counts + size * x)
                for p, x in zip(own, share, strict=True)
            ]
        case "resets":
            plant("rate", "resets", RESET_NODE, at, 1.0)
            return [
                replace(p, resets=min(2, int(rng.poisson(1.5 * on))))
                for p, on in zip(own, late, strict=True)
            ]
        case "emcys":
            plant("rate", "emcy", EMCY_NODE, at, 1.0)
            return [
                replace(p, emcys=min(4, int(rng.poisson(2.0 * on))))
                for p, on in zip(own, late, strict=True)
            ]
        case "saves":
            more = float(rng.uniform(60, 250))
            plant("rate", "eeprom-wear", WORN_NODE, at, more)
            grown = np.cumsum(late * more)
            return [
                replace(p, eeprom_writes=int((p.eeprom_writes or 0) + g))
                for p, g in zip(own, grown, strict=True)
            ]
        case _:
            more = float(rng.uniform(350, 900))
            plant("wear", "eeprom-wear", WORN_NODE, 0, more)
            grown = np.arange(days) * more
            return [
                replace(p, eeprom_writes=int((p.eeprom_writes or 0) + g))
                for p, g in zip(own, grown, strict=True)
            ]


def _with_lure(
    rng: np.random.Generator, own: list[Planted], machine: str, what: str, lures: list[Lure]
) -> list[Planted]:
    days = len(own)
    at = int(rng.integers(3, days - 3))
    quantity = "pdo-latency"
    changed = list(own)
    match what:
        case "one bad day":
            changed[at] = replace(own[at], late_us=300.0, sync_jitter_us=200.0, noise_counts=40.0)
        case "weekly rhythm":
            changed = [
                replace(p, late_us=p.late_us + 150 * (day % 7 >= 5)) for day, p in enumerate(own)
            ]
        case "one storm":
            quantity = "emcy"
            changed[at] = replace(own[at], emcys=20)
        case "too small":
            changed = [replace(p, late_us=p.late_us + 8 * (day >= at)) for day, p in enumerate(own)]
        case "counter set back":
            quantity = "eeprom-wear"
            base = own[at].eeprom_writes or 0
            changed = [
                replace(
                    p, eeprom_writes=(p.eeprom_writes or 0) - base if day >= at else p.eeprom_writes
                )
                for day, p in enumerate(own)
            ]
        case "shorter":
            changed = [replace(p, share=0.7 if day >= at else p.share) for day, p in enumerate(own)]
    lures.append(Lure(what, quantity, machine, None if quantity == "sync-jitter" else LATE_NODE))
    return changed
