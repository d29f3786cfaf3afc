"""`report.html`: one file that opens anywhere, without a network, and says first what went wrong."""

from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

from plotly.offline import get_plotlyjs

from syncline_analyzer.results import Analysis, Finding, NodeRow
from syncline_analyzer.views import report_tables as tables
from syncline_analyzer.views import report_timing as timing
from syncline_analyzer.views.basis import basis_lines
from syncline_analyzer.views.histogram_svg import histogram_figures
from syncline_analyzer.views.html import Html, data_script, element, joined, table
from syncline_analyzer.views.known import KnownLine, device_line, device_words, known_lines
from syncline_analyzer.views.load import load_listing
from syncline_analyzer.views.markdown import chain_lines, extent, verdict, where
from syncline_analyzer.views.palette import (
    EMCY_CLEAR_COLOUR,
    EMCY_COLOUR,
    GAP_COLOUR,
    SEVERITY_COLOURS,
    STATE_COLOURS,
    css,
)
from syncline_analyzer.views.plots import RESPONSES_APART
from syncline_analyzer.views.report_plots import plots_of
from syncline_analyzer.views.services import change_listing, error_list, listings
from syncline_analyzer.views.text import recording_lines
from syncline_analyzer.views.timeline_svg import node_id, timeline
from syncline_analyzer.views.traces import COMPARED, trace_listings, trace_notes
from syncline_analyzer.views.waits import waiting_listings
from syncline_analyzer.views.words import (
    Clock,
    names_of,
    node_label,
    number,
)
from syncline_schemas.wording import counted

FIRST_STORIES = 6
"""Findings told at once; the rest opens on a click."""

OPEN_COMMANDS = 12
"""NMT commands shown at once; more open on a click."""

_OF_A_NODE = ("Bus", "Node")

_BADGES = {"error": "ERROR", "warning": "WARNING", "info": "NOTE"}
_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data: blob:"
)


def write_report(analysis: Analysis, path: Path) -> Path:
    """Write the report of an analysis, and return the file."""
    path.write_text(report(analysis), encoding="utf-8")
    return path


def report(analysis: Analysis) -> str:
    """The page."""
    clock, plots = Clock.of(analysis.capture), plots_of(analysis)
    title = ", ".join(Path(file).name for file in analysis.capture.files)
    body = element(
        "body",
        element("a", "Skip to the findings", href="#findings", class_="skip"),
        _header(analysis, clock, title),
        element("main", *_sections(analysis, clock, plots)),
        element("footer", element("p", "Made by Syncline from the recorded frames alone.")),
        *_scripts(analysis, clock, plots),
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        element("title", f"{title}: {verdict(analysis)}"),
        element("style", Html(_asset("report.css") + _colours())),
    )
    return "<!DOCTYPE html>\n" + element("html", head, body, lang="en")


def _asset(name: str) -> str:
    return (files("syncline_analyzer.views") / name).read_text(encoding="utf-8")


def _colours() -> str:
    named = {f"s-{state.lower()}": colour for state, colour in STATE_COLOURS.items()}
    named |= {f"s-{severity}": colour for severity, colour in SEVERITY_COLOURS.items()}
    named |= {"s-blind": GAP_COLOUR}
    bars = "".join(
        f".{name} rect{{fill:{css(c)};stroke:{css(c)}}}i.{name},.share .{name}{{background:{css(c)}}}"
        for name, c in named.items()
    )
    marks = {"m-emcy": EMCY_COLOUR, "m-clear": EMCY_CLEAR_COLOUR}
    return bars + "".join(
        f".{name}{{stroke:{css(c)}}}i.{name}{{background:{css(c)}}}" for name, c in marks.items()
    )


def _scripts(analysis: Analysis, clock: Clock, plots: list[dict[str, Any]]) -> Iterator[Html]:
    capture = analysis.capture
    dated = clock.dated and clock.timed
    yield data_script(
        "report-data",
        {
            "begin": (capture.begin_ns - clock.first_ns) / 1e9,
            "seconds": max(capture.duration_ns, 1) / 1e9,
            "start_ms": clock.first_ns / 1e6 if dated else None,
            "plots": plots,
        },
    )
    if plots:
        yield element("script", Html(get_plotlyjs()))
    yield element("script", Html(_asset("report.js")))


