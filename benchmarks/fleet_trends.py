"""How many trends of a simulated fleet are found, and how much of what is told is true.

    uv run python -m benchmarks.fleet_trends --machines 200 --days 30 --seed 1 2 3

Values of captures are drawn (`syncline_samples.fleet_weeks`), with trends and with what only looks
like one, and judged. A trend is found where machine, quantity, node and kind are right and the
onset is within days. What is told beside that is false.
"""

import argparse
import math
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import pandas as pd

from syncline_analyzer.fleet.trends.judging import trends_of
from syncline_analyzer.fleet.trends.rows import TrendFinding
from syncline_analyzer.fleet.trends.tracks import COLUMNS, Tracks, tracks_of
from syncline_analyzer.fleet.trends.wording import finding_of
from syncline_samples.fleet_weeks import BEGIN_NS, DAY_NS, Lure, Truth, Weeks, simulate

KINDS = {
    "trend.drift": "drift",
    "trend.fleet_drift": "drift",
    "trend.step": "step",
    "trend.fleet_step": "step",
    "trend.rate_rising": "rate",
    "trend.fleet_rate_rising": "rate",
    "trend.wear_out": "wear",
}
NEAR_DAYS = {"step": 2.0, "drift": 10.0, "rate": 6.0, "wear": math.inf}
_Z = 1.96


@dataclass
class Score:
    """Counts over all runs, by kind; those of fleets apart."""

    planted: Counter[str] = field(default_factory=Counter)
    found: Counter[str] = field(default_factory=Counter)
    told: Counter[str] = field(default_factory=Counter)
    true: Counter[str] = field(default_factory=Counter)
    false: list[TrendFinding] = field(default_factory=list)
    missed: list[Truth] = field(default_factory=list)
    lures: Counter[str] = field(default_factory=Counter)
    fell_for: Counter[str] = field(default_factory=Counter)

    @property
    def precision(self) -> float:
        """Share of what was told that is true; 1 where nothing was."""
        return self.true.total() / self.told.total() if self.told.total() else 1.0

    @property
    def recall(self) -> float:
        """Share of what was planted that was found."""
        return self.found.total() / self.planted.total() if self.planted.total() else 1.0

    def add(
        self,
        truths: Sequence[Truth],
        lures: Sequence[Lure],
        told: Sequence[TrendFinding],
        either: Sequence[Truth] = (),
    ) -> None:
        """Count one run."""
        for truth in truths:
            self.planted[_kind(truth)] += 1
            if any(_is(truth, row) for row in told):
                self.found[_kind(truth)] += 1
            else:
                self.missed.append(truth)
        for row in told:
            if any(_is(truth, row) for truth in either):
                continue
            kind = KINDS[row.id] + (" of fleet" if row.machine is None else "")
            self.told[kind] += 1
            if any(_is(truth, row) for truth in truths):
                self.true[kind] += 1
            else:
                self.false.append(row)
        for lure in lures:
            self.lures[lure.what] += 1
            self.fell_for[lure.what] += any(
                lure.machine == row.machine
                and lure.quantity == row.quantity
                and lure.node in _nodes(row)
                for row in self.false
            )


def _kind(truth: Truth) -> str:
    return truth.kind + (" of fleet" if truth.machine is None else "")


def _nodes(row: TrendFinding) -> Sequence[int | None]:
    return row.nodes or [None]


def _is(truth: Truth, row: TrendFinding) -> bool:
    """Whether a row tells of a trend that was planted."""
    days = (row.onset_ns - BEGIN_NS) / DAY_NS - truth.day
    return (
        truth.kind == KINDS[row.id]
        and truth.quantity == row.quantity
        and truth.machine == row.machine
        and truth.node in _nodes(row)
        and (truth.change > 0) == (row.change > 0)
        and -NEAR_DAYS[truth.kind] <= days <= NEAR_DAYS[truth.kind] + 1
    )


def tell(weeks: Weeks) -> list[TrendFinding]:
    """What is told of a simulated fleet."""
    return [finding_of(trend, {}) for trend in trends_of(_tracks(weeks))]


def _tracks(weeks: Weeks) -> Iterator[Tracks]:
    for quantity, rows in weeks.rows.items():
        frame = pd.DataFrame(rows, columns=list(COLUMNS)).astype({"node": "Int64"})
        tracks = tracks_of(quantity, frame)
        if tracks is not None:
            yield tracks


def bounds(hits: int, of: int) -> tuple[float, float]:
    """95 % confidence of a share (E. B. Wilson 1927).

    >>> [round(each, 3) for each in bounds(95, 100)]
    [0.888, 0.978]
    """
    if not of:
        return 0.0, 1.0
    share, square = hits / of, _Z**2
    middle = (share + square / (2 * of)) / (1 + square / of)
    half = _Z * math.sqrt(share * (1 - share) / of + square / (4 * of**2)) / (1 + square / of)
    return middle - half, middle + half


def report(score: Score) -> Iterator[str]:
    """Precision and recall of each kind, with 95 % confidence."""
    for kind in (*sorted({*score.planted, *score.told}), ""):
        planted, found, told, true = (
            each[kind] if kind else each.total()
            for each in (score.planted, score.found, score.told, score.true)
        )
        yield (
            f"{kind or 'all':18} planted {planted:5}, found {found:5}: recall {_share(found, planted)};"
            f" told {told:5}, true {true:5}: precision {_share(true, told)}"
        )
    for what, count in score.lures.most_common():
        yield f"no trend: {what}: {score.fell_for[what]} of {count} told as one"


def _share(hits: int, of: int) -> str:
    low, high = bounds(hits, of)
    return f"{hits / of:.3f} ({low:.3f} to {high:.3f})" if of else "-"


def main(arguments: Iterable[str] | None = None) -> None:
    """Simulate fleets, judge them, and print how well."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--machines", type=int, default=200)
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--seed", type=int, nargs="+", default=[1])
    parser.add_argument("--healthy", action="store_true", help="nothing planted, only near misses")
    parser.add_argument("--show", action="store_true", help="what was missed, and told falsely")
    args = parser.parse_args(None if arguments is None else list(arguments))
    score, silent = Score(), 0
    begun_s = time.perf_counter()
    judged_s = 0.0
    for seed in args.seed:
        if args.healthy:
            weeks = simulate(args.machines, args.days, seed, planted=0.0, fleet_wide=False)
        else:
            weeks = simulate(args.machines, args.days, seed)
        start_s = time.perf_counter()
        told = tell(weeks)
        judged_s += time.perf_counter() - start_s
        silent += not told
        score.add(weeks.truths, weeks.lures, told, weeks.either)
    for line in report(score):
        print(line)
    print(f"{silent} of {len(args.seed)} fleets with nothing told")
    print(
        f"{time.perf_counter() - begun_s:.0f} s in all, {judged_s / len(args.seed):.1f} s to judge a fleet"
    )
    if args.show:
        for truth in score.missed:
            print("missed", truth)
        for row in score.false:
            print("false", row)


if __name__ == "__main__":
    main()
