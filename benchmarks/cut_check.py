"""What captures hold after their recorder was killed: every frame intact, in order, or reported."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from benchmarks.numbered_source import COB_ID
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.scan import CaptureScan


@dataclass(frozen=True)
class Found:
    """The numbered frames of one recording, over all of its files.

    Attributes:
        frames: how many there are.
        lost: frames that its gaps report.
        intact: whether they are 0, 1, 2 ... but for what the gaps report; these may tell of more,
            that was lost behind the last one.
        whole: files with an end, and `files` in all.
    """

    frames: int
    lost: int
    intact: bool
    whole: int
    files: int


def look_at(folder: Path, recording_id: str) -> Found:
    """What a recording's files hold, in the order of their segments."""
    numbers: list[int] = []
    lost = whole = 0
    strange = False
    paths = sorted(folder.glob(f"*_{recording_id}*.mcap"))
    for path in paths:
        scan = CaptureScan(path)
        for item in scan.batches():
            if isinstance(item, FrameBatch):
                numbers += item.data[:, :8].copy().view("<u8").ravel().tolist()
                strange |= bool((item.can_id != COB_ID).any() or (item.dlc != 8).any())
            elif isinstance(item, Gap):
                lost += item.lost_frames or 0
        whole += scan.facts.closed
    jumps = [b - a - 1 for a, b in pairwise(numbers)]
    started = numbers[0] if numbers else 0
    in_order = all(jump >= 0 for jump in jumps)
    intact = not strange and in_order and started + sum(jumps) <= lost
    return Found(len(numbers), lost, intact, whole, len(paths))
