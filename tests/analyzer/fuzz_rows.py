"""Rows of the truth and of an analysis side by side; what several checks know of a scenario."""

from collections import Counter
from collections.abc import Iterator, Sequence

from syncline_samples.faults import DuplicateNode
from syncline_samples.truth import BootUpTruth
from tests.analyzer.fuzz_case import MS, Case

Row = tuple[object, ...]
Timed = tuple[int, Row]
"""Stamp and what happened then."""


def differences(
    what: str, case: Case, true: Sequence[Timed], told: Sequence[Timed]
) -> Iterator[str]:
    """Rows that only one side has, and rows whose times lie further apart than stamps may."""
    left, right = Counter(row for _, row in true), Counter(row for _, row in told)
    for row in left - right:
        yield f"{what} not told: {row}"
    for row in right - left:
        yield f"{what} invented: {row}"
    if left != right:
        return
    stamped = [(case.stamp(t_ns), row) for t_ns, row in true]
    for (true_ns, row), (told_ns, _) in zip(_in_order(stamped), _in_order(told), strict=True):
        if abs(told_ns - true_ns) > case.slack_ns:
            yield f"{what} {row} is told {(told_ns - true_ns) / 1000:.0f} us off"


def _in_order(rows: Sequence[Timed]) -> list[Timed]:
    return sorted(rows, key=lambda each: (repr(each[1]), each[0]))


def boot_ups(case: Case, node: int) -> list[BootUpTruth]:
    return [boot for boot in case.truth.boot_ups if boot.node == node and case.heard(boot.t_ns)]


def falls(case: Case, node: int) -> int:
    """Falls to PRE-OPERATIONAL of a device that boots with 7Fh: they look like restarts."""
    return sum(
        each.node == node and each.id == "nmt.left_operational" and bool(each.or_as)
        for each in case.truth.findings
    )


def twins(case: Case) -> set[int]:
    """Numbers that two devices carry."""
    return {f.node for f in case.scenario.faults if isinstance(f, DuplicateNode)}


def clear(case: Case, start_ns: int, end_ns: int) -> bool:
    """Whether a stretch lies well outside of what the recorder did not hear."""
    near = 600 * MS
    return not any(start_ns < end + near and end_ns > start - near for start, end in case.deaf)
