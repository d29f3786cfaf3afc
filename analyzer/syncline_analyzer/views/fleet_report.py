"""The report of a fleet: one page that opens anywhere, and says first which machines need help."""

from collections.abc import Iterable, Sequence
from importlib.resources import files

from syncline_analyzer.fleet.captures import HEALTHY
from syncline_analyzer.fleet.layout import UNDATED
from syncline_analyzer.fleet.overview import NO_CAPTURE, Overview
from syncline_analyzer.fleet.trend_lines import TrendLine
from syncline_analyzer.views.fleet_links import Links, many
from syncline_analyzer.views.fleet_machines import cards_of, kinds_part, machines_part
from syncline_analyzer.views.fleet_map import Anchors, map_part
from syncline_analyzer.views.fleet_tables import devices_part, failures_part, recording_part
from syncline_analyzer.views.fleet_trends import trends_of_machines, trends_part
from syncline_analyzer.views.html import Html, element
from syncline_analyzer.views.report_findings import BADGES
from syncline_analyzer.views.report_html import POLICY
from syncline_analyzer.views.words import duration

_SECTIONS = {
    "map": "Map",
    "machines": "Machines in trouble",
    "trends": "Trends",
    "findings": "Findings",
    "devices": "Devices and firmware",
    "recording": "Recording",
    "failures": "Failures",
}


def fleet_page(
    found: Overview, trends: Sequence[TrendLine], links: Links, title: str, scope: str = ""
) -> str:
    """The page.

    Args:
        trends: the gravest first.
        links: to the captures' reports.
        title: where the data set is.
        scope: in words which part of it this is, "" for all.
    """
    cards = cards_of(found)
    parts: dict[str, Iterable[Html]] = {
        "map": map_part(found, links, Anchors(cards, trends_of_machines(trends))),
        "machines": machines_part(found, links, cards),
        "trends": trends_part(trends, links),
        "findings": kinds_part(found, links),
        "devices": devices_part(found),
        "recording": recording_part(found),
        "failures": failures_part(found),
    }
    body = element(
        "body",
        element("a", "Skip to the map", href="#map", class_="skip"),
        _header(found, trends, title, scope),
        _bar(),
        element("main", *(_section(name, part) for name, part in parts.items())),
        element("footer", element("p", "Made by Syncline from the recorded frames alone.")),
        element("script", Html(_asset("fleet_report.js"))),
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", http_equiv="Content-Security-Policy", content=POLICY),
        element("title", f"Fleet: {fleet_verdict(found, len(trends))}"),
        element("style", Html(_asset("report.css") + _asset("fleet_report.css"))),
    )
    return "<!DOCTYPE html>\n" + element("html", head, body, lang="en")


def fleet_verdict(found: Overview, trends: int) -> str:
    """One sentence: how many machines are in trouble, and that something becomes different."""
    return _verdict(found) + (f"; {many(trends, 'trend')}" if trends else "")


def _verdict(found: Overview) -> str:
    machines = [each for each in found.machines if each.verdict]
    if not machines:
        return "No capture was analyzed"
    counts = {
        verdict: sum(each.verdict == verdict for each in machines)
        for verdict in ("error", "warning", HEALTHY)
    }
    fleet = many(len(machines), "machine")
    if counts[HEALTHY] == len(machines):
        return f"{fleet} healthy" if len(machines) == 1 else f"All {fleet} healthy"
    told = [f"{counts[name]:,} of {fleet} with {name}s" for name in ("error",) if counts[name]]
    if counts["warning"]:
        told.append(f"{counts['warning']:,}{'' if told else f' of {fleet}'} with warnings")
    if counts[HEALTHY]:
        told.append(f"{counts[HEALTHY]:,} healthy")
    return ", ".join(told)


def _header(found: Overview, trends: Sequence[TrendLine], title: str, scope: str) -> Html:
    known = {machine.verdict for machine in found.machines if machine.verdict}
    severities = known | {trend.finding.severity for trend in trends}
    worst = next((each for each in BADGES if each in severities), "ok")
    now = {
        severity: sum(
            each.latest is not None and each.latest.verdict == severity for each in found.machines
        )
        for severity in ("error", "warning")
    }
    told = " and ".join(
        f"{many(count, 'machine')} with {severity}s" for severity, count in now.items() if count
    )
    failed = sum(each.kind != NO_CAPTURE for each in found.failures)
    return element(
        "header",
        element("p", f"CANopen fleet {title}{scope}", class_="dim"),
        element("h1", fleet_verdict(found, len(trends)), class_=f"verdict {worst}"),
        element("p", f"By their latest captures: {told or 'none in trouble'}.") if known else None,
        element("p", _extent(found)),
        element(
            "p",
            element("a", f"{many(failed, 'recording')} could not be analyzed", href="#failures"),
            class_="badge error",
        )
        if failed
        else None,
    )


def _extent(found: Overview) -> str:
    captures = list(found.captures)
    machines = many(sum(bool(each.captures) for each in found.machines), "machine")
    days = sorted({each.date for each in captures} - {UNDATED})
    span = f", {days[0]} to {days[-1]}" if days else ""
    recorded_ns = sum(each.duration_ns for each in captures)
    return f"{many(len(captures), 'capture')} of {machines}{span}, {duration(recorded_ns)} in all."


def _bar() -> Html:
    items = (element("li", element("a", text, href=f"#{name}")) for name, text in _SECTIONS.items())
    everything = element(
        "button", "Open all tables", type="button", id="everything", aria_pressed="false"
    )
    nav = element("nav", element("ul", *items), everything, aria_label="Sections")
    return element("div", nav, class_="top")


def _section(identity: str, children: Iterable[Html]) -> Html:
    heading = element("h2", _SECTIONS[identity], id=f"{identity}-title")
    return element("section", heading, *children, id=identity, aria_labelledby=f"{identity}-title")


def _asset(name: str) -> str:
    return (files("syncline_analyzer.views") / name).read_text(encoding="utf-8")
