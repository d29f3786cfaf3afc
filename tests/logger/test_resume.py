"""The start after a cut: the broken file is finished, the pause is a gap, nothing keeps it from starting."""

import json
import os
import threading
from pathlib import Path

import pytest

from syncline_logger.manifest import Manifest
from syncline_logger.recording_folder import strangers_without_end
from syncline_logger.retention import Keep
from syncline_logger.segments import Split
from syncline_logger.triggers.plan import TriggerPlan
from syncline_schemas.batch import Gap
from syncline_schemas.capture.gap_message import DID_NOT_RUN
from syncline_schemas.capture.record_file import RawChunk, RecordFile
from syncline_schemas.capture.recover import is_whole
from tests.logger.capture_contents import doctor_complaints
from tests.logger.store_runs import (
    FailingDisk,
    Run,
    S,
    files_of,
    gaps_in,
    numbers_in,
)

PAUSE = 3600 * S


def killed(folder: Path, steps: int = 5, **options: object) -> Run:
    """A recording that was killed: no stop, no summary, and nothing said to the manifest."""
    run = Run(folder, **({"recording_id": "old"} | options))  # type: ignore[arg-type]
    return run.step(steps).kill()


def next_run(folder: Path, after: Run, **options: object) -> Run:
    """The next recording in this folder, an hour later."""
    defaults = {"recording_id": "new", "resumes": True, "start_ns": after.now_ns + PAUSE}
    return Run(folder, **(defaults | options))  # type: ignore[arg-type]


def of(folder: Path, recording_id: str) -> list[Path]:
    return [path for path in files_of(folder) if f"_{recording_id}" in path.name]


@pytest.mark.parametrize("split", [None, 60_000])
def test_a_cut_file_is_finished_in_its_place(tmp_path: Path, split: int | None) -> None:
    before = killed(tmp_path, split=Split(split))
    run = next_run(tmp_path, before, split=Split(split)).step(2)
    run.finish()
    [path] = of(tmp_path, "old")
    assert not path.name.endswith(".part.mcap")
    assert is_whole(path)
    assert doctor_complaints(path) == []
    assert numbers_in(path) == list(range(500))
    manifest = Manifest.from_json((tmp_path / "old.json").read_text(encoding="utf-8"))
    assert manifest is not None
    assert [(each.state, each.file, each.frames) for each in manifest.segments] == [
        ("closed", path.name, 500)
    ]
    assert numbers_in(*of(tmp_path, "new")) == list(range(200))
    assert len(files_of(tmp_path)) == 2


def test_the_pause_is_a_gap(tmp_path: Path) -> None:
    before = killed(tmp_path)
    next_run(tmp_path, before).step(2).finish()
    last_ns = before.now_ns - 1
    assert gaps_in(*of(tmp_path, "new")) == [Gap(last_ns, before.now_ns + PAUSE, DID_NOT_RUN)]


def test_the_pause_after_a_regular_end_is_a_gap_too(tmp_path: Path) -> None:
    before = Run(tmp_path, recording_id="old").step(2)
    before.finish()
    next_run(tmp_path, before).step(1).finish()
    [gap] = gaps_in(*of(tmp_path, "new"))
    assert (gap.start_ns, gap.end_ns) == (before.now_ns, before.now_ns + PAUSE)


def test_no_gap_after_a_recording_of_other_buses(tmp_path: Path) -> None:
    before = killed(tmp_path, buses=("x",))
    next_run(tmp_path, before).step(1).finish()
    assert gaps_in(*of(tmp_path, "new")) == []


def test_a_pause_of_unknown_length_where_the_clock_is_behind(tmp_path: Path) -> None:
    before = killed(tmp_path)
    result = next_run(tmp_path, before, start_ns=S).step(1).finish()
    assert gaps_in(*of(tmp_path, "new")) == [Gap(S, S, DID_NOT_RUN)]
    assert any("behind the end of the last recording" in text for text in result.problems)


def test_no_gap_where_nothing_was_recorded_before(tmp_path: Path) -> None:
    run = Run(tmp_path, resumes=True).step(1)
    run.finish()
    assert gaps_in(*files_of(tmp_path)) == []


def test_what_another_machine_recorded_is_left_alone_with_its_manifest(tmp_path: Path) -> None:
    before = killed(tmp_path, steps=5, split=Split(6_000))
    manifest = tmp_path / "old.json"
    manifest.write_text(
        manifest.read_text(encoding="utf-8").replace('"host": "here"', '"host": "away"'),
        encoding="utf-8",
    )
    for path in files_of(tmp_path):
        path.write_bytes(path.read_bytes().replace(b"here", b"away"))
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    keep = Keep(size_bytes=1, age_ns=1)
    next_run(tmp_path, before, split=Split(6_000), keep=keep).step(20).finish()
    assert {name: (tmp_path / name).read_bytes() for name in kept} == kept


@pytest.mark.parametrize("keep_bytes", [0, 1, 8, 30, 200, 3000, -1, -7, -200, -2500])
def test_however_the_file_was_cut_the_next_recording_starts(
    tmp_path: Path, keep_bytes: int
) -> None:
    before = killed(tmp_path)
    [path] = files_of(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[:keep_bytes])
    run = next_run(tmp_path, before).step(1)
    run.finish()
    assert numbers_in(*of(tmp_path, "new")) == list(range(100))
    [old] = of(tmp_path, "old")
    found = numbers_in(old)
    assert found == list(range(len(found)))
    if keep_bytes < 0:
        assert len(found) == (400 if keep_bytes == -2500 else 500)
        assert is_whole(old)


