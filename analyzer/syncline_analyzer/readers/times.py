"""Times as logs write them: decimal digits to ns, dates to ns since the UNIX epoch."""

import re
from datetime import UTC, datetime
from decimal import Decimal
from typing import Final

from syncline_analyzer.readers.layout import Span

SECOND_NS: Final = 10**9
MILLISECOND_NS: Final = 10**6
FIRST_UTC_NS: Final = 946_684_800 * SECOND_NS
"""2000-01-01: an earlier time is a clock that was never set, or counts from something else."""

Times = tuple[tuple[Span, int], ...]

_MONTHS: Final = {
    name: number
    for names, number in (
        (("jan",), 1),
        (("feb",), 2),
        (("mar", "mär", "mrz"), 3),
        (("apr",), 4),
        (("may", "mai"), 5),
        (("jun",), 6),
        (("jul",), 7),
        (("aug",), 8),
        (("sep",), 9),
        (("oct", "okt"), 10),
        (("nov",), 11),
        (("dec", "dez"), 12),
    )
    for name in names
}


def decimal_times(whole: Span, fraction: Span, unit_ns: int) -> tuple[Times, tuple[Span, ...]]:
    """The fields of a decimal number in units of `unit_ns`, and its digits finer than 1 ns.

    >>> decimal_times((1, 3), (4, 7), SECOND_NS)
    ((((1, 3), 1000000000), ((4, 7), 1000000)), ())
    """
    start, end = fraction
    if start < 0 or end == start:
        return ((whole, unit_ns),), ()
    places = len(str(unit_ns)) - 1
    if not places:
        return ((whole, unit_ns),), (fraction,)
    kept = min(end, start + places)
    fields = ((whole, unit_ns), ((start, kept), 10 ** (places - (kept - start))))
    return fields, ((kept, end),) if kept < end else ()


def seconds_ns(whole: bytes, fraction: bytes) -> int:
    """Seconds as written [ns]; of endless digits only the last nine count, and the first nine of the fraction.

    >>> seconds_ns(b"12", b"5")
    12500000000
    """
    return int(whole[-9:]) * SECOND_NS + int(fraction.ljust(9, b"0")[:9])


def utc_ns(
    year: int, month: int, day: int, hour: int = 0, minute: int = 0, second: int = 0
) -> int | None:
    """A date as ns since the UNIX epoch; None when there is no such date, or not in int64."""
    if not 1900 <= year < 2200:
        return None
    try:
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    return (moment.toordinal() - 719163) * 86400 * SECOND_NS + (
        hour * 3600 + minute * 60 + second
    ) * SECOND_NS


_MAX_DATE: Final = 100
"""Characters in which a date must stand; in endless ones it would be looked for very long."""
_ENGLISH = re.compile(
    r"(?:[^\W\d]+\.?\s+)?(?P<month>[^\W\d]{3})[^\W\d]*\.?\s+(?P<day>\d{1,2})\s+"
    r"(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d)(?:[.,](?P<fraction>\d+))?"
    r"(?:\s+(?P<half>[ap]m))?\s+(?P<year>\d{4})",
    re.IGNORECASE,
)
_NUMERIC = re.compile(
    r"(?:[^\W\d]+\.?\s+)?(?P<day>\d{1,2})[./](?P<month>\d{1,2})[./](?P<year>\d{4})\s+"
    r"(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d)(?:[.,](?P<fraction>\d+))?"
    r"(?:\s*(?P<half>[ap]m))?",
    re.IGNORECASE,
)
_ISO = re.compile(
    r"(?P<year>\d{4})-(?P<month>\d{1,2})-(?P<day>\d{1,2})[ T]"
    r"(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d)(?:[.,](?P<fraction>\d+))?(?P<half>)"
)


def date_ns(text: str) -> int | None:
    """A date in one of the spellings of log headers, taken as UTC; None when it is none.

    One before 2000 is that of a clock that was never set, or of a tool that had none: no date either.
    A fraction of fewer than three digits is a number of milliseconds: the makers write three, and
    python-can's writer leaves out their leading zeros.

    >>> date_ns("Mon Mar 30 02:51:58.002 pm 2009") == date_ns("Mon Mar 30 14:51:58.2 2009")
    True
    >>> date_ns("Thu Jan 1 01:00:00 1970") is None
    True
    """
    for pattern in (_ENGLISH, _NUMERIC, _ISO):
        found = pattern.search(text[:_MAX_DATE])
        if found:
            t_ns = _date_of(found)
            return t_ns if t_ns is not None and t_ns >= FIRST_UTC_NS else None
    return None


def _date_of(found: re.Match[str]) -> int | None:
    month = found["month"].lower()
    number = int(month) if month.isdigit() else _MONTHS.get(month)
    hour, half = int(found["hour"]), (found["half"] or "").lower()
    if half:
        hour = hour % 12 + (12 if half == "pm" else 0)
    if number is None:
        return None
    day = int(found["day"])
    if day <= 12 and (number > 12 or (half and "/" in found[0] and month.isdigit())):
        # Americans write the month first.
        number, day = day, number
    whole = utc_ns(
        int(found["year"]),
        number,
        day,
        hour,
        int(found["minute"]),
        int(found["second"]),
    )
    fraction = found["fraction"] or "0"
    part_ns = (
        int(fraction) * MILLISECOND_NS if len(fraction) < 3 else int(fraction.ljust(9, "0")[:9])
    )
    return None if whole is None else whole + part_ns


_FIRST_DAY: Final = 36_526
"""2000-01-01, as `FIRST_UTC_NS`."""


def ole_date_ns(text: str) -> int | None:
    """Days since 1899-12-30 as ns since the UNIX epoch, rounded to 1 ns; None when no number, or before 2000.

    >>> ole_date_ns("36526.5") - FIRST_UTC_NS == 12 * 3600 * SECOND_NS
    True
    >>> ole_date_ns("25569.5") is None
    True
    """
    try:
        days = Decimal(text.strip().replace(",", "."))
        return (
            round((days - 25569) * 86400 * SECOND_NS)
            if days.is_finite() and _FIRST_DAY <= days < 100_000
            else None
        )
    except ArithmeticError:
        return None
