"""Triggers in a recording: marks in what is written, or files of their own."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from syncline_logger.record_options import RecordOptions
from syncline_logger.record_view import say_result
from syncline_logger.recorder import record_batches
from syncline_logger.recording import Recording
from syncline_logger.segments import Split
from syncline_logger.triggers.conditions import parse_conditions
from syncline_logger.triggers.event import Event
from syncline_logger.triggers.hold_off import HoldOff
from syncline_logger.triggers.plan import TriggerPlan
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.capture.scan import CaptureScan

T0 = 1_760_000_000_000_000_000
MS = 1_000_000
S = 1_000 * MS
Row = tuple[int, int, int, int, int, bytes]
EMCY = b"\x30\x81\x11\x00\x00\x00\x00\x00"


def beats(node: int, begin_s: float, end_s: float, every_ms: int = 100) -> list[Row]:
    times = range(round(begin_s * S), round(end_s * S), every_ms * MS)
    return [(T0 + t, 0, 0x700 + node, 0, 1, b"\x05") for t in times]


def emcy(at_s: float, node: int = 5, data: bytes = EMCY) -> Row:
    return (T0 + round(at_s * S), 0, 0x80 + node, 0, 8, data)


def batch(*rows: Row | list[Row]) -> FrameBatch:
    flat = [row for each in rows for row in (each if isinstance(each, list) else [each])]
    return FrameBatch.from_rows(sorted(flat, key=lambda row: row[0]))


def options(*words: str, only: bool = False, **plan: int) -> RecordOptions:
    triggers = TriggerPlan(parse_conditions(words), only, **plan)
    return RecordOptions(recording_id="run", sync=False, triggers=triggers)


def scanned(path: Path) -> tuple[FrameBatch, CaptureScan]:
    scan = CaptureScan(path)
    frames = [item for item in scan.batches() if isinstance(item, FrameBatch)]
    return FrameBatch.concat(frames), scan


def marks(path: Path) -> list[tuple[float, str, int | None]]:
    found = scanned(path)[1].facts.marks
    return [((mark.t_ns - T0) / S, mark.reason, mark.node) for mark in found]


def recorded(tmp_path: Path, frames: FrameBatch, settings: RecordOptions) -> list[Path]:
    record_batches([frames], [BusInfo("a", 0, interface="socketcan")], tmp_path, settings)
    return sorted(tmp_path.glob("*.mcap"))


def test_an_error_is_marked_once_in_a_continuous_recording(tmp_path: Path) -> None:
    frames = batch(beats(5, 0, 20), emcy(4), emcy(5), emcy(6, node=6))
    (path,) = recorded(tmp_path, frames, options("emcy:5"))
    assert len(scanned(path)[0]) == len(frames)
    assert marks(path) == [(4.0, "node 5: EMCY 8130h life guard or heartbeat error", 5)]


def test_a_lost_node_is_marked_where_it_was_lost(tmp_path: Path) -> None:
    frames = batch(beats(5, 0, 8), beats(6, 0, 30), beats(7, 0, 8), beats(7, 10, 30))
    (path,) = recorded(tmp_path, frames, options("node-lost"))
    assert [(at, node) for at, _, node in marks(path)] == [(8.05, 7), (8.05, 5)]


def test_a_silence_of_the_whole_bus_and_a_gap_accuse_no_node(tmp_path: Path) -> None:
    quiet = batch(beats(5, 0, 8), beats(6, 0, 8), beats(5, 12, 20), beats(6, 12, 20))
    assert marks(recorded(tmp_path / "a", quiet, options("node-lost"))[0]) == []
    items: list[FrameBatch | Gap] = [
        batch(beats(5, 0, 8), beats(6, 0, 8)),
        Gap(T0 + 8 * S, T0 + 12 * S, "adapter lost"),
        batch(beats(5, 12, 20), beats(6, 13, 20)),
    ]
    record_batches(items, [BusInfo("a", 0)], tmp_path / "b", options("node-lost", "gap"))
    (path,) = (tmp_path / "b").glob("*.mcap")
    assert marks(path) == [(8.0, "gap of 4.000 s: adapter lost", None)]


def test_only_a_boot_up_that_nobody_commanded_is_marked(tmp_path: Path) -> None:
    boot = (0x705, 0, 1, b"\x00")
    frames = batch(
        beats(6, 0, 40),
        beats(5, 0, 5),
        (T0 + 5 * S, 0, 0x000, 0, 2, b"\x81\x05"),
        (T0 + 6 * S, 0, *boot),
        beats(5, 6.1, 20),
        (T0 + 20 * S + 500 * MS, 0, *boot),
        beats(5, 20.6, 40),
    )
    (path,) = recorded(tmp_path, frames, options("boot-up"))
    assert marks(path) == [(20.5, "node 5: boot-up that nobody commanded", 5)]


def test_states_aborts_bus_off_and_decoded_values(tmp_path: Path) -> None:
    abort = b"\x80\x17\x10\x00\x11\x00\x09\x06"
    mapping = b"\x43\x00\x1a\x01\x10\x00\x04\x60"
    position = [
        (T0 + (10 + n) * S, 0, 0x185, 0, 2, (100 * n).to_bytes(2, "little")) for n in range(8)
    ]
    frames = batch(
        beats(5, 0, 3),
        (T0 + 3 * S, 0, 0x705, 0, 1, b"\x04"),
        (T0 + 4 * S, 0, 0x605, 0, 8, b"\x40\x17\x10\x00\x00\x00\x00\x00"),
        (T0 + 4 * S + MS, 0, 0x585, 0, 8, abort),
        (T0 + 5 * S, 0, 0x605, 0, 8, b"\x40\x00\x1a\x00\x00\x00\x00\x00"),
        (T0 + 5 * S + MS, 0, 0x585, 0, 8, b"\x4f\x00\x1a\x00\x01\x00\x00\x00"),
        (T0 + 6 * S, 0, 0x605, 0, 8, b"\x40\x00\x1a\x01\x00\x00\x00\x00"),
        (T0 + 6 * S + MS, 0, 0x585, 0, 8, mapping),
        (T0 + 7 * S, 0, 0x040, 4, 8, bytes(8)),
        position,
    )
    words = ("nmt:5:stopped", "sdo-abort", "bus-off", "value:5:6004h>450")
    (path,) = recorded(tmp_path, frames, options(*words))
    assert [(at, reason.split(":")[0]) for at, reason, _ in marks(path)] == [
        (3.0, "node 5"),
        (4.001, "node 5"),
        (7.0, "a"),
        (15.0, "node 5"),
    ]


def test_nothing_is_written_without_a_trigger(tmp_path: Path) -> None:
    settings = options("emcy:9", only=True)
    assert recorded(tmp_path, batch(beats(5, 0, 20), emcy(4)), settings) == []
    assert list(tmp_path.glob("*.mcap*")) == []


def test_an_event_holds_what_lies_around_its_triggers_and_says_why(tmp_path: Path) -> None:
    plan = {"before_ns": 5 * S, "after_ns": 3 * S}
    frames = batch(beats(5, 0, 100), emcy(30), emcy(32, node=6), emcy(70, node=7))
    first, second = recorded(tmp_path, frames, options("emcy", only=True, **plan))
    for path, begin, end in ((first, 25, 35), (second, 65, 73)):
        held, scan = scanned(path)
        whole = frames[(frames.t_ns >= held.t_ns[0]) & (frames.t_ns <= held.t_ns[-1])]
        assert np.array_equal(held.t_ns, whole.t_ns)
        assert abs((held.t_ns[0] - T0) / S - begin) < 2.0
        assert abs((held.t_ns[-1] - T0) / S - end) < 1.0
        records = scan.facts.metadata_records
        assert records["syncline.trigger"]["begins"].endswith("before the trigger, as wanted")
        assert records["syncline.stop"]["reason"] == "3 s after the last trigger"
        assert scan.facts.closed
    assert [node for _, _, node in marks(first)] == [5, 6]
    ids = [scanned(path)[1].facts.metadata.recording_id for path in (first, second)]  # type: ignore[union-attr]
    assert ids == ["run-0000", "run-0001"]


def test_the_result_tells_what_the_files_hold_and_what_was_received(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = batch(beats(5, 0, 100), emcy(30), emcy(70, node=6), emcy(99, node=7))
    around = {"before_ns": 5 * S, "after_ns": 3 * S}
    settings = options("emcy", only=True, **around)
    result = record_batches([frames], [BusInfo("a", 0)], tmp_path, settings)
    held = sum(len(scanned(path)[0]) for path in tmp_path.glob("*.mcap"))
    assert held < len(frames) == result.frame_count
    say_result(result, triggered_only=True)
    told = f"{result.path} and 2 more files: {held} of {len(frames)} frames received, 0 gaps\n"
    assert capsys.readouterr().err == told


def test_the_result_of_no_trigger_names_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames, settings = batch(beats(5, 0, 20)), options("emcy", only=True)
    result = record_batches([frames], [BusInfo("a", 0)], tmp_path, settings)
    say_result(result, triggered_only=True)
    told = f"nothing was written: 0 of {len(frames)} frames received, 0 gaps\n"
    assert capsys.readouterr().err == told


def test_an_event_at_the_end_and_at_the_beginning(tmp_path: Path) -> None:
    frames = batch(beats(5, 0, 10), emcy(1), emcy(9.5, node=6))
    plan = {"before_ns": 5 * S, "after_ns": 3 * S}
    first, second = recorded(tmp_path, frames, options("emcy", only=True, **plan))
    assert int(scanned(first)[0].t_ns[0]) == T0
    begins = scanned(first)[1].facts.metadata_records["syncline.trigger"]["begins"]
    assert "where the recorder began" in begins
    assert scanned(second)[1].facts.metadata_records["syncline.stop"]["reason"] == "end of input"
    assert int(scanned(second)[0].t_ns[-1]) == int(frames.t_ns[-1])


def test_marks_keep_what_lies_around_them(tmp_path: Path) -> None:
    settings = replace(
        options("emcy", before_ns=15 * S, after_ns=15 * S), split=Split(time_ns=10 * S)
    )
    recorded(tmp_path, batch(beats(5, 0, 100), emcy(50)), settings)
    manifest = json.loads((tmp_path / "run.json").read_text(encoding="utf-8"))
    kept = [(each["end_ns"] - T0) / S for each in manifest["segments"] if each["marks"]]
    assert len(kept) < len(manifest["segments"])
    assert min(kept) < 46
    assert max(kept) > 55


def test_a_wish_is_marked_where_it_came(tmp_path: Path) -> None:
    recording = Recording(
        tmp_path, [BusInfo("a", 0)], RecordOptions(sync=False), start_ns=T0, host="x"
    )
    frames = batch(beats(5, 0, 1))
    recording.take_frames(frames, frames.t_ns)
    recording.ask("asked for by SIGUSR1", T0 + S)
    recording.write(frames, frames.t_ns)
    result = recording.finish(T0 + S, "stopped")
    assert marks(result.path) == [(1.0, "asked for by SIGUSR1", None)]


def test_a_storm_is_one_trigger_and_its_number() -> None:
    hold_off = HoldOff(10 * S)
    event = Event("emcy", 0, 0, "node 5: EMCY", 0, 5, 0x8130)
    told = [
        (at, trigger.text)
        for at in (0, 5, 9, 14, 30)
        if (trigger := hold_off.take(replace(event, log_ns=at * S)))
    ]
    assert told == [(0, "node 5: EMCY"), (30, "node 5: EMCY; 3 times more since the last mark")]
    assert hold_off.take(replace(event, log_ns=31 * S, node=6)) is not None
    assert hold_off.take(replace(event, log_ns=32 * S)) is None
    assert list(hold_off.rest()) == ["trigger emcy 8130h of node 5: 1 time more"]


def test_marks_are_told_by_the_analysis(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    from syncline_analyzer import open_session
    from syncline_analyzer.info import inspect
    from syncline_analyzer.views.events import marks as markers
    from syncline_analyzer.views.events import nmt_events

    (path,) = recorded(tmp_path, batch(beats(5, 0, 20), emcy(4)), options("emcy"))
    analysis = open_session(path).analysis
    (row,) = analysis.capture.marks
    assert ((row.t_ns - T0) / S, row.bus, row.node) == (4.0, "a", 5)
    assert any("marked by the recorder: node 5: EMCY" in e.text for e in nmt_events(analysis))
    assert any(each.name == "marked by the recorder" for each in markers(analysis))
    assert [mark.t_ns for mark in inspect(path).marks] == [row.t_ns]
