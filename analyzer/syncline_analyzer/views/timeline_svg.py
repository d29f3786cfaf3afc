"""NMT states, findings and EMCY of all nodes over time as SVG lanes, also without scripts."""

import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby

from syncline_analyzer.results import Analysis, Finding, NmtStateRow
from syncline_analyzer.views.events import CLEARING, RESET
from syncline_analyzer.views.html import Html, element, joined
from syncline_analyzer.views.lanes import cells, lanes_of
from syncline_analyzer.views.palette import STATE_LETTERS, URGENCY
from syncline_analyzer.views.report_axes import time_ticks
from syncline_analyzer.views.report_moment import LEAST_NS, Moments, seconds
from syncline_analyzer.views.words import duration, names_of, node_label
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.wording import counted

MAX_INTERVALS = 2_000
"""Intervals of a lane that are drawn one by one; more become this number of cells."""
PAGE_INTERVALS = 12_000
"""Intervals of all lanes together, so that forty restless nodes do not make a page that crawls."""
MAX_FLAGS = 60
"""Findings of one severity that have a flag with their number; the others are bars alone."""
MAX_ROWS = 4
"""Rows of flags; of more findings in one place the later ones are bars alone."""
MANY_LANES = 12
"""From more nodes on, a box leaves only those in trouble."""

TICKS = 7
_HEIGHT = 20
_FLAG_PERCENT = 2.4
"""Width of a flag; one that would cover another is put below it."""
_LETTER_PERCENT = 1.6
_LETTERS = 60
_NEAR_END_PERCENT = 90

_NAMES = {"error": "Errors", "warning": "Warnings", "info": "Notes"}
_THIN = (NmtState.OPERATIONAL, NmtState.UNKNOWN)
"""What needs no attention is a thin bar without a letter."""
_THIN_BAR, _LOW_BAR, _WHOLE_BAR = (5, 10), (16, 4), (1, _HEIGHT - 2)
"""Top and height of such bars, of findings, which lie below their flags, and of all others."""


