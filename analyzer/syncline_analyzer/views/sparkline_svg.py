"""Sparklines of the report: what a PDO did over the whole capture, as small as a word."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis, PdoRow
from syncline_analyzer.views.html import Html, element
from syncline_analyzer.views.report_moment import Moments
from syncline_analyzer.views.report_plots import steps
from syncline_analyzer.views.thin import extremes
from syncline_analyzer.views.words import hex_code, number, trace_object

MAX_VALUES = 4
"""Values of a PDO that have a sparkline."""
_POINTS = 160


def sparklines(row: PdoRow, analysis: Analysis, moments: Moments) -> Html:
    """The answers of a PDO over time, and the values that it carried."""
    if not moments.clock.timed:
        return Html("-")
    drawn = [*_responses(row, analysis, moments), *_values(row, analysis, moments)]
    return element("div", *drawn, class_="sparks") if drawn else Html("-")


def _responses(row: PdoRow, analysis: Analysis, moments: Moments) -> Iterator[Html]:
    for found in analysis.responses:
        if (found.bus, found.cob_id) == (row.bus, row.cob_id):
            yield sparkline("response", "us", found.t_ns, found.response_us, moments)


def _values(row: PdoRow, analysis: Analysis, moments: Moments) -> Iterator[Html]:
    carried = {
        (trace.bus, trace.node, trace.object)
        for trace in analysis.traces
        if trace.bus == row.bus and hex_code(row.cob_id, 3) in trace.sources
    }
    found = [t for t in analysis.trace_data if (t.bus, t.node, t.object) in carried]
    for trace in found[:MAX_VALUES]:
        angle = trace.columns.get("angle_deg")
        known = angle is not None and np.isfinite(angle).any()
        value, unit = (angle, "deg") if angle is not None and known else (trace.value, trace.unit)
        name = f"{trace.name} ({trace_object(trace.object)})"
        yield sparkline(name, unit, trace.t_ns, value, moments)


def sparkline(
    name: str, unit: str, t_ns: NDArray[np.int64], value: NDArray[np.float64], moments: Moments
) -> Html:
    """A quantity over the whole capture with its least and greatest value; t_ns, value (n,)."""
    known = value[np.isfinite(value)]
    if not len(known):
        return Html("")
    low, high = float(known.min()), float(known.max())
    room = (high - low) or 1.0
    rows = extremes(value, _POINTS)
    told = f"{number(low)} to {number(high, unit)}" if high > low else number(low, unit)
    words = f"{name} over time: {told}"
    path = steps(t_ns[rows], high + 0.1 * room - value[rows], moments)
    drawing = element(
        "svg",
        element("title", words),
        element("path", d=path, class_="line"),
        viewBox=f"0 0 {moments.span} {1.2 * room:.9g}",
        preserveAspectRatio="none",
        role="img",
        aria_label=words,
    )
    return element("div", drawing, element("small", f"{name} {told}"), class_="spark")
