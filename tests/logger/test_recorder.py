"""Recording end to end: from a python-can bus to a file that strangers can read."""

import struct
import threading
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from can import Message
from can.interfaces.virtual import VirtualBus

from syncline_logger import pdo_channel
from syncline_logger.batcher import FrameBuffer
from syncline_logger.bus_options import BusOptions
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder import record, record_batches
from syncline_logger.recording import Recording, RecordResult
from syncline_logger.source import Source, SourceFacts
from syncline_logger.sources.python_can import PythonCanSource
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.description import BusDescription
from syncline_schemas.errors import SourceError, UsageError
from tests.logger.capture_contents import (
    Contents,
    doctor_complaints,
    read_capture,
    read_cut_frames,
)

T0 = 1_760_000_000_000_000_000
MS = 1_000_000
S = 1_000 * MS

Sent = tuple[int, str]
"""Identifier and data as hex; "R" for a remote frame."""


def message(can_id: int, data: str) -> Message:
    if data == "R":
        return Message(arbitration_id=can_id, is_extended_id=False, is_remote_frame=True, dlc=1)
    return Message(arbitration_id=can_id, is_extended_id=False, data=bytes.fromhex(data))


def record_live(
    target: Path, send: Callable[[], None], buses: Sequence[str] = ("a",), **options: Any
) -> RecordResult:
    """Record virtual buses of these names while `send` runs."""
    stop = threading.Event()

    def started(path: Path) -> None:
        def work() -> None:
            try:
                send()
            finally:
                stop.set()

        threading.Thread(target=work).start()

    return record(
        [PythonCanSource(BusOptions(name, "virtual", f"recorder-{name}")) for name in buses],
        target,
        RecordOptions(**options),
        stop=stop,
        on_start=started,
    )


def record_rows(
    target: Path, *rows: Sent, period_ns: int = 10 * MS, **options: Any
) -> tuple[RecordResult, Contents]:
    """Record frames in virtual time, one every `period_ns` from T0 on."""
    data = [(T0 + n * period_ns, 0, i, 0, bytes.fromhex(d)) for n, (i, d) in enumerate(rows)]
    batch = FrameBatch.from_rows((t, b, i, f, len(d), d) for t, b, i, f, d in data)
    path = target / "x.mcap"
    result = record_batches([batch], [BusInfo("a", 0, 500_000)], path, RecordOptions(**options))
    assert doctor_complaints(path) == []
    return result, read_capture(path)


def test_two_buses_into_one_file(tmp_path: Path) -> None:
    sent: dict[str, list[Sent]] = {
        "a": [(0x185, f"{n:02X}") for n in range(300)],
        "b": [(0x705, "05"), (0x705, "R"), (0x285, "0102030405060708")] * 50,
    }

    def send() -> None:
        with VirtualBus("recorder-a") as a, VirtualBus("recorder-b") as b:
            for bus, name in ((a, "a"), (b, "b")):
                for can_id, data in sent[name]:
                    bus.send(message(can_id, data[-2:] if name == "a" else data))

    result = record_live(tmp_path, send, ["a", "b"])
    assert result.frames == {"a": 300, "b": 150}
    assert doctor_complaints(result.path) == []
    contents = read_capture(result.path)
    assert [(i, d) for i, _, _, d in contents.frames("a")] == [
        (0x185, bytes([n % 256 if n < 256 else int(f"{n:02X}"[-2:], 16)])) for n in range(300)
    ]
    assert contents.frames("b")[:3] == [
        (0x705, 0, 1, b"\x05"),
        (0x705, 2, 1, b""),
        (0x285, 0, 8, bytes(range(1, 9))),
    ]
    assert all(later >= earlier for earlier, later in pairwise(contents.log_times))
    status = contents.values("/can/b/status")[-1]
    assert (status.frames_received, status.adapter_present) == (150, True)
    assert contents.values("/recorder/clock")
    assert contents.metadata["syncline.stop"]["reason"] == "stopped"


def test_it_never_transmits(tmp_path: Path) -> None:
    with VirtualBus("recorder-a") as listener:

        def send() -> None:
            with VirtualBus("recorder-a") as sender:
                sender.send(message(0x705, "05"))

        record_live(tmp_path, send)
        assert listener.recv(0) is not None
        assert listener.recv(0) is None


def test_the_file_name_is_start_and_recording_id(tmp_path: Path) -> None:
    batch = FrameBatch.from_rows([(T0, 0, 1, 0, 0, b"")])
    options = RecordOptions(recording_id="abc123")
    result = record_batches([batch], [BusInfo("a", 0)], tmp_path, options)
    assert result.path == tmp_path / "20251009T085320Z_abc123.mcap"


