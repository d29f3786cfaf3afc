"""A disk that is full, read-only or broken: the recorder goes on, and every frame is accounted for."""

import errno
import json
import os
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.merge import Merge
from syncline_analyzer.readers.mcap import McapReader
from syncline_logger import waiting_room
from syncline_logger.finishing import finish_file
from syncline_logger.manifest import Manifest
from syncline_logger.notes import Note
from syncline_logger.retention import Keep
from syncline_logger.segments import Split, is_part
from syncline_logger.triggers.event_store import EventStore
from syncline_logger.triggers.plan import TriggerPlan
from syncline_schemas.batch import Gap
from syncline_schemas.capture.gap_message import DID_NOT_RUN
from syncline_schemas.capture.recover import is_whole
from tests.logger.capture_contents import doctor_complaints, read_capture
from tests.logger.store_runs import (
    FULL,
    FailingDisk,
    Run,
    S,
    files_of,
    gaps_in,
    is_sorted,
    lost_in,
    numbers_in,
)


@pytest.fixture(autouse=True)
def small_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only 500 frames may wait."""
    monkeypatch.setattr(waiting_room.WaitingRoom.__init__, "__defaults__", _small_defaults())


def _small_defaults() -> tuple[object, ...]:
    defaults = waiting_room.WaitingRoom.__init__.__defaults__
    assert defaults is not None
    return tuple(500 if each == waiting_room.MAX_WAITING_FRAMES else each for each in defaults)


def in_trouble(
    number: int, operation: str, run_steps: int, target: Path
) -> tuple[Run, FailingDisk]:
    """A recording on a disk that refuses from its fourth step on."""
    disk = FailingDisk()
    run = Run(target, disk=disk).step(3)
    disk.refusal = lambda what, path: number if what == operation else 0
    run.step(run_steps)
    return run, disk


@pytest.mark.parametrize("operation", ["write", "sync"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_a_short_trouble_costs_no_frame(tmp_path: Path, operation: str, number: int) -> None:
    run, disk = in_trouble(number, operation, 3, tmp_path)
    disk.refusal = lambda what, path: 0
    result = run.step(20).finish()
    files = files_of(tmp_path)
    assert numbers_in(*files) == list(range(run.sent))
    assert (result.lost_frames, result.files) == (0, 2)
    assert any("disk cannot be written" in text for text in result.problems)
    assert any("can be written again" in text for text in result.problems)


@pytest.mark.parametrize("operation", ["write", "sync", "create"])
def test_a_long_trouble_is_a_gap_with_its_count(tmp_path: Path, operation: str) -> None:
    disk = FailingDisk()
    run = Run(tmp_path, disk=disk).step(3)
    disk.refusal = lambda what, path: (
        FULL if what == operation or (operation == "create" and what == "write") else 0
    )
    for n in range(100):
        run.per_step = 30 if n % 3 == 0 else 100
        run.step()
    assert run.store.waiting.frames <= 500
    disk.refusal = lambda what, path: 0
    result = run.step(40).finish()
    files = files_of(tmp_path)
    found = numbers_in(*files)
    assert is_sorted(found)
    assert len(found) + lost_in(*files) == run.sent
    assert result.lost_frames == lost_in(*files) > 6000
    [gap] = gaps_in(*files)
    assert gap.bus == 0
    assert gap.reason == "the disk cannot be written: No space left on device"
    missing = sorted(set(range(run.sent)) - set(found))
    assert missing == list(range(missing[0], missing[-1] + 1))
    assert read_capture(files[-1]).values("/can/a/status")[-1].dropped_disk == result.lost_frames


def test_the_status_says_so(tmp_path: Path) -> None:
    run, disk = in_trouble(FULL, "write", 2, tmp_path)
    snapshot = run.recording.snapshot(run.now_ns)
    assert snapshot.trouble == "the disk cannot be written: No space left on device"
    disk.refusal = lambda what, path: 0
    assert run.step(3).recording.snapshot(run.now_ns).trouble == ""


def test_it_tries_again_at_growing_intervals(tmp_path: Path) -> None:
    run, disk = in_trouble(FULL, "write", 0, tmp_path)
    disk.done.clear()
    run.step(200)
    tries = sum(what == "create" for what, _ in disk.done)
    assert 5 < tries < 20


def test_tries_leave_no_files_behind(tmp_path: Path) -> None:
    in_trouble(FULL, "sync", 200, tmp_path)
    assert len(files_of(tmp_path)) == 1


def test_a_file_that_cannot_be_taken_away_is_not_in_the_way(tmp_path: Path) -> None:
    disk = FailingDisk()
    run = Run(tmp_path, disk=disk).step(3)
    disk.refusal = lambda what, path: FULL if what in ("write", "remove") else 0
    run.step(30)
    disk.refusal = lambda what, path: 0
    run.step(70).finish()
    files = [path for path in files_of(tmp_path) if path.stat().st_size > 0]
    assert len(numbers_in(*files)) + lost_in(*files) == run.sent


def test_what_was_written_before_is_kept_to_the_last_chunk(tmp_path: Path) -> None:
    run, _ = in_trouble(errno.EIO, "write", 1, tmp_path)
    [path] = files_of(tmp_path)
    assert numbers_in(path) == list(range(300))
    assert run.sent == 400


def test_a_disk_that_is_full_to_the_end_is_said_in_the_result(tmp_path: Path) -> None:
    run, _ = in_trouble(FULL, "write", 50, tmp_path)
    result = run.finish()
    assert result.lost_frames + len(numbers_in(*files_of(tmp_path))) == run.sent
    assert any("the disk" in text for text in result.problems)


def test_a_disk_that_is_full_from_the_start_does_not_keep_it_from_recording(tmp_path: Path) -> None:
    disk = FailingDisk(lambda what, path: FULL if what == "write" else 0)
    run = Run(tmp_path, disk=disk).step(2)
    disk.refusal = lambda what, path: 0
    run.step(3).finish()
    assert numbers_in(*files_of(tmp_path)) == list(range(500))


def test_a_folder_without_the_right_to_write_is_an_error(tmp_path: Path) -> None:
    disk = FailingDisk(lambda what, path: errno.EACCES if what == "create" else 0)
    with pytest.raises(PermissionError):
        Run(tmp_path, disk=disk)


def test_a_segment_that_cannot_be_opened_lets_the_last_one_go_on(tmp_path: Path) -> None:
    disk = FailingDisk()
    run = Run(tmp_path, disk=disk, split=Split(size_bytes=6_000)).step(1)
    disk.refusal = lambda what, path: errno.EMFILE if what == "create" else 0
    run.step(20)
    assert len(files_of(tmp_path)) == 1
    disk.refusal = lambda what, path: 0
    run.step(5).finish()
    assert numbers_in(*files_of(tmp_path)) == list(range(2600))


def test_a_segment_that_cannot_be_closed_is_cut_and_loses_nothing(tmp_path: Path) -> None:
    disk = FailingDisk()
    run = Run(tmp_path, disk=disk, split=Split(size_bytes=6_000)).step(5)
    first = files_of(tmp_path)[-1].name
    failing = iter([errno.EIO])
    seen: set[str] = set()

    def refuse(what: str, path: Path) -> int:
        closing = path.name == first and len({n for w, n in disk.done if w == "create"}) > 1
        seen.add(path.name)
        return next(failing, 0) if what == "sync" and closing and len(seen) > 1 else 0

    disk.refusal = refuse
    run.step(20).finish()
    assert numbers_in(*files_of(tmp_path)) == list(range(2500))


def test_a_cut_segment_is_finished_where_the_disk_confirmed_it(tmp_path: Path) -> None:
    """The chunk whose sync failed stands in the next file; it must not come back from the first."""
    disk = FailingDisk()
    run = Run(tmp_path, disk=disk).step(3)
    disk.refusal = lambda what, path: errno.EIO if what in ("sync", "truncate") else 0
    run.step(1)
    disk.refusal = lambda what, path: 0
    run.step(5).finish()
    manifest = Manifest.from_json((tmp_path / "id.json").read_text(encoding="utf-8"))
    assert manifest is not None
    cut = manifest.segments[0]
    assert cut.state == "cut"
    finish_file("id", cut, tmp_path, disk)
    assert numbers_in(*files_of(tmp_path)) == list(range(run.sent))
    assert doctor_complaints(files_of(tmp_path)[0]) == []


def test_gaps_of_the_time_of_trouble_are_written_later(tmp_path: Path) -> None:
    run, disk = in_trouble(FULL, "write", 20, tmp_path)
    unplugged = Gap(run.now_ns, run.now_ns + S, "unplugged", None, 0)
    run.recording.add_gap(unplugged, run.now_ns)
    run.recording.mark("somebody pressed a button", run.now_ns)
    run.step(10)
    disk.refusal = lambda what, path: 0
    run.step(40).finish()
    assert unplugged in gaps_in(*files_of(tmp_path))
    marks = read_capture(files_of(tmp_path)[-1]).values("/recorder/mark")
    assert [mark.reason for mark in marks] == ["somebody pressed a button"]


def test_a_manifest_that_cannot_be_written_is_written_later(tmp_path: Path) -> None:
    disk = FailingDisk(lambda what, path: errno.EIO if what == "text" else 0)
    run = Run(tmp_path, disk=disk, split=Split(size_bytes=6_000)).step(10)
    assert not (tmp_path / "id.json").exists()
    disk.refusal = lambda what, path: 0
    run.finish()
    manifest = json.loads((tmp_path / "id.json").read_text(encoding="utf-8"))
    assert sum(each["frames"] for each in manifest["segments"]) == 1000


@pytest.mark.skipif(not hasattr(os, "fstatvfs"), reason="POSIX alone")
def test_a_sync_on_a_disk_that_became_read_only_is_no_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ext4's fsync returns 0 after an emergency remount, although nothing is written any more."""
    run = Run(tmp_path).step(2)
    real = os.fstatvfs

    def read_only(fd: int) -> SimpleNamespace:
        return SimpleNamespace(f_flag=real(fd).f_flag | os.ST_RDONLY)

    monkeypatch.setattr(os, "fstatvfs", read_only)
    run.step(3)
    assert run.store.trouble is not None
    assert "Read-only" in run.store.trouble.text
    monkeypatch.setattr(os, "fstatvfs", real)
    result = run.step(5).finish()
    assert result.lost_frames == 0
    assert numbers_in(*files_of(tmp_path)) == list(range(run.sent))


