"""Which files are captures, which are one recording, and of which machine."""

import gzip
import io
import os
import random
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("fsspec")

import fsspec
import zstandard

from syncline_analyzer.fleet.gathering import recordings_of
from syncline_analyzer.fleet.machine import MachineRule
from syncline_analyzer.fleet.recording import File, Recording
from syncline_analyzer.fleet.source import find_captures
from syncline_analyzer.fleet.storage import open_storage
from syncline_analyzer.fleet_options import fleet_extra
from syncline_schemas.errors import MissingExtraError, UsageError
from tests.analyzer.fleet.fleet_builder import T0_NS, small_log, small_mcap


def found(*sources: str, out: str = "/nowhere/out") -> list[str]:
    return [each.url for each in find_captures(sources, open_storage(out))]


def gathered(folder: Path, rule: str | None = None) -> list[Recording]:
    files = find_captures([str(folder)], open_storage("/nowhere/out"))
    return recordings_of(files, MachineRule.of(rule))


def names(recordings: list[Recording]) -> list[list[str]]:
    return [[Path(file.url).name for file in each.files] for each in recordings]


@pytest.fixture
def bucket() -> Iterator[fsspec.AbstractFileSystem]:
    """An object store in memory."""
    fs = fsspec.filesystem("memory")
    fs.store.clear()
    yield fs
    fs.store.clear()


