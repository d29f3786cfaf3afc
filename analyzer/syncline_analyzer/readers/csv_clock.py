"""Times of the clock in a cell of a table, with or without a date, as people and tools write them."""

import re
from collections.abc import Iterable
from typing import Final

from syncline_analyzer.readers.layout import Span
from syncline_analyzer.readers.times import SECOND_NS, Times, decimal_times, utc_ns
from syncline_schemas.records import dataclass

_DATE_TEXT: Final = (
    rb"(?:(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})"
    rb"|(?P<a>\d{1,2})(?P<mark>[./-])(?P<b>\d{1,2})(?P=mark)(?P<y2>\d{4}))"
)
_DATE: Final = re.compile(_DATE_TEXT)
_CLOCK: Final = re.compile(
    rb"(?:" + _DATE_TEXT + rb"[ T_-]+)?(?P<hour>\d{1,3}):(?P<minute>\d{2}):(?P<s>\d{2})"
    rb"(?:[.,:](?P<f>\d+))?(?:\.(?P<tenth>\d))?\s*(?P<half>[AaPp][Mm])?"
    rb"(?P<zone>Z|[+-]\d{2}:?\d{2})?"
)
_TENTH_NS: Final = 100_000
_HOUR_NS: Final = 3600 * SECOND_NS


@dataclass(frozen=True, slots=True)
class ClockTime:
    """A time of the clock: its fields, what is added to them, and digits that mean nothing."""

    times: Times
    digits: tuple[Span, ...]
    base_ns: int


@dataclass(slots=True)
class Clock:
    """How a log writes times of the clock.

    Attributes:
        month_first: whether 1/2/2023 is in January.
        dated: whether they have dates. zoned: whether they name a time zone.
    """

    month_first: bool = False
    dated: bool = False
    zoned: bool = False

    @classmethod
    def of(cls, cells: Iterable[bytes], dates: Iterable[bytes]) -> "Clock | None":
        """What the first cells tell, with the dates that stand in cells of their own.

        >>> Clock.of([b"11/14/2023 10:13:20 PM"], [])
        Clock(month_first=True, dated=True, zoned=False)
        """
        found = [match for cell in cells if (match := _CLOCK.fullmatch(cell))]
        if not found:
            return None
        apart = [match for cell in dates if (match := _DATE.fullmatch(cell))]
        both = [match for match in (*found, *apart) if match["a"]]
        late = any(int(match["b"]) > 12 for match in both)
        american = any(match["half"] and match["mark"] == b"/" for match in found)
        day_first = any(int(match["a"]) > 12 for match in both)
        return cls(
            month_first=late or (american and not day_first),
            dated=bool(apart) or any(match["y"] or match["y2"] for match in found),
            zoned=any(match["zone"] for match in found),
        )

    def read(self, line: bytes, span: Span, date: Span | None) -> ClockTime | None:
        """The time in a span of a line, its date in another or none; None when it is none."""
        found = _CLOCK.fullmatch(line, *span)
        if found is None:
            return None
        base_ns = self._date_ns(found, line, date)
        if base_ns is None:
            return None
        times, digits = decimal_times(found.span("s"), found.span("f"), SECOND_NS)
        times = ((found.span("minute"), 60 * SECOND_NS), *times)
        if found["tenth"]:
            times = (*times, (found.span("tenth"), _TENTH_NS))
        if found["half"]:
            # The hour stays part of what lines have in common: twelve counts as none.
            hours = int(found["hour"]) % 12 + (12 if found["half"].lower() == b"pm" else 0)
            base_ns += hours * _HOUR_NS
        else:
            times = ((found.span("hour"), _HOUR_NS), *times)
        return ClockTime(times, digits, base_ns - _zone_ns(found["zone"]))

    def _date_ns(self, found: re.Match[bytes], line: bytes, span: Span | None) -> int | None:
        date: re.Match[bytes] | None = found
        if not found["y"] and not found["y2"]:
            if span is None:
                return 0
            date = _DATE.fullmatch(line, *span)
        if date is None:
            return 0
        if date["y"]:
            return utc_ns(int(date["y"]), int(date["m"]), int(date["d"]))
        day, month = int(date["a"]), int(date["b"])
        if self.month_first:
            day, month = month, day
        return utc_ns(int(date["y2"]), month, day)


def is_clock(cell: bytes) -> bool:
    """Whether a cell is a time of the clock.

    >>> is_clock(b"2023-11-14 22:13:20.5"), is_clock(b"0.5")
    (True, False)
    """
    return _CLOCK.fullmatch(cell) is not None


def _zone_ns(zone: bytes | None) -> int:
    """How far a zone such as `+01:00` is ahead of UTC."""
    if zone is None or zone == b"Z":
        return 0
    minutes = int(zone[1:3]) * 60 + int(zone[-2:])
    return (-minutes if zone[:1] == b"-" else minutes) * 60 * SECOND_NS