def test_a_file_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"precious")
    with pytest.raises(UsageError, match="exists"):
        record_batches(
            [FrameBatch.from_rows([(T0, 0, 1, 0, 0, b"")])], [BusInfo("a", 0)], tmp_path / "x.mcap"
        )
    assert (tmp_path / "x.mcap").read_bytes() == b"precious"


def test_equal_input_gives_an_equal_file(tmp_path: Path) -> None:
    batch = FrameBatch.from_rows((T0 + n * MS, 0, 0x705, 0, 1, b"\x05") for n in range(3000))
    files = []
    for name in ("x", "y"):
        options = RecordOptions(recording_id="same")
        record_batches([batch], [BusInfo("a", 0)], tmp_path / f"{name}.mcap", options)
        files.append((tmp_path / f"{name}.mcap").read_bytes())
    assert files[0] == files[1]


def test_small_batches_share_a_chunk(tmp_path: Path) -> None:
    batches = [FrameBatch.from_rows([(T0 + n * MS, 0, 1, 0, 0, b"")]) for n in range(500)]
    many = record_batches(iter(batches), [BusInfo("a", 0)], tmp_path / "many.mcap")
    one = record_batches([FrameBatch.concat(batches)], [BusInfo("a", 0)], tmp_path / "one.mcap")
    assert many.bytes_written < one.bytes_written * 1.1


def test_nothing_recorded_is_a_whole_file(tmp_path: Path) -> None:
    result = record_batches([], [BusInfo("a", 0)], tmp_path / "x.mcap")
    assert doctor_complaints(result.path) == []
    assert read_capture(result.path).frames("a") == []


def test_services_are_decoded(tmp_path: Path) -> None:
    _, contents = record_rows(
        tmp_path,
        (0x000, "8105"),
        (0x705, "00"),
        (0x000, "0100"),
        (0x705, "05"),
        (0x705, "85"),
        (0x080, ""),
        (0x080, "07"),
        (0x100, "00 00 00 00 01 00"),
        (0x7E5, "04 01 00 00 00 00 00 00"),
        (0x085, "30 81 11 00 00 00 00 00"),
    )
    nmt = contents.values("/canopen/a/nmt")
    assert [(m.command, m.command_name, m.node) for m in nmt] == [
        (0x81, "reset node", 5),
        (1, "start", 0),
    ]
    heartbeats = contents.values("/canopen/a/node5/heartbeat")
    assert [(m.state, m.state_name, m.toggle, m.boot_up) for m in heartbeats] == [
        (0, "boot-up", 0, True),
        (5, "OPERATIONAL", 0, False),
        (5, "OPERATIONAL", 1, False),
    ]
    counters = [
        m.counter if m.HasField("counter") else None for m in contents.values("/canopen/a/sync")
    ]
    assert counters == [None, 7]
    [time] = contents.values("/canopen/a/time")
    assert (time.milliseconds, time.days_since_1984) == (0, 1)
    assert time.utc_ns == 441_849_600 * S  # 1984-01-02T00:00:00Z
    [lss] = contents.values("/canopen/a/lss")
    assert (lss.from_master, lss.command) == (True, 4)
    [emcy] = contents.values("/canopen/a/node5/emcy")
    assert (emcy.code, emcy.meaning, emcy.error_register) == (
        0x8130,
        "life guard or heartbeat error",
        0x11,
    )
    assert list(emcy.registers) == ["generic", "communication"]


def test_decoded_messages_carry_the_frames_times(tmp_path: Path) -> None:
    _, contents = record_rows(tmp_path, (0x705, "05"), (0x705, "7F"), period_ns=3 * S)
    frames = [(log, wire) for log, wire, _ in contents.messages["/can/a/frames"]]
    decoded = [(log, wire) for log, wire, _ in contents.messages["/canopen/a/node5/heartbeat"]]
    assert decoded == frames == [(T0, T0), (T0 + 3 * S, T0 + 3 * S)]


JN2100 = BusDescription.loads('[bus.a.node.10]\ndevice = "jn2100"\n')