OPERATIONS = ("create", "write", "sync", "truncate", "close", "replace", "remove", "text")


@settings(max_examples=60, deadline=None)
@given(
    troubles=st.lists(
        st.tuples(
            st.sets(st.sampled_from(OPERATIONS), max_size=4),
            st.sampled_from([errno.ENOSPC, errno.EIO, errno.EROFS]),
            st.integers(1, 40),
        ),
        max_size=6,
    ),
    split=st.sampled_from([None, 8_000]),
    keep=st.sampled_from([Keep(), Keep(size_bytes=25_000)]),
    healed=st.booleans(),
)
def test_whatever_the_disk_does_every_frame_is_recorded_or_reported(
    tmp_path_factory: pytest.TempPathFactory,
    troubles: list[tuple[set[str], int, int]],
    split: int | None,
    keep: Keep,
    healed: bool,
) -> None:
    folder = tmp_path_factory.mktemp("trouble")
    disk = FailingDisk()
    run = Run(folder, disk=disk, split=Split(split), keep=keep, sync=True).step(2)
    for operations, number, steps in troubles:
        disk.refusal = lambda what, path, o=operations, n=number: n if what in o else 0  # type: ignore[misc]
        run.step(steps)
    if healed:
        disk.refusal = lambda what, path: 0
        run.step(40)
    result = run.finish()
    disk.refusal = lambda what, path: 0
    manifest = Manifest.from_json((folder / "id.json").read_text(encoding="utf-8"))
    if healed:
        assert manifest is not None
        for segment in [each for each in manifest.segments if each.state == "cut"]:
            finish_file("id", segment, folder, disk)
    files = [path for path in files_of(folder) if path.stat().st_size > 0]
    found = numbers_in(*files)
    deleted = run.store._manifest.deleted_frames
    accounted = len(set(found)) + deleted + result.lost_frames
    assert accounted >= run.sent
    # A chunk that the disk refused half-way and did not let be cut off may be readable after all.
    if healed or not any("truncate" in operations for operations, _, _ in troubles):
        assert accounted == run.sent
    if healed:
        assert is_sorted(found)
    # The file that told of the losses may have been deleted to make room.
    if healed and not deleted:
        assert lost_in(*files) == result.lost_frames


