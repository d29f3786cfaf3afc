"""Captures in python-can: its own functions and tools, found by the entry points."""

import gzip
import io
import logging
import math
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path

import can
import can.cli
import can.logconvert
import can.logger
import can.player
import pytest
from can.interfaces.virtual import VirtualBus
from can.io.logger import MESSAGE_WRITERS
from can.io.player import MESSAGE_READERS
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer import open_session
from syncline_logger import message_log
from syncline_logger.can_message import ns_of
from syncline_logger.can_plugin import McapReader, McapWriter
from syncline_schemas.batch import FrameFlag
from syncline_schemas.errors import CaptureError
from tests.analyzer import binary_files
from tests.analyzer.log_builder import row
from tests.logger.capture_contents import doctor_complaints, read_capture

ROOT = Path(__file__).parents[1]
GROUPS = ("can.io.message_writer", "can.io.message_reader")
START_S = 1_700_000_000.0


def declared(group: str) -> dict[str, str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found: dict[str, str] = project["entry-points"][group]
    return found


@pytest.fixture
def _plugged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The entry points of the project, for python-can to find, whatever is installed."""
    folder = tmp_path / "site" / "syncline_declared-0.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text("Name: syncline-declared\nVersion: 0\n", encoding="utf-8")
    sections = [
        f"[{group}]\n" + "".join(f"{name} = {place}\n" for name, place in declared(group).items())
        for group in GROUPS
    ]
    (folder / "entry_points.txt").write_text("\n".join(sections), encoding="utf-8")
    for known in (MESSAGE_WRITERS, MESSAGE_READERS):
        monkeypatch.delitem(known, ".mcap", raising=False)
    monkeypatch.syspath_prepend(str(folder.parent))
    yield
    for known in (MESSAGE_WRITERS, MESSAGE_READERS):
        known.pop(".mcap", None)


plugged = pytest.mark.usefixtures("_plugged")

MESSAGES = (
    can.Message(timestamp=START_S, arbitration_id=0x000, is_extended_id=False, data=b"\x01\x05",
                channel="can0", is_rx=False),
    can.Message(timestamp=START_S + 1e-6, arbitration_id=0x18DAF110, data=bytes(8), channel=1),
    can.Message(timestamp=START_S + 0.25, arbitration_id=0x705, is_extended_id=False,
                is_remote_frame=True, dlc=3),
    can.Message(timestamp=START_S + 0.5, arbitration_id=0x88, is_extended_id=False,
                is_error_frame=True, data=bytes(range(8)), channel="can0"),
    can.Message(timestamp=START_S + 0.75, arbitration_id=0x123, is_extended_id=False, is_fd=True,
                bitrate_switch=True, error_state_indicator=True, data=bytes(range(64)), channel=1),
    can.Message(timestamp=START_S + 0.5, arbitration_id=0x7FF, is_extended_id=False),
)  # fmt: skip


def write(file: Path, messages: tuple[can.Message, ...] = MESSAGES) -> None:
    with McapWriter(file) as writer:
        for message in messages:
            writer(message)


def same(messages: list[can.Message], others: list[can.Message]) -> bool:
    return len(messages) == len(others) and all(
        one.equals(other, timestamp_delta=0.0) for one, other in zip(messages, others, strict=True)
    )


@pytest.mark.parametrize("group", GROUPS)
def test_the_installed_package_has_the_declared_entry_points(group: str) -> None:
    if not any(each.dist and each.dist.name == "syncline" for each in entry_points(group=group)):
        pytest.skip("installed before the entry points were declared: `uv sync`")
    found = {each.name: each for each in entry_points(group=group)}
    assert found[".mcap"].value == declared(group)[".mcap"]
    assert found[".mcap"].load() in (McapWriter, McapReader)


@plugged
def test_logger_and_log_reader_take_mcap(tmp_path: Path) -> None:
    path = tmp_path / "x.MCAP"
    with can.Logger(path) as writer:
        assert isinstance(writer, McapWriter)
        for message in MESSAGES:
            writer(message)
    with can.LogReader(path) as reader:
        assert isinstance(reader, McapReader)
        assert same(list(reader), list(MESSAGES))
        assert same(list(reader), list(MESSAGES)), "a second pass reads the same"


def test_other_readers_of_mcap_find_each_channel_as_a_bus(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    write(path)
    found = {topic: len(each) for topic, each in read_capture(path).messages.items()}
    assert found == {"/can/can0/frames": 2, "/can/1/frames": 2, "/can/can/frames": 2}
    assert doctor_complaints(path) == []


@plugged
def test_can_logger_records_a_bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.mcap"
    received = interrupted_after(monkeypatch, 20)
    with VirtualBus("logged") as sender:
        monkeypatch.setattr(sys, "argv", ["can_logger", "-f", str(path), "-i", "virtual",
                                          "-c", "logged"])  # fmt: skip
        original = can.cli.create_bus_from_namespace

        def connected(*words: object, **more: object) -> can.BusABC:
            bus = original(*words, **more)  # type: ignore[arg-type]
            for number in range(20):
                sender.send(can.Message(arbitration_id=number, is_extended_id=False, data=[number]))
            return bus

        monkeypatch.setattr(can.logger, "create_bus_from_namespace", connected)
        can.logger.main()
    assert same(list(McapReader(path)), received)


def interrupted_after(monkeypatch: pytest.MonkeyPatch, count: int) -> list[can.Message]:
    """What a bus delivers before it is interrupted as by Ctrl-C."""
    received: list[can.Message] = []
    original: Callable[..., can.Message | None] = VirtualBus.recv

    def recv(self: VirtualBus, timeout: float | None = None) -> can.Message | None:
        if len(received) == count:
            raise KeyboardInterrupt
        message = original(self, timeout)
        if message is not None:
            received.append(message)
        return message

    monkeypatch.setattr(VirtualBus, "recv", recv)
    return received


@plugged
def test_can_player_plays_a_capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.mcap"
    write(path)
    with VirtualBus("played") as receiver:
        monkeypatch.setattr(sys, "argv", ["can_player", "-i", "virtual", "-c", "played", "-g", "0",
                                          "--ignore-timestamps", "-v", str(path)])  # fmt: skip
        monkeypatch.setattr(can.player, "_set_logging_level_from_namespace", lambda _: None)
        can.player.main()
        got = [receiver.recv(0) for _ in range(len(MESSAGES))]
    shown = [(each.arbitration_id, bytes(each.data)) for each in got if each is not None]
    expected = [(m.arbitration_id, bytes(m.data)) for m in MESSAGES if not m.is_error_frame]
    assert shown == expected


@plugged
def test_can_logconvert_reads_and_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = tmp_path / "x.mcap", tmp_path / "y.mcap"
    write(first)
    monkeypatch.setattr(sys, "argv", ["can_logconvert", str(first), str(second)])
    can.logconvert.main()
    assert same(list(McapReader(second)), list(MESSAGES))


BAG = [
    row(0, 0x701, b"\5"),
    row(1_000, 0x18DAF110, bytes(range(8)), bus=1, flags=FrameFlag.EXTENDED),
    row(2_000, 0x705, flags=FrameFlag.REMOTE, dlc=3),
]


@plugged
def test_log_reader_reads_ros2_bags(tmp_path: Path) -> None:
    (tmp_path / "bag.mcap").write_bytes(binary_files.ros2(BAG))
    with can.LogReader(tmp_path / "bag.mcap") as log:
        got = list(log)
    truth = [
        can.Message(timestamp=START_S, arbitration_id=0x701, is_extended_id=False, data=b"\5"),
        can.Message(timestamp=START_S + 1e-3, arbitration_id=0x18DAF110, data=bytes(range(8))),
        can.Message(timestamp=START_S + 2e-3, arbitration_id=0x705, is_extended_id=False,
                    is_remote_frame=True, dlc=3),
    ]  # fmt: skip
    for message, bus in zip(truth, (0, 1, 0), strict=True):
        message.channel = f"/can{bus}/from_can_bus"
    assert same(got, truth)


def test_can_fd_in_a_ros2_bag_and_what_is_cut_off(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    raw = binary_files.ros2_fd([row(0, 0x123, bytes(range(12)), flags=FrameFlag.FD)])
    (tmp_path / "bag.mcap").write_bytes(raw[:-20])
    (got,) = McapReader(tmp_path / "bag.mcap")
    assert (got.is_fd, bytes(got.data), got.timestamp) == (True, bytes(range(12)), START_S)
    assert "no footer" in caplog.text


@plugged
def test_can_player_plays_a_ros2_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bag.mcap").write_bytes(binary_files.ros2(BAG))
    with VirtualBus("bag") as receiver:
        monkeypatch.setattr(sys, "argv", ["can_player", "-i", "virtual", "-c", "bag", "-g", "0",
                                          "--ignore-timestamps", str(tmp_path / "bag.mcap")])  # fmt: skip
        monkeypatch.setattr(can.player, "_set_logging_level_from_namespace", lambda _: None)
        can.player.main()
        got = [receiver.recv(0) for _ in BAG]
    assert [m.arbitration_id for m in got if m is not None] == [0x701, 0x18DAF110, 0x705]


def test_message_sync_keeps_the_order_of_the_capture(tmp_path: Path) -> None:
    write(tmp_path / "x.mcap")
    with McapReader(tmp_path / "x.mcap") as reader:
        assert same(list(can.MessageSync(reader, timestamps=False, gap=0)), list(MESSAGES))


@plugged
def test_appending_is_refused_and_leaves_the_file_alone(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    write(path)
    before = path.read_bytes()
    with pytest.raises(ValueError, match="cannot be appended to: give another file name"):
        can.Logger(path, append=True)
    assert path.read_bytes() == before


def test_what_waits_is_written_without_another_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_log, "FLUSH_AFTER_S", 0.0)
    path = tmp_path / "x.mcap"
    writer = McapWriter(path)
    for number, message in enumerate(MESSAGES, 1):
        writer(message)
        wait_for(lambda: len(list(McapReader(path))) == number)  # noqa: B023
    assert same(list(McapReader(path)), list(MESSAGES)), "as a killed process leaves it"
    writer.stop()


def wait_for(holds: Callable[[], bool]) -> None:
    until = time.monotonic() + 30
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.01)


def test_a_cut_capture_is_read_up_to_the_cut(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "x.mcap"
    write(path)
    path.write_bytes(path.read_bytes()[:-60])
    with caplog.at_level(logging.WARNING):
        assert same(list(McapReader(path)), list(MESSAGES))
    assert "cut off" in caplog.text


def test_file_objects_and_gzip(tmp_path: Path) -> None:
    stream = io.BytesIO()
    keep, stream.close = stream.close, lambda: None  # type: ignore[method-assign]
    with McapWriter(stream) as writer:
        for message in MESSAGES:
            writer(message)
    with McapReader(io.BytesIO(stream.getvalue())) as reader:
        assert same(list(reader), list(MESSAGES))
    keep()
    with McapWriter(gzip.open(tmp_path / "x.mcap.gz", "wb")) as writer:
        writer(MESSAGES[0])
    with McapReader(gzip.open(tmp_path / "x.mcap.gz", "rb")) as reader:
        assert same(list(reader), [MESSAGES[0]])


def test_stopping_twice_and_messages_after_it_do_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    writer = McapWriter(path)
    writer.stop()
    writer(MESSAGES[0])
    writer.stop()
    assert list(McapReader(path)) == []


def test_a_full_disk_is_raised_by_the_next_call(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_log, "FLUSH_AFTER_S", 0.0)

    class Full(io.BytesIO):
        def write(self, data: object, /) -> int:
            raise OSError(28, "No space left on device")

    writer = McapWriter(Full())
    writer(MESSAGES[0])
    wait_for(lambda: writer._log._failure is not None)
    with pytest.raises(OSError, match="No space left"):
        writer(MESSAGES[1])
    with pytest.raises(OSError, match="No space left"):
        writer.stop()


@pytest.mark.parametrize("content", [b"", b"no capture at all"])
def test_what_is_no_capture(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    if content:
        with pytest.raises(CaptureError, match="no MCAP file"):
            McapReader(path)
    else:
        assert list(McapReader(path)) == []


def test_channels_whose_names_make_one_topic_stay_apart(tmp_path: Path) -> None:
    sent = tuple(
        can.Message(timestamp=START_S, arbitration_id=1, channel=channel)
        for channel in ("a/b", "a b", None, "can", 0, "00")
    )
    write(tmp_path / "x.mcap", sent)
    assert [each.channel for each in McapReader(tmp_path / "x.mcap")] == [s.channel for s in sent]


stamps = st.one_of(
    st.floats(0, 1e6), st.floats(1.6e9, 2e9), st.just(0.0), st.sampled_from([math.nan, math.inf])
)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.builds(
            can.Message,
            timestamp=st.floats(1.6e9, 2e9),
            arbitration_id=st.integers(0, 0x7FF),
            is_extended_id=st.booleans(),
            is_error_frame=st.booleans(),
            is_rx=st.booleans(),
            channel=st.sampled_from([None, 0, 3, "can1", "vcan"]),
            data=st.binary(max_size=8),
        ),
        max_size=20,
    )
)
def test_nothing_is_lost_on_the_way(
    tmp_path_factory: pytest.TempPathFactory, messages: list[can.Message]
) -> None:
    path = tmp_path_factory.mktemp("trip") / "x.mcap"
    write(path, tuple(messages))
    assert same(list(McapReader(path)), messages)


@given(stamps)
def test_stamps_of_any_kind_are_taken(stamp: float) -> None:
    with McapWriter(io.BytesIO()) as writer:
        writer(can.Message(timestamp=stamp, arbitration_id=1))


@given(st.floats(1e9, 4e9))
def test_seconds_become_nanoseconds_without_loss(stamp: float) -> None:
    assert abs(ns_of(stamp) * stamp.as_integer_ratio()[1]
               - stamp.as_integer_ratio()[0] * 10**9) <= stamp.as_integer_ratio()[1]  # fmt: skip
    assert ns_of(stamp) / 10**9 == stamp


def test_a_healthy_capture_stays_healthy_through_python_can(tmp_path: Path) -> None:
    healthy = ROOT / "samples" / "healthy_line.mcap"
    path = tmp_path / "x.mcap"
    with McapReader(healthy) as reader:
        write(path, tuple(reader))
    before, after = open_session(str(healthy)), open_session(str(path))
    assert {each.severity for each in after.analysis.findings} <= {"info"}
    assert len(after.nmt_states()) == len(before.nmt_states())
    assert after.analysis.capture.frames == before.analysis.capture.frames
    assert after.analysis.capture.buses == before.analysis.capture.buses


@pytest.mark.parametrize(("length", "found"), [(8, {"error.bus_off"}), (4, set()), (0, set())])
def test_error_frames_of_other_drivers_are_no_classes_of_socketcan(
    length: int, found: set[str], tmp_path: Path
) -> None:
    """40h is bus-off in SocketCAN's eight bytes; PEAK's error frames have four and other bits."""
    beats = [
        can.Message(timestamp=START_S + k * 0.01, arbitration_id=0x705, is_extended_id=False,
                    data=[5])
        for k in range(200)
    ]  # fmt: skip
    error = can.Message(timestamp=START_S + 1, arbitration_id=0x40, is_extended_id=False,
                        is_error_frame=True, data=bytes(length))  # fmt: skip
    write(tmp_path / "x.mcap", (*beats[:101], error, *beats[101:]))
    analysis = open_session(str(tmp_path / "x.mcap")).analysis
    assert analysis.capture.error_frames == 1
    assert {each.id for each in analysis.findings} == found