def test_folders_globs_and_files_give_captures_by_their_endings(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.LOG.gz", "c.txt", "d.html", "x/e.blf", "x/day.dat", "f.part.mcap"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"x")
    root = tmp_path.as_posix()
    everything = ["a.mcap", "b.LOG.gz", "c.txt", "f.part.mcap", "x/e.blf"]
    assert found(str(tmp_path)) == [f"{root}/{name}" for name in everything]
    assert found(f"{root}/**") == found(str(tmp_path))
    assert found(f"{root}/x/*.dat", f"{root}/a.mcap") == [f"{root}/a.mcap", f"{root}/x/day.dat"]
    assert found(str(tmp_path), out=f"{root}/x") == [f"{root}/{n}" for n in everything[:-1]]
    with pytest.raises(UsageError, match="is not there"):
        found(f"{root}/missing")
    with pytest.raises(UsageError, match="nosuch://x"):
        found("nosuch://x")
    with pytest.raises(UsageError, match="is not there"):
        found(str(tmp_path / "*.nothing"))


def test_what_is_surely_a_capture_is_known_by_ending_or_by_name(tmp_path: Path) -> None:
    log = small_log(tmp_path / "a.log")
    small_mcap(tmp_path / "b.mcap")
    out = open_storage("/nowhere/out")
    assert [each.sure for each in find_captures([str(tmp_path)], out)] == [False, True]
    assert [each.sure for each in find_captures([str(log)], out)] == [True]


def test_an_object_store_is_listed_with_what_tells_a_change(
    bucket: fsspec.AbstractFileSystem, tmp_path: Path
) -> None:
    content = small_mcap(tmp_path / "a.mcap", recording_id="one").read_bytes()
    bucket.pipe_file("/line/press/a.mcap", content)
    bucket.pipe_file("/line/fleet/old.mcap", content)
    files = find_captures(["memory://line/**"], open_storage("memory://line/fleet"))
    assert [each.url for each in files] == ["memory:///line/press/a.mcap"]
    assert files[0].size_bytes == len(content)
    (recording,) = recordings_of(files, MachineRule())
    assert (recording.machine, recording.files[0].recording_id) == ("press", "one")


def test_segments_of_one_recording_belong_together_wherever_they_are(tmp_path: Path) -> None:
    for segment in (2, 0, 1):
        folder = tmp_path / f"2026-03-0{segment + 2}"
        at_ns = T0_NS + segment * 10**12
        small_mcap(
            folder / f"{segment}.mcap", recording_id="3f2a", segment=segment, created_ns=at_ns
        )
    small_mcap(tmp_path / "x" / "other.mcap", recording_id="77aa")
    small_log(tmp_path / "x" / "night.log")
    recordings = gathered(tmp_path)
    assert names(recordings) == [["0.mcap", "1.mcap", "2.mcap"], ["night.log"], ["other.mcap"]]
    assert [bool(each.capture_id) for each in recordings] == [True, False, True]
    assert recordings[0].machine == "2026-03-02"


def test_a_capture_id_stays_when_segments_come(tmp_path: Path) -> None:
    small_mcap(tmp_path / "a.mcap", recording_id="3f2a")
    (before,) = gathered(tmp_path)
    small_mcap(tmp_path / "b.mcap", recording_id="3f2a", segment=1, created_ns=T0_NS + 10**12)
    (after,) = gathered(tmp_path)
    assert before.capture_id == after.capture_id
    assert before.capture_id.startswith("c")


def test_copies_of_a_segment_are_read_once_the_largest_one(tmp_path: Path) -> None:
    small_mcap(tmp_path / "cut.mcap", recording_id="3f2a", frames=5)
    small_mcap(tmp_path / "whole.mcap", recording_id="3f2a", frames=500)
    (recording,) = gathered(tmp_path)
    assert [Path(file.url).name for file in recording.files] == ["whole.mcap"]
    assert [Path(file.url).name for file in recording.copies] == ["cut.mcap"]


def test_of_equal_copies_the_oldest_is_read(tmp_path: Path) -> None:
    first = small_mcap(tmp_path / "press-3" / "a.mcap", recording_id="a1")
    copy = tmp_path / "backup" / "a.mcap"
    copy.parent.mkdir()
    copy.write_bytes(first.read_bytes())
    os.utime(copy, ns=(T0_NS, first.stat().st_mtime_ns + 10**9))
    [recording] = gathered(tmp_path)
    assert recording.machine == "press-3"
    assert [file.url for file in recording.copies] == [copy.as_posix()]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are text")
def test_a_name_that_is_no_utf_8_is_told_as_text(tmp_path: Path) -> None:
    folder = os.fsencode(tmp_path) + b"/m\xfc"
    os.mkdir(folder)
    with open(folder + b"/a.mcap", "wb") as stream:
        stream.write(b"x")
    [recording] = gathered(tmp_path)
    assert recording.files[0].url.endswith("m\\udcfc/a.mcap")


def test_a_data_set_is_no_file(tmp_path: Path) -> None:
    path = tmp_path / "out"
    path.write_bytes(b"x")
    with pytest.raises(UsageError, match="is a file"):
        open_storage(str(path))


def test_equal_ids_by_chance_stay_apart(tmp_path: Path) -> None:
    for machine, at_ns in (("press", T0_NS), ("winder", T0_NS + 5)):
        for segment in (0, 1):
            small_mcap(
                tmp_path / machine / f"{machine}{segment}.mcap",
                recording_id="3f2a",
                segment=segment,
                created_ns=at_ns + segment * 100,
            )
    recordings = gathered(tmp_path)
    assert names(recordings) == [["press0.mcap", "press1.mcap"], ["winder0.mcap", "winder1.mcap"]]
    assert len({each.capture_id for each in recordings}) == 2
    # Of another gateway it is another recording anyway.
    small_mcap(tmp_path / "lift" / "lift.mcap", recording_id="3f2a", host="other")
    assert len(gathered(tmp_path)) == 3


def test_files_that_do_not_tell_when_they_were_begun_are_no_copies(tmp_path: Path) -> None:
    small_mcap(tmp_path / "a.mcap", recording_id="benchmark", created_ns=0)
    small_mcap(tmp_path / "b.mcap", recording_id="benchmark", created_ns=0, frames=30)
    recordings = gathered(tmp_path)
    assert names(recordings) == [["a.mcap"], ["b.mcap"]]
    assert [each.capture_id for each in recordings] == ["", ""]


@pytest.mark.parametrize("pack", [gzip.compress, zstandard.compress], ids=["gzip", "zstd"])
def test_packed_captures_tell_their_recording(tmp_path: Path, pack: object) -> None:
    raw = small_mcap(tmp_path / "a.mcap", recording_id="3f2a", frames=5000)
    assert callable(pack)
    (tmp_path / "b.mcap.gz").write_bytes(pack(raw.read_bytes()))
    raw.unlink()
    (recording,) = gathered(tmp_path)
    assert recording.files[0].recording_id == "3f2a"


def test_a_killed_recording_and_one_with_large_attachments_tell_theirs(tmp_path: Path) -> None:
    from syncline_schemas.capture.layout import Attachment, CaptureMetadata
    from syncline_schemas.capture.writer import CaptureWriter

    noise = random.Random(1).randbytes(200_000)
    stream = io.BytesIO()
    CaptureWriter(
        stream,
        CaptureMetadata("test", "cut", host="gateway"),
        [],
        attachments=[Attachment("a.eds", "text/x-canopen-eds", noise)],
    )
    (tmp_path / "a.mcap").write_bytes(stream.getvalue())
    (recording,) = gathered(tmp_path)
    assert recording.files[0].recording_id == "cut"


def test_an_unchanged_file_is_not_opened_again(tmp_path: Path) -> None:
    path = small_mcap(tmp_path / "a.mcap", recording_id="3f2a")
    files = find_captures([str(path)], open_storage("/nowhere/out"))
    each = files[0]
    known = File(each.url, each.size_bytes, each.modified_ns, recording_id="as known")
    (recording,) = recordings_of(files, MachineRule(), {each.url: known})
    assert recording.files[0].recording_id == "as known"
    changed = File(each.url, each.size_bytes + 1, each.modified_ns, recording_id="as known")
    (recording,) = recordings_of(files, MachineRule(), {each.url: changed})
    assert recording.files[0].recording_id == "3f2a"


@pytest.mark.parametrize(
    ("rule", "url", "machine"),
    [
        (None, "/data/press-3/a.mcap", "press-3"),
        ("{machine}/{date}", "/data/press-3/2026-03-01/a.mcap", "press-3"),
        ("{machine}/*/raw", "s3://b/press-3/2026/raw/a.mcap", "press-3"),
        ("{machine}_{date}.mcap", "/data/press-3_0301.mcap", "press-3"),
        (r"line-(?P<machine>\d+)", "/data/line-17/x/a.mcap", "17"),
        ("{machine}/{date}/{more}/{deep}/{deeper}", "/a/b.mcap", "a"),
        ("host", "/data/x/a.mcap", "gateway-9"),
    ],
)
def test_rules_for_the_name_of_the_machine(rule: str | None, url: str, machine: str) -> None:
    assert MachineRule.of(rule).machine(url, host="gateway-9")[0] == machine


def test_what_the_recorder_was_told_counts_more_than_the_folder() -> None:
    assert MachineRule.of(None).machine("/x/y/a.mcap", told="press 3") == ("press 3", "recorder")
    with pytest.raises(UsageError, match="names no machine"):
        MachineRule.of("{date}")
    with pytest.raises(UsageError, match="is no pattern"):
        MachineRule.of("(?P<machine>")


def test_a_missing_package_is_said_with_what_to_type() -> None:
    with pytest.raises(MissingExtraError, match=r'pip install "syncline\[fleet\]"'), fleet_extra():
        raise ModuleNotFoundError("no module named dask", name="dask")