def test_a_folder_that_was_removed_is_made_again(tmp_path: Path) -> None:
    folder = tmp_path / "captures"
    run, disk = in_trouble(errno.EIO, "write", 2, folder)
    folder.rename(tmp_path / "gone")
    disk.refusal = lambda what, path: 0
    run.step(5).finish()
    assert numbers_in(*files_of(folder)) == list(range(300, run.sent))


def test_a_reserve_that_cannot_be_kept_is_told_once(tmp_path: Path) -> None:
    run = Run(tmp_path, disk=FailingDisk(free=10), keep=Keep(reserve_bytes=1000)).step(40)
    told = [text for text in run.finish().problems if "than the reserve" in text]
    assert len(told) == 1
    assert numbers_in(*files_of(tmp_path)) == list(range(run.sent))


def test_a_reserve_alone_splits_by_itself() -> None:
    assert Keep(reserve_bytes=200_000_000).split_bytes == 10_000_000


@pytest.mark.parametrize(("ring_bytes", "loses"), [(3_000, True), (10_000_000, False)])
def test_an_event_waits_in_the_ring_while_the_disk_refuses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ring_bytes: int, loses: bool
) -> None:
    monkeypatch.setattr(waiting_room, "MAX_WAITING_CONTENTS", 3)
    disk = FailingDisk()
    plan = TriggerPlan(only=True, before_ns=8 * S, after_ns=3 * S, ring_bytes=ring_bytes)
    run = Run(tmp_path, disk=disk, triggers=plan).step(2)
    run.recording.mark("asked", run.now_ns)
    run.step(1)
    disk.refusal = lambda what, path: FULL if what == "write" else 0
    run.step(20)
    store = run.recording.store
    assert isinstance(store, EventStore)
    assert store._ring.bytes <= ring_bytes
    assert store.waiting.frames <= 300
    disk.refusal = lambda what, path: 0
    run.step(40).finish()
    paths = files_of(tmp_path)
    found, gone = numbers_in(*paths), lost_in(*paths)
    assert bool(gone) == loses
    assert len(found) + gone == found[-1] - found[0] + 1
    assert found[0] == 0
    told = json.loads(next(tmp_path.glob("*.json")).read_text(encoding="utf-8"))
    assert told["lost_frames"] == gone
    assert [bool(gap.lost_frames) for gap in gaps_in(*paths)] == [True] * loses


