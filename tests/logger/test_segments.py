"""A recording in several files: nothing is lost or doubled between them, and each opens alone."""

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_logger.segments import Split
from syncline_schemas.capture.scan import CaptureScan
from syncline_schemas.description import BusDescription
from syncline_schemas.errors import UsageError
from tests.logger.capture_contents import doctor_complaints, read_capture
from tests.logger.store_runs import MS, T0, FailingDisk, Run, S, files_of, numbers_in

MINUTE = 60 * S
HOUR_NS = T0 - T0 % (60 * MINUTE)
"""A full hour of UTC."""


def test_segments_hold_every_frame_once_and_in_order(tmp_path: Path) -> None:
    run = Run(tmp_path, per_step=1000, split=Split(size_bytes=60_000)).step(50)
    result = run.finish()
    files = files_of(tmp_path)
    assert len(files) == result.files > 5
    assert numbers_in(*files) == list(range(50_000))
    assert all(path.stat().st_size < 70_000 for path in files)


def test_segments_end_at_full_periods_of_the_clock(tmp_path: Path) -> None:
    run = Run(
        tmp_path,
        start_ns=HOUR_NS + 3 * MINUTE + 7 * S,
        step_ns=23 * S,
        split=Split(None, 5 * MINUTE),
    )
    run.step(40).finish()
    files = files_of(tmp_path)
    stamps = [
        [message[0] for message in read_capture(path).messages["/can/a/frames"]] for path in files
    ]
    periods = [[t // (5 * MINUTE) for t in times] for times in stamps]
    assert all(len(set(each)) == 1 for each in periods)
    assert [each[0] for each in periods] == list(range(periods[0][0], periods[0][0] + len(periods)))
    assert [path.name[9:15] for path in files[:3]] == [
        f"{(HOUR_NS // (60 * MINUTE)) % 24:02d}{minute}" for minute in ("0307", "0500", "1000")
    ]


def test_a_quiet_bus_is_split_on_time_too(tmp_path: Path) -> None:
    run = Run(tmp_path, start_ns=HOUR_NS, per_step=1, step_ns=100 * S, split=Split(None, MINUTE))
    run.step(3).finish()
    assert len(files_of(tmp_path)) >= 3
    assert numbers_in(*files_of(tmp_path)) == [0, 1, 2]


def test_the_next_segment_opens_before_the_last_one_closes(tmp_path: Path) -> None:
    disk = FailingDisk()
    Run(tmp_path, disk=disk, split=Split(size_bytes=6_000)).step(20).finish()
    moments = [(what, name) for what, name in disk.done if what in ("create", "close")]
    assert [what for what, _ in moments[:3]] == ["create", "create", "close"]
    assert moments[2][1] == moments[0][1]


def test_each_segment_opens_alone(tmp_path: Path) -> None:
    described = BusDescription.loads('[bus.a.node.10]\ndevice = "jn2100"\n')
    Run(tmp_path, description=described, split=Split(size_bytes=60_000)).step(20).finish()
    files = files_of(tmp_path)
    assert len(files) > 2
    for number, path in enumerate(files):
        assert doctor_complaints(path) == []
        contents = read_capture(path)
        about = contents.metadata["syncline"]
        assert (about["recording_id"], about["segment"]) == ("id", str(number))
        assert contents.attachments["jn2100.eds"] == described.files["jn2100.eds"]
        assert contents.metadata["syncline.device.a.node10"]["device"] == "jn2100"


def test_only_a_whole_file_has_its_final_name(tmp_path: Path) -> None:
    run = Run(tmp_path, split=Split(size_bytes=6_000)).step(20)
    whole = [CaptureScan(path).facts.closed for path in files_of(tmp_path)]
    parts = [path.name.endswith(".part.mcap") for path in files_of(tmp_path)]
    assert whole == [not part for part in parts]
    assert parts.count(True) == 1
    run.finish()
    assert not any(path.name.endswith(".part.mcap") for path in files_of(tmp_path))


def test_a_named_file_is_split_under_its_name(tmp_path: Path) -> None:
    Run(tmp_path / "x.mcap", split=Split(size_bytes=6_000)).step(10).finish()
    assert [path.name for path in files_of(tmp_path)][:2] == ["x_0000.mcap", "x_0001.mcap"]


def test_segments_never_overwrite(tmp_path: Path) -> None:
    (tmp_path / "x_0000.mcap").write_bytes(b"precious")
    with pytest.raises(UsageError, match="exists"):
        Run(tmp_path / "x.mcap", split=Split(size_bytes=6_000))
    assert (tmp_path / "x_0000.mcap").read_bytes() == b"precious"


def test_an_unsplit_recording_is_one_file_of_the_old_name(tmp_path: Path) -> None:
    Run(tmp_path / "x.mcap").step(3).finish()
    assert [path.name for path in tmp_path.iterdir()] == ["x.mcap"]


def test_the_manifest_tells_of_every_segment(tmp_path: Path) -> None:
    run = Run(tmp_path, split=Split(size_bytes=6_000)).step(20)
    result = run.finish()
    manifest = json.loads((tmp_path / "id.json").read_text(encoding="utf-8"))
    files = files_of(tmp_path)
    assert [each["file"] for each in manifest["segments"]] == [path.name for path in files]
    assert [each["bytes"] for each in manifest["segments"]] == [p.stat().st_size for p in files]
    assert sum(each["frames"] for each in manifest["segments"]) == result.frame_count == 2000
    assert result.frames_written == 2000
    assert {each["state"] for each in manifest["segments"]} == {"closed"}
    assert (manifest["reason"], manifest["end_ns"]) == ("stopped", run.now_ns)
    assert all(
        first["end_ns"] <= second["start_ns"]
        for first, second in zip(manifest["segments"], manifest["segments"][1:], strict=False)
    )


@settings(max_examples=25, deadline=None)
@given(
    sizes=st.lists(st.integers(1, 400), min_size=1, max_size=12),
    size=st.none() | st.integers(3_000, 40_000),
    period_ms=st.none() | st.integers(300, 9_000),
)
def test_however_it_is_split_the_frames_are_the_same(
    tmp_path_factory: pytest.TempPathFactory,
    sizes: list[int],
    size: int | None,
    period_ms: int | None,
) -> None:
    folder = tmp_path_factory.mktemp("split")
    period = None if period_ms is None else period_ms * MS
    for_all = Run(folder, split=Split(size, period), sync=False)
    for count in sizes:
        for_all.per_step = count
        for_all.step()
    for_all.finish()
    assert numbers_in(*files_of(folder)) == list(range(sum(sizes)))


@pytest.mark.parametrize(
    ("target", "names"),
    [("x.mcap", ["x.mcap", "x_0001.mcap"]), ("", ["_id.mcap", "_id_0001.mcap"])],
)
def test_an_unsplit_recording_goes_on_before_its_index_fills_the_memory(
    tmp_path: Path, target: str, names: list[str]
) -> None:
    limit = 20_000
    run = Run(tmp_path / target, split=Split(index_bytes=limit))
    largest = 0
    for _ in range(400):
        open_file = run.step().store._open
        assert open_file is not None
        largest = max(largest, open_file.file.index_bytes)
    result = run.finish()
    files = files_of(tmp_path)
    assert limit / 2 < largest < limit + 1000
    assert result.files == len(files) >= 3
    assert (
        sorted(path.name[-len(name) :] for path, name in zip(files, names, strict=False)) == names
    )
    assert numbers_in(*files) == list(range(run.sent))
    assert all(doctor_complaints(path) == [] for path in files)
