"""Which segments are deleted to make room: the oldest that are whole and not marked."""

from collections.abc import Sequence
from dataclasses import dataclass

from syncline_logger.manifest import Manifest, Segment
from syncline_logger.running_time import DAY_NS

SPLITS_OF_KEEP = 20
"""A budget without a split size is kept in so many segments."""
SMALLEST_SPLIT = 1_000_000
EARLIEST_NS = 1_577_836_800_000_000_000
"""2020-01-01: what is dated earlier was recorded by a machine that did not know the date."""


@dataclass(frozen=True, slots=True)
class Keep:
    """How much a recorder may leave in its folder; None = no limit.

    Attributes:
        size_bytes: of all its recordings there, the running one with them.
        age_ns: segments that ended longer ago, by the date and by the time recorded since, are
            deleted.
        reserve_bytes: what is left free on the disk for others.
    """

    size_bytes: int | None = None
    age_ns: int | None = None
    reserve_bytes: int | None = None

    def __bool__(self) -> bool:
        return any(
            limit is not None for limit in (self.size_bytes, self.age_ns, self.reserve_bytes)
        )

    @property
    def split_bytes(self) -> int | None:
        """Size of segments where the user says none: only whole ones can be deleted."""
        room = self.reserve_bytes if self.size_bytes is None else self.size_bytes
        return None if room is None else max(room // SPLITS_OF_KEEP, SMALLEST_SPLIT)


@dataclass(frozen=True, slots=True)
class Surplus:
    """A segment that goes, and why."""

    manifest: Manifest
    segment: Segment
    why: str


def surplus(
    recordings: Sequence[Manifest],
    keep: Keep,
    *,
    now_ns: int,
    writing_bytes: int = 0,
    free_bytes: int | None = None,
    needed_bytes: int = 0,
    ran_ns: int = 0,
) -> list[Surplus]:
    """The segments to delete, the oldest first; never more than the limits ask for.

    Args:
        recordings: own ones alone, in the order in which they were made.
        now_ns: log time.
        writing_bytes: size of the file that is being written; it counts and stays.
        free_bytes: free on the disk now; None where nobody knows.
        needed_bytes: must be free whatever the user says, because the disk refused a write.
        ran_ns: how long the file that is being written has been, whatever the date did.
    """
    total = writing_bytes + sum(
        segment.bytes for each in recordings for segment in each.segments if _stands(segment)
    )
    reserve = max(keep.reserve_bytes or 0, needed_bytes)
    ages = _recorded_since(recordings, ran_ns)
    chosen = []
    for manifest in recordings:
        for segment in sorted(manifest.segments, key=lambda each: each.segment):
            if segment.state != "closed" or segment.marks:
                continue
            ended_ns = max(segment.end_ns or 0, now_ns - ages[segment.file])
            undated = (segment.end_ns or 0) < EARLIEST_NS
            age_ns = 0 if undated else now_ns - ended_ns
            why = _why(keep, total, age_ns, free_bytes, reserve)
            if why:
                chosen.append(Surplus(manifest, segment, why))
                total -= segment.bytes
                free_bytes = None if free_bytes is None else free_bytes + segment.bytes
    return chosen


def _stands(segment: Segment) -> bool:
    return segment.state != "writing"


def _recorded_since(recordings: Sequence[Manifest], ran_ns: int) -> dict[str, int]:
    """By file, how long recorders have run since it ended; pauses count for a day at most.

    A date that was wrong for a while, or that comes late, makes nothing old.
    """
    since: dict[str, int] = {}
    begun_ns = None
    for manifest in reversed(recordings):
        ends = [manifest.end_ns, *(each.end_ns for each in manifest.segments)]
        ended_ns = max((end for end in ends if end is not None), default=None)
        if begun_ns is not None and ended_ns is not None:
            ran_ns += min(max(begun_ns - ended_ns, 0), DAY_NS)
        begun_ns = manifest.created_ns
        for segment in sorted(manifest.segments, key=lambda each: -each.segment):
            since[segment.file] = ran_ns
            ran_ns += _ran_ns(segment)
    return since


def _ran_ns(segment: Segment) -> int:
    if segment.ran_ns is not None:
        return max(segment.ran_ns, 0)
    return min(max((segment.end_ns or 0) - (segment.start_ns or 0), 0), DAY_NS)


def _why(
    keep: Keep,
    total: int,
    age_ns: int,
    free_bytes: int | None,
    reserve_bytes: int,
) -> str:
    if keep.size_bytes is not None and total > keep.size_bytes:
        return "the recordings are larger than allowed"
    if free_bytes is not None and free_bytes < reserve_bytes:
        return "the disk is nearly full"
    if keep.age_ns is not None and age_ns > keep.age_ns:
        return "it is older than allowed"
    return ""