@pytest.mark.parametrize("kept_files", [0, 1, 2])
def test_tries_that_wrote_nothing_are_no_missing_segments(tmp_path: Path, kept_files: int) -> None:
    """A disk with room for the head of a file only; some such files cannot be taken away."""
    disk = FailingDisk()
    run = Run(tmp_path, disk=disk, per_step=10).step(3)
    tries, synced = 0, False

    def refuse(what: str, path: Path) -> int:
        nonlocal tries, synced
        if what == "create":
            tries, synced = tries + 1, False
        refused = (what == "write" and synced) or (what == "remove" and tries <= kept_files)
        synced = synced or what == "sync"
        return FULL if refused else 0

    disk.refusal = refuse
    run.step(20)
    disk.refusal = lambda what, path: 0
    run.step(60).finish()
    files = [path for path in files_of(tmp_path) if numbers_in(path)]
    assert tries > 3
    assert files == files_of(tmp_path)
    merged = list(Merge([McapReader(path) for path in files]).stream())
    assert [each for each in merged if isinstance(each, Gap)] == []
    assert numbers_in(*files) == list(range(run.sent))


def merged_gaps(*paths: Path) -> list[Gap]:
    """What the analysis of these captures says of stretches in which nothing was heard."""
    merged = Merge([McapReader(path) for path in paths]).stream()
    return [each for each in merged if isinstance(each, Gap)]


