"""Bounds of device times on random loaded buses: `python -m benchmarks.timing_truth 1000`."""

import argparse
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from random import Random

import numpy as np
from numpy.typing import NDArray

from syncline_samples.loaded import random_loaded_bus
from tests.analyzer.load_truth import wrong_peaks, wrong_rate, wrong_shares
from tests.analyzer.timing_truth import Measured, carried, kind, measured, widths_us, wrong
from tests.analyzer.waiting_truth import wrong_causes, wrong_delays

LOAD_EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0)
_EXAMPLES = 2


@dataclass
class Tried:
    """One bus: its load, how many responses it has, the widths of the bounds, and what is wrong.

    Widths are shares of the SYNC period, (n,) float64 by column; `carried` responses come after a
    SYNC that is not the one they answer. `rate_told`: the bit rate is told when nobody knows it.
    """

    seed: int
    load: float = 0.0
    resolution_ns: int = 1
    rate_told: bool = False
    carried: int = 0
    widths: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def tried(seed: int) -> Tried:
    """The bus of a seed; a warning is a problem, too."""
    warnings.simplefilter("error")
    try:
        case = measured(random_loaded_bus(Random(seed), seed))
        problems = [*wrong(case), *wrong_shares(case), *_wrong_load(case), *wrong_delays(case)]
        problems += [line for row in case.analysis.lateness for line in wrong_causes(case, row)]
        unknown = measured(case.plan, bitrate_known=False)
        problems += wrong_rate(unknown)
    except Exception:  # noqa: BLE001 - whatever is raised is a problem of this seed
        return Tried(seed, problems=[f"raised: {traceback.format_exc().splitlines()[-1]}"])
    told = unknown.analysis.bus_load[0].bitrate is not None
    step_ns = case.plan.stamp_resolution_ns
    return Tried(seed, case.load, step_ns, told, carried(case), _shares(case), problems)


def _wrong_load(case: Measured) -> Iterable[str]:
    """Peaks are compared where nothing is lost or destroyed."""
    return () if case.plan.gap_s or case.plan.errors_s else wrong_peaks(case)


def _shares(case: Measured) -> dict[str, NDArray[np.float64]]:
    period_us = case.usual_period_ns / 1000
    return {name: widths / period_us for name, widths in widths_us(case).items()}


def print_widths(buses: list[Tried]) -> None:
    """Median and 99th percentile of the widths, by load."""
    print("\nwidth of the device-time bounds, as a share of the SYNC period")
    print(f"  {'load':>12}{'buses':>7}{'responses':>11}{'column':>14}{'median':>9}{'p99':>9}")
    for low, high in pairwise(LOAD_EDGES):
        within = [bus for bus in buses if low <= bus.load < high and bus.resolution_ns < 1_000_000]
        for name in dict.fromkeys(name for bus in within for name in bus.widths):
            shares = np.concatenate([bus.widths[name] for bus in within if name in bus.widths])
            shares = shares[np.isfinite(shares)]
            if len(shares):
                middle, most = np.quantile(shares, (0.5, 0.99))
                text = f"  {low:>6.0%}-{high:>5.0%}{len(within):>7}{len(shares):>11,}{name:>14}"
                print(f"{text}{middle:>9.2%}{most:>9.2%}")


def print_problems(buses: Iterable[Tried]) -> None:
    """Each kind of problem with its number and some examples."""
    counts: Counter[str] = Counter()
    for bus in buses:
        for problem in bus.problems:
            counts[kind(problem)] += 1
            if counts[kind(problem)] <= _EXAMPLES:
                print(f"seed {bus.seed}: {problem}")
    for name, number in counts.most_common():
        print(f"{number:8} {name}")


def print_rates(buses: list[Tried]) -> None:
    """How often the bit rate is told when nobody knows it, by the step of the stamps."""
    print("\nbuses whose bit rate is estimated and used")
    for step_ns in sorted({bus.resolution_ns for bus in buses}):
        of_step = [bus for bus in buses if bus.resolution_ns == step_ns]
        told = sum(bus.rate_told for bus in of_step)
        print(f"  stamps of {step_ns / 1000:g} us: {told} of {len(of_step)}")


def main() -> None:
    """Try many buses, print what is wrong and how wide the bounds are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    begun = time.perf_counter()
    with ProcessPoolExecutor(args.jobs) as pool:
        seeds = range(args.seed, args.seed + args.count)
        buses = list(pool.map(tried, seeds, chunksize=4))
    print_problems(buses)
    print_widths(buses)
    print_rates(buses)
    responses = sum(len(next(iter(bus.widths.values()), ())) for bus in buses)
    failed = sum(bool(bus.problems) for bus in buses)
    print(
        f"\n{failed} of {args.count} buses have problems; {responses:,} responses,"
        f" {sum(bus.carried for bus in buses):,} of them after a later SYNC,"
        f" {time.perf_counter() - begun:.0f} s"
    )
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
