"""Response histograms of the report: one small picture per PDO, which needs no script."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from syncline_analyzer.results import Analysis, PdoRow, Responses
from syncline_analyzer.views.basis import fine
from syncline_analyzer.views.histogram import Bars, bars_of
from syncline_analyzer.views.html import Html, element
from syncline_analyzer.views.words import hex_code, names_of, node_label, number

OPEN_HISTOGRAMS = 12
MAX_HISTOGRAMS = 160

_WIDTH, _HEIGHT = 300.0, 90.0


def histogram_figures(analysis: Analysis) -> Iterator[Html]:
    """A picture per PDO that answered; the first ones at once, the others to be opened."""
    several = len(analysis.capture.buses) > 1
    rows = {(row.bus, row.cob_id): row for row in analysis.pdos}
    names = names_of(analysis.nodes)
    answered = [r for r in analysis.responses if r.histogram.any()]
    drawn = []
    for responses in answered[:MAX_HISTOGRAMS]:
        label = names.get((responses.bus, responses.node or 0), node_label(responses.node))
        bus = f"{responses.bus} " if several else ""
        title = f"{hex_code(responses.cob_id, 3)} {responses.pdo or 'PDO'} of {bus}node {label}"
        drawn.append(_figure(title, responses, rows.get((responses.bus, responses.cob_id))))
    yield from _grids(drawn, len(answered) - len(drawn))


def _grids(drawn: Sequence[Html], left_out: int) -> Iterator[Html]:
    if drawn:
        yield element("div", *drawn[:OPEN_HISTOGRAMS], class_="hists")
    if rest := drawn[OPEN_HISTOGRAMS:]:
        more = f", {left_out} are only in the tables" if left_out else ""
        told = element("summary", f"Response histograms of {len(rest)} more PDOs{more}")
        yield element("details", told, element("div", *rest, class_="hists"))


def _figure(title: str, responses: Responses, row: PdoRow | None) -> Html:
    bars = bars_of(responses)
    low = bars.middle_us[0] - bars.width_us[0] / 2
    high = bars.middle_us[-1] + bars.width_us[-1] / 2
    span = max(float(high - low), 1e-9)
    told = list(_told(bars, responses, row))
    words = f"Response histogram of {title}: {', '.join(told)}"
    picture = element(
        "svg",
        element("title", words),
        element("path", d=_outline(bars, float(low), span), class_="hist"),
        *_marks(row, float(low), span),
        viewBox=f"0 0 {_WIDTH:g} {_HEIGHT:g}",
        preserveAspectRatio="none",
        role="img",
        aria_label=words,
    )
    ends = (element("span", number(float(end), "us")) for end in (low, high))
    return element(
        "figure",
        element("figcaption", title),
        picture,
        element("div", *ends, class_="ends", aria_hidden="true"),
        element("p", ", ".join(told), class_="dim"),
        class_="histogram",
    )


def _outline(bars: Bars, low: float, span: float) -> str:
    """Bars as one path; a bar that is too narrow to be seen is still a stroke."""
    most = float(bars.per_us.max()) or 1.0
    left = (bars.middle_us - bars.width_us / 2 - low) / span * _WIDTH
    right = left + bars.width_us / span * _WIDTH
    top = _HEIGHT - bars.per_us / most * (_HEIGHT - 4)
    shown = np.flatnonzero(bars.per_us)
    return "".join(
        f"M{left[i]:.4g} {_HEIGHT:g}V{top[i]:.4g}H{right[i]:.4g}V{_HEIGHT:g}z" for i in shown
    )


def _marks(row: PdoRow | None, low: float, span: float) -> Iterable[Html]:
    """Median and 99th percentile as lines."""
    if row is None or row.response_us is None:
        return
    for value, name in ((row.response_us.median, "median"), (row.response_us.p99, "p99")):
        place = (value - low) / span * _WIDTH
        if 0 <= place <= _WIDTH:
            yield element("path", d=f"M{place:.4g} 0V{_HEIGHT:g}", class_=name)


def _told(bars: Bars, responses: Responses, row: PdoRow | None) -> Iterator[str]:
    yield f"{int(responses.histogram.sum()):,} answers"
    if row is not None and row.response_us is not None:
        yield f"median {number(row.response_us.median, 'us')}"
        yield f"p99 {number(row.response_us.p99, 'us')}"
        spread = row.jitter_us.std if row.jitter_us else None
        yield f"std {fine(spread, row.resolution_us)}{'' if spread is None else ' us'}"
    if bars.left_out:
        yield f"{bars.left_out} far away left out"
