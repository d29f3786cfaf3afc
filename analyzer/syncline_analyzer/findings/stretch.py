"""Words for durations, and events gathered into stretches."""

from collections.abc import Iterable
from itertools import pairwise


def seconds(ns: int) -> str:
    """A duration in the unit that people would say it in.

    >>> seconds(320_000_000), seconds(87_553_800_000)
    ('320 ms', '87.55 s')
    """
    if abs(ns) < 1_000_000_000:
        return f"{ns / 1e6:.4g} ms"
    return f"{ns / 1e9:.4g} s" if abs(ns) < 600_000_000_000 else f"{ns / 60e9:.1f} min"


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