def _header(analysis: Analysis, clock: Clock, title: str) -> Html:
    links = [("findings", "Findings"), ("timeline", "Timeline"), ("plots", "Measured values")]
    links += [("pdos", "Bus load, SYNC and PDOs"), ("nodes", "Nodes"), ("recording", "Recording")]
    items = (element("li", element("a", text, href=f"#{name}")) for name, text in links)
    worst = next((f.severity for s in _BADGES for f in analysis.findings if f.severity == s), "ok")
    times = None
    if clock.dated and clock.timed:
        begin, end = analysis.capture.begin_ns, analysis.capture.end_ns
        times = element("p", f"{clock.full(begin)} to {clock.full(end)}", class_="dim")
    elif not clock.timed and analysis.capture.frames:
        times = element("p", "The log has no times.", class_="dim")
    return element(
        "header",
        element("p", f"CANopen capture {title}", class_="dim"),
        element("h1", verdict(analysis), class_=f"badge-{worst}"),
        element("p", extent(analysis)),
        *(
            element("p", f"Damaged, read in part: {d}", class_="badge error")
            for d in analysis.capture.damage
        ),
        times,
        element("nav", element("ul", *items), aria_label="Sections"),
    )


def _sections(analysis: Analysis, clock: Clock, plots: list[dict[str, Any]]) -> Iterator[Html]:
    yield _section("findings", "Findings", *_stories(analysis, clock))
    if clock.timed and analysis.nmt_states:
        lanes = timeline(analysis)
        yield _section("timeline", "Timeline", _controls(), lanes, *_commands(analysis, clock))
    else:
        yield _section("timeline", "Timeline", element("p", "There is nothing to draw over time."))
    traces = [plot for plot in plots if plot["group"] == "traces"]
    shafts = [each for each in trace_listings(analysis, clock) if each.title in COMPARED]
    compared = [part for each in shafts for part in tables.listed_table(each)]
    yield _section("plots", "Measured values", *compared, *_figures(traces))
    about = [plot for plot in plots if plot["group"] == "timing"]
    yield _section("pdos", "Bus load, SYNC and PDOs", *_timing(analysis, clock, about))
    yield _section("nodes", "Nodes", *_nodes(analysis, clock))
    yield _section("recording", "Recording", *_recording(analysis, clock))


def _section(identity: str, title: str, *children: object) -> Html:
    heading = element("h2", title, id=f"{identity}-title")
    return element("section", heading, *children, id=identity, aria_labelledby=f"{identity}-title")


def _commands(analysis: Analysis, clock: Clock) -> Iterator[Html]:
    count = len(analysis.nmt_commands)
    if count:
        rows = tables.command_table(analysis.nmt_commands, names_of(analysis.nodes), clock)
        told = element("summary", f"{count} NMT command{'s'[: count != 1]}")
        yield element("details", told, *rows, open=count <= OPEN_COMMANDS)


def _controls() -> Html:
    moves = {
        "all": "Whole capture",
        "in": "Zoom in",
        "out": "Zoom out",
        "back": "Earlier",
        "on": "Later",
    }
    buttons = (
        element("button", text, type="button", data_zoom=name) for name, text in moves.items()
    )
    return element("div", *buttons, class_="controls", role="group", aria_label="Time range")


def _stories(analysis: Analysis, clock: Clock) -> Iterator[Html]:
    if not analysis.findings:
        yield element("p", "No rule found anything wrong in what was recorded.")
        return
    labels = names_of(analysis.nodes)
    stories = [element("li", _story(finding, labels, clock)) for finding in analysis.findings]
    yield element("ol", *stories[:FIRST_STORIES], class_="stories")
    if rest := stories[FIRST_STORIES:]:
        listed = element("ol", *rest, class_="stories", start=FIRST_STORIES + 1)
        told = element("summary", f"{len(rest)} more finding{'s'[: len(rest) != 1]}")
        yield element("details", told, listed, class_="rest")


