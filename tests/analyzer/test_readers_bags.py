"""ROS 2 bags and MDF files: what only some of them have."""

import struct
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from syncline_analyzer.readers import open_capture
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.errors import CaptureError
from tests.analyzer import binary_files
from tests.analyzer.log_builder import T0_NS, Row, frame_rows, message, read, row, rows
from tests.analyzer.log_frames import FRAMES

PROPERTY = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def _written(tmp_path: Path, raw: bytes) -> Path:
    path = tmp_path / "bag"
    path.write_bytes(raw)
    return path


def _bag(*payloads: bytes, encoding: str = "cdr", profile: str = "ros2") -> bytes:
    stream = BytesIO()
    writer = Writer(stream)
    writer.start(profile, "rosbag2")
    schema = writer.register_schema("can_msgs/msg/Frame", "ros2msg", b"")
    other = writer.register_schema("std_msgs/msg/String", "ros2msg", b"")
    channel = writer.register_channel("/from_can_bus", encoding, schema)
    rest = writer.register_channel("/rosout", "cdr", other)
    for number, payload in enumerate(payloads):
        writer.add_message(channel, T0_NS + number * 1000, payload, T0_NS + number * 1000)
        writer.add_message(rest, T0_NS, b"\0\1\0\0hello", T0_NS)
    writer.finish()
    return stream.getvalue()


