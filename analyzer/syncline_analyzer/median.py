"""The number in the middle of a few."""

from collections.abc import Iterable


def median(numbers: Iterable[int]) -> float:
    """What `statistics.median` tells of at least one; to import that takes 3 ms.

    >>> median([5, 1, 3]), median([4, 1])
    (3, 2.5)
    """
    ordered = sorted(numbers)
    half = len(ordered) // 2
    return ordered[half] if len(ordered) % 2 else (ordered[half - 1] + ordered[half]) / 2
