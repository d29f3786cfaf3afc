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


def milliseconds(us: float) -> str:
    """A period in milliseconds, also where timers are long.

    >>> milliseconds(25_031.4), milliseconds(65_535_000)
    ('25.03 ms', '65535 ms')
    """
    ms = us / 1000
    return f"{ms:.0f} ms" if ms >= 9999.5 else f"{ms:.4g} ms"


def moment(analysis: Analysis, t_ns: int) -> str:
    """A moment of the capture as time since its begin.

    Where its clock was set back, stamps may lie before the begin: those say after which step too.
    """
    told = since_begin(t_ns - analysis.capture.first_ns)
    later = analysis.capture.stretches[1:] if t_ns < analysis.capture.first_ns else []
    found = [n for n, each in enumerate(later, 1) if each.start_ns <= t_ns <= each.end_ns]
    if len(found) != 1:
        return told
    passed = (t_ns - later[found[0] - 1].start_ns) / 1e9
    which = "the clock was set back" if len(later) == 1 else f"step back {found[0]} of the clock"
    return f"{told} ({passed:.3f} s after {which})"


def since_begin(ns: int) -> str:
    """A time since the begin of a capture; from an hour on as the views write it.

    >>> since_begin(33_933_000_000), since_begin(-5_000_000), since_begin(49_998_015_000_000)
    ('+33.933 s', '-0.005 s', '+13:53:18.015')
    """
    if abs(ns) < 3_600_000_000_000:
        return f"{ns / 1e9:+.3f} s"
    seconds_, ms = divmod((abs(ns) + 500_000) // 1_000_000, 1000)
    minutes, rest = divmod(seconds_, 60)
    return f"{'-' if ns < 0 else '+'}{minutes // 60}:{minutes % 60:02}:{rest:02}.{ms:03}"


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
