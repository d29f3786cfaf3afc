"""Many random scenarios by seed, in parallel: `python -m benchmarks.fuzz 2000`."""

import argparse
import sys
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from random import Random
from typing import Any

from syncline_samples.fuzz import random_scenario
from syncline_samples.machine import Scenario
from tests.analyzer.fuzz_case import make
from tests.analyzer.fuzz_checks import wrong
from tests.analyzer.fuzz_invariants import broken


def tried(seed: int) -> tuple[int, list[str]]:
    """What is wrong with the analysis of a seed's scenario."""
    return seed, _problems(random_scenario(Random(seed)))


def _problems(scenario: Scenario) -> list[str]:
    try:
        case = make(scenario)
        return [*wrong(case), *broken(case, Random(scenario.seed))]
    except Exception:  # noqa: BLE001 - whatever is raised is a problem of this seed
        return [f"raised: {traceback.format_exc().strip().splitlines()[-1]}"]


def minimal(scenario: Scenario, kind: str) -> Scenario:
    """The scenario without each fault and device that a kind of problem does not need."""
    for smaller in _smaller(scenario):
        if any(_kind(problem) == kind for problem in _problems(smaller)):
            return minimal(smaller, kind)
    return scenario


def _smaller(scenario: Scenario) -> Iterator[Scenario]:
    faults, devices = scenario.faults, scenario.devices
    for fault in faults:
        yield replace(scenario, faults=tuple(each for each in faults if each is not fault))
    used = {getattr(fault, "node", 0) for fault in faults} | {scenario.rpdo_node}
    for spec in devices if len(devices) > 1 else ():
        if spec.node_id not in used:
            yield replace(scenario, devices=tuple(each for each in devices if each is not spec))
    for name, plain in _PLAIN.items():
        if getattr(scenario, name) != plain:
            yield replace(scenario, **{name: plain})
    for spec in devices:
        if spec.drift_ppm or spec.jobs:
            plainer = replace(spec, drift_ppm=0, jobs=tuple(j for j in spec.jobs if j.data))
            if plainer != spec:
                others = (plainer if each is spec else each for each in devices)
                yield replace(scenario, devices=tuple(others))


_PLAIN: dict[str, Any] = {
    "stamp_jitter_ns": 0,
    "stamp_resolution_ns": 1,
    "sync_counter": 0,
    "sync_jitter_us": 0,
    "rpdo_node": 0,
    "bitrate": 500_000,
    "remote_as_data": False,
}
"""Settings of a scenario that seldom matter."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--show", type=int, default=2, help="examples of each kind of problem")
    parser.add_argument("--minimal", action="store_true", help="and what they need")
    args = parser.parse_args()
    begun = time.perf_counter()
    kinds: Counter[str] = Counter()
    failed = 0
    with ProcessPoolExecutor(args.jobs) as pool:
        seeds = range(args.seed, args.seed + args.count)
        for seed, problems in pool.map(tried, seeds, chunksize=8):
            failed += bool(problems)
            for problem in dict.fromkeys(problems):
                kind = _kind(problem)
                kinds[kind] += 1
                if kinds[kind] <= args.show:
                    print(f"seed {seed}: {problem}", flush=True)
                    if args.minimal:
                        print(f"    {minimal(random_scenario(Random(seed)), kind)}", flush=True)
    passed_s = time.perf_counter() - begun
    print(f"{failed} of {args.count} scenarios fail, {passed_s:.0f} s")
    for kind, number in kinds.most_common():
        print(f"{number:6} {kind}")
    sys.exit(failed > 0)


def _kind(problem: str) -> str:
    """A problem without its numbers."""
    words = "".join(" " if c.isdigit() else c for c in problem[:70]).split()
    return " ".join(words[:8])


if __name__ == "__main__":
    main()