def _frame(stamp: tuple[int, int] = (T0_NS // 10**9, 0), name: bytes = b"\0") -> bytes:
    head = struct.pack("<iII", *stamp, len(name)) + name + bytes(-len(name) % 4)
    return (
        b"\0\1\0\0"
        + head
        + struct.pack("<I???B", 0x181, False, False, False, 2)
        + b"\1\2"
        + bytes(6)
    )


@PROPERTY
@given(frames=frame_rows(fd=False))
def test_any_frames_come_out_as_they_went_in(tmp_path: Path, frames: list[Row]) -> None:
    batch, facts, _ = read(_written(tmp_path, binary_files.ros2(frames)))
    buses = [int(name[4]) for name in facts.buses]
    found = [(t, buses[bus], *rest) for t, bus, *rest in rows(batch)]
    assert found == [binary_files.ros2_keeps(frame) for frame in frames]


@pytest.mark.parametrize("orders", [">", "<>"])
def test_messages_may_be_big_endian(tmp_path: Path, orders: str) -> None:
    frames = [frame for frame in FRAMES if not frame[3] & FrameFlag.FD]
    batch, facts, _ = read(_written(tmp_path, binary_files.ros2(frames, orders)))
    buses = [int(name[4]) for name in facts.buses]
    found = [(t, buses[bus], *rest) for t, bus, *rest in rows(batch)]
    assert found == [binary_files.ros2_keeps(frame) for frame in frames]
    assert facts.unparsed_count == 0


def test_fd_messages_may_be_big_endian(tmp_path: Path) -> None:
    batch, facts, _ = read(_written(tmp_path, binary_files.ros2_fd(FRAMES, ">")))
    assert rows(batch) == rows(read(_written(tmp_path, binary_files.ros2_fd(FRAMES)))[0])
    assert len(batch)
    assert facts.unparsed_count == 0


def test_a_message_of_zeros_or_of_an_unknown_form_is_no_frame(tmp_path: Path) -> None:
    unknown = b"\0\x0b" + _frame()[2:]
    batch, facts, _ = read(_written(tmp_path, _bag(_frame(), bytes(36), unknown, b"\0")))
    assert len(batch) == 1
    assert facts.unparsed_count == 3


@pytest.mark.parametrize("name", [b"\0", b"a\0", b"can0\0", b"/vehicle/can_interface_0\0"])
def test_the_length_of_the_frame_id_does_not_matter(tmp_path: Path, name: bytes) -> None:
    batch, facts, _ = read(_written(tmp_path, _bag(_frame(name=name))))
    assert rows(batch) == [row(0, 0x181, b"\1\2")]
    assert facts.buses == ["/from_can_bus"]


def test_a_message_without_a_stamp_takes_the_time_of_recording(tmp_path: Path) -> None:
    batch, facts, _ = read(_written(tmp_path, _bag(_frame(), _frame((0, 0)))))
    assert batch.t_ns.tolist() == [T0_NS, T0_NS + 1000]
    assert "1 message(s) have no stamp; the time of recording is used" in facts.notes


def test_a_message_that_is_no_frame_is_counted(tmp_path: Path) -> None:
    batch, facts, _ = read(_written(tmp_path, _bag(_frame(), _frame()[:20], b"", _frame())))
    assert len(batch) == 2
    assert facts.unparsed_count == 2


def test_another_encoding_of_the_messages_is_told(tmp_path: Path) -> None:
    batch, facts, _ = read(_written(tmp_path, _bag(_frame(), encoding="protobuf")))
    assert len(batch) == 0
    assert facts.damage is not None
    assert "protobuf" in facts.damage


def test_a_bag_without_a_profile_is_one_by_its_schemas(tmp_path: Path) -> None:
    batch, facts, _ = read(_written(tmp_path, _bag(_frame(), profile="")))
    assert (len(batch), facts.format) == (1, "ros2")


@PROPERTY
@given(data=st.data())
def test_broken_bags_never_raise_anything_else(tmp_path: Path, data: st.DataObject) -> None:
    raw = bytearray(data.draw(st.sampled_from([binary_files.ros2, binary_files.ros2_fd]))(FRAMES))
    for _ in range(data.draw(st.integers(1, 6))):
        raw[data.draw(st.integers(8, len(raw) - 1))] = data.draw(st.integers(0, 255))
    try:
        batch, _, _ = read(_written(tmp_path, bytes(raw)))
    except CaptureError:
        return
    assert len(batch) <= len(FRAMES)


def test_without_asammdf_the_pip_line_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("syncline_analyzer.readers.mf4.find_spec", lambda name: None)
    with pytest.raises(CaptureError, match=r"pip install 'syncline\[mf4\]'"):
        read(_written(tmp_path, b"MDF     4.10    " + bytes(64)))


@pytest.mark.skipif(find_spec("asammdf") is None, reason="asammdf is not here")
def test_mdf_logs_of_python_can_are_read(tmp_path: Path) -> None:
    path = tmp_path / "x.mf4"
    with can.MF4Writer(str(path)) as log:
        for frame in FRAMES:
            log.on_message_received(message(frame))
    batch, facts, _ = read(path)
    # python-can's seconds since 1970 have steps of 238 ns, and its log counts from the time of writing.
    found = sorted((round(t / 1000), int(facts.buses[bus]), *rest) for t, bus, *rest in rows(batch))
    assert found == [(t // 1000, *rest) for t, *rest in FRAMES]
    assert {FrameFlag.FD, FrameFlag.REMOTE, FrameFlag.ERROR} <= {
        FrameFlag(f[3]) & ~FrameFlag.TX for f in rows(batch)
    }


@pytest.mark.skipif(find_spec("asammdf") is None, reason="asammdf is not here")
@pytest.mark.parametrize("at_once", [2, 1 << 17])
def test_mdf_logs_of_single_bits_and_data_apart_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_once: int
) -> None:
    from syncline_analyzer.readers import mf4_library
    from tests.analyzer.mf4_files import canedge

    monkeypatch.setattr(mf4_library, "_RECORDS_AT_ONCE", at_once)
    extended, fd = FrameFlag.EXTENDED, FrameFlag.FD
    frames = [
        row(0, 0x181, b"\1\2\3"),
        row(1_000, 0x18FEF100, bytes(range(8)), bus=1, flags=extended),
        row(2_000, 0x701, b"\5", flags=FrameFlag.TX),
        row(3_000, 0x1FFFFFFF, bytes(range(64)), bus=1, flags=extended | fd | FrameFlag.BRS),
        row(4_000, 0x080),
        row(5_000, 0x123, bytes(range(12)), flags=fd | FrameFlag.ESI),
        row(6_000, 0x000, b"\x01\x05"),
    ]
    path = _written(tmp_path, canedge(frames))
    # In this process, so that the number of records counts.
    reader = mf4_library.Mf4Frames(path, path)
    batch, facts = FrameBatch.concat(list(reader.batches())), reader.facts
    assert rows(read(path)[0]) == rows(batch)
    assert [(t, int(facts.buses[bus]) - 1, *rest) for t, bus, *rest in rows(batch)] == frames


@pytest.mark.skipif(find_spec("asammdf") is None, reason="asammdf is not here")
@pytest.mark.parametrize("offset", [80, 1 << 20])
def test_mdf_fields_outside_of_their_records_are_not_read(tmp_path: Path, offset: int) -> None:
    from tests.analyzer.mf4_files import canedge

    raw = bytearray(canedge([row(0, 0x181, b"\1"), row(1_000, 0x182, b"\2")]))
    places = [at for at in range(len(raw)) if raw[at : at + 4] == b"##CN"]
    data = [at + 24 + 8 * int.from_bytes(raw[at + 16 : at + 24], "little") for at in places]
    # In the data of a channel block the byte offset is at 4, and at 8 the bit count: 29 of an ID.
    at = 4 + next(at for at in data if raw[at + 8 : at + 12] == b"\x1d\0\0\0")
    raw[at : at + 4] = offset.to_bytes(4, "little")
    with pytest.raises(
        CaptureError, match="the fields of CAN_DataFrame lie outside of its records"
    ):
        read(_written(tmp_path, bytes(raw)))


@pytest.mark.skipif(find_spec("asammdf") is None, reason="asammdf is not here")
@settings(parent=PROPERTY, max_examples=20)
@given(frames=frame_rows(back=False))
def test_any_frames_come_out_of_mdf_as_they_were_written(tmp_path: Path, frames: list[Row]) -> None:
    from syncline_analyzer.readers.mf4_library import Mf4Frames
    from tests.analyzer.mf4_files import mf4

    path = _written(tmp_path, mf4(frames))
    reader = Mf4Frames(path, path)
    found = rows(FrameBatch.concat(list(reader.batches())))
    assert sorted(
        (t, int(reader.facts.buses[bus]) - 1, *rest) for t, bus, *rest in found
    ) == sorted(frames)


LOGGED = (
    row(0, 0x080),
    row(1_000, 0x181, bytes(range(8))),
    row(2_000, 0x70A, flags=FrameFlag.REMOTE, dlc=1),
    row(3_000, 0x18FEF100, b"\1\2\3", bus=1, flags=FrameFlag.EXTENDED | FrameFlag.TX),
    row(4_000, 0x70A, b"\5"),
)
RECORD_BYTES = 26


@pytest.mark.skipif(find_spec("asammdf") is None, reason="asammdf is not here")
@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize("missing", [0, 1, 3 * RECORD_BYTES + 7])
def test_mdf_logs_that_were_cut_off_or_never_finished_give_what_stands(
    tmp_path: Path, finished: bool, missing: int
) -> None:
    from tests.analyzer.mf4_files import logger_mf4

    raw = logger_mf4(LOGGED, finished=finished)
    batch, facts, _ = read(_written(tmp_path, raw[: len(raw) - missing]))
    kept = len(LOGGED) - -(-missing // RECORD_BYTES)
    assert [(t, int(facts.buses[bus]) - 1, *rest) for t, bus, *rest in rows(batch)] == list(
        LOGGED[:kept]
    )
    said = "never finished" if not finished else "cut off"
    assert facts.damage is None if finished and not missing else said in (facts.damage or "")
    assert facts.time_base == "utc"


_DYING = (
    "import os, pickle, sys; from pathlib import Path; from syncline_analyzer.capture import CaptureFacts;"
    " from syncline_analyzer.readers.mf4 import Message;"
    " sys.stdout.buffer.write(pickle.dumps(Message(CaptureFacts(Path('x'), 'mf4'))) + b'half');"
    " sys.stdout.flush(); os._exit(9)"
)


@pytest.mark.skipif(find_spec("asammdf") is None, reason="asammdf is not here")
@pytest.mark.parametrize("code", ["import os; os._exit(9)", "import time; time.sleep(600)"])
def test_a_crash_or_hang_of_what_reads_mdf_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str
) -> None:
    monkeypatch.setattr("syncline_analyzer.readers.mf4._START", code)
    monkeypatch.setattr("syncline_analyzer.readers.mf4.PATIENCE_S", 2.0)
    with pytest.raises(CaptureError, match="crashed or took too long") as caught:
        read(_written(tmp_path, b"MDF     4.10    " + bytes(64)))
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(find_spec("asammdf") is None, reason="asammdf is not here")
def test_a_crash_amid_the_frames_is_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("syncline_analyzer.readers.mf4._START", _DYING)
    path = _written(tmp_path, b"MDF     4.10    " + bytes(64))
    reader = open_capture(path)
    assert list(reader.batches()) == []
    assert "crashed" in (reader.facts.damage or "")
    assert reader.facts.path == path
