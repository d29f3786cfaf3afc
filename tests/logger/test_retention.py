"""Room for what is new: the oldest whole segments go, and nothing else ever does."""

import json
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from syncline_logger.clock import ClockReading
from syncline_logger.manifest import Manifest, MarkNote, Segment
from syncline_logger.retention import Keep, surplus
from syncline_logger.segments import Split
from syncline_logger.triggers.plan import TriggerPlan
from tests.logger.store_runs import T0, FailingDisk, Run, S, files_of, is_sorted, numbers_in

DAY = 86_400 * S


def recording(
    *sizes: int, number: int = 1, marked: tuple[int, ...] = (), first: int = 0, **values: Any
) -> Manifest:
    """A recording of whole segments of these sizes, which ended 1, 2, 3 ... days after T0."""
    segments = [
        Segment(
            first + n,
            f"r{number}_{first + n}.mcap",
            "closed",
            T0 + n * DAY,
            T0 + (n + 1) * DAY,
            1,
            size,
        )
        for n, size in enumerate(sizes)
    ]
    for n in marked:
        segments[n].mark(MarkNote(0, "trigger"))
    return Manifest(f"r{number}", number, segments=segments, **values)


def deleted(*recordings: Manifest, keep: Keep, **values: Any) -> list[str]:
    found = surplus(recordings, keep, **{"now_ns": T0 + 10 * DAY, "ran_ns": 10 * DAY, **values})
    return [each.segment.file for each in found]


def test_the_oldest_go_until_the_budget_is_kept() -> None:
    assert deleted(recording(10, 10, 10, 10), keep=Keep(size_bytes=25)) == [
        "r1_0.mcap",
        "r1_1.mcap",
    ]


def test_earlier_recordings_go_first() -> None:
    old, new = recording(10, 10), recording(10, 10, number=2)
    assert deleted(old, new, keep=Keep(size_bytes=30)) == ["r1_0.mcap"]


def test_a_marked_segment_stays_and_the_next_one_goes() -> None:
    marked = recording(10, 10, 10, marked=(0,))
    assert deleted(marked, keep=Keep(size_bytes=20)) == ["r1_1.mcap"]


@pytest.mark.parametrize("state", ["writing", "cut", "unreadable"])
def test_only_whole_segments_go(state: Any) -> None:
    busy = recording(10, 10)
    busy.segments[0].state = state
    assert deleted(busy, keep=Keep(size_bytes=1)) == ["r1_1.mcap"]


def test_what_is_being_written_counts() -> None:
    assert deleted(recording(10, 10), keep=Keep(size_bytes=30), writing_bytes=15) == ["r1_0.mcap"]


def test_the_reserve_is_left_free() -> None:
    whole = recording(10, 10, 10)
    assert deleted(whole, keep=Keep(reserve_bytes=100), free_bytes=85) == ["r1_0.mcap", "r1_1.mcap"]
    assert deleted(whole, keep=Keep(reserve_bytes=100), free_bytes=100) == []
    assert deleted(whole, keep=Keep(reserve_bytes=100), free_bytes=None) == []


def test_what_is_too_old_goes() -> None:
    assert deleted(recording(1, 1, 1), keep=Keep(age_ns=8 * DAY)) == ["r1_0.mcap"]


def test_a_clock_that_was_set_back_makes_nothing_old() -> None:
    assert deleted(recording(1, 1, 1), keep=Keep(age_ns=DAY), now_ns=0) == []


def test_the_age_is_the_time_recorded_since() -> None:
    whole = recording(1, 1, 1)
    assert deleted(whole, keep=Keep(age_ns=8 * DAY), ran_ns=5 * DAY) == []
    assert deleted(whole, keep=Keep(age_ns=8 * DAY), ran_ns=7 * DAY) == ["r1_0.mcap"]


def test_a_pause_between_recordings_counts_for_a_day_at_most() -> None:
    old, new = recording(1), recording(1, number=2, created_ns=T0 + 30 * DAY)
    assert deleted(old, new, keep=Keep(age_ns=5 * DAY), now_ns=T0 + 40 * DAY, ran_ns=2 * DAY) == []


HOUR = 3600 * S


@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("ahead_ns", [30 * DAY, 5 * 365 * DAY])
def test_a_date_that_goes_ahead_makes_nothing_old(
    tmp_path: Path, ahead_ns: int, told: bool
) -> None:
    """A wrong step forward, and the right date that comes late, look the same."""
    options: dict[str, Any] = {"split": Split(time_ns=HOUR), "keep": Keep(age_ns=14 * DAY)}
    before = Run(tmp_path, recording_id="old", per_step=2, step_ns=HOUR, **options).step(5)
    before.finish()
    run = Run(tmp_path, per_step=2, step_ns=HOUR, start_ns=before.now_ns, **options).step(5)
    if told:
        reading = ClockReading(run.now_ns, run.now_ns, ahead_ns, offset_ns=ahead_ns)
        run.recording.add_clock(reading, run.now_ns)
    run.now_ns += ahead_ns
    result = run.step(5).finish()
    assert numbers_in(*files_of(tmp_path)) == [*range(10), *range(20)]
    assert any("went ahead" in text for text in result.problems)


