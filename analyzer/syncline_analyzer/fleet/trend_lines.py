"""Trends together with the values that they were judged from, to be drawn."""

from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.fleet.database import Database
from syncline_analyzer.fleet.trends.gathering import Scope, gather, sync_periods_us
from syncline_analyzer.fleet.trends.judging import trends_of
from syncline_analyzer.fleet.trends.rows import TrendFinding
from syncline_analyzer.fleet.trends.trend import Trend
from syncline_analyzer.fleet.trends.wording import finding_of
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class TrendLine:
    """A trend with the values that it was judged from.

    Attributes:
        t_ns, value: when and what they were, mostly a value a day; (n,) int64 and float64, NaN
            where nothing was recorded. Of many machines it is the median over those that show it.
    """

    finding: TrendFinding
    t_ns: NDArray[np.int64]
    value: NDArray[np.float64]


def trend_lines(database: Database, machine: str | None = None) -> list[TrendLine]:
    """Trends in a data set, the gravest first.

    Args:
        machine: which to tell of, `*` and `?` stand for others; they are compared with all.

    Raises:
        UsageError: the data set cannot be read.
    """
    trends = trends_of(gather(database, Scope()))
    sync_us = sync_periods_us(database) if trends else {}
    lines = [
        TrendLine(finding_of(trend, sync_us), *_line(trend))
        for trend in trends
        if machine is None or any(fnmatchcase(name, machine) for name in trend.machines)
    ]
    return sorted(lines, key=lambda each: each.finding.rank)


def _line(trend: Trend) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    tracks = trend.tracks
    source = tracks.reading if trend.kind == "wear" else tracks.value
    members = trend.members if trend.of_fleet else trend.members[:1]
    rows = source[list(members)]
    value = np.full(rows.shape[1], np.nan)
    known = np.isfinite(rows).any(axis=0)
    value[known] = np.nanmedian(rows[:, known], axis=0)
    first = tracks.first[members[0]]
    bins_ns = tracks.begin_ns + tracks.bin_ns * np.arange(len(value))
    return np.where(first >= 0, tracks.begun_ns[first], bins_ns), value