def _story(finding: Finding, labels: dict[tuple[str, int], str], clock: Clock) -> Html:
    badge = element("span", _BADGES[finding.severity], class_=f"badge {finding.severity}")
    when: list[Html | str] = []
    if clock.timed:
        link = element(
            "a",
            clock.stretch(finding.start_ns, finding.end_ns),
            href="#timeline",
            title=f"{clock.full(finding.start_ns)}: show in the timeline",
            data_from=f"{(finding.start_ns - clock.first_ns) / 1e9:.9g}",
            data_to=f"{(finding.end_ns - clock.first_ns) / 1e9:.9g}",
        )
        when = [", ", link]
    evidence = ", ".join(map(str, finding.evidence[:8])) or "-"
    return element(
        "article",
        element("p", badge, " ", _place(finding, labels), *when),
        element("h3", finding.text),
        *_chain(finding, clock),
        element(
            "dl",
            *_terms(("Likely cause", finding.cause), ("Check next", finding.check_next)),
            *(_terms(("Assumed", "; ".join(finding.assumed))) if finding.assumed else ()),
            *_terms(("Evidence", joined(["frames ", evidence, " ", element("code", finding.id)]))),
        ),
        class_=f"story {finding.severity}",
    )


def _chain(finding: Finding, clock: Clock) -> Iterator[Html]:
    """The other pieces of the story, in order of time."""
    if finding.chain:
        lines = (
            element("li", element("span", f"{line.label} ", class_="dim"), line.text)
            for line in chain_lines(finding, clock)
        )
        yield element("ol", *lines, class_="chain", aria_label="Before and after")


def _place(finding: Finding, labels: dict[tuple[str, int], str]) -> Html | str:
    text = where(finding, labels)
    if (finding.bus or "", finding.node or 0) not in labels:
        return text
    return element("a", text, href=f"#{node_id(finding.bus or '', finding.node or 0)}")


def _terms(*pairs: tuple[str, object]) -> Iterator[Html]:
    for term, told in pairs:
        yield element("dt", term)
        yield element("dd", told)


def _nodes(analysis: Analysis, clock: Clock) -> Iterator[Html]:
    if not analysis.nodes:
        yield element("p", "No frame proves a CANopen node; this may be a bus of another protocol.")
        return
    heads = ["Bus", "Node", "Device", ">Boot-ups", ">Heartbeats", ">Period", ">Guarded", ">EMCY", ">SDO", ">PDO frames", "Last state"]  # fmt: skip
    rows = (
        (
            row.bus,
            element("a", node_label(row.node, row.name), href=f"#{node_id(row.bus, row.node)}"),
            device_words(row),
            row.boot_ups,
            row.heartbeats,
            number(row.heartbeat_period_ms, "ms"),
            row.guard_answers,
            row.emcy,
            row.sdo_transfers,
            row.pdo_frames,
            row.final_state,
        )
        for row in analysis.nodes
    )
    yield table("Nodes on the bus", heads, rows)
    known = known_lines(analysis)
    for row in analysis.nodes:
        own = [line for line in known if (line.bus, line.node) == (row.bus, row.node)]
        yield _node(row, analysis, own, clock)