def test_pdos_of_a_described_device_are_decoded_in_its_units(tmp_path: Path) -> None:
    angles = [(0, 0), (123, -456), (-1800, 1800), (1, -1)]
    frames = [(0x18A, struct.pack("<hh", *pair).hex()) for pair in angles]
    _, contents = record_rows(tmp_path, *frames, description=JN2100)
    decoded = contents.values("/canopen/a/node10/tpdo1")
    names = [field.name for field in decoded[0].DESCRIPTOR.fields]
    values = [[getattr(each, name) for name in names] for each in decoded]
    assert values == [pytest.approx([0.1 * x, 0.1 * y]) for x, y in angles]
    units = contents.channel_metadata["/canopen/a/node10/tpdo1"]
    assert [units[f"unit.{name}"] for name in names] == ["deg", "deg"]


def test_description_and_eds_are_attached(tmp_path: Path) -> None:
    _, contents = record_rows(tmp_path, (0x705, "05"), description=JN2100)
    assert contents.attachments["bus-description.toml"].decode() == JN2100.text
    assert contents.attachments["jn2100.eds"] == JN2100.files["jn2100.eds"]
    assert contents.metadata["syncline.device.a.node10"]["device"] == "jn2100"


MAPPED = [
    (0x601, "2F 00 1A 00 00 00 00 00"),
    (0x581, "60 00 1A 00 00 00 00 00"),
    (0x601, "23 00 1A 01 10 00 04 60"),
    (0x581, "60 00 1A 01 00 00 00 00"),
    (0x601, "23 00 1A 02 08 00 01 20"),
    (0x581, "60 00 1A 02 00 00 00 00"),
    (0x601, "2F 00 1A 00 02 00 00 00"),
    (0x581, "60 00 1A 00 00 00 00 00"),
]
"""1A00h of node 1: 6004h:00 with 16 bits, 2001h:00 with 8."""


def values_of(contents: Contents, topic: str) -> list[list[float]]:
    return [
        [getattr(each, field.name) for field in each.DESCRIPTOR.fields]
        for each in contents.values(topic)
    ]


def test_a_mapping_is_learned_from_the_bus(tmp_path: Path) -> None:
    _, contents = record_rows(
        tmp_path, (0x181, "AAAAAA"), *MAPPED, (0x181, "3412FF"), (0x181, "010000")
    )
    assert values_of(contents, "/canopen/a/node1/tpdo1") == [[0x1234, 0xFF], [1, 0]]


def test_a_moved_identifier_is_followed(tmp_path: Path) -> None:
    moved = [(0x601, "23 00 18 01 E5 01 00 00"), (0x581, "60 00 18 01 00 00 00 00")]
    _, contents = record_rows(tmp_path, *MAPPED, *moved, (0x181, "AAAAAA"), (0x1E5, "020003"))
    assert values_of(contents, "/canopen/a/node1/tpdo1") == [[2, 3]]


def test_an_unsaved_mapping_is_gone_after_a_reset(tmp_path: Path) -> None:
    _, contents = record_rows(
        tmp_path, *MAPPED, (0x181, "010002"), (0x701, "00"), (0x181, "030004")
    )
    assert values_of(contents, "/canopen/a/node1/tpdo1") == [[1, 2]]


def test_a_saved_mapping_survives_a_reset(tmp_path: Path) -> None:
    save = [(0x601, "23 10 10 01 73 61 76 65"), (0x581, "60 10 10 01 00 00 00 00")]
    _, contents = record_rows(
        tmp_path, *MAPPED, *save, (0x000, "8101"), (0x701, "00"), (0x181, "030004")
    )
    assert values_of(contents, "/canopen/a/node1/tpdo1") == [[3, 4]]


def test_a_changed_mapping_gets_a_channel_of_its_own(tmp_path: Path) -> None:
    changed = [(0x601, "23 00 1A 01 10 00 09 60"), (0x581, "60 00 1A 01 00 00 00 00")]
    _, contents = record_rows(tmp_path, *MAPPED, (0x181, "010002"), *changed, (0x181, "030004"))
    assert values_of(contents, "/canopen/a/node1/tpdo1") == [[1, 2]]
    assert values_of(contents, "/canopen/a/node1/tpdo1_v2") == [[3, 4]]


def test_a_device_is_recognised_by_what_it_answers(tmp_path: Path) -> None:
    answers = [
        (0x60A, "40 00 10 00 00 00 00 00"),
        (0x58A, "43 00 10 00 9A 01 04 00"),
        (0x60A, "40 08 10 00 00 00 00 00"),
        (0x58A, "41 08 10 00 06 00 00 00"),
        (0x60A, "60 00 00 00 00 00 00 00"),
        (0x58A, "03 4A 4E 32 31 30 30 00"),  # "JN2100"
    ]
    _, contents = record_rows(tmp_path, *answers, (0x18A, "7B00 38FE"))
    assert values_of(contents, "/canopen/a/node10/tpdo1") == [pytest.approx([12.3, -45.6])]
    assert contents.metadata["syncline.device.a.node10"]["device"] == "jn2100"
    assert "jn2100.eds" in contents.attachments


