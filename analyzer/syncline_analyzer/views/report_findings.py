"""Findings of the report as stories: what happened, what came before and after, what to do."""

from collections.abc import Iterator

from syncline_analyzer.results import Analysis, Finding
from syncline_analyzer.views.html import Html, element, joined
from syncline_analyzer.views.markdown import CHAIN_LINES, where
from syncline_analyzer.views.report_moment import Moments
from syncline_analyzer.views.timeline_svg import node_id, nodes_of
from syncline_analyzer.views.words import names_of
from syncline_schemas.wording import counted

FIRST_STORIES = 6
"""Findings told at once; the rest opens on a click."""
MAX_STORIES = 500
"""Findings that the page tells; `findings.json` holds all."""
FEW = 3
"""With more findings than these there is a filter."""

BADGES = {"error": "ERROR", "warning": "WARNING", "info": "NOTE"}
_BOXES = {"error": "Errors", "warning": "Warnings", "info": "Notes"}
_EVIDENCE = 8

Labels = dict[tuple[str, int], str]


def findings_part(analysis: Analysis, moments: Moments) -> Iterator[Html]:
    """All findings, the worst first, behind a filter where they are many."""
    found = analysis.findings
    if not found:
        yield element("p", "No rule found anything wrong in what was recorded.")
        return
    labels = names_of(analysis.nodes)
    if len(found) > FEW:
        yield _filter(found, labels)
    stories = [
        _story(number, finding, labels, moments)
        for number, finding in enumerate(found[:MAX_STORIES], 1)
    ]
    yield element("ol", *stories[:FIRST_STORIES], class_="stories")
    if rest := stories[FIRST_STORIES:]:
        listed = element("ol", *rest, class_="stories", start=FIRST_STORIES + 1)
        told = element("summary", counted(len(rest), "more finding"))
        yield element("details", told, listed, class_="rest")
    if left := len(found) - len(stories):
        yield element("p", f"{counted(left, 'more finding')} only in findings.json.", class_="dim")


def _filter(found: list[Finding], labels: Labels) -> Html:
    """Search, severities and node; the script shows it, since without one it does nothing."""
    boxes = []
    for severity, name in _BOXES.items():
        count = sum(row.severity == severity for row in found)
        if count:
            box = element("input", type="checkbox", name="severity", value=severity, checked=True)
            boxes.append(element("label", box, f" {name} ({count})"))
    named = dict.fromkeys(
        (row.bus, row.node) for row in found if row.bus is not None and row.node is not None
    )
    options = [element("option", "all nodes", value="")]
    for bus, node in sorted(named):
        label = f"{labels.get((bus, node), node)} on {bus}"
        options.append(element("option", label, value=node_id(bus, node)))
    search = element("input", type="search", name="words", autocomplete="off")
    return element(
        "form",
        element("label", "Search ", search),
        element("fieldset", element("legend", "Severity"), *boxes),
        element("label", "Node ", element("select", *options, name="node")),
        element("output", aria_live="polite"),
        class_="filter",
        role="search",
        aria_label="Filter the findings",
        hidden=True,
    )


def _story(number: int, finding: Finding, labels: Labels, moments: Moments) -> Html:
    identity = f"finding-{number}"
    badge = element("span", BADGES[finding.severity], class_=f"badge {finding.severity}")
    when = [element("p", moments.finding(finding))] if moments.clock.timed else []
    place = _place(finding, labels)
    story = element(
        "article",
        element("p", element("b", str(number)), " ", badge, " ", place),
        *when,
        element("h3", finding.text, id=f"{identity}-text"),
        *_chain(finding, moments),
        element("dl", *_details(finding)),
        class_=f"story {finding.severity}",
        aria_labelledby=f"{identity}-text",
    )
    return element(
        "li",
        story,
        id=identity,
        data_severity=finding.severity,
        data_nodes=" ".join(node_id(bus, node) for bus, node in nodes_of(finding)),
    )


def _details(finding: Finding) -> Iterator[Html]:
    evidence = ", ".join(map(str, finding.evidence[:_EVIDENCE])) or "-"
    if len(finding.evidence) > _EVIDENCE:
        evidence += ", ..."
    frames = "frame" if len(finding.evidence) == 1 else "frames"
    yield from _term("Likely cause", finding.cause)
    yield from _term("Check next", finding.check_next)
    if finding.assumed:
        yield from _term("Assumed", "; ".join(finding.assumed))
    proof = joined([f"{frames} {evidence} ", element("code", finding.id)])
    yield from _term("Evidence", proof)


def _term(term: str, told: object) -> Iterator[Html]:
    yield element("dt", term)
    yield element("dd", told)


def _chain(finding: Finding, moments: Moments) -> Iterator[Html]:
    """The other pieces of the story, in order of time."""
    if not finding.chain:
        return
    lines = []
    for link in finding.chain[:CHAIN_LINES]:
        before = moments.clock.timed and link.start_ns < finding.start_ns
        label = element("span", "before it " if before else "followed by ", class_="dim")
        when = [moments.when(link.start_ns), ": "] if moments.clock.timed else []
        lines.append(element("li", label, *when, link.text))
    if (rest := len(finding.chain) - CHAIN_LINES) and rest > 0:
        lines.append(element("li", f"and {rest} more"))
    yield element("ol", *lines, class_="chain", aria_label="Before and after")


def _place(finding: Finding, labels: Labels) -> Html | str:
    text = where(finding, labels)
    if (finding.bus or "", finding.node or 0) not in labels:
        return text
    return element("a", text, href=f"#{node_id(finding.bus or '', finding.node or 0)}")