def _node(node: NodeRow, analysis: Analysis, known: list[KnownLine], clock: Clock) -> Html:
    def own(row: object) -> bool:
        return (getattr(row, "bus", None), getattr(row, "node", None)) == (node.bus, node.node)

    pdos = [row for row in analysis.pdos if own(row)]
    contexts = {row.seq: row for row in analysis.emcy_context if own(row)}
    read = [row for row in analysis.error_history if own(row)]
    history = error_list(analysis, read, clock, named=False)
    troubled = any(own(row) for row in (*analysis.findings, *analysis.emcy, *analysis.errors))
    label = f"Node {node_label(node.node, node.name)} on {node.bus}"
    return element(
        "details",
        element(
            "summary", f"{label}: {node.device or 'device not known'}, last {node.final_state}"
        ),
        _identity(node),
        *tables.error_table([row for row in analysis.errors if own(row)], clock),
        *tables.emcy_table([row for row in analysis.emcy if own(row)], contexts, clock),
        *(tables.listed_table(history) if history else ()),
        *timing.pdo_table("PDOs", pdos, analysis.lateness, _OF_A_NODE),
        *timing.response_table("Answers to SYNC", pdos, _OF_A_NODE),
        *timing.error_control_table(
            "Heartbeat and guarding",
            [row for row in analysis.error_control_periods if own(row)],
            names_of(analysis.nodes),
            _OF_A_NODE,
        ),
        *tables.sdo_table(analysis.sdo.failed.of_node(node.bus, node.node), clock),
        *_measured(node, analysis, clock),
        *tables.state_table([row for row in analysis.nmt_states if own(row)], clock),
        *tables.known_table([line for line in known if line.what != "device"]),
        id=node_id(node.bus, node.node),
        open=troubled,
    )


def _measured(node: NodeRow, analysis: Analysis, clock: Clock) -> Iterator[Html]:
    """Traces of a node with what they rest on, its health and what was changed in it."""
    key = node.bus, node.node
    for listing in trace_listings(analysis, clock, key):
        yield from tables.listed_table(listing)
        if listing.title == "Traces":
            rows = [row for row in analysis.traces if (row.bus, row.node) == key]
            if notes := trace_notes(rows):
                yield element("ul", *(element("li", note) for note in notes), class_="dim")
    changes = [row for row in analysis.object_changes if (row.bus, row.node) == key]
    if changes:
        yield from tables.listed_table(change_listing(changes, clock, named=False))


def _identity(node: NodeRow) -> Html:
    shares = [(state, share) for state, share in node.state_share.items() if share > 0]
    bar = (
        element("div", class_=f"s-{state.lower()}", style=f"width:{share * 100:.4g}%", title=state)
        for state, share in shares
    )
    told = ", ".join(f"{state} {share:.2%}" for state, share in shares) or "no state known"
    device = device_line(node)
    return joined(
        [
            element("p", f"Device: {device}.") if device else None,
            element("p", f"Known by {', '.join(node.proof) or 'nothing'}. {told}."),
            element("div", *bar, class_="share", role="img", aria_label=told),
        ]
    )


def _timing(analysis: Analysis, clock: Clock, plots: list[dict[str, Any]]) -> Iterator[Html]:
    yield element("ul", *(element("li", line) for line in basis_lines(analysis)))
    if analysis.bus_load:
        yield from tables.listed_table(load_listing(analysis, clock))
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
    for listing in waiting_listings(analysis, clock):
        yield from tables.listed_table(listing)
    yield from timing.ahead_table(analysis, clock)
    yield from timing.delay_table(analysis)
    yield from timing.error_control_table(
        "Heartbeats and guarding",
        analysis.error_control_periods,
        names_of(analysis.nodes),
        hidden,
    )
    yield from timing.worst_table(analysis, clock)


def _titled(plots: list[dict[str, Any]], *titles: str) -> Iterator[Html]:
    """The plots of some quantities."""
    if wanted := [plot for plot in plots if plot["title"].startswith(titles)]:
        yield from _figures(wanted)


def _figures(plots: list[dict[str, Any]]) -> Iterator[Html]:
    if not plots:
        yield element("p", "No PDO or SDO of a known device carries a value to plot.")
    for plot in plots:
        caption = plot["title"]
        lines = ", ".join(plot["lines"])
        drawing = element(
            "div", id=plot["id"], class_="plot", role="img", aria_label=f"{caption}: {lines}"
        )
        yield element("figure", element("figcaption", caption), drawing)


def _recording(analysis: Analysis, clock: Clock) -> Iterator[Html]:
    capture = analysis.capture
    yield element("ul", *(element("li", line) for line in recording_lines(analysis, clock)))
    for listing in listings(analysis, clock):
        yield from tables.listed_table(listing)
    yield element("p", "Files: ", ", ".join(capture.files))
