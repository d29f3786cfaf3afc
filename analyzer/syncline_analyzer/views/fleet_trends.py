"""Trends in the fleet's report: a card each, with the values that it was judged from."""

from collections.abc import Iterator, Sequence

import numpy as np

from syncline_analyzer.fleet.trend_lines import TrendLine
from syncline_analyzer.fleet.trends.wording import WORDS
from syncline_analyzer.views.fleet_links import Links, day, many
from syncline_analyzer.views.html import Html, element, joined
from syncline_analyzer.views.report_findings import BADGES
from syncline_analyzer.views.words import number

FIRST_TRENDS = 6
MAX_TRENDS = 100
_ENDS = ("first", "last before", "first after", "last")
"""What the captures are that prove a trend of a machine."""
_WIDE, _HIGH, _MARGIN = 300, 60, 4


def trends_part(trends: Sequence[TrendLine], links: Links) -> Iterator[Html]:
    """All trends, the gravest first."""
    if not trends:
        told = "Nothing drifts, steps or comes more often: or there are too few captures to tell."
        yield element("p", told)
        return
    cards = [_card(trend, links, n) for n, trend in enumerate(trends[:MAX_TRENDS], 1)]
    yield element("ol", *cards[:FIRST_TRENDS], class_="stories")
    if rest := cards[FIRST_TRENDS:]:
        listed = element("ol", *rest, class_="stories", start=FIRST_TRENDS + 1)
        summary = element("summary", many(len(rest), "more trend"))
        yield element("details", summary, listed, class_="rest")
    if left := len(trends) - len(cards):
        yield element("p", f"{many(left, 'more trend')} left out here.", class_="dim")


def trends_of_machines(trends: Sequence[TrendLine]) -> dict[str, str]:
    """By machine, where the page tells of its first trend; those of the fleet are of none."""
    found: dict[str, str] = {}
    for place, trend in enumerate(trends[:MAX_TRENDS], 1):
        if trend.finding.machine is not None:
            found.setdefault(trend.finding.machine, f"trend-{place}")
    return found


def _card(trend: TrendLine, links: Links, place: int) -> Html:
    finding, identity = trend.finding, f"trend-{place}"
    terms = [("Likely cause", finding.cause), ("Check next", finding.check_next)]
    if finding.assumed:
        terms.append(("Assumed", "; ".join(finding.assumed)))
    names = _ENDS if finding.machine and len(finding.evidence) == len(_ENDS) else finding.evidence
    evidence = map(links.link, names, finding.evidence)
    proof = joined(part for each in evidence for part in (each, ", "))
    article = element(
        "article",
        element(
            "p",
            element("span", BADGES[finding.severity], class_=f"badge {finding.severity}"),
            f" {finding.machine or many(finding.machines, 'machine')}, from {day(finding.onset_ns)} on ",
            element("code", finding.id),
        ),
        element("h3", finding.text, id=f"{identity}-text"),
        _drawing(trend),
        element(
            "dl",
            *(part for a, b in terms for part in (element("dt", a), element("dd", b))),
            element("dt", "Captures"),
            element("dd", proof, f"of {many(finding.captures, 'capture')}"),
        ),
        class_=f"story {finding.severity}",
        aria_labelledby=f"{identity}-text",
    )
    return element("li", article, id=identity)


def _drawing(trend: TrendLine) -> Html | None:
    """Values as points over time, joined, with a line where it began."""
    known = np.flatnonzero(np.isfinite(trend.value))
    if len(known) < 2:
        return None
    value, t_ns = trend.value[known], trend.t_ns[known]
    low, high = float(value.min()), float(value.max())
    begin_ns, span_ns = int(t_ns[0]), max(int(t_ns[-1] - t_ns[0]), 1)
    x = _MARGIN + (t_ns - begin_ns) / span_ns * (_WIDE - 2 * _MARGIN)
    y = _MARGIN + (high - value) / ((high - low) or 1.0) * (_HIGH - 2 * _MARGIN)
    pairs = [f"{a:.1f} {b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    onset = _MARGIN + (trend.finding.onset_ns - begin_ns) / span_ns * (_WIDE - 2 * _MARGIN)
    unit = trend.finding.unit
    told = f"{number(low)} to {number(high, unit)}" if high > low else number(low, unit)
    quantity = WORDS.get(trend.finding.quantity, trend.finding.quantity)
    words = (
        f"{quantity[:1].upper()}{quantity[1:]} {told}, {day(begin_ns)} to {day(int(t_ns[-1]))};"
        f" dashed: {day(trend.finding.onset_ns)}"
    )
    drawing = element(
        "svg",
        element("title", words),
        element("path", d=f"M{onset:.1f} 0V{_HIGH}", class_="onset"),
        element("path", d="M" + "L".join(pairs), class_="line"),
        element("path", d="".join(f"M{pair}h0" for pair in pairs), class_="dots"),
        viewBox=f"0 0 {_WIDE} {_HIGH}",
        preserveAspectRatio="none",
        role="img",
        aria_label=words,
    )
    return element("div", drawing, element("small", words), class_="trend")
