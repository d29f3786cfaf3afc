"""The same from captures on: simulated, analyzed by `fleet analyze`, asked for trends.

    uv run python -m benchmarks.fleet_month --machines 200 --days 30 --seed 1

Captures of twelve seconds of virtual time; about a third of a second each to analyze.
"""

import argparse
import tempfile
import time
from pathlib import Path

from benchmarks.fleet import fleet_run
from benchmarks.fleet_trends import Score, report
from syncline_analyzer.fleet.database import Database
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.trends import trend_findings
from syncline_samples.fleet import Template, fleet_captures
from syncline_samples.fleet_month import simulate_month

SECONDS, SYNC_US = 12.0, 20_000
"""The press stands still at first, long enough for its noise at rest to be measured."""


def main() -> None:
    """Simulate, analyze, ask, and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--machines", type=int, default=200)
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, help="keep captures and data set there")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="syncline-month-") as name:
        folder = args.out or Path(name)
        month = simulate_month(args.machines, args.days, args.seed)
        template = Template(SECONDS, SYNC_US)
        paths = list(fleet_captures(folder / "in", args.machines, args.days, month.plan, template))
        print(f"{len(paths)} captures", flush=True)
        summary, wall_s, cpu_s, _ = fleet_run(folder / "in", folder / "out", args.workers)
        print(f"analyzed {summary.analyzed} in {wall_s:.0f} s, CPU {cpu_s:.0f} s", flush=True)
        begun_s = time.perf_counter()
        told = trend_findings(Database(Dataset.open(str(folder / "out"))))
        print(f"{len(told)} trends in {time.perf_counter() - begun_s:.1f} s")
        score = Score()
        score.add(month.truths, month.lures, told)
        for line in report(score):
            print(line)
        for truth in score.missed:
            print("missed", truth)
        for row in score.false:
            print("false", row)


if __name__ == "__main__":
    main()
