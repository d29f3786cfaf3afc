"""The map of a fleet: machines by day, each time with its worst verdict."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

from syncline_analyzer.fleet.captures import HEALTHY
from syncline_analyzer.fleet.layout import UNDATED
from syncline_analyzer.fleet.overview import SEVERITIES, Cell, Machine, Overview, column_of
from syncline_analyzer.views.fleet_links import Links, many
from syncline_analyzer.views.html import Html, element, joined
from syncline_schemas.named_tuples import NamedTuple

FIRST_ROWS = 40
"""Machines that are seen at once; the others open on a click."""
MAX_ROWS = 1_000
"""Machines in the map; it begins with the worst."""
_CLASS = {"error": "e", "warning": "w", HEALTHY: "h"}
_WORDS = {"error": "with errors", "warning": "with warnings", HEALTHY: "healthy"}
_TICK = "✓"
_BAR = 100
_SPACE = 0.15


class Anchors(NamedTuple):
    """Where else the page tells of a machine, by its name: its card, and its first trend."""

    cards: Mapping[str, str]
    trends: Mapping[str, str]


def map_part(found: Overview, links: Links, anchors: Anchors) -> Iterator[Html]:
    """Captures by day, then the map."""
    shown = found.machines[:MAX_ROWS]
    yield _days(found)
    yield _legend(found, links)
    if len(shown) > 1:
        yield _filter(found)
    # What the script says of the cell at the pointer or the focus.
    yield element("output", id="cell", class_="dim")
    yield _table(found, shown[:FIRST_ROWS], links, anchors, "The worst of each machine by time")
    if rest := shown[FIRST_ROWS:]:
        told = element("summary", many(len(rest), "more machine"))
        table = _table(found, rest, links, anchors, "Further machines by time")
        yield element("details", told, table, class_="rest map-rest")
    if left := len(found.machines) - len(shown):
        yield element(
            "p",
            f"{many(left, 'more machine')}, none of them worse than these, left out here;"
            " 'syncline fleet report --machine NAME' shows some alone.",
            class_="dim",
        )


def _legend(found: Overview, links: Links) -> Html:
    told = [
        element("i", "E2", class_="e"), " two errors, ",
        element("i", "W1", class_="w"), " one warning, ",
        element("i", _TICK, class_="h"), " healthy, blank: nothing recorded. ",
    ]  # fmt: skip
    if found.every != "day":
        told.append(f"A column is a {found.every}. ")
    told.append("Of several captures the worst one is shown. ")
    if not found.reports:
        told.append("Made with 'syncline fleet analyze --reports' it leads to their reports.")
    elif links.folder is None:
        told.append("Their reports are elsewhere: this page was written outside of the data set.")
    else:
        told.append("A click opens its report.")
    return element("p", *told, class_="legend map-key")


def _filter(found: Overview) -> Html:
    """Name and verdict; the script shows it, since without one it does nothing."""
    boxes = []
    for verdict in SEVERITIES:
        count = sum(machine.verdict == verdict for machine in found.machines)
        if count:
            box = element("input", type="checkbox", name="verdict", value=verdict, checked=True)
            boxes.append(element("label", box, f" {_WORDS[verdict]} ({count:,})"))
    search = element("input", type="search", name="words", autocomplete="off")
    return element(
        "form",
        element("label", "Machine ", search),
        element("fieldset", element("legend", "Verdict"), *boxes),
        element("output", aria_live="polite"),
        class_="filter",
        role="search",
        aria_label="Filter the machines",
        hidden=True,
    )


def _table(
    found: Overview,
    machines: Sequence[Machine],
    links: Links,
    anchors: Anchors,
    caption: str,
) -> Html:
    rows = (_row(found, machine, links, anchors) for machine in machines)
    whole = element(
        "table",
        element("caption", caption),
        element("thead", *_heads(found.columns)),
        element("tbody", *rows),
        class_="map",
    )
    return element("div", whole, class_="scroll", role="region", aria_label=caption, tabindex=0)


def _heads(columns: Sequence[str]) -> Iterator[Html]:
    """Months above days; whole dates where columns are longer."""
    if not all(len(each) == len("2026-11-22") for each in columns if each != UNDATED):
        yield element("tr", element("th", "Machine", scope="col"), *map(_head, columns))
        return
    months = [
        element("th", month, scope="col", colspan=len(list(group)))
        for month, group in groupby(columns, key=lambda each: each[:7])
    ]
    yield element("tr", element("th", "", scope="col"), *months, class_="months")
    yield element("tr", element("th", "Machine", scope="col"), *map(_head, columns))


def _head(column: str) -> Html:
    short = "?" if column == UNDATED else column[8:] or column
    return element("th", short, scope="col", data_day=column)


def _row(found: Overview, machine: Machine, links: Links, anchors: Anchors) -> Html:
    cells = found.cells(machine)
    card, trend = anchors.cards.get(machine.name), anchors.trends.get(machine.name)
    name = element("a", machine.name, href=f"#{card}") if card else machine.name
    drifts = element("small", " ", element("a", "trend", href=f"#{trend}")) if trend else None
    failed = element("small", f" {machine.failures} failed") if machine.failures else None
    return element(
        "tr",
        element("th", name, drifts, failed, scope="row"),
        *(_cell(cells.get(column), links) for column in found.columns),
        data_verdict=machine.verdict,
        data_name=machine.name,
    )


def _cell(cell: Cell | None, links: Links) -> Html:
    if cell is None:
        return _EMPTY
    worst = cell.worst
    text = {"error": f"E{worst.errors}", "warning": f"W{worst.warnings}"}.get(worst.verdict, _TICK)
    several = cell.captures if cell.captures > 1 else None
    return element(
        "td", links.link(text, worst.capture_id), class_=_CLASS[worst.verdict], data_n=several
    )


_EMPTY = element("td")


def _days(found: Overview) -> Html:
    """How many captures of each column came out how, as bars one on the other."""
    counts: dict[str, dict[str, int]] = {column: {} for column in found.columns}
    for capture in found.captures:
        of = counts.get(column_of(capture.date, found.every))
        if of is not None:
            of[capture.verdict] = of.get(capture.verdict, 0) + 1
    most = max((sum(each.values()) for each in counts.values()), default=0) or 1
    bars = []
    for place, (column, of) in enumerate(counts.items()):
        below = 0.0
        for verdict in SEVERITIES:
            high = _BAR * of.get(verdict, 0) / most
            if not high:
                continue
            told = f"{column}: {many(of[verdict], 'capture')} {_WORDS[verdict]}"
            bar = element(
                "rect",
                x=f"{place + _SPACE:.3g}",
                y=f"{_BAR - below - high:.4g}",
                width=1 - 2 * _SPACE,
                height=f"{high:.4g}",
                class_=_CLASS[verdict],
            )
            bars.append(element("g", element("title", told), bar))
            below += high
    words = f"Captures by {found.every} and verdict, at most {most:,}"
    drawing = element(
        "svg",
        element("title", words),
        *bars,
        viewBox=f"0 0 {max(len(counts), 1)} {_BAR}",
        preserveAspectRatio="none",
        role="img",
        aria_label=words,
    )
    ends = element("p", *_ends(found.columns), class_="ends")
    key = [
        element("span", element("i", class_=_CLASS[verdict]), f" {_WORDS[verdict]} ")
        for verdict in SEVERITIES
    ]
    return element(
        "figure",
        element("figcaption", words, " ", element("small", joined(key))),
        drawing,
        ends,
        class_="days",
    )


def _ends(columns: Sequence[str]) -> Iterator[Html]:
    if columns:
        yield element("span", columns[0])
        yield element("span", columns[-1])
