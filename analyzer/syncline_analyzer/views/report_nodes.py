"""Nodes of the report: one table of all, and a part for each with everything that is known of it."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.results import Analysis, NodeRow
from syncline_analyzer.views import report_tables as tables
from syncline_analyzer.views import report_timing as timing
from syncline_analyzer.views.html import Html, element, joined, table
from syncline_analyzer.views.known import KnownLine, device_line, device_words, known_lines
from syncline_analyzer.views.lanes import Lanes, lanes_of
from syncline_analyzer.views.report_moment import Moments
from syncline_analyzer.views.report_plots import Plot
from syncline_analyzer.views.services import change_listing, error_list
from syncline_analyzer.views.sparkline_svg import sparklines
from syncline_analyzer.views.timeline_svg import node_id, node_lane
from syncline_analyzer.views.traces import trace_listings, trace_notes
from syncline_analyzer.views.words import names_of, node_label, number
from syncline_schemas.wording import counted

OPEN_NODES = 3
"""Nodes with errors whose parts are open; the others open on a click or a link."""

_OF_A_NODE = ("Bus", "Node")
_WORDS = {"error": "error", "warning": "warning", "info": "note"}


def nodes_part(analysis: Analysis, moments: Moments, plots: Sequence[Plot]) -> Iterator[Html]:
    """The table of all nodes, then their parts."""
    if not analysis.nodes:
        yield element(
            "p",
            "No frame proves a CANopen node; this may be a bus of another protocol."
            if analysis.capture.frames
            else "There are no frames in it.",
        )
        return
    yield _overview(analysis)
    known, lanes = known_lines(analysis), lanes_of(analysis)
    errors = {(f.bus, f.node): None for f in analysis.findings if f.severity == "error"}
    opened = [*errors][:OPEN_NODES]
    for row in analysis.nodes:
        own = [line for line in known if (line.bus, line.node) == (row.bus, row.node)]
        yield _node(row, analysis, own, lanes, moments, plots, (row.bus, row.node) in opened)


def _overview(analysis: Analysis) -> Html:
    heads = ["Bus", "Node", "Findings", "Last state", "Time in each state", "Device", ">Boot-ups", ">Heartbeats", ">Period", ">Guarded", ">EMCY", ">SDO", ">PDO frames"]  # fmt: skip
    rows = (
        (
            row.bus,
            element("a", node_label(row.node, row.name), href=f"#{node_id(row.bus, row.node)}"),
            _found(analysis, row),
            row.final_state,
            _share_bar(row),
            device_words(row),
            row.boot_ups,
            row.heartbeats,
            number(row.heartbeat_period_ms, "ms"),
            row.guard_answers,
            row.emcy,
            row.sdo_transfers,
            row.pdo_frames,
        )
        for row in analysis.nodes
    )
    skipped = 0 if len(analysis.capture.buses) > 1 else 1
    return table("Nodes on the bus", heads[skipped:], (row[skipped:] for row in rows))


def _found(analysis: Analysis, node: NodeRow) -> Html:
    """Numbers of the findings about a node, as links."""
    links = []
    for number_, row in enumerate(analysis.findings, 1):
        if (row.bus, row.node) == (node.bus, node.node):
            label = f"{_WORDS[row.severity]} {number_}"
            link = element("a", label, href=f"#finding-{number_}", class_=f"badge {row.severity}")
            links.append(link)
    if len(links) > 3:
        more = f" and {len(links) - 3} more"
        return joined([*_spaced(links[:3]), more])
    return joined(_spaced(links)) if links else Html("-")


def _spaced(links: list[Html]) -> Iterator[Html]:
    for i, link in enumerate(links):
        yield Html(", ") if i else Html("")
        yield link


def _node(
    node: NodeRow,
    analysis: Analysis,
    known: list[KnownLine],
    lanes: Lanes,
    moments: Moments,
    plots: Sequence[Plot],
    is_open: bool,
) -> Html:
    def own(row: object) -> bool:
        return (getattr(row, "bus", None), getattr(row, "node", None)) == (node.bus, node.node)

    clock = moments.clock
    pdos = [row for row in analysis.pdos if own(row)]
    contexts = {row.seq: row for row in analysis.emcy_context if own(row)}
    read = [row for row in analysis.error_history if own(row)]
    history = error_list(analysis, read, clock, named=False)
    name = element("h3", f"Node {node_label(node.node, node.name)} on {node.bus}")
    return element(
        "details",
        element("summary", name, element("span", _in_short(node, analysis), class_="dim")),
        _identity(node, analysis),
        *node_lane(lanes.get((node.bus, node.node), []), analysis, moments),
        *tables.error_table([row for row in analysis.errors if own(row)], moments),
        *tables.emcy_table([row for row in analysis.emcy if own(row)], contexts, moments),
        *(tables.listed_table(history) if history else ()),
        *timing.pdo_table(
            "PDOs",
            pdos,
            analysis.lateness,
            _OF_A_NODE,
            lambda row: sparklines(row, analysis, moments),
        ),
        *timing.response_table("Answers to SYNC", pdos, _OF_A_NODE),
        *_changes(node, analysis, moments),
        *timing.error_control_table(
            "Heartbeat and guarding",
            [row for row in analysis.error_control_periods if own(row)],
            names_of(analysis.nodes),
            _OF_A_NODE,
        ),
        *tables.sdo_table(analysis.sdo.failed.of_node(node.bus, node.node), moments),
        *_drawn(node, plots),
        *_measured(node, analysis, moments),
        *tables.state_table([row for row in analysis.nmt_states if own(row)], moments),
        *tables.known_table([line for line in known if line.what != "device"]),
        id=node_id(node.bus, node.node),
        class_="node",
        open=is_open,
    )


def _in_short(node: NodeRow, analysis: Analysis) -> str:
    told = [node.device or "device not known", f"last {node.final_state}"]
    for severity, word in _WORDS.items():
        count = sum(
            (row.bus, row.node, row.severity) == (node.bus, node.node, severity)
            for row in analysis.findings
        )
        told += [counted(count, word)] if count else []
    return ", ".join(told)


def _measured(node: NodeRow, analysis: Analysis, moments: Moments) -> Iterator[Html]:
    """Traces of a node with what they rest on, and its health."""
    key = node.bus, node.node
    for listing in trace_listings(analysis, moments.clock, key):
        yield from tables.listed_table(listing)
        if listing.title == "Traces":
            rows = [row for row in analysis.traces if (row.bus, row.node) == key]
            if notes := trace_notes(rows):
                yield element("ul", *(element("li", note) for note in notes), class_="dim")


def _drawn(node: NodeRow, plots: Sequence[Plot]) -> Iterator[Html]:
    """Links to the plots that show a node."""
    own = [plot for plot in plots if (node.bus, node.node) in plot.nodes]
    if own:
        links = [element("a", plot.title, href=f"#{plot.identity}") for plot in own]
        yield element("p", "Plots: ", joined(_spaced(links)))


def _changes(node: NodeRow, analysis: Analysis, moments: Moments) -> Iterator[Html]:
    """What was changed in a node."""
    key = node.bus, node.node
    if changes := [row for row in analysis.object_changes if (row.bus, row.node) == key]:
        yield from tables.listed_table(change_listing(changes, moments.clock, named=False))


def _identity(node: NodeRow, analysis: Analysis) -> Html:
    device = device_line(node)
    found = _found(analysis, node)
    return joined(
        [
            element("p", f"Device: {device}.") if device else None,
            element("p", "Findings: ", found) if found != "-" else None,
            element("p", f"Known by {', '.join(node.proof) or 'nothing'}. {_shares(node)}."),
        ]
    )


def _shares(node: NodeRow) -> str:
    shares = [(state, share) for state, share in node.state_share.items() if share > 0]
    return ", ".join(f"{state} {_percent(share)}" for state, share in shares) or "no state known"


def _percent(share: float) -> str:
    """A share; one that is not nothing never reads so.

    >>> _percent(0.94), _percent(0.00001)
    ('94.00 %', '< 0.01 %')
    """
    return f"{100 * share:.2f} %" if share >= 0.0001 else "< 0.01 %"


def _share_bar(node: NodeRow) -> Html:
    bar = (
        element("i", class_=f"s-{state.lower()}", style=f"width:{share * 100:.4g}%", title=state)
        for state, share in node.state_share.items()
        if share > 0
    )
    return element("div", *bar, class_="share", role="img", aria_label=_shares(node))
