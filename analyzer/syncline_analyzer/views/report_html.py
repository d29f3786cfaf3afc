"""`report.html`: one file that opens anywhere, without a network, and says first what went wrong."""

from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path

from syncline_analyzer.results import Analysis
from syncline_analyzer.views import report_tables as tables
from syncline_analyzer.views import report_timing as timing
from syncline_analyzer.views.basis import basis_lines
from syncline_analyzer.views.histogram_svg import histogram_figures
from syncline_analyzer.views.html import Html, data_script, element
from syncline_analyzer.views.load import load_listing
from syncline_analyzer.views.markdown import extent, verdict
from syncline_analyzer.views.palette import GAP_COLOUR, SEVERITY_COLOURS, STATE_COLOURS, css
from syncline_analyzer.views.plots import RESPONSES_APART
from syncline_analyzer.views.report_findings import BADGES, findings_part
from syncline_analyzer.views.report_moment import Moments
from syncline_analyzer.views.report_nodes import nodes_part
from syncline_analyzer.views.report_plots import ROOM, Plot, opened_stretch, plots_of
from syncline_analyzer.views.report_recording import quality, recording_part
from syncline_analyzer.views.timeline_svg import timeline
from syncline_analyzer.views.traces import COMPARED, trace_listings
from syncline_analyzer.views.waits import waiting_listings
from syncline_analyzer.views.words import extent_words, names_of, undrawn
from syncline_schemas.wording import counted

OPEN_COMMANDS = 12
"""NMT commands shown at once; more open on a click."""

_SECTIONS = {
    "findings": "Findings",
    "timeline": "Timeline",
    "nodes": "Nodes",
    "plots": "Measured values",
    "pdos": "Bus load, SYNC and PDOs",
    "recording": "Recording",
}
_MOVES = {
    "all": ("Whole capture", "All"),
    "in": ("Zoom in", "+"),
    "out": ("Zoom out", "\u2212"),
    "back": ("Earlier", "\u25c0"),
    "on": ("Later", "\u25b6"),
}
"""Moves of the range of time: what they do, and a sign for narrow screens."""
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:; "
    "form-action 'none'; base-uri 'none'"
)


def write_report(analysis: Analysis, path: Path) -> Path:
    """Write the report of an analysis, and return the file."""
    path.write_text(report(analysis), encoding="utf-8")
    return path


def report(analysis: Analysis) -> str:
    """The page."""
    moments = Moments.of(analysis)
    title = ", ".join(Path(file).name for file in analysis.capture.files)
    body = element(
        "body",
        element("a", "Skip to the findings", href="#findings", class_="skip"),
        _header(analysis, moments, title),
        _bar(moments, bool(analysis.capture.frames)),
        element("main", *_sections(analysis, moments)),
        element("footer", element("p", "Made by Syncline from the recorded frames alone.")),
        data_script("report-data", _data(moments)),
        element("script", Html(_asset("report.js"))),
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", http_equiv="Content-Security-Policy", content=POLICY),
        element("title", f"{title}: {verdict(analysis)}"),
        element("style", Html(_asset("report.css") + _colours())),
    )
    return "<!DOCTYPE html>\n" + element("html", head, body, lang="en")


def _data(moments: Moments) -> dict[str, float | None]:
    """What the script needs besides the page itself."""
    clock = moments.clock
    return {
        "begin": (moments.begin_ns - clock.first_ns) / 1e9,
        "seconds": moments.span_ns / 1e9,
        "start_ms": clock.first_ns / 1e6 if clock.dated and clock.timed else None,
        "room": ROOM,
        "least_room": max(opened_stretch(0, 0, moments.span_ns)[1], 1) / 1e9,
    }


def _asset(name: str) -> str:
    return (files("syncline_analyzer.views") / name).read_text(encoding="utf-8")


def _colours() -> str:
    """States and severities, which have the same colours in every view."""
    named = {f"s-{state.lower()}": colour for state, colour in STATE_COLOURS.items()}
    named |= {f"s-{severity}": colour for severity, colour in SEVERITY_COLOURS.items()}
    named |= {"s-blind": GAP_COLOUR}
    return "".join(
        f".{name} rect,rect.{name}{{fill:{css(c)};stroke:{css(c)}}}i.{name}{{background:{css(c)}}}"
        for name, c in named.items()
    )


def _header(analysis: Analysis, moments: Moments, title: str) -> Html:
    capture, clock = analysis.capture, moments.clock
    worst = next((s for s in BADGES if any(f.severity == s for f in analysis.findings)), "ok")
    times = None
    if clock.dated and clock.timed:
        times = element("p", extent_words(capture, clock), class_="dim")
    elif not clock.timed and capture.frames:
        times = element("p", "The log has no times.", class_="dim")
    link = element("a", "Recording", href="#recording")
    return element(
        "header",
        element("p", f"CANopen capture {title}", class_="dim"),
        element("h1", verdict(analysis), class_=f"verdict {worst}"),
        element("p", f"{extent(analysis)} ", link, f": {quality(analysis)}."),
        *(
            element("p", f"Damaged, read in part: {d}", class_="badge error")
            for d in capture.damage
        ),
        times,
    )


