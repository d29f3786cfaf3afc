"""Builders for the tests of trends: values of captures of a fleet, as a data set would have them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from syncline_analyzer.fleet.trends.judging import trends_of
from syncline_analyzer.fleet.trends.rows import TrendFinding
from syncline_analyzer.fleet.trends.tracks import COLUMNS, tracks_of
from syncline_analyzer.fleet.trends.wording import finding_of

BEGIN_NS = 1_772_409_600 * 10**9
"""Monday, 2026-03-02."""
DAY_NS = 86_400 * 10**9
LEVEL_US = 640.0
Change = Callable[[int, int], float]
"""What is added on a machine on a day."""


def rows(
    quantity: str = "pdo-latency",
    machines: int = 20,
    days: int = 30,
    change: Change = lambda _machine, _day: 0.0,
    *,
    base: float = LEVEL_US,
    noise: float = 2.0,
    hours: float = 8.0,
    seed: int = 7,
    node: int | None = 3,
    device: str | None = "lir-ma158k",
    recorded: Callable[[int, int], bool] = lambda _machine, _day: True,
    more: Callable[[int, int], dict[str, Any]] = lambda _machine, _day: {},
) -> pd.DataFrame:
    """A capture a day of each machine, `base` and normal noise, and what is to change.

    Args:
        hours: time in which events are counted; a level has none.
        recorded: whether there is a capture.
        more: columns that differ from the usual.
    """
    rng = np.random.default_rng(seed)
    made = []
    for machine in range(machines):
        for day in range(days):
            value = base + float(rng.normal(0, noise)) + change(machine, day)
            if not recorded(machine, day):
                continue
            begun_ns = BEGIN_NS + day * DAY_NS + 6 * 3600 * 10**9
            row = {
                "machine": f"press-{machine}",
                "capture_id": f"c{machine}-{day}",
                "bus": "can0",
                "node": node,
                "part": "TPDO2",
                "amount": value,
                "over": hours,
                "reading": None,
                "begun_ns": begun_ns,
                "duration_ns": round(hours * 3.6e12),
                "recorder": f"gateway-{machine}",
                "resolution_us": 1.0,
                "name": "press drive",
                "device": device,
                "serial": f"{machine}",
            }
            made.append(row | more(machine, day))
    return pd.DataFrame(made, columns=list(COLUMNS)).astype({"node": "Int64"})


def counts(
    quantity: str,
    rate: Callable[[int, int], float],
    *,
    machines: int = 20,
    seed: int = 7,
    **options: Any,
) -> pd.DataFrame:
    """Events of each capture, drawn at a rate of so many in a capture."""
    rng = np.random.default_rng(seed)
    return rows(
        quantity, machines, change=lambda machine, day: float(rng.poisson(rate(machine, day))),
        base=0.0, noise=0.0, **options,
    )  # fmt: skip


def told(*of: tuple[str, pd.DataFrame]) -> list[TrendFinding]:
    """What is told of the rows of quantities, the gravest first."""
    tracks = [tracks_of(quantity, frame) for quantity, frame in of]
    trends = trends_of(each for each in tracks if each is not None)
    sync_us = {(f"press-{machine}", "can0"): 20_000.0 for machine in range(100)}
    return sorted((finding_of(each, sync_us) for each in trends), key=lambda each: each.rank)


def brief(findings: Sequence[TrendFinding]) -> list[tuple[str, str | None, int | None]]:
    """Id, machine and day of the onset."""
    return [(each.id, each.machine, (each.onset_ns - BEGIN_NS) // DAY_NS) for each in findings]
