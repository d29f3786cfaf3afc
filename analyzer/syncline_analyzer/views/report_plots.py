"""Plots of the report as SVG: thinned so that a page stays small, dense where findings are.

A plot is a picture already without scripts, and one in vectors on paper. The script reads the
values back out of the paths, so that they are in the page once.
"""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import Analysis
from syncline_analyzer.views.events import Marks, marks
from syncline_analyzer.views.html import Html, element
from syncline_analyzer.views.plots import Line, Panel, panels, shown_at_once
from syncline_analyzer.views.report_axes import value_ticks
from syncline_analyzer.views.report_moment import Moments, seconds
from syncline_analyzer.views.thin import envelope, extremes
from syncline_analyzer.views.timeline_svg import time_labels
from syncline_analyzer.views.words import number
from syncline_schemas.records import dataclass

POINTS_OF_A_PAGE = 160_000
"""Points of all lines over the whole capture ..."""
POINTS_AT_FINDINGS = 80_000
"""... and so many more where findings are, to be seen when one is opened."""
MAX_POINTS, MIN_POINTS = 4_000, 100
MAX_LINES = 40
"""Lines of one plot; of more, those that reach farthest up and down."""
MAX_MARKS, MAX_BANDS, MAX_STRETCHES = 1_000, 200, 24

COLOURS = 8
ROOM = 0.5
"""What is shown of a finding before and after it, as a part of its length ..."""
LEAST_ROOM = 0.005
"""... but at least this part of the capture, within the limits below."""
LEAST_ROOM_NS, MOST_LEAST_ROOM_NS = 50_000_000, 10_000_000_000

_OUTLINE = 8
"""Points of a stretch that are worth an outline; with more holes a band is drawn as a line."""
_LONGEST_BAND = 0.2
_VALUE_TICKS = 5
_DIGITS = 6

