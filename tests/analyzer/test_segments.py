"""A recording that was split tells the same as one that was not; each part of it opens alone."""

import random
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.merge import Merge
from syncline_analyzer.session import open_session
from syncline_analyzer.views.json_view import to_object
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder import record_batches
from syncline_logger.recording import Recording
from syncline_logger.segments import Split
from syncline_logger.triggers.plan import TriggerPlan
from syncline_samples.machine import Run
from syncline_samples.scenarios import bad_day, healthy_line
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.gap_message import DID_NOT_RUN
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.description import BusDescription

S = 1_000_000_000


@cache
def day() -> tuple[Run, list[FrameBatch | Gap]]:
    """A day on which everything goes wrong, and what was on the bus."""
    run = bad_day(110).start()
    return run, list(run.stream())


def recorded(target: Path, split: Split, recording_id: str = "day") -> None:
    run, stream = day()
    options = RecordOptions(
        description=BusDescription.loads(run.description_toml),
        sync=False,
        recording_id=recording_id,
        split=split,
    )
    bus = BusInfo(
        run.scenario.bus_name,
        0,
        run.scenario.bitrate,
        interface="simulated",
        clock="simulated",
        resolution_ns=run.scenario.stamp_resolution_ns,
    )
    record_batches(stream, [bus], target, options)


def told(*paths: Path) -> dict[str, Any]:
    """Everything that the analysis tells, but for the files' names."""
    found = to_object(open_session(list(paths)).analysis)
    found["capture"].pop("files")
    return found


@pytest.mark.parametrize(
    "split", [Split(size_bytes=150_000), Split(time_ns=7 * S), Split(100_000, 10 * S)]
)
def test_a_split_recording_tells_what_the_whole_one_tells(tmp_path: Path, split: Split) -> None:
    recorded(tmp_path / "whole.mcap", Split())
    folder = tmp_path / "split"
    recorded(folder, split)
    parts = sorted(folder.glob("*.mcap"))
    assert len(parts) > 4
    random.Random(1).shuffle(parts)
    whole, joined = told(tmp_path / "whole.mcap"), told(*parts)
    for table in whole:
        assert joined[table] == whole[table], table


def test_each_segment_opens_alone(tmp_path: Path) -> None:
    recorded(tmp_path, Split(time_ns=20 * S))
    parts = sorted(tmp_path.glob("*.mcap"))
    alone = [told(path) for path in parts]
    assert all(not each["capture"]["gaps"] or each is not alone[0] for each in alone)
    names = {node["name"] for each in alone for node in each["nodes"]}
    assert "boom sensor" in names or len(names) > 3
    total = sum(each["capture"]["frames"] for each in alone)
    assert total == told(*parts)["capture"]["frames"]


class Recorded:
    """A segment in memory: frames at these times on one bus, after gaps."""

    def __init__(
        self, segment: int, *times: int, recording: str = "r", gap: Gap | None = None
    ) -> None:
        metadata = {"recording_id": recording, "segment": str(segment)}
        self.facts = CaptureFacts(
            Path(f"{recording}{segment}"), "test", ["can0"], metadata=metadata
        )
        self._times = times
        self._gap = gap

    def batches(self) -> Iterator[FrameBatch | Gap]:
        if self._gap:
            yield self._gap
        yield FrameBatch.from_rows((t, 0, 0x701, 0, 1, b"\x05") for t in self._times)


def items(*segments: Recorded) -> tuple[list[int], list[Gap]]:
    found = list(Merge(segments).stream())
    times = [int(t) for each in found if isinstance(each, FrameBatch) for t in each.t_ns]
    return times, [each for each in found if isinstance(each, Gap)]


def test_segments_join_by_number_without_a_gap() -> None:
    assert items(Recorded(1, 30, 40), Recorded(0, 10, 20)) == ([10, 20, 30, 40], [])


def test_stamps_that_overlap_at_the_border_are_no_second_bus() -> None:
    merge = Merge([Recorded(0, 10, 31), Recorded(1, 30, 40)])
    assert len(list(merge.stream())) == 2
    assert merge.buses == ["can0"]


def test_a_segment_that_was_deleted_is_a_gap() -> None:
    times, gaps = items(Recorded(4, 10, 20), Recorded(7, 90))
    assert times == [10, 20, 90]
    assert gaps == [Gap(20, 90, "segments 5 to 6 of the recording are missing")]


def test_the_oldest_segments_are_not_missed() -> None:
    assert items(Recorded(8, 10), Recorded(9, 20)) == ([10, 20], [])


def test_a_segment_and_its_copy_stay_apart() -> None:
    times, _ = items(Recorded(0, 10, 20), Recorded(0, 10, 20))
    assert times == [10, 10, 20, 20]


def test_the_pause_between_two_recordings_is_told_once() -> None:
    pause = Gap(21, 100, DID_NOT_RUN)
    first, second = Recorded(0, 10, 20), Recorded(0, 100, recording="s", gap=pause)
    assert items(first, second) == ([10, 20, 100], [Gap(20, 100, DID_NOT_RUN, None, 0)])


def test_the_time_before_a_recording_is_no_part_of_it() -> None:
    assert items(Recorded(0, 100, gap=Gap(21, 100, DID_NOT_RUN))) == ([100], [])


MAPPED = [
    (0x601, "2F 00 1A 00 00 00 00 00"),
    (0x581, "60 00 1A 00 00 00 00 00"),
    (0x601, "23 00 1A 01 10 00 04 60"),
    (0x581, "60 00 1A 01 00 00 00 00"),
    (0x601, "2F 00 1A 00 01 00 00 00"),
    (0x581, "60 00 1A 00 00 00 00 00"),
    (0x601, "2B 17 10 00 E8 03 00 00"),
    (0x581, "60 17 10 00 00 00 00 00"),
]
"""1A00h of node 1 holds 6004h:00 with 16 bits; its heartbeat comes each second."""