def test_a_tail_of_zeros_is_no_harm(tmp_path: Path) -> None:
    """What a power cut may leave of a write that was on its way."""
    before = killed(tmp_path)
    [path] = files_of(tmp_path)
    with path.open("ab") as file:
        file.write(bytes(5000))
    next_run(tmp_path, before).step(1).finish()
    assert numbers_in(*of(tmp_path, "old")) == list(range(500))
    assert is_whole(*of(tmp_path, "old"))


@pytest.mark.parametrize("content", [b"", b"x" * 5000, b"\x89MCAP0\r\n" + bytes(3000), b"{}"])
def test_strangers_in_the_folder_are_left_alone(tmp_path: Path, content: bytes) -> None:
    names = ["20251009T085320Z_abcd.mcap", "20251009T085320Z_abcd_0001.part.mcap", "old.json"]
    for name in names:
        (tmp_path / name).write_bytes(content)
    Run(tmp_path, resumes=True).step(2).finish()
    for name in names:
        assert (tmp_path / name).read_bytes() == content
    assert numbers_in(*of(tmp_path, "id")) == list(range(200))


def test_a_damaged_chunk_inside_keeps_the_original(tmp_path: Path) -> None:
    before = killed(tmp_path, steps=9)
    [path] = files_of(tmp_path)
    data = bytearray(path.read_bytes())
    with path.open("rb") as file:
        chunks = [each for each in RecordFile(file).records() if isinstance(each, RawChunk)]
    for chunk in chunks[2:5:2]:
        data[chunk.offset + 100 : chunk.offset + 140] = bytes(40)
    path.write_bytes(data)
    next_run(tmp_path, before).step(1).finish()
    [old] = of(tmp_path, "old")
    assert is_whole(old)
    assert path.with_name(path.name + ".damaged").read_bytes() == data
    assert gaps_in(old)


def test_a_cut_file_of_another_machine_is_left_alone(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    before = killed(elsewhere)
    [path] = files_of(elsewhere)
    here = tmp_path / "here"
    here.mkdir()
    data = path.read_bytes().replace(b"here", b"away")
    (here / path.name).write_bytes(data)
    next_run(here, before).step(1).finish()
    assert (here / path.name).read_bytes() == data


def test_manifests_that_are_missing_are_made_anew(tmp_path: Path) -> None:
    around = TriggerPlan(before_ns=3 * S, after_ns=0)
    before = Run(tmp_path, recording_id="old", split=Split(6_000), triggers=around).step(10)
    before.recording.mark("trigger", before.now_ns)
    before.step(1).finish()
    wanted = json.loads((tmp_path / "old.json").read_text(encoding="utf-8"))
    (tmp_path / "old.json").unlink()
    next_run(tmp_path, before).step(1).finish()
    found = json.loads((tmp_path / "old.json").read_text(encoding="utf-8"))
    names = ("segment", "file", "state", "start_ns", "end_ns", "frames", "bytes")
    assert [[each[name] for name in names] for each in found["segments"]] == [
        [each[name] for name in names] for each in wanted["segments"]
    ]
    marked = [bool(each["marks"]) for each in found["segments"]]
    assert marked == [bool(each["marks"]) for each in wanted["segments"]]
    assert sum(marked) > 1
    assert not all(marked)
    assert (found["buses"], found["host"]) == (["a"], "here")


def test_a_file_that_another_recorder_is_writing_is_left_alone(tmp_path: Path) -> None:
    running = Run(tmp_path, recording_id="old").step(3)
    next_run(tmp_path, running).step(1).finish()
    running.step(3).finish()
    assert numbers_in(*of(tmp_path, "old")) == list(range(600))


def test_the_original_stays_until_the_new_file_is_on_the_disk(tmp_path: Path) -> None:
    before = killed(tmp_path, split=Split(60_000))
    disk = FailingDisk()
    next_run(tmp_path, before, disk=disk).finish()
    old = [what for what, name in disk.done if "_old_" in name]
    assert old.index("replace") < old.index("remove")


def test_too_little_room_leaves_the_cut_file_as_it_is(tmp_path: Path) -> None:
    before = killed(tmp_path)
    [path] = files_of(tmp_path)
    data = path.read_bytes()
    run = next_run(tmp_path, before, disk=FailingDisk(free=1000)).step(1)
    assert "no room" in " ".join(run.finish().problems)
    assert path.read_bytes() == data


def test_the_end_of_a_long_cut_file_is_found_from_behind(tmp_path: Path) -> None:
    before = killed(tmp_path, steps=60)
    [path] = files_of(tmp_path)
    with path.open("rb") as file:
        assert RecordFile(file).last_chunk_end_ns() == before.now_ns - 1


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_what_is_no_file_blocks_no_start(tmp_path: Path) -> None:
    strange = ["x.mcap", "y.json", "20200101T000000Z_id.mcap", "z.mcap.recovering"]
    for name in strange:
        os.mkfifo(tmp_path / name)
        (tmp_path / f"d{name}").mkdir()
    os.mkfifo(tmp_path / "x.trigger")
    (tmp_path / "loop.mcap").symlink_to("loop.mcap")
    (tmp_path / "fifo.mcap").symlink_to("x.mcap")
    (tmp_path / "garbage.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    (tmp_path / "20200101T000000Z_garbage.mcap").write_bytes(b"no capture at all")
    before = sorted(tmp_path.iterdir())

    def start() -> None:
        assert strangers_without_end(tmp_path) == [tmp_path / "garbage.mcap"]
        Run(tmp_path, resumes=True, split=Split(6_000), keep=Keep(size_bytes=10**6)).step(
            3
        ).finish()

    thread = threading.Thread(target=start, daemon=True)
    thread.start()
    thread.join(20)
    assert not thread.is_alive()
    assert set(before) <= set(tmp_path.iterdir())
    assert len(numbers_in(*tmp_path.glob("*_id_*.mcap"))) == 300