@pytest.mark.parametrize("between", [0, 1])
def test_what_a_disk_that_stays_full_costs_stands_in_the_next_capture(
    tmp_path: Path, between: int
) -> None:
    """Also where the recording between writes nothing at all."""
    run, disk = in_trouble(FULL, "write", 20, tmp_path)
    full_text = "the disk cannot be written: No space left on device"
    first = run.finish()
    begun_ns = [run.now_ns + 60 * S]
    runs = [run]
    for n in range(between):
        again = Run(
            tmp_path, disk=disk, recording_id=f"full{n}", resumes=True, start_ns=begun_ns[-1]
        )
        again.step(10).finish()
        runs.append(again)
        begun_ns.append(again.now_ns + 60 * S)
    last = Run(tmp_path, recording_id="next", resumes=True, start_ns=begun_ns[-1]).step(2)
    runs.append(last)
    result = last.finish()
    files = files_of(tmp_path)
    found = merged_gaps(*files)
    expected = [(full_text, each.sent - (300 if each is run else 0)) for each in runs[:-1]]
    assert [(gap.reason, gap.lost_frames) for gap in found if gap.lost_frames] == expected
    pauses = [gap for gap in found if gap.reason == DID_NOT_RUN]
    assert [(gap.start_ns, gap.end_ns) for gap in pauses] == [
        (each.now_ns, begun) for each, begun in zip(runs, begun_ns, strict=False)
    ]
    assert len(found) == len(expected) + len(pauses)
    assert first.lost_frames + 300 == run.sent
    assert result.lost_frames == 0
    assert len(numbers_in(*files)) + lost_in(*files) == sum(each.sent for each in runs)
    third = Run(tmp_path, recording_id="third", resumes=True, start_ns=last.now_ns + S).step(1)
    third.finish()
    assert lost_in(*files_of(tmp_path)) == lost_in(*files)


def test_a_disk_without_room_for_a_second_manifest_keeps_what_was_lost(tmp_path: Path) -> None:
    disk = FailingDisk()
    run = Run(tmp_path, disk=disk).step(3)
    disk.refusal = lambda what, path: FULL if what in ("write", "text") else 0
    run.step(10).finish()
    Run(tmp_path, recording_id="next", resumes=True, start_ns=run.now_ns + S).step(1).finish()
    assert lost_in(*files_of(tmp_path)) == 1000
    assert [gap.start_ns for gap in merged_gaps(*files_of(tmp_path))][1] == run.now_ns


def test_what_the_stop_costs_is_a_serious_note(tmp_path: Path) -> None:
    run, _ = in_trouble(FULL, "write", 5, tmp_path)
    notes: list[Note] = []
    run.recording._on_note = notes.append
    result = run.finish()
    assert [each.serious for each in notes if "500 frames" in each.text] == [True]
    assert (result.gap_count, result.lost_frames) == (1, 500)


def test_gaps_that_come_while_the_disk_refuses_keep_their_numbers(tmp_path: Path) -> None:
    disk = FailingDisk()
    run = Run(tmp_path, disk=disk, per_step=1).step(3)
    run.store.waiting.max_frames = 20
    disk.refusal = lambda what, path: FULL if what == "write" else 0
    for n in range(1500):
        reason = f"lines of the adapter were damaged {n % 3}"
        run.recording.add_gap(Gap(run.now_ns, run.now_ns + 5, reason, 2, 0), run.now_ns)
        run.step()
    disk.refusal = lambda what, path: 0
    result = run.step(60).finish()
    files = files_of(tmp_path)
    damaged = [gap for gap in gaps_in(*files) if "damaged" in gap.reason]
    assert sum(gap.lost_frames or 0 for gap in damaged) == 3000
    assert len(numbers_in(*files)) + lost_in(*files) == run.sent + 3000
    assert result.lost_frames == lost_in(*files)