def settings_at_the_end(tmp_path: Path, *more: tuple[int, int, str]) -> dict[str, int]:
    """Objects of node 1 as the last segment alone tells them, after these frames (at a second)."""
    rows = [(0, *each) for each in MAPPED] + [(20, 0x181, "01 00"), (40, 0x181, "02 00")]
    stream = [
        FrameBatch.from_rows(
            (S * (1_790_000_000 + at_s) + n * 1_000_000, 0, can_id, 0, len(data), data)
            for n, (at_s, can_id, text) in enumerate(sorted(rows + list(more), key=first_of))
            for data in [bytes.fromhex(text)]
        )
    ]
    options = RecordOptions(sync=False, recording_id="r", split=Split(time_ns=15 * S))
    record_batches(stream, [BusInfo("can0", 0, 500_000)], tmp_path, options)
    last = max(tmp_path.glob("*.mcap"))
    objects = open_session(last).objects(1)
    return {f"{row.index:04X}:{row.sub}": int(str(row.value)) for row in objects.itertuples()}


def first_of(row: tuple[int, int, str]) -> int:
    return row[0]


def test_what_the_recorder_learned_is_known_in_later_segments(tmp_path: Path) -> None:
    found = settings_at_the_end(tmp_path)
    assert (found["1A00:1"], found["1017:0"]) == (0x60040010, 1000)


@pytest.mark.parametrize("at_s", [3, 41])
def test_a_reset_before_or_in_a_later_segment_throws_it_away(tmp_path: Path, at_s: int) -> None:
    assert "1017:0" not in settings_at_the_end(tmp_path, (at_s, 0x701, "00"))


def test_what_was_saved_survives_it(tmp_path: Path) -> None:
    save = [(1, 0x601, "23 10 10 01 73 61 76 65"), (1, 0x581, "60 10 10 01 00 00 00 00")]
    found = settings_at_the_end(tmp_path, *save, (3, 0x701, "00"), (41, 0x701, "00"))
    assert found["1017:0"] == 1000


def findings(*paths: Path) -> list[tuple[str, int | None, int]]:
    """Id, node and begin of each finding of some weight."""
    analysis = open_session(list(paths)).analysis
    return [
        (each.id, each.node, each.start_ns)
        for each in analysis.findings
        if each.severity in ("warning", "error")
    ]


@cache
def healthy_stretch() -> tuple[Run, list[FrameBatch | Gap]]:
    """A machine on which nothing is wrong."""
    run = healthy_line(30).start()
    return run, list(run.stream())


def healthy(target: Path, options: RecordOptions, marks: Sequence[int] = ()) -> None:
    """Record a machine on which nothing is wrong; somebody asks for marks at these seconds."""
    run, stream = healthy_stretch()
    recording = None
    bus = BusInfo(run.scenario.bus_name, 0, run.scenario.bitrate, interface="simulated")
    for batch in stream:
        assert isinstance(batch, FrameBatch)
        begin_ns = int(batch.t_ns[0])
        recording = recording or Recording(target, [bus], options, start_ns=begin_ns, host="here")
        for start in range(0, len(batch), 200):
            part = batch[start : start + 200]
            recording.take_frames(part, part.t_ns)
            now_ns = int(part.t_ns[-1])
            for mark in marks:
                if int(part.t_ns[0]) <= recording._start_ns + mark * S <= now_ns:
                    recording.mark(f"asked at {mark} s", now_ns)
            recording.write(part, part.t_ns, now_ns=now_ns)
    assert recording is not None
    recording.finish(recording._heard_ns, "stopped")


def described(**more: Any) -> RecordOptions:
    text = healthy_stretch()[0].description_toml
    description = BusDescription.loads(text)
    return RecordOptions(description=description, sync=False, recording_id="well", **more)


def test_a_healthy_machine_is_not_accused_in_files_of_triggers(tmp_path: Path) -> None:
    around = TriggerPlan(only=True, before_ns=5 * S, after_ns=3 * S)
    healthy(tmp_path, described(triggers=around), marks=(8, 20))
    paths = sorted(tmp_path.glob("*.mcap"))
    assert len(paths) == 2
    for path in paths:
        assert findings(path) == []
    assert findings(*paths) == []


@pytest.mark.parametrize("cut", [0.3, 0.999])
def test_a_healthy_machine_is_not_accused_in_a_cut_file(tmp_path: Path, cut: float) -> None:
    healthy(tmp_path, described(split=Split(size_bytes=60_000)))
    *_, last = paths = sorted(tmp_path.glob("*.mcap"))
    assert len(paths) > 3
    data = last.read_bytes()
    last.write_bytes(data[: round(len(data) * cut)])
    assert [each for each in findings(*paths) if each[0] != "capture.damaged"] == []


def test_a_window_over_a_border_tells_what_the_whole_file_tells(tmp_path: Path) -> None:
    recorded(tmp_path / "one.mcap", Split())
    recorded(tmp_path / "many", Split(size_bytes=300_000))
    many = sorted((tmp_path / "many").glob("*.mcap"))
    assert len(many) > 2
    border_ns = open_session(many[1]).analysis.capture.begin_ns
    begin, end = border_ns - 20 * S, border_ns + 20 * S
    one = to_object(open_session(tmp_path / "one.mcap", start=begin, end=end).analysis)
    joined = to_object(open_session(many, start=begin, end=end).analysis)
    for each in (one, joined):
        each["capture"].pop("files")
    assert joined == one
    assert joined["capture"]["frames"] > 0
