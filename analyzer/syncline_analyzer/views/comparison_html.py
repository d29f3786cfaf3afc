"""A comparison as one self-contained page in the style of the report."""

from collections.abc import Iterator
from importlib.resources import files

from syncline_analyzer.comparison.rows import Comparison, ComparisonRow
from syncline_analyzer.views.comparison_words import (
    comparison_verdict,
    empty_sides,
    evidence,
    place,
    side_words,
)
from syncline_analyzer.views.html import Html, element, table
from syncline_analyzer.views.words import Clock, extent_words

_BADGES = {"error": "ERROR", "warning": "WARNING", "info": "NOTE"}
_POLICY = "default-src 'none'; style-src 'unsafe-inline'"


def comparison_page(comparison: Comparison) -> str:
    """The page; it needs no script and no network."""
    verdict = comparison_verdict(comparison)
    worst = comparison.rows[0].severity if comparison.rows else "ok"
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        element("title", verdict),
        element("style", Html(_style())),
    )
    body = element(
        "body",
        element(
            "header",
            element("p", "CANopen captures compared", class_="dim"),
            element("h1", verdict, class_=f"badge-{worst}"),
            *_sides(comparison),
        ),
        element("main", *_sections(comparison)),
        element("footer", element("p", "Made by Syncline from the recorded frames alone.")),
    )
    return "<!DOCTYPE html>\n" + element("html", head, body, lang="en")


def _style() -> str:
    return (files("syncline_analyzer.views") / "report.css").read_text(encoding="utf-8")


def _sides(comparison: Comparison) -> Iterator[Html]:
    for name, capture, heard_s in (
        ("Golden", comparison.golden, comparison.golden_heard_s),
        ("Capture", comparison.capture, comparison.capture_heard_s),
    ):
        clock, when = Clock.of(capture), ""
        if clock.dated and clock.timed and capture.frames:
            when = f", {extent_words(capture, clock)}"
        told = f"{side_words(capture, heard_s)} on {', '.join(capture.buses) or 'no bus'}{when}"
        yield element("p", element("strong", name), f": {told}.")


def _sections(comparison: Comparison) -> Iterator[Html]:
    stories = [element("li", _story(row, comparison)) for row in comparison.rows]
    found = element("ol", *stories, class_="stories")
    why = "Rates, periods, states, errors and settings are those of golden."
    nothing = element("p", "There is nothing to compare." if empty_sides(comparison) else why)
    yield element(
        "section", element("h2", "Differences"), found if stories else nothing, id="differences"
    )
    if comparison.unseen:
        rows = [
            (row.bus or "-", row.node or "-", element("div", row.subject, class_="wrap"),
             row.not_seen_in, row.reason)
            for row in comparison.unseen
        ]  # fmt: skip
        heads = ["Bus", ">Node", "What", "Not seen in", "Why that is no difference"]
        yield element(
            "section",
            element("h2", "Not seen in one of both"),
            table("One capture shows it, the other could not have", heads, rows),
            id="unseen",
        )


def _story(row: ComparisonRow, comparison: Comparison) -> Html:
    proof = "; ".join(evidence(row, comparison)) or "the whole of both"
    terms = (
        ("Golden", row.golden),
        ("Capture", row.capture),
        ("Why it matters", row.why),
        ("Evidence", f"{proof} [{row.kind}]"),
    )
    return element(
        "article",
        element(
            "p",
            element("span", _BADGES[row.severity], class_=f"badge {row.severity}"),
            f" {place(row)}: {row.subject}",
        ),
        element("h3", row.text),
        element("dl", *(part for a, b in terms for part in (element("dt", a), element("dd", b)))),
        class_=f"story {row.severity}",
    )