def stop_of(folder: Path, event: int) -> int:
    """Lost frames in the manifest of an event."""
    [path] = folder.glob(f"*-{event:04d}.json")
    return int(json.loads(path.read_text(encoding="utf-8"))["lost_frames"])


def test_an_event_tells_its_own_losses_only(tmp_path: Path) -> None:
    disk = FailingDisk()
    plan = TriggerPlan((), True, 5 * S, 5 * S, 4_000)
    run = Run(tmp_path, disk=disk, triggers=plan).step(10)
    run.recording.mark("one", run.now_ns - 1)
    run.step(2)
    disk.refusal = lambda what, path: FULL
    run.step(30)
    disk.refusal = lambda what, path: 0
    run.step(40)
    run.recording.add_gap(Gap(run.now_ns, run.now_ns + 5, "between", 7, 0), run.now_ns)
    run.step(10)
    for reason in ("two", "three"):
        run.recording.mark(reason, run.now_ns - 1)
        run.step(2 if reason == "three" else 30)
    result = run.finish()
    lost = lost_in(*files_of(tmp_path))
    assert lost > 100
    assert [stop_of(tmp_path, event) for event in range(3)] == [lost, 0, 0]
    assert result.lost_frames == lost + 7
    assert run.recording.store.refused_frames == {0: lost}


@pytest.mark.parametrize("back", [False, True])
def test_an_event_whose_file_cannot_be_begun_is_tried_again_and_accounted_for(
    tmp_path: Path, back: bool
) -> None:
    disk = FailingDisk()
    plan = TriggerPlan((), True, 5 * S, 5 * S, 4_000)
    run = Run(tmp_path, disk=disk, triggers=plan).step(10)
    disk.refusal = lambda what, path: errno.EACCES if what == "create" else 0
    run.recording.mark("one", run.now_ns - 1)
    run.step(100)
    assert sum(what == "create" for what, _ in disk.done) < 12
    snapshot = run.recording.snapshot(run.now_ns)
    assert snapshot.trouble == "the disk cannot be written: Permission denied"
    if back:
        disk.refusal = lambda what, path: 0
        run.step(40)
    result = run.finish()
    assert len(result.problems) < 5
    assert result.lost_frames > 5000
    found = numbers_in(*files_of(tmp_path))
    first = 500
    if back:
        assert len(found) + lost_in(*files_of(tmp_path)) == found[-1] + 1 - first
        return
    later = Run(tmp_path, recording_id="next", resumes=True, start_ns=run.now_ns + S).step(1)
    later.finish()
    assert lost_in(*files_of(tmp_path)) == result.lost_frames


@pytest.mark.parametrize("only", [False, True])
def test_a_file_that_could_not_be_closed_is_finished_while_the_recorder_runs(
    tmp_path: Path, only: bool
) -> None:
    disk = FailingDisk()
    plan = TriggerPlan((), only, 5 * S, 60 * S, 10**8)
    run = Run(tmp_path, disk=disk, triggers=plan, split=Split(None, 10 * S), resumes=True)
    run.step(8).recording.mark("one", run.now_ns - 1)
    disk.refusal = lambda what, path: FULL if what == "close" else 0
    run.step(7)
    disk.refusal = lambda what, path: 0
    assert "close" in [what for what, _ in disk.done]
    for _ in range(40):
        run.step()
        time.sleep(0.005)
    *earlier, running = files_of(tmp_path)
    assert len(earlier) > 2
    assert [path.name for path in earlier if is_part(path)] == []
    assert is_part(running)
    run.finish()
    assert all(map(is_whole, files_of(tmp_path)))