_ON_PLOTS = {"EMCY": "emcy", "EMCY cleared": "clear", "node lost": "lost"}
_HEIGHTS = {"emcy": 0.16, "clear": 0.08, "lost": 1.0}
"""How far a marker reaches down, so that the kinds differ not in colour alone."""


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot of the page: anchor, quantity, whether it is of the bus at work, whose values, HTML."""

    identity: str
    title: str
    is_timing: bool
    nodes: frozenset[tuple[str, int]]
    html: Html


def plots_of(analysis: Analysis) -> list[Plot]:
    """Plots in the order of the page. A capture without times has no plots."""
    moments = Moments.of(analysis)
    drawn = shown_at_once(panels(analysis), analysis) if moments.clock.timed else []
    lines = max(sum(min(len(panel.lines), MAX_LINES) for panel in drawn), 1)
    points = max(MIN_POINTS, min(MAX_POINTS, POINTS_OF_A_PAGE // lines))
    thinning = _Thinning(points, POINTS_AT_FINDINGS // lines, moments)
    return [
        _plot(f"plot-{number}", panel, analysis, thinning) for number, panel in enumerate(drawn, 1)
    ]


def opened_stretch(start_ns: int, end_ns: int, span_ns: int) -> tuple[int, int]:
    """What the page shows when a stretch is opened: the script does the same."""
    least = min(max(LEAST_ROOM * span_ns, LEAST_ROOM_NS), MOST_LEAST_ROOM_NS)
    room = max(ROOM * (end_ns - start_ns), least)
    return start_ns - round(room), end_ns + round(room)


@dataclass(frozen=True, slots=True)
class _Thinning:
    """How many points a line has over all, and how many more where findings are."""

    points: int
    at_findings: int
    moments: Moments

    def rows(self, line: Line, stretches: Sequence[tuple[int, int]]) -> NDArray[np.intp]:
        """Rows of a line that are drawn."""
        rows = extremes(line.value, self.points, line.wraps)
        if len(rows) == len(line.value) or not stretches:
            return rows
        each = max(self.at_findings // len(stretches), MIN_POINTS // 2)
        dense = [self._dense(line, start_ns, end_ns, each) for start_ns, end_ns in stretches]
        kept: NDArray[np.intp] = np.unique(np.concatenate([rows, *dense]))
        return kept

    def _dense(self, line: Line, start_ns: int, end_ns: int, points: int) -> NDArray[np.intp]:
        start_ns, end_ns = opened_stretch(start_ns, end_ns, self.moments.span_ns)
        within = np.flatnonzero((line.t_ns >= start_ns) & (line.t_ns <= end_ns))
        return within[extremes(line.value[within], points)]


def _plot(identity: str, panel: Panel, analysis: Analysis, thinning: _Thinning) -> Plot:
    nodes = frozenset((line.bus, line.node) for line in panel.lines if line.node is not None)
    html = _figure(identity, panel, analysis, thinning)
    return Plot(identity, panel.title, panel.is_timing, nodes, html)


def _figure(identity: str, panel: Panel, analysis: Analysis, thinning: _Thinning) -> Html:
    moments, told = thinning.moments, panel.told(analysis)
    lines = _farthest(panel.lines)
    low, high = panel.limits()
    shown = [mark for mark in marks(told) if mark.name in _ON_PLOTS]
    left_out = len(panel.lines) - len(lines)
    caption = panel.label + (f", {left_out} lines left out" if left_out else "")
    stretches = [(row.start_ns, row.end_ns) for row in told.findings[:MAX_STRETCHES]]
    drawn = [
        _drawn(line, colour, high, stretches, thinning)
        for line, colour in zip(lines, _colours(lines), strict=True)
    ]
    words = f"{caption}. {'; '.join(_told(line, panel.unit) for line in lines)}"
    drawing = element(
        "svg",
        element("title", words),
        _grid(low, high, panel.unit, moments),
        *_bands(told, moments, high - low),
        *(each.html for each in drawn),
        *_marks(shown, moments, high - low),
        viewBox=f"0 0 {moments.span} {high - low:.9g}",
        preserveAspectRatio="none",
        role="img",
        aria_label=words,
    )
    area = element("div", drawing, *_ticks(low, high, panel.unit, moments), class_="area")
    keys = element("ul", *_keys(lines, [each.points for each in drawn], shown), class_="keys")
    gutter = element("div", element("figcaption", caption), keys, class_="gutter")
    return element(
        "figure", gutter, area, class_="plot", id=identity,
        data_low=repr(low), data_high=repr(high), data_unit=panel.unit,
    )  # fmt: skip


def _told(line: Line, unit: str) -> str:
    """A line in words, for those who do not see it."""
    known = line.value[np.isfinite(line.value)]
    if not len(known):
        return f"{line.name}: no value"
    return f"{line.name}: {number(float(known.min()))} to {number(float(known.max()), unit)}"


def _farthest(lines: list[Line]) -> list[Line]:
    """The lines of the widest reach, in their order."""
    if len(lines) <= MAX_LINES:
        return lines
    kept = sorted(range(len(lines)), key=lambda i: -_reach(lines[i].value))[:MAX_LINES]
    return [lines[i] for i in sorted(kept)]


def _reach(value: NDArray[np.float64]) -> float:
    known = value[np.isfinite(value)]
    return float(np.ptp(known)) if len(known) else 0.0


def _bands(told: Analysis, moments: Moments, height: float) -> Iterator[Html]:
    """Stretches of the findings and those in which the recorder was blind.

    A finding that lasts for most of the capture is only marked where it starts.
    """
    longest = moments.span_ns * _LONGEST_BAND
    spans = [(gap.start_ns, gap.end_ns, "blind") for gap in told.capture.gaps]
    for row in told.findings:
        short = row.end_ns - row.start_ns <= longest
        spans.append((row.start_ns, row.end_ns if short else row.start_ns, row.severity))
    for start_ns, end_ns, kind in spans[:MAX_BANDS]:
        yield element(
            "rect",
            x=moments.second(start_ns),
            y=0,
            width=seconds(max(end_ns - start_ns, 0)),
            height=f"{height:.9g}",
            class_=f"band s-{kind}",
        )


def _colours(lines: Iterable[Line]) -> list[int]:
    """Number of the colour of each line; a band has that of the line that it lies behind."""
    counts = {True: 0, False: 0}
    found = []
    for line in lines:
        found.append(counts[line.band] % COLOURS)
        counts[line.band] += 1
    return found


@dataclass(frozen=True, slots=True)
class _Drawn:
    """A line as it is drawn: its path, and of how many of its values."""

    html: Html
    points: int


def _drawn(
    line: Line,
    colour: int,
    high: float,
    stretches: Sequence[tuple[int, int]],
    thinning: _Thinning,
) -> _Drawn:
    outlines = np.count_nonzero(np.isnan(line.value)) + 1
    if line.band and len(line.value) > thinning.points > _OUTLINE * outlines:
        t_ns, value = envelope(line.t_ns, line.value, thinning.points)
        kind, count = f"area-of l{colour}", len(line.value)
    else:
        rows = thinning.rows(line, stretches)
        t_ns, value = line.t_ns[rows], line.value[rows]
        count = int(np.count_nonzero(np.isfinite(value)))
        kind = f"line l{colour}" + (" behind" if line.band else "") + " lone" * (count == 1)
    path = element("path", d=steps(t_ns, high - value, thinning.moments), class_=kind)
    return _Drawn(path, count)


def steps(t_ns: NDArray[np.int64], down: NDArray[np.float64], moments: Moments) -> str:
    """A path through points, interrupted at each NaN; a point alone is a dot."""
    digits = _digits(down)
    parts: list[str] = []
    start = True
    alone = ""
    for x, y in zip((t_ns - moments.begin_ns).tolist(), down.tolist(), strict=True):
        if math.isnan(y):
            parts.append(alone)
            start, alone = True, ""
            continue
        point = f"{seconds(x)} {_short(y, digits)}"
        parts.append(f"{'M' if start else ' '}{point}")
        alone = f" {point}" if start else ""
        start = False
    return "".join([*parts, alone])


def _digits(value: NDArray[np.float64]) -> int:
    """Decimals that show a millionth of the reach."""
    reach = _reach(value) or 1.0
    return int(max(0, _DIGITS - np.ceil(np.log10(reach))))


def _short(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _marks(shown: Sequence[Marks], moments: Moments, height: float) -> Iterator[Html]:
    for mark in shown:
        kind = _ON_PLOTS[mark.name]
        down = f"{height * _HEIGHTS[kind]:.9g}"
        told = mark.moments[:: len(mark.moments) // MAX_MARKS + 1]
        strokes = "".join(f"M{moments.second(t_ns)} 0V{down}" for t_ns, _ in told)
        yield element("path", d=strokes, class_=f"mark m-{kind}")


def _grid(low: float, high: float, unit: str, moments: Moments) -> Html:
    ticks = value_ticks(low, high, _VALUE_TICKS, unit)
    rules = "".join(f"M0 {high - value:.9g}H{moments.span}" for value, _ in ticks)
    return element("path", d=rules, class_="grid")


def _ticks(low: float, high: float, unit: str, moments: Moments) -> Iterator[Html]:
    values = (
        element("span", text, style=f"top:{100 * (high - value) / (high - low):.3f}%")
        for value, text in value_ticks(low, high, _VALUE_TICKS, unit)
    )
    yield element("div", *values, class_="values", aria_hidden="true")
    yield element("div", *time_labels(moments), class_="ticks", aria_hidden="true")


def _keys(lines: Sequence[Line], points: Sequence[int], shown: Sequence[Marks]) -> Iterator[Html]:
    """What the lines and markers are, each beside its look, and how much of a line is drawn."""
    for line, colour, drawn in zip(lines, _colours(lines), points, strict=True):
        kind = "swatch behind" if line.band else "swatch"
        look = element("i", class_=f"{kind} l{colour}")
        known = int(np.count_nonzero(np.isfinite(line.value)))
        thinned = f"{drawn:,} of {known:,} samples drawn" if drawn < known else None
        yield element(
            "li",
            look,
            element("span", line.name),
            element("small", thinned) if thinned else None,
        )
    for mark in shown:
        look = element("i", "|", class_=f"m-{_ON_PLOTS[mark.name]}")
        yield element("li", look, element("span", mark.name), class_="of-mark")
