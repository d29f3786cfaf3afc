"""Moments of a capture in the report: capture time, UTC beside it, and a link into the timeline."""

from syncline_analyzer.results import Analysis, Finding
from syncline_analyzer.views.html import Html, element, joined
from syncline_analyzer.views.words import Clock
from syncline_schemas.records import dataclass

_DAY_NS = 86_400_000_000_000
_HALF_MS = 500_000
LEAST_NS = 1000
"""What is shorter is drawn as long as this: the step of the places on the time axis."""
_MONTH, _TIME, _MS = 5, 11, 23


@dataclass(frozen=True, slots=True)
class Moments:
    """What the report shows of time: from which stamp on, how long, and how it is written."""

    clock: Clock
    begin_ns: int
    span_ns: int

    @classmethod
    def of(cls, analysis: Analysis) -> "Moments":
        """The moments of an analysis; a capture of a single frame is a microsecond long."""
        capture = analysis.capture
        span_ns = capture.end_ns - capture.begin_ns
        return cls(Clock.of(capture), capture.begin_ns, max(span_ns, LEAST_NS))

    def second(self, t_ns: int) -> str:
        """Seconds from the left edge to a stamp, to the microsecond.

        >>> Moments(Clock(0, True, True), 0, 1).second(86_400_000_001_000)
        '86400.000001'
        """
        return seconds(t_ns - self.begin_ns)

    @property
    def span(self) -> str:
        """Seconds that are shown."""
        return f"{self.span_ns / 1e9:.12g}"

    def percent(self, t_ns: int) -> float:
        """Where a stamp lies, from the left edge to the right one."""
        return 100 * (t_ns - self.begin_ns) / self.span_ns

    def utc(self, t_ns: int) -> str:
        """Time of day in UTC to the millisecond, with the date in captures of several days.

        >>> Moments(Clock(0, True, True), 0, 1).utc(1_790_000_000_123_456_789)
        '14:13:20.123'
        """
        if not (self.clock.dated and self.clock.timed):
            return ""
        several = self.begin_ns // _DAY_NS != (self.begin_ns + self.span_ns) // _DAY_NS
        return self.clock.full(t_ns + _HALF_MS)[_MONTH if several else _TIME : _MS]

    def when(self, start_ns: int, end_ns: int | None = None) -> Html:
        """A moment or stretch as a link that shows it in the timeline, with its UTC beside it."""
        if not self.clock.timed:
            return Html("-")
        end_ns = start_ns if end_ns is None else end_ns
        to = self.second(end_ns) if end_ns > start_ns else None
        link = element(
            "a",
            self.clock.stretch(start_ns, end_ns),
            href="#timeline",
            data_from=self.second(start_ns),
            data_to=to,
        )
        utc = self.utc(start_ns)
        return joined([link, " ", element("small", utc)]) if utc else link

    def finding(self, row: Finding) -> Html:
        """When a finding was, as a link that names what it opens."""
        link = element(
            "a",
            self.clock.stretch(row.start_ns, row.end_ns),
            href="#timeline",
            title=f"{self.clock.full(row.start_ns)}: show in the timeline",
            data_from=self.second(row.start_ns),
            data_to=self.second(row.end_ns),
        )
        if not (utc := self.utc(row.start_ns)):
            return link
        return joined([link, " ", element("small", f"{utc} UTC")])


def seconds(ns: int) -> str:
    """A stretch in seconds, to the microsecond and without needless zeros.

    >>> seconds(250_000_000_000), seconds(-1_500_000), seconds(400)
    ('250', '-0.0015', '0')
    """
    text = f"{ns / 1e9:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
