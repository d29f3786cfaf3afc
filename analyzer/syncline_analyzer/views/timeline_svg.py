"""NMT states, findings and EMCY of all nodes over time as SVG lanes, also without scripts."""

from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import NamedTuple

from syncline_analyzer.results import Analysis, NmtStateRow
from syncline_analyzer.views.events import CLEARING, RESET
from syncline_analyzer.views.html import Html, element, joined
from syncline_analyzer.views.lanes import cells, lanes_of
from syncline_analyzer.views.palette import STATE_LETTERS, URGENCY
from syncline_analyzer.views.words import Clock, duration, names_of, node_label

MAX_INTERVALS = 2_000
"""Intervals of a lane that are drawn one by one; more become this number of cells."""

_HEIGHT = 20
_SECOND = 1_000_000_000


class _View(NamedTuple):
    """What the lanes show: from when in capture time, and how long [ns]."""

    start_ns: int
    span_ns: int


def timeline(analysis: Analysis) -> Html:
    """All lanes with their axis and legend; the widths are seconds of capture time."""
    clock = Clock.of(analysis.capture)
    capture = analysis.capture
    view = _View(capture.begin_ns - clock.first_ns, max(capture.duration_ns, 1))
    labels = names_of(analysis.nodes)
    several = len(analysis.capture.buses) > 1
    lanes = [*_finding_lanes(analysis, clock, view)]
    if analysis.capture.gaps:
        lanes.append(_gaps_lane(analysis, clock, view))
    for (bus, node), rows in lanes_of(analysis).items():
        label = labels.get((bus, node), node_label(node))
        title = f"{bus} {label}" if several else label
        link = element("a", title, href=f"#{node_id(bus, node)}")
        shapes = [*_states(rows, clock, view), *_emcy(analysis, bus, node, clock)]
        lanes.append(_lane(link, f"NMT states of node {title}: {_told(rows)}", shapes, view))
    axis = element("div", *_ticks(clock, view), class_="axis", aria_hidden="true")
    return element("div", *lanes, axis, _legend(), class_="timeline", id="lanes")


def node_id(bus: str, node: int) -> str:
    """Anchor of a node's section."""
    return f"node-{bus}-{node}".replace(" ", "_")


def _lane(label: Html | str, told: str, shapes: Iterable[Html], view: _View) -> Html:
    drawing = element(
        "svg",
        element("title", told),
        *shapes,
        viewBox=f"{view.start_ns / _SECOND:.9g} 0 {view.span_ns / _SECOND:.9g} {_HEIGHT}",
        preserveAspectRatio="none",
        role="img",
        aria_label=told,
    )
    return element("div", element("div", label, class_="label"), drawing, class_="lane")


def _states(rows: list[NmtStateRow], clock: Clock, view: _View) -> Iterator[Html]:
    """Urgent states last: what is narrower than a pixel is drawn one pixel wide, on top."""
    if len(rows) > MAX_INTERVALS:
        yield from _cells(rows, clock, view)
        return
    for row in sorted(rows, key=lambda row: URGENCY.index(row.state)):
        stretch = clock.stretch(row.start_ns, row.end_ns)
        long = duration(row.end_ns - row.start_ns)
        title = f"{row.state} {stretch} ({long}), {row.cause}, {row.certainty}"
        yield _bar(row.state, row.start_ns - clock.first_ns, row.end_ns - clock.first_ns, title)


def _cells(rows: list[NmtStateRow], clock: Clock, view: _View) -> Iterator[Html]:
    begin_ns = clock.first_ns + view.start_ns
    shown = cells(rows, begin_ns, begin_ns + view.span_ns, MAX_INTERVALS)
    at = 0
    for state, run in groupby(shown):
        count = len(list(run))
        if state:
            step = view.span_ns / MAX_INTERVALS
            title = f"mostly {state} (too many changes to draw each)"
            start_ns = view.start_ns + round(at * step)
            yield _bar(state, start_ns, start_ns + round(count * step), title)
        at += count


def _bar(kind: str, start_ns: int, end_ns: int, title: str) -> Html:
    width = max(end_ns - start_ns, 0) / _SECOND
    return element(
        "g",
        element("title", title),
        element(
            "rect", x=f"{start_ns / _SECOND:.9g}", y=2, width=f"{width:.9g}", height=_HEIGHT - 4
        ),
        class_=f"s-{kind.lower()}",
    )


def _emcy(analysis: Analysis, bus: str, node: int, clock: Clock) -> Iterator[Html]:
    moments = [
        (row.t_ns, row.transition in CLEARING)
        for row in analysis.emcy
        if (row.bus, row.node) == (bus, node) and row.transition != RESET
    ][:MAX_INTERVALS]
    for clears, name in ((True, "clear"), (False, "emcy")):
        steps = [
            f"M{(t - clock.first_ns) / _SECOND:.9g} 0V{_HEIGHT}" for t, c in moments if c == clears
        ]
        if steps:
            yield element("path", d="".join(steps), class_=f"m-{name}")


def _finding_lanes(analysis: Analysis, clock: Clock, view: _View) -> Iterator[Html]:
    for severity, name in (("error", "Errors"), ("warning", "Warnings"), ("info", "Notes")):
        rows = [row for row in analysis.findings if row.severity == severity]
        bars = (
            _bar(severity, row.start_ns - clock.first_ns, row.end_ns - clock.first_ns, row.text)
            for row in rows
        )
        if rows:
            link = element("a", name, href="#findings")
            yield _lane(link, f"{len(rows)} findings of severity {severity}", bars, view)


def _gaps_lane(analysis: Analysis, clock: Clock, view: _View) -> Html:
    bars = (
        _bar("blind", g.start_ns - clock.first_ns, g.end_ns - clock.first_ns, f"blind: {g.reason}")
        for g in analysis.capture.gaps[:MAX_INTERVALS]
    )
    link = element("a", "Recorder", href="#recording")
    return _lane(link, f"{len(analysis.capture.gaps)} stretches without recording", bars, view)


def _told(rows: list[NmtStateRow]) -> str:
    counts = {state: sum(row.state == state for row in rows) for state in reversed(URGENCY)}
    return ", ".join(f"{count} times {state}" for state, count in counts.items() if count)


def _ticks(clock: Clock, view: _View) -> Iterator[Html]:
    for percent in (0, 25, 50, 75, 100):
        moment = clock.short(clock.first_ns + view.start_ns + view.span_ns * percent // 100)
        yield element("span", moment, style=f"left:{percent}%")


def _legend() -> Html:
    keys = [
        joined([element("i", letter, class_=f"s-{state.lower()}"), f" {state} "])
        for state, letter in STATE_LETTERS.items()
    ]
    marks = [
        joined([element("i", "|", class_=f"m-{name}"), f" {text} "])
        for name, text in (("emcy", "EMCY"), ("clear", "EMCY cleared"))
    ]
    return element("p", *keys, *marks, class_="legend")