def test_a_wrong_date_at_the_start_makes_nothing_old(tmp_path: Path) -> None:
    options: dict[str, Any] = {"split": Split(time_ns=HOUR), "keep": Keep(age_ns=14 * DAY)}
    before = Run(tmp_path, recording_id="old", per_step=2, step_ns=HOUR, **options).step(5)
    before.finish()
    start_ns = before.now_ns + 1000 * DAY
    Run(tmp_path, per_step=2, step_ns=HOUR, start_ns=start_ns, **options).step(5).finish()
    assert len(numbers_in(*files_of(tmp_path))) == 20


def test_what_was_recorded_long_enough_ago_goes(tmp_path: Path) -> None:
    options: dict[str, Any] = {"split": Split(time_ns=HOUR), "keep": Keep(age_ns=10 * HOUR)}
    Run(tmp_path, per_step=2, step_ns=HOUR, **options).step(40).finish()
    found = numbers_in(*files_of(tmp_path))
    assert found[-1] == 79
    assert 10 <= len(found) // 2 <= 13


def test_what_was_recorded_before_the_date_was_known_is_not_old() -> None:
    undated = recording(1)
    undated.segments[0].end_ns = DAY
    assert deleted(undated, keep=Keep(age_ns=DAY)) == []


@given(
    sizes=st.lists(st.integers(1, 100), max_size=20),
    budget=st.integers(0, 1000),
    marked=st.sets(st.integers(0, 19)),
)
def test_never_more_than_the_budget_asks_for(
    sizes: list[int], budget: int, marked: set[int]
) -> None:
    kept = tuple(n for n in marked if n < len(sizes))
    whole = recording(*sizes, marked=kept)
    gone = surplus([whole], Keep(size_bytes=budget), now_ns=0)
    left = sum(sizes) - sum(each.segment.bytes for each in gone)
    assert is_sorted([each.segment.segment for each in gone])
    assert not {each.segment.segment for each in gone} & set(kept)
    if gone:
        assert left + gone[-1].segment.bytes > budget
    if left > budget:
        assert len(gone) == len(sizes) - len(kept)


def test_a_recorder_keeps_its_budget_and_its_manifest_tells(tmp_path: Path) -> None:
    keep = Keep(size_bytes=400_000)
    run = Run(tmp_path, per_step=1000, split=Split(60_000), keep=keep).step(100)
    run.finish()
    files = files_of(tmp_path)
    assert sum(path.stat().st_size for path in files) < 410_000
    found = numbers_in(*files)
    assert found == list(range(found[0], run.sent))
    manifest = json.loads((tmp_path / "id.json").read_text(encoding="utf-8"))
    assert manifest["deleted_frames"] == found[0]
    assert manifest["deleted_segments"] == int(files[0].stem[-4:])
    assert manifest["deletions"][-1]["why"] == "the recordings are larger than allowed"
    assert [each["file"] for each in manifest["segments"]] == [path.name for path in files]