def test_sdo_frames_are_decoded(tmp_path: Path) -> None:
    _, contents = record_rows(
        tmp_path,
        (0x60A, "2B 17 10 00 E8 03 00 00"),
        (0x58A, "80 17 10 00 22 00 00 08"),
        description=JN2100,
    )
    request, answer = contents.values("/canopen/a/node10/sdo")
    assert (request.request, request.kind, request.index, request.sub) == (
        True,
        "download",
        0x1017,
        0,
    )
    assert request.data == bytes.fromhex("E803")
    assert "roducer heartbeat time" in request.object_name
    assert (answer.kind, answer.abort_code) == ("abort", 0x08000022)
    assert "present device state" in answer.abort_text


def test_a_short_pdo_is_said_once_and_not_decoded(tmp_path: Path) -> None:
    result, contents = record_rows(
        tmp_path, (0x18A, "7B"), (0x18A, "7B"), (0x18A, "7B000000"), description=JN2100
    )
    assert len(contents.values("/canopen/a/node10/tpdo1")) == 1
    assert len(contents.frames("a")) == 3
    [problem] = result.problems
    assert "1 bytes, the mapping needs 4" in problem


def test_a_decoder_that_fails_costs_only_its_own_channel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("bug")

    monkeypatch.setattr(pdo_channel, "decode_pdo", fail)
    frames = [(0x18A, "7B000000"), (0x70A, "05")] * 500
    result, contents = record_rows(tmp_path, *frames, description=JN2100)
    assert [(i, d.hex()) for i, _, _, d in contents.frames("a")] == [
        (i, d.lower()) for i, d in frames
    ]
    assert len(contents.values("/canopen/a/node10/heartbeat")) == 500
    assert "/canopen/a/node10/tpdo1" not in contents.messages
    texts = [each.text for each in contents.values("/can/a/status") if each.text]
    assert texts == ["decoding of /canopen/a/node10/tpdo1 is off: ZeroDivisionError: bug"]
    assert result.frame_count == 1000


