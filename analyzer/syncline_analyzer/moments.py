"""Moments as users write them: seconds into the capture, or UTC."""

import re
from datetime import UTC, datetime

from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

_DURATION = re.compile(r"(?:(\d+)d)?(?:(\d+)h)?(?:(\d+)m(?!s))?(?:(\d+(?:\.\d+)?)s)?(?:(\d+)ms)?")
_PRINTED = re.compile(
    r"\+?(?:(?P<hours>\d+):)?(?P<minutes>\d+):(?P<seconds>[0-5]\d(?:\.\d+)?)"
    r"|\+(?P<only>\d+(?:\.\d+)?) ?s"
)
"""How times of the capture are printed: 0:33.933 and 1:02:03.5, and in findings +33.933 s, +1:02:03.500."""
_UNIT_NS = (86_400_000_000_000, 3_600_000_000_000, 60_000_000_000, 1_000_000_000, 1_000_000)


@dataclass(frozen=True, slots=True)
class Moment:
    """A time of the capture: `ns` counts from the first frame when `relative`, else from 1970."""

    ns: int
    relative: bool

    def resolved(self, first_ns: int) -> int:
        """The stamp `t_ns` that is meant in a capture whose first frame has `first_ns`."""
        return self.ns + first_ns if self.relative else self.ns


def parse_moment(text: str) -> Moment:
    """A moment from "90s", "1m30s", "2h", "250ms" or "2026-03-01T12:00:00Z", or as it is printed.

    >>> parse_moment("1m30s")
    Moment(ns=90000000000, relative=True)
    >>> parse_moment("1:30.5"), parse_moment("+90.5 s")
    (Moment(ns=90500000000, relative=True), Moment(ns=90500000000, relative=True))
    >>> parse_moment("+1:02:03.500").ns
    3723500000000
    >>> parse_moment("2026-03-01T12:00:00.5Z").ns
    1772366400500000000

    Raises: UsageError when the text is neither.
    """
    plain = text.strip()
    match = _DURATION.fullmatch(plain)
    if match and any(match.groups()):
        return Moment(_duration_ns(match.groups()), relative=True)
    if printed := _PRINTED.fullmatch(plain):
        hours, minutes, seconds, only = printed.groups()
        return Moment(_duration_ns((None, hours, minutes, seconds or only, None)), relative=True)
    try:
        when = datetime.fromisoformat(plain.removesuffix(" UTC"))
    except ValueError:
        raise UsageError(
            f"{text!r} is no time: write it as 90s, 1m30s, 2h or 1:30.5 into the capture,"
            " or as UTC such as 2026-03-01T12:00:00Z"
        ) from None
    when = when if when.tzinfo else when.replace(tzinfo=UTC)
    since = when - datetime(1970, 1, 1, tzinfo=UTC)
    return Moment((since.days * 86_400 + since.seconds) * 10**9 + since.microseconds * 1000, False)


def _duration_ns(groups: tuple[str | None, ...]) -> int:
    return sum(
        round(float(group) * unit) for group, unit in zip(groups, _UNIT_NS, strict=True) if group
    )