def test_strangers_are_never_deleted(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    Run(elsewhere, recording_id="precious").step(20).finish()
    [precious] = files_of(elsewhere)
    folder = tmp_path / "captures"
    folder.mkdir()
    strangers = {
        "renamed.mcap": precious.read_bytes(),
        "20200101T000000Z_away.mcap": precious.read_bytes(),
        "20200101T000000Z_none_0001.mcap": b"not an MCAP file",
        "notes.txt": b"call the customer",
        "id2.json": b"{}",
    }
    for name, content in strangers.items():
        (folder / name).write_bytes(content)
    Run(folder, split=Split(6_000), keep=Keep(size_bytes=7_000)).step(40).finish()
    assert {name: (folder / name).read_bytes() for name in strangers} == strangers


def test_a_file_that_was_replaced_by_another_is_not_deleted(tmp_path: Path) -> None:
    run = Run(tmp_path, split=Split(6_000), keep=Keep(size_bytes=30_000)).step(8)
    first = files_of(tmp_path)[0]
    Run(tmp_path / "elsewhere", recording_id="precious").step(2).finish()
    [precious] = files_of(tmp_path / "elsewhere")
    first.write_bytes(precious.read_bytes())
    run.step(60).finish()
    assert first.read_bytes() == precious.read_bytes()


def test_a_marked_segment_of_an_earlier_recording_stays(tmp_path: Path) -> None:
    alone = TriggerPlan(before_ns=0, after_ns=0)
    before = Run(tmp_path, recording_id="old", split=Split(6_000), triggers=alone).step(6)
    before.recording.mark("EMCY 8130h", before.now_ns)
    before.step(6).finish()
    [marked] = [
        tmp_path / each["file"]
        for each in json.loads((tmp_path / "old.json").read_text(encoding="utf-8"))["segments"]
        if each["marks"]
    ]
    (tmp_path / "old.json").unlink()
    keep = Keep(size_bytes=20_000)
    Run(tmp_path, start_ns=before.now_ns, split=Split(6_000), keep=keep).step(40).finish()
    assert [path for path in files_of(tmp_path) if "_old_" in path.name] == [marked]


@pytest.mark.parametrize("killed", [False, True])
def test_what_lies_before_a_mark_stays_without_its_manifest(tmp_path: Path, killed: bool) -> None:
    around = TriggerPlan(before_ns=4 * S, after_ns=2 * S)
    before = Run(tmp_path, recording_id="old", split=Split(6_000), triggers=around).step(12)
    before.recording.mark("EMCY 8130h", before.now_ns)
    before.step(1)
    if killed:
        before.kill()
    else:
        before.step(11).finish()
    told = json.loads((tmp_path / "old.json").read_text(encoding="utf-8"))["segments"]
    marked = [each["file"].replace(".part", "") for each in told if each["marks"]]
    assert 2 < len(marked) < len(told)
    (tmp_path / "old.json").unlink()
    keep = Keep(size_bytes=20_000)
    after = Run(tmp_path, start_ns=before.now_ns, split=Split(6_000), keep=keep, resumes=True).step(
        40
    )
    after.finish()
    assert [path.name for path in files_of(tmp_path) if "_old_" in path.name] == marked


def test_all_files_of_an_event_stay(tmp_path: Path) -> None:
    only = TriggerPlan(before_ns=4 * S, after_ns=8 * S, only=True)
    run = Run(tmp_path, split=Split(6_000), keep=Keep(size_bytes=7_000), triggers=only).step(5)
    run.recording.mark("EMCY 8130h", run.now_ns)
    run.step(20).finish()
    [path] = tmp_path.glob("*.json")
    told = json.loads(path.read_text(encoding="utf-8"))
    assert len(told["segments"]) > 3
    assert all(each["marks"] for each in told["segments"])
    assert told["deletions"] == []


def test_a_disk_that_is_full_gets_room_by_deleting(tmp_path: Path) -> None:
    disk = FailingDisk()
    run = Run(tmp_path, disk=disk, split=Split(6_000), keep=Keep(reserve_bytes=1_000)).step(30)
    before = len(files_of(tmp_path))
    disk.free = 0
    disk.refusal = lambda what, path: 28 if what == "write" and disk.free == 0 else 0
    run.step(1)

    def freed(what: str, path: Path) -> int:
        if what == "remove":
            disk.free = 100_000
        return 28 if what == "write" and disk.free == 0 else 0

    disk.refusal = freed
    result = run.step(5).finish()
    files = files_of(tmp_path)
    found = numbers_in(*files)
    assert found == list(range(found[0], run.sent))
    assert len(files) < before
    manifest = json.loads((tmp_path / "id.json").read_text(encoding="utf-8"))
    assert len(found) + manifest["deleted_frames"] + result.lost_frames == run.sent
    assert result.lost_frames == 0
    assert manifest["deletions"][-1]["why"] == "the disk is nearly full"


def test_manifests_of_empty_recordings_go(tmp_path: Path) -> None:
    before = Run(tmp_path, recording_id="old").step(20)
    before.finish()
    keep = Keep(size_bytes=10_000)
    Run(tmp_path, start_ns=before.now_ns, split=Split(5_000), keep=keep).step(20).finish()
    assert [path.name for path in tmp_path.glob("*.json")] == ["id.json"]


def test_without_limits_nothing_is_deleted(tmp_path: Path) -> None:
    Run(tmp_path, split=Split(6_000), disk=FailingDisk(free=0)).step(40).finish()
    assert numbers_in(*files_of(tmp_path)) == list(range(4000))


def test_a_budget_alone_splits_by_itself(tmp_path: Path) -> None:
    run = Run(tmp_path, per_step=20_000, keep=Keep(size_bytes=4_000_000)).step(40)
    run.finish()
    assert len(files_of(tmp_path)) > 1


@pytest.mark.parametrize("killed", [False, True])
def test_marks_keep_what_lies_around_them_over_a_restart(tmp_path: Path, killed: bool) -> None:
    """Those before the mark are of the recording before, those after it of the one that follows."""
    around = TriggerPlan((), False, 20 * S, 20 * S)
    options: dict[str, Any] = {
        "per_step": 20,
        "split": Split(None, 10 * S),
        "resumes": True,
        "triggers": around,
        "sync": False,
    }
    first = Run(tmp_path, recording_id="one", **options).step(55)
    first.finish()
    second = Run(tmp_path, recording_id="two", start_ns=first.now_ns + S, **options).step(3)
    second.recording.mark("x", second.now_ns - 1)
    second.step(1)
    if killed:
        second.kill()
    else:
        second.finish()
    keep = Keep(size_bytes=1)
    third = Run(tmp_path, recording_id="three", start_ns=second.now_ns + S, keep=keep, **options)
    for _ in range(60):
        third.step()
        time.sleep(0.002)
    third.finish()
    left = [path.name.split("_", 1)[1].removesuffix(".mcap") for path in files_of(tmp_path)]
    assert left == ["one_0003", "one_0004", "one_0005", "two_0000", "three_0000", "three_0001"] + [
        each for each in left if each > "three_0001" and each.startswith("three")
    ]
    assert "three_0003" not in left