def _bar(moments: Moments, any_frames: bool) -> Html:
    """What stays in sight: the way to the sections, and the stretch that all pictures show."""
    items = (element("li", element("a", text, href=f"#{name}")) for name, text in _SECTIONS.items())
    everything = element(
        "button", "Open all tables", type="button", id="everything", aria_pressed="false"
    )
    parts = [element("nav", element("ul", *items), everything, aria_label="Sections")]
    if moments.clock.timed and any_frames:
        buttons = (
            element(
                "button",
                element("span", text, class_="wide"),
                element("span", sign, class_="narrow"),
                type="button",
                data_zoom=name,
                aria_label=text,
            )
            for name, (text, sign) in _MOVES.items()
        )
        shown = element("output", id="shown")
        parts.append(
            element(
                "div",
                *buttons,
                shown,
                element("span", id="cursor", aria_hidden="true"),
                class_="controls",
                role="group",
                aria_label="Time range of all pictures",
            )
        )
    return element("div", *parts, class_="top")


def _sections(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    plots = plots_of(analysis)
    yield _section("findings", *findings_part(analysis, moments))
    yield _section("timeline", *_timeline(analysis, moments))
    yield _section("nodes", *nodes_part(analysis, moments, plots))
    yield _section("plots", *_values(analysis, moments, plots))
    yield _section("pdos", *_timing(analysis, moments, plots))
    yield _section("recording", *recording_part(analysis, moments))


def _section(identity: str, *children: object) -> Html:
    heading = element("h2", _SECTIONS[identity], id=f"{identity}-title")
    return element("section", heading, *children, id=identity, aria_labelledby=f"{identity}-title")


def _timeline(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    anything = analysis.nmt_states or analysis.findings or analysis.capture.gaps
    if not (moments.clock.timed and anything):
        yield element("p", "There is nothing to draw over time.")
        return
    told = "Drag to zoom, double-click for the whole capture; numbers lead to the findings."
    yield element("p", told, class_="dim hint")
    if not_drawn := undrawn(analysis.capture):
        yield element("p", not_drawn)
    yield timeline(analysis, moments)
    count = len(analysis.nmt_commands)
    if count:
        rows = tables.command_table(analysis.nmt_commands, names_of(analysis.nodes), moments)
        summary = element("summary", counted(count, "NMT command"))
        yield element("details", summary, *rows, open=count <= OPEN_COMMANDS)


def _values(analysis: Analysis, moments: Moments, plots: Sequence[Plot]) -> Iterator[Html]:
    """What devices measured."""
    for listing in trace_listings(analysis, moments.clock):
        if listing.title in COMPARED:
            yield from tables.listed_table(listing)
    drawn = [plot.html for plot in plots if not plot.is_timing]
    if not drawn:
        yield element("p", "No PDO or SDO of a known device carries a value to plot.")
    yield from drawn


def _timing(analysis: Analysis, moments: Moments, plots: Sequence[Plot]) -> Iterator[Html]:
    yield element("ul", *(element("li", line) for line in basis_lines(analysis)))
    if analysis.bus_load:
        yield from tables.listed_table(load_listing(analysis, moments.clock))
    yield from _titled(plots, "Bus load", "Frame rate")
    yield from timing.share_tables(analysis)
    if not (analysis.sync or analysis.pdos):
        yield element("p", "No SYNC and no PDO was recorded.")
    hidden = () if len(analysis.capture.buses) > 1 else ("Bus",)
    yield from timing.sync_table(analysis.sync, hidden)
    yield from _titled(plots, "SYNC period")
    yield from timing.pdo_table("PDOs of all nodes", analysis.pdos, analysis.lateness, hidden)
    yield from timing.answer_table([*analysis.pdos, *analysis.unsent_pdos], hidden)
    yield from timing.response_table(
        "Answers to SYNC: response, and what of it is the device's", analysis.pdos, hidden
    )
    yield from histogram_figures(analysis)
    yield from _titled(plots, "PDO response")
    left = len({(r.bus, r.node) for r in analysis.responses}) - RESPONSES_APART
    if plots and left > 0:
        told = f"Without a plot here: {counted(left, 'node')} that answer more evenly."
        yield element("p", told, class_="dim")
    for listing in waiting_listings(analysis, moments.clock):
        yield from tables.listed_table(listing)
    yield from timing.ahead_table(analysis, moments)
    yield from timing.delay_table(analysis)
    yield from timing.error_control_table(
        "Heartbeats and guarding",
        analysis.error_control_periods,
        names_of(analysis.nodes),
        hidden,
    )
    yield from timing.worst_table(analysis, moments)


def _titled(plots: Sequence[Plot], *titles: str) -> Iterator[Html]:
    """The plots of some quantities."""
    yield from (plot.html for plot in plots if plot.title in titles)
