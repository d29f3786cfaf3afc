"""The machines of a fleet, the worst first, and what was found on many of them."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.findings import RULES
from syncline_analyzer.fleet.captures import HEALTHY
from syncline_analyzer.fleet.overview import Machine, Overview, Story
from syncline_analyzer.views.fleet_links import Links, day, many, since
from syncline_analyzer.views.html import Html, element
from syncline_analyzer.views.report_findings import BADGES
from syncline_analyzer.views.report_tables import limited

FIRST_CARDS = 8
MAX_CARDS = 200
"""Machines that the page tells of one by one; the map has them all."""
_STORIES = 3
"""Of a machine; how many there are besides is said."""


def cards_of(found: Overview) -> dict[str, str]:
    """Identity of what the page tells of a machine, of those that it tells of one by one."""
    troubled = [each for each in found.machines if any(map(_is_grave, each.stories))]
    return {each.name: f"machine-{n}" for n, each in enumerate(troubled[:MAX_CARDS], 1)}


def machines_part(found: Overview, links: Links, cards: dict[str, str]) -> Iterator[Html]:
    """A card of each machine in trouble: what is most grave, since when, how often."""
    if not cards:
        yield element("p", "No rule found an error or a warning on any machine.")
        return
    told = [each for each in found.machines if each.name in cards]
    listed = [_card(machine, links, cards[machine.name]) for machine in told]
    yield element("ol", *listed[:FIRST_CARDS], class_="stories")
    if rest := listed[FIRST_CARDS:]:
        more = element("ol", *rest, class_="stories", start=FIRST_CARDS + 1)
        summary = element("summary", f"{many(len(rest), 'more machine')} in trouble")
        yield element("details", summary, more, class_="rest")
    troubled = sum(any(map(_is_grave, each.stories)) for each in found.machines)
    if left := troubled - len(told):
        yield element("p", f"{many(left, 'more machine')} only in the map.", class_="dim")


def _is_grave(story: Story) -> bool:
    return story.severity in ("error", "warning")


def _card(machine: Machine, links: Links, identity: str) -> Html:
    grave = [story for story in machine.stories if _is_grave(story)]
    shown = [_story(story, machine, links) for story in grave[:_STORIES]]
    if left := len(grave) - len(shown):
        shown.append(element("li", f"and {left} more kinds of findings", class_="dim"))
    article = element(
        "article",
        element("h3", machine.name, id=f"{identity}-name"),
        element("p", _state(machine, links)),
        element("ol", *shown, class_="chain", aria_label="What was found"),
        class_=f"story {machine.verdict}",
        aria_labelledby=f"{identity}-name",
    )
    return element("li", article, id=identity, data_verdict=machine.verdict, data_name=machine.name)


def _state(machine: Machine, links: Links) -> Html:
    """How the machine is now, and how it was."""
    latest = machine.latest
    assert latest is not None
    now = {"error": "errors", "warning": "warnings"}.get(latest.verdict, HEALTHY)
    counts = [
        f"{machine.count(severity)} with {severity}s"
        for severity in ("error", "warning")
        if machine.count(severity)
    ]
    captures = many(len(machine.captures), "capture")
    told = f" ({day(latest.begun_ns)}). Of {captures} {' and '.join(counts)}."
    return element("span", "Latest: ", links.link(now, latest.capture_id), told)


def _story(story: Story, machine: Machine, links: Links) -> Html:
    badge = element("span", BADGES[story.severity], class_=f"badge {story.severity}")
    often = (
        f"{many(story.findings, 'time')} in {story.captures} of {len(machine.captures)} captures"
    )
    where = [element("code", story.id), " ", links.link("latest", story.last_capture)]
    if story.first_capture != story.last_capture:
        where += [" ", links.link("first", story.first_capture)]
    return element(
        "li",
        badge,
        f" {story.text} ",
        element("small", f"{often}, {since(story.first_ns, story.last_ns)}. ", *where),
    )


def kinds_part(found: Overview, links: Links) -> Iterator[Html]:
    """What was found, over the whole fleet."""
    meanings = {rule.id: rule.meaning for rule in RULES}
    rows: list[Sequence[object]] = [
        (
            element("span", BADGES[kind.severity], class_=f"badge {kind.severity}"),
            element("code", kind.id),
            f"{kind.machines:,}",
            f"{kind.captures:,}",
            f"{kind.findings:,}",
            day(kind.first_ns),
            day(kind.last_ns),
            links.link(kind.last_machine, kind.last_capture),
            element("div", meanings.get(kind.id, ""), class_="wrap"),
        )
        for kind in found.kinds
    ]
    if not rows:
        yield element("p", "Nothing was found.")
    heads = ["Severity", "Finding", ">Machines", ">Captures", ">Findings", "First", "Last", "Latest on", "Meaning"]  # fmt: skip
    yield from limited("Findings by kind", heads, rows)