def timeline(analysis: Analysis, moments: Moments) -> Html:
    """All lanes with their axis and legend."""
    lanes = [*_finding_lanes(analysis, moments)]
    if analysis.capture.gaps:
        lanes.append(_gaps_lane(analysis, moments))
    shown = lanes_of(analysis)
    troubled = troubled_nodes(analysis)
    most = min(MAX_INTERVALS, PAGE_INTERVALS // max(len(shown), 1))
    for key, rows in shown.items():
        label = _label(analysis, *key)
        link = element("a", label, href=f"#{node_id(*key)}", title=label)
        lanes.append(_node_lane(link, label, rows, analysis, moments, most, key in troubled))
    several = [_only_troubled()] if len(shown) > MANY_LANES and troubled else []
    return element("div", *several, *lanes, axis(moments), _legend(), class_="lanes", id="lanes")


def node_lane(rows: list[NmtStateRow], analysis: Analysis, moments: Moments) -> Iterator[Html]:
    """The lane of the node of these intervals, for its own section."""
    if moments.clock.timed and rows:
        most = min(MAX_INTERVALS, PAGE_INTERVALS // 2 // max(len(analysis.nodes), 1))
        label = _label(analysis, rows[0].bus, rows[0].node)
        name = element("span", "NMT state")
        lane = _node_lane(name, label, rows, analysis, moments, most, False)
        yield element("div", lane, axis(moments), class_="lanes own")


def troubled_nodes(analysis: Analysis) -> set[tuple[str, int]]:
    """Nodes that an error or a warning names, or that were lost or reported something."""
    told = {(s.bus, s.node) for s in analysis.nmt_states if s.state == NmtState.LOST}
    told |= {(row.bus, row.node) for row in analysis.emcy}
    told |= {(row.bus, row.node) for row in analysis.errors}
    return told.union(*(nodes_of(row) for row in analysis.findings if row.severity != "info"))


def nodes_of(finding: Finding) -> dict[tuple[str, int], None]:
    """Nodes that a story names, its own first."""
    named = [(finding.bus, finding.node), *((link.bus, link.node) for link in finding.chain)]
    return {(bus, node): None for bus, node in named if bus is not None and node is not None}


def node_id(bus: str, node: int) -> str:
    """Anchor of a node's section, of letters that any address may hold.

    >>> node_id("can0", 5), node_id("a b", 5), node_id("a_b", 5)
    ('node-can0-5', 'node-a_b-806c5cd3-5', 'node-a_b-5')
    """
    plain = re.sub(r"[^A-Za-z0-9_-]", "_", bus)
    if plain != bus:
        plain += f"-{zlib.crc32(bus.encode('utf-8', 'surrogatepass')):08x}"
    return f"node-{plain}-{node}"


def axis(moments: Moments) -> Html:
    """Round moments of capture time with the time of day below them."""
    labels = time_labels(moments, dated=True)
    ticks = element("div", *labels, class_="ticks")
    return element("div", ticks, class_="axis", aria_hidden="true")


def time_labels(moments: Moments, *, dated: bool = False) -> Iterator[Html]:
    """Round moments of capture time in their places; `dated` with the time of day below each."""
    first_ns = moments.clock.first_ns
    for t_ns, text in time_ticks(moments.begin_ns - first_ns, moments.span_ns, TICKS):
        percent = moments.percent(first_ns + t_ns)
        utc = _day_time(moments, t_ns) if dated else ""
        below = [element("small", utc)] if utc else []
        place = f"left:{percent:.3f}%"
        yield element("span", text, *below, style=place, class_=end_class(percent))


def end_class(percent: float) -> str | None:
    """Class of a label that stands before its moment, since there is no room behind it."""
    return "end" if percent > _NEAR_END_PERCENT else None


def _day_time(moments: Moments, t_ns: int) -> str:
    return moments.utc(moments.clock.first_ns + t_ns).removesuffix(".000")


def _label(analysis: Analysis, bus: str, node: int) -> str:
    label = names_of(analysis.nodes).get((bus, node), node_label(node))
    return f"{bus} {label}" if len(analysis.capture.buses) > 1 else label


def _node_lane(
    label: Html,
    title: str,
    rows: list[NmtStateRow],
    analysis: Analysis,
    moments: Moments,
    most: int,
    troubled: bool,
) -> Html:
    bus, node = rows[0].bus, rows[0].node
    shapes = [*_states(rows, moments, most), *_emcy(analysis, bus, node, moments, most)]
    told = f"NMT states of node {title}: {_told(rows)}"
    return _lane(label, told, shapes, moments, _letters(rows, moments), trouble=troubled)


def _lane(
    label: Html | str,
    told: str,
    shapes: Iterable[Html],
    moments: Moments,
    over: Iterable[Html] = (),
    rows: int = 1,
    *,
    trouble: bool = True,
) -> Html:
    drawing = element(
        "svg",
        element("title", told),
        *shapes,
        viewBox=f"0 0 {moments.span} {_HEIGHT}",
        preserveAspectRatio="none",
        role="img",
        aria_label=told,
    )
    return element(
        "div",
        element("div", label, class_="label"),
        element("div", drawing, *over, class_="area"),
        class_="lane",
        style=f"--rows:{rows}" if rows > 1 else None,
        data_trouble=trouble,
    )


def _states(rows: list[NmtStateRow], moments: Moments, most: int) -> Iterator[Html]:
    """Urgent states last: what is narrower than a pixel is drawn one pixel wide, on top."""
    if len(rows) > most:
        yield from _cells(rows, moments, most)
        return
    for row in sorted(rows, key=lambda row: URGENCY.index(row.state)):
        stretch = moments.clock.stretch(row.start_ns, row.end_ns)
        long = duration(row.end_ns - row.start_ns)
        title = f"{row.state} {stretch} ({long}), {row.cause}, {row.certainty}"
        yield bar(row.state, row.start_ns - moments.begin_ns, row.end_ns - row.start_ns, title)


def _cells(rows: list[NmtStateRow], moments: Moments, most: int) -> Iterator[Html]:
    shown = cells(rows, moments.begin_ns, moments.begin_ns + moments.span_ns, most)
    at, step = 0, moments.span_ns / most
    for state, run in groupby(shown):
        count = len(list(run))
        if state:
            title = f"mostly {state} (too many changes to draw each)"
            yield bar(state, round(at * step), round(count * step), title)
        at += count


def bar(kind: str, start_ns: int, long_ns: int, title: str) -> Html:
    """A stretch that tells what it is when it is pointed at; `start_ns` from the left edge."""
    top, height = _LOW_BAR if kind in _NAMES else _THIN_BAR if kind in _THIN else _WHOLE_BAR
    return element(
        "g",
        element("title", title),
        element(
            "rect",
            x=seconds(start_ns),
            y=top,
            width=seconds(max(long_ns, LEAST_NS)),
            height=height,
        ),
        class_=f"s-{kind.lower()}",
    )


def _letters(rows: Sequence[NmtStateRow], moments: Moments) -> Iterator[Html]:
    """The letter of every state that is not the usual one, where there is room for it."""
    least_ns = moments.span_ns * _LETTER_PERCENT / 100
    drawn = [row for row in rows if row.end_ns > moments.begin_ns]
    loud = [row for row in drawn if row.state not in _THIN]
    wide = [row for row in loud if row.end_ns - row.start_ns >= least_ns]
    for row in wide[:_LETTERS]:
        place = f"left:{max(moments.percent(row.start_ns), 0.0):.3f}%"
        letter = STATE_LETTERS[row.state]
        yield element("span", letter, class_="letter", style=place, aria_hidden="true")


def _emcy(analysis: Analysis, bus: str, node: int, moments: Moments, most: int) -> Iterator[Html]:
    """EMCY as strokes over the whole lane, those that clear over its lower half."""
    told = [
        (row.t_ns, row.transition in CLEARING)
        for row in analysis.emcy
        if (row.bus, row.node) == (bus, node) and row.transition != RESET
    ][:most]
    for clears, name, top in ((True, "clear", _HEIGHT // 2), (False, "emcy", 0)):
        steps = [f"M{moments.second(t)} {top}V{_HEIGHT}" for t, c in told if c == clears]
        if steps:
            yield element("path", d="".join(steps), class_=f"m-{name}")


def _finding_lanes(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    numbered = [*enumerate(analysis.findings, 1)]
    for severity, name in _NAMES.items():
        rows = [(number, row) for number, row in numbered if row.severity == severity]
        if not rows:
            continue
        bars = (
            bar(
                severity,
                row.start_ns - moments.begin_ns,
                row.end_ns - row.start_ns,
                f"{number}: {row.text}",
            )
            for number, row in rows
        )
        flags, levels = _flags(severity, rows[:MAX_FLAGS], moments)
        link = element("a", name, href="#findings")
        told = f"{counted(len(rows), 'finding')} of severity {severity}"
        yield _lane(link, told, bars, moments, flags, levels)


def _flags(
    severity: str, rows: Sequence[tuple[int, Finding]], moments: Moments
) -> tuple[list[Html], int]:
    """Numbers of findings at their start that lead to them, and how many rows they take."""
    ends: list[float] = []
    flags = []
    for number, row in sorted(rows, key=lambda pair: pair[1].start_ns):
        left = min(max(moments.percent(row.start_ns), 0.0), 100 - _FLAG_PERCENT)
        level = next((i for i, end in enumerate(ends) if end <= left), len(ends))
        if level == MAX_ROWS:
            continue
        ends[level : level + 1] = [left + _FLAG_PERCENT]
        flags.append(
            element(
                "a",
                str(number),
                href=f"#finding-{number}",
                class_=f"flag {severity}",
                style=f"left:{left:.3f}%;--row:{level}",
                data_at=moments.second(row.start_ns),
                aria_label=f"Finding {number}",
                title=row.text,
            )
        )
    return flags, max(len(ends), 1)


def _gaps_lane(analysis: Analysis, moments: Moments) -> Html:
    gaps = analysis.capture.gaps
    bars = (
        bar("blind", g.start_ns - moments.begin_ns, g.end_ns - g.start_ns, f"blind: {g.reason}")
        for g in gaps[:MAX_INTERVALS]
    )
    link = element("a", "Recorder blind", href="#recording")
    return _lane(link, f"{len(gaps)} stretches without recording", bars, moments)


def _told(rows: list[NmtStateRow]) -> str:
    counts = {state: sum(row.state == state for row in rows) for state in reversed(URGENCY)}
    told = ", ".join(f"{count} times {state}" for state, count in counts.items() if count)
    return f"{told}; at the end {rows[-1].state}"


def _only_troubled() -> Html:
    box = element("input", type="checkbox", id="only-trouble")
    return element("label", box, " Only nodes in trouble", class_="only", for_="only-trouble")


def _legend() -> Html:
    keys = [
        joined([element("i", letter, class_=f"s-{state.lower()}"), f" {state} "])
        for state, letter in STATE_LETTERS.items()
    ]
    marks = [
        joined([element("i", sign, class_=f"m-{name}"), f" {text} "])
        for name, sign, text in (("emcy", "|", "EMCY"), ("clear", "\u02cc", "EMCY cleared"))
    ]
    return element("p", *keys, *marks, class_="legend")
