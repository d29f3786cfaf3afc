"""Words for times, durations and numbers, and events gathered into stretches."""

from collections.abc import Iterable
from itertools import pairwise

from syncline_analyzer.results import Analysis

LISTED = 10
"""Moments that a text names one by one."""


def seconds(ns: int) -> str:
    """A duration in the unit that people would say it in.

    >>> seconds(320_000_000), seconds(87_553_800_000)
    ('320 ms', '87.55 s')
    """
    if abs(ns) < 1_000_000_000:
        return f"{ns / 1e6:.4g} ms"
    if abs(ns) < 600_000_000_000:
        return f"{ns / 1e9:.4g} s"
    return f"{ns / 60e9:.1f} min" if abs(ns) < 7_200_000_000_000 else f"{ns / 3600e9:.1f} h"


def moment(analysis: Analysis, t_ns: int) -> str:
    """A moment as seconds into the capture."""
    return f"+{(t_ns - analysis.capture.first_ns) / 1e9:.3f} s"


def error_name(code: int, meaning: str) -> str:
    """An EMCY code in words, with the code.

    >>> error_name(0x3100, "mains voltage")
    'mains voltage (3100h)'
    """
    return f"{meaning} ({code:04X}h)"


def several(moments: list[str]) -> str:
    """How often and when, followed by a blank; nothing for a single time.

    >>> several(["+1.000 s"]), several(["+1.000 s", "+2.000 s"])
    ('', '2 times (at +1.000 s, +2.000 s) ')
    """
    if len(moments) < 2:
        return ""
    more = ", ..." if len(moments) > LISTED else ""
    return f"{len(moments)} times (at {', '.join(moments[:LISTED])}{more}) "


class Stretch:
    """Events gathered so that none is further than a given time from the next."""

    @staticmethod
    def of(times_ns: Iterable[int], apart_ns: int) -> list[tuple[int, int]]:
        """(first, last) of every stretch.

        >>> Stretch.of([1, 2, 9], 3)
        [(1, 2), (9, 9)]
        """
        ordered = sorted(times_ns)
        if not ordered:
            return []
        cuts = [b for a, b in pairwise(ordered) if b - a > apart_ns]
        starts = [ordered[0], *cuts]
        ends = [a for a, b in pairwise(ordered) if b - a > apart_ns] + [ordered[-1]]
        return list(zip(starts, ends, strict=True))
