"""Rhythm of heartbeats and guard requests, in rows for the text view."""

from collections.abc import Iterator

from syncline_analyzer.results import Analysis, ErrorControlRow
from syncline_analyzer.views.basis import fine, stepped
from syncline_analyzer.views.services import Listing
from syncline_analyzer.views.words import duration, names_of, node_label, number

_SHOWN = 8
"""Nodes that are listed: those whose messages are missing, and the least even ones."""


def error_control_listings(analysis: Analysis) -> Iterator[Listing]:
    """Periods of heartbeats and guard requests, held against what they are set to."""
    rows = sorted(analysis.error_control_periods, key=_rank, reverse=True)[:_SHOWN]
    if rows:
        names = names_of(analysis.nodes)
        left = len(analysis.error_control_periods) - len(rows)
        title = "Heartbeats and guarding" + (f" (the least even; {left} more)" if left else "")
        heads = ["bus", "node", "what", ">count", ">period [ms]", ">jitter [us]", "set to"]
        lines = [
            _line(row, names.get((row.bus, row.node), node_label(row.node)))
            for row in sorted(rows, key=lambda row: (row.bus, row.node))
        ]
        yield Listing(title, heads, lines)


def _rank(row: ErrorControlRow) -> tuple[int, float]:
    return row.missing, (row.jitter_us.max_min or 0.0) if row.jitter_us else 0.0


def _line(row: ErrorControlRow, label: str) -> list[str]:
    period = row.period_us
    lengths = (period.min, period.median, period.max) if period else ()
    return [
        row.bus,
        label,
        row.kind,
        str(row.count),
        "/".join(number(each / 1000) for each in lengths) or "-",
        fine(row.jitter_us.std, row.resolution_us) if row.jitter_us else "-",
        ", ".join(_against(row)) or "-",
    ]


def _against(row: ErrorControlRow) -> Iterator[str]:
    if row.expected_us is not None:
        yield f"{number(row.expected_us / 1000)} ms ({row.expected_source}): {_off(row)} off"
    if row.missing:
        yield f"{row.missing} {'missing' if row.kind == 'heartbeat' else 'not answered'}"
    if row.answer_us is not None:
        yield f"answered within {stepped(row.answer_us.max, row.resolution_us)} us"


def _off(row: ErrorControlRow) -> str:
    """How far the median period is off what it is set to."""
    if row.deviation_us is None:
        return fine(None, row.resolution_us)
    sign = "+" if row.deviation_us > 0 else ""
    return f"{sign}{duration(round(1000 * row.deviation_us))}"
