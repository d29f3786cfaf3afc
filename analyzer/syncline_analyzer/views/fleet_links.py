"""Links from the fleet's report to the reports of its captures, and how moments are written there."""

from collections.abc import Container
from urllib.parse import quote

from syncline_analyzer.fleet.layout import date_of
from syncline_analyzer.views.html import Html, element
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class Links:
    """Where the reports of the captures are.

    Attributes:
        folder: of the reports as the page sees it, `reports`; None where it cannot lead there.
        made: ids of the captures that have one.
    """

    folder: str | None
    made: Container[str]

    def to(self, capture_id: str) -> str | None:
        """Address of a capture's report; None where there is none."""
        if self.folder is None or capture_id not in self.made:
            return None
        return f"{quote(self.folder, errors='surrogateescape')}/{quote(capture_id)}.html"

    def link(self, text: object, capture_id: str) -> Html | str:
        """Some words that lead to a capture's report, or the words alone."""
        to = self.to(capture_id)
        return str(text) if to is None else element("a", text, href=to)


def many(number: int, noun: str) -> str:
    """A number of things, of which there may be thousands.

    >>> many(30_000, "capture"), many(1, "machine")
    ('30,000 captures', '1 machine')
    """
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def day(t_ns: int | None) -> str:
    """UTC date of a moment.

    >>> day(1_790_000_000_000_000_000), day(None)
    ('2026-09-21', 'no date')
    """
    return "no date" if t_ns is None else date_of(t_ns)


def since(first_ns: int | None, last_ns: int | None) -> str:
    """From which day to which.

    >>> since(1_790_000_000_000_000_000, 1_790_000_000_000_000_000)
    'on 2026-09-21'
    """
    first, last = day(first_ns), day(last_ns)
    if first_ns is None or last_ns is None:
        return "in captures without a date"
    return f"on {first}" if first == last else f"since {first}, last on {last}"
