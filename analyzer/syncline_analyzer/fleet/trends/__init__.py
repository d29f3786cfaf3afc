"""Trends: what drifts, steps or comes more often over the captures of weeks, as findings."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from syncline_analyzer.fleet.database import Database
    from syncline_analyzer.fleet.trends.rows import TrendFinding

__all__ = ["trend_findings"]


def trend_findings(
    database: "Database",
    *,
    machine: str | None = None,
    bus: str | None = None,
    node: int | None = None,
    quantity: str | None = None,
    since: str | None = None,
    until: str | None = None,
    min_samples: int = 10,
) -> "list[TrendFinding]":
    """Trends in a data set, the gravest first; captures without a date are left out.

    Args:
        machine: which to tell of, `*` and `?` stand for others; they are compared with all.
        bus, node: of the node.
        quantity: name in `quantities.QUANTITIES`; all by default.
        since, until: ISO date or time, UTC; the half-open span in which captures began.
        min_samples: captures with fewer are left out, where a value is made from samples.

    Raises:
        UsageError: a name or a date is wrong, or the data set cannot be read.
    """
    from fnmatch import fnmatchcase

    from syncline_analyzer.fleet.trends.gathering import Scope, gather, sync_periods_us
    from syncline_analyzer.fleet.trends.judging import trends_of
    from syncline_analyzer.fleet.trends.wording import finding_of

    scope = Scope.of(bus, node, quantity, since, until, min_samples)
    trends = trends_of(gather(database, scope))
    sync_us = sync_periods_us(database) if trends else {}
    findings = [finding_of(trend, sync_us) for trend in trends]
    if machine is not None:
        findings = [
            each
            for each in findings
            if any(fnmatchcase(name, machine) for name in each.machine_names)
        ]
    return sorted(findings, key=lambda each: each.rank)