def test_a_dead_decoder_costs_no_frame_live(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("syncline_logger.decoding.LiveDecoder.decode", None)

    def send() -> None:
        with VirtualBus("recorder-a") as bus:
            for n in range(100):
                bus.send(message(0x705, f"{n:02X}"))

    result = record_live(tmp_path, send)
    assert len(read_capture(result.path).frames("a")) == 100
    assert any("decoding is off" in problem for problem in result.problems)
    assert any("rehearsal" in problem for problem in result.problems)


def test_no_decode_writes_frames_alone(tmp_path: Path) -> None:
    _, contents = record_rows(tmp_path, (0x705, "05"), decode=False)
    assert not [topic for topic in contents.messages if topic.startswith("/canopen")]


def test_a_gap_stands_between_the_frames(tmp_path: Path) -> None:
    def batch(t_ns: int) -> FrameBatch:
        return FrameBatch.from_rows([(t_ns, 0, 1, 0, 0, b"")])

    gap = Gap(T0 + 1, T0 + 2 * S, "adapter lost", 17, 0)
    path = tmp_path / "x.mcap"
    record_batches([batch(T0), gap, batch(T0 + 3 * S)], [BusInfo("a", 0)], path)
    contents = read_capture(path)
    [(log_ns, _, found)] = contents.messages["/recorder/gap"]
    assert (found.start_ns, found.end_ns) == (gap.start_ns, gap.end_ns)
    assert (found.reason, found.lost_frames, found.bus) == (gap.reason, 17, 0)
    first, last = (log for log, _, _ in contents.messages["/can/a/frames"])
    assert first < log_ns < last


class FlakySource:
    """A source that is lost after its first frame, and back at the next opening."""

    def __init__(self, stop: threading.Event) -> None:
        self.facts = SourceFacts("a", "virtual", "x")
        self._stop = stop
        self._opened = 0
        self._sent = 0

    def open(self) -> None:
        self._opened += 1

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        if self._sent == 1 and self._opened == 1:
            raise SourceError("unplugged")
        if self._sent == 2:
            self._stop.set()
            self._stop.wait(timeout_s)
            return 0
        self._sent += 1
        buffer.append(0, bus, self._sent, 0, 0, b"")
        return 1

    def fileno(self) -> None:
        return None

    def close(self) -> None:
        pass


def test_a_lost_adapter_is_a_gap_and_is_opened_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("syncline_logger.source_thread.FIRST_RETRY_S", 0.01)
    stop = threading.Event()
    source: Source = FlakySource(stop)
    result = record([source], tmp_path, stop=stop)
    contents = read_capture(result.path)
    assert [i for i, _, _, _ in contents.frames("a")] == [1, 2]
    [(gap_log, _, gap)] = contents.messages["/recorder/gap"]
    assert (gap.reason, gap.bus, gap.HasField("lost_frames")) == ("unplugged", 0, False)
    first, last = (log for log, _, _ in contents.messages["/can/a/frames"])
    assert first <= gap.start_ns < gap.end_ns <= last
    assert first <= gap_log <= last
    changes = [(s.text, s.adapter_present) for s in contents.values("/can/a/status") if s.text]
    assert [text for text, _ in changes] == ["unplugged", "listening again"]


class BurstSource(FlakySource):
    """A source that gives more frames at once than may wait."""

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        if self._sent == 0:
            for n in range(1000):
                buffer.append(0, bus, n, 0, 0, b"")
            self._sent = 1000
        self._stop.set()
        self._stop.wait(timeout_s)
        return 0


def test_frames_without_room_are_a_gap_with_their_number(tmp_path: Path) -> None:
    stop = threading.Event()
    result = record([BurstSource(stop)], tmp_path, RecordOptions(queue_frames=100), stop=stop)
    contents = read_capture(result.path)
    assert len(contents.frames("a")) + result.lost_frames == 1000
    assert result.lost_frames > 0
    assert sum(gap.lost_frames for gap in contents.values("/recorder/gap")) == result.lost_frames
    assert contents.values("/can/a/status")[-1].dropped_queue == result.lost_frames


def test_a_bus_that_cannot_be_opened_leaves_no_file(tmp_path: Path) -> None:
    sources = [
        PythonCanSource(BusOptions("a", "virtual", "x")),
        PythonCanSource(BusOptions("b", "slcan", "/dev/none")),
    ]
    with pytest.raises(SourceError, match="bus 'b'"):
        record(sources, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_it_stops_by_itself_after_the_given_time(tmp_path: Path) -> None:
    source = PythonCanSource(BusOptions("a", "virtual", "recorder-time"))
    result = record([source], tmp_path, duration_ns=200 * MS)
    assert read_capture(result.path).metadata["syncline.stop"]["reason"] == "time is over"


def test_a_broken_input_leaves_a_file_that_can_be_read(tmp_path: Path) -> None:
    def items() -> Iterator[FrameBatch]:
        yield FrameBatch.from_rows((T0 + n * S, 0, n, 0, 0, b"") for n in range(5))
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        record_batches(items(), [BusInfo("a", 0)], tmp_path / "x.mcap")
    assert len(read_cut_frames(tmp_path / "x.mcap")) == 4


def broken(*_: object) -> None:
    raise ValueError("a bug")


@pytest.mark.parametrize(
    ("method", "told"),
    [
        ("live_status.LiveStatus.update", "bus load and node states of the live status: off"),
        ("live_status.LiveStatus.listened", "bus load and node states of the live status: off"),
        ("live_status.LiveStatus.snapshot", "the live status: off"),
        ("triggers.watch.TriggerWatch.update", "triggers: off after ValueError: a bug"),
        ("triggers.watch.TriggerWatch.take", "triggers: off after ValueError: a bug"),
        ("triggers.watch.TriggerWatch.finish", "triggers: off after ValueError: a bug"),
        ("triggers.watch.TriggerWatch.gap", "triggers: off after ValueError: a bug"),
    ],
)
def test_a_bug_beside_the_recording_costs_no_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str, told: str
) -> None:
    monkeypatch.setattr(f"syncline_logger.{method}", broken)
    recording = Recording(tmp_path / "x.mcap", [BusInfo("a", 0)], RecordOptions(), start_ns=T0)
    batch = FrameBatch.from_rows([(T0, 0, 0x705, 0, 1, b"\x05")])
    for _ in range(2):
        recording.take_frames(batch, batch.t_ns)
        recording.add_gap(Gap(T0, T0 + 1, "adapter lost", None, 0), T0)
        recording.ask("it fell", T0)
        recording.listened(0, T0, T0)
        assert recording.snapshot(T0).gaps == recording.result().gap_count
        recording.write(batch, batch.t_ns)
    result = recording.finish(T0 + S, "stopped")
    contents = read_capture(result.path)
    assert len(contents.frames("a")) == 2
    assert sum(told in text for text in result.problems) == 1
    assert recording.marks >= 1
