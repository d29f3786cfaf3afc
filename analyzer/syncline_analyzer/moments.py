"""Moments as users write them: seconds into the capture, or UTC."""

import re
from dataclasses import dataclass
from datetime import UTC, datetime

from syncline_schemas.errors import UsageError

_DURATION = re.compile(r"(?:(\d+)d)?(?:(\d+)h)?(?:(\d+)m(?!s))?(?:(\d+(?:\.\d+)?)s)?(?:(\d+)ms)?")
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
    """A moment from "90s", "1m30s", "2h", "250ms" or "2026-03-01T12:00:00Z".

    >>> parse_moment("1m30s")
    Moment(ns=90000000000, relative=True)
    >>> parse_moment("2026-03-01T12:00:00.5Z").ns
    1772366400500000000

    Raises: UsageError when the text is neither.
    """
    match = _DURATION.fullmatch(text.strip())
    if match and any(match.groups()):
        return Moment(_duration_ns(match.groups()), relative=True)
    try:
        when = datetime.fromisoformat(text.strip())
    except ValueError:
        raise UsageError(
            f"{text!r} is no time: write it as 90s, 1m30s or 2h into the capture,"
            " or as UTC such as 2026-03-01T12:00:00Z"
        ) from None
    when = when if when.tzinfo else when.replace(tzinfo=UTC)
    since = when - datetime(1970, 1, 1, tzinfo=UTC)
    return Moment((since.days * 86_400 + since.seconds) * 10**9 + since.microseconds * 1000, False)


def _duration_ns(groups: tuple[str | None, ...]) -> int:
    return sum(
        round(float(group) * unit) for group, unit in zip(groups, _UNIT_NS, strict=True) if group
    )
