"""Gaps that a disk which refused to the end kept out of every capture, on their way to the next one."""

from collections.abc import Iterable, Mapping

from syncline_logger.gap_notes import join_into
from syncline_logger.manifest import UntoldGap
from syncline_schemas.batch import Gap

MAX_UNTOLD = 200
"""Reasons by bus; the rest is joined."""


def untold_of(gaps: Iterable[Gap], names: Mapping[int, str]) -> list[UntoldGap]:
    """Gaps for the manifest, those of one bus and reason joined; `names` by bus number."""
    found: dict[tuple[int | None, str], Gap] = {}
    for gap in gaps:
        join_into(found, gap, MAX_UNTOLD)
    return [
        UntoldGap(
            gap.start_ns,
            gap.end_ns,
            gap.reason,
            gap.lost_frames,
            None if gap.bus is None else names.get(gap.bus),
        )
        for gap in sorted(found.values(), key=lambda each: each.start_ns)
    ]


def told_of(untold: UntoldGap, numbers: Mapping[str, int]) -> Gap:
    """The gap in a recording whose buses have these numbers, by name."""
    bus = None if untold.bus is None else numbers.get(untold.bus)
    return Gap(untold.start_ns, untold.end_ns, untold.reason, untold.lost_frames, bus)
