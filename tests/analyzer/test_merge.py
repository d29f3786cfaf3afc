"""Several files as one session: order, gaps, and buses that only share a name."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.merge import BETWEEN_FILES, Merge
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.errors import UsageError


class Recorded:
    """A capture in memory: frames at these times on one bus, in batches of two."""

    def __init__(
        self, *times: int, bus: str = "can0", name: str = "a.log", dated: bool = True
    ) -> None:
        self.facts = CaptureFacts(Path(name), "test", [bus], "utc" if dated else "relative")
        self.times = times

    def batches(self) -> Iterator[FrameBatch | Gap]:
        for at in range(0, len(self.times), 2):
            rows = [(t, 0, 0x701, 0, 1, b"\x05") for t in self.times[at : at + 2]]
            yield FrameBatch.from_rows(rows)


def frames_of(merge: Merge) -> list[tuple[int, str]]:
    return [
        (int(t), merge.buses[bus])
        for item in merge.stream()
        if isinstance(item, FrameBatch)
        for t, bus in zip(item.t_ns, item.bus, strict=True)
    ]


def test_segments_join_in_time_order_with_a_gap_between() -> None:
    merge = Merge([Recorded(50, 60, name="b.log"), Recorded(10, 20, 30)])
    items = list(merge.stream())
    assert [g for g in items if isinstance(g, Gap)] == [Gap(30, 50, BETWEEN_FILES, None, 0)]
    assert [int(t) for b in items if isinstance(b, FrameBatch) for t in b.t_ns] == [
        10,
        20,
        30,
        50,
        60,
    ]
    assert merge.buses == ["can0"]


def test_overlapping_files_keep_their_buses_apart() -> None:
    merge = Merge([Recorded(10, 20, 30, 40), Recorded(15, 35, name="b.log")])
    assert frames_of(merge) == [
        (10, "can0"), (15, "can0 (b.log)"), (20, "can0"), (30, "can0"),
        (35, "can0 (b.log)"), (40, "can0"),
    ]  # fmt: skip


def test_different_buses_interleave_without_a_gap() -> None:
    merge = Merge([Recorded(10, 30), Recorded(20, 40, bus="can1", name="b.log")])
    items = list(merge.stream())
    assert not any(isinstance(item, Gap) for item in items)
    assert merge.buses == ["can0", "can1"]


def test_a_step_back_inside_a_file_is_kept() -> None:
    assert [t for t, _ in frames_of(Merge([Recorded(10, 5, 7, 20)]))] == [10, 5, 7, 20]


def test_undated_logs_cannot_be_joined() -> None:
    with pytest.raises(UsageError, match=r"a\.log has no dates"):
        Merge([Recorded(1, dated=False), Recorded(2, name="b.log")])
