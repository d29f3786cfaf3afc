"""Trends of a fleet as text, as JSON or as a table."""

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TextIO

import pyarrow as pa

from syncline_analyzer.fleet.columns import schema_of
from syncline_analyzer.fleet.trends.rows import TrendFinding
from syncline_analyzer.views.fleet_answer import write_csv
from syncline_schemas.wording import counted

SCHEMA = "syncline.trends/1"
_NOTHING = "Nothing drifts, steps or comes more often: or there are too few captures to tell."


def write_trends(trends: Sequence[TrendFinding], form: str, stream: TextIO | None = None) -> None:
    """Write trends as text, json (one object) or csv; to standard output by default."""
    to = stream or sys.stdout
    if form == "json":
        told = {"schema": SCHEMA, "trends": [asdict(each) for each in trends]}
        to.write(json.dumps(told, ensure_ascii=False) + "\n")
    elif form == "csv":
        rows = [asdict(each) for each in trends]
        write_csv(pa.Table.from_pylist(rows, schema_of(TrendFinding)).to_reader(), to)
    else:
        for line in trend_lines(trends):
            to.write(line + "\n")


def trend_lines(trends: Sequence[TrendFinding]) -> Iterator[str]:
    """Each trend with its likely cause, what to check next and the captures that prove it."""
    for trend in trends:
        yield _printable(str(trend))
        yield f"    likely: {trend.cause}"
        yield f"    check next: {trend.check_next}"
        if trend.assumed:
            yield f"    assumed: {', '.join(trend.assumed)}"
        yield _printable(f"    captures: {counted(trend.captures, 'value')}, {_sides(trend)}")
    fleet = sum(trend.machine is None for trend in trends)
    yield f"{counted(len(trends), 'trend')}, {fleet} of many machines" if trends else _NOTHING


def _sides(trend: TrendFinding) -> str:
    ids = ", ".join(trend.evidence[:4])
    if trend.captures_before == 0:
        return ids
    return f"{trend.captures_before} before it and {trend.captures_after} after; {ids}"


def _printable(text: str) -> str:
    """Text without what would move a terminal's cursor."""
    return "".join(each if each.isprintable() else "·" for each in text)
