"""Frames of real SocketCAN, as they come out of the capture."""

import struct
import threading
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from syncline_logger.batcher import FrameBuffer
from syncline_logger.bus_options import BusOptions
from syncline_logger.cli import cli
from syncline_logger.sources.socketcan import SocketCanSource
from syncline_schemas.batch import FrameBatch, FrameFlag
from tests.logger.capture_contents import read_capture
from tests.socketcan.can_bus import FD_FRAME, FRAME, in_the_vm, numbered, raw_socket, send
from tests.socketcan.live_recording import recording_of

pytestmark = in_the_vm

TX = int(FrameFlag.TX)
EXTENDED = int(FrameFlag.EXTENDED)
REMOTE = int(FrameFlag.REMOTE)
ERROR = int(FrameFlag.ERROR)


def read(source: SocketCanSource) -> FrameBatch:
    """What waits in a source."""
    buffer = FrameBuffer(time.time_ns)
    source.read(buffer, 0, 0)
    return buffer.take().frames


def test_frames_of_all_kinds(tmp_path: Path) -> None:
    sent = [
        FRAME.pack(0x181, 3, 0, 0, 0, b"\x01\x02\x03"),
        FRAME.pack(0x1ABCDEF0 | 1 << 31, 8, 0, 0, 0, b"abcdefgh"),
        FRAME.pack(0x705 | 1 << 30, 1, 0, 0, 0, b""),
        FRAME.pack(0x80, 0, 0, 0, 0, b""),
    ]
    with recording_of(tmp_path, "vcan0") as running:
        begin_ns = time.time_ns()
        send("vcan0", sent)
        end_ns = time.time_ns()
        running.wait_for_frames(len(sent))
    assert running.contents.frames("vcan0") == [
        (0x181, TX, 3, b"\x01\x02\x03"),
        (0x1ABCDEF0, TX | EXTENDED, 8, b"abcdefgh"),
        (0x705, TX | REMOTE, 1, b""),
        (0x80, TX, 0, b""),
    ]
    stamps = [stamp for _, stamp, _ in running.contents.messages["/can/vcan0/frames"]]
    assert begin_ns <= stamps[0] <= stamps[-1] <= end_ns
    about = running.contents.channel_metadata["/can/vcan0/frames"]
    assert (about["clock"], about["resolution_ns"]) == ("kernel", "1")


def test_the_stamp_is_that_of_the_arrival() -> None:
    source = SocketCanSource(BusOptions("vcan0", "socketcan", "vcan0"))
    source.open()
    begin_ns = time.time_ns()
    send("vcan0", numbered(1))
    end_ns = time.time_ns()
    time.sleep(0.2)
    [stamp] = read(source).t_ns.tolist()
    source.close()
    assert begin_ns <= stamp <= end_ns


def test_fd_frames(tmp_path: Path) -> None:
    data = bytes(range(64))
    sent = [
        FD_FRAME.pack(0x181, 64, 0x01, 0, 0, data),
        FD_FRAME.pack(0x182, 12, 0x02, 0, 0, data[:12]),
        FRAME.pack(0x183, 8, 0, 0, 0, data[:8]),
    ]
    with recording_of(tmp_path, "vcan1") as running:
        send("vcan1", sent)
        running.wait_for_frames(len(sent))
    fd = int(FrameFlag.FD) | TX
    assert running.contents.frames("vcan1") == [
        (0x181, fd | int(FrameFlag.BRS), 64, data),
        (0x182, fd | int(FrameFlag.ESI), 12, data[:12]),
        (0x183, TX, 8, data[:8]),
    ]


def test_error_frames_keep_all_their_bits() -> None:
    """On a virtual bus anybody may send an error frame."""
    classes = [1 << bit for bit in range(29)] + [0x1FFF_FFFF]
    data = bytes(range(0xF0, 0xF8))
    source = SocketCanSource(BusOptions("vcan0", "socketcan", "vcan0"))
    source.open()
    send("vcan0", [FRAME.pack(each | 1 << 29, 8, 0, 0, 0, data) for each in classes])
    frames = read(source)
    source.close()
    assert frames.can_id.tolist() == classes
    assert set(frames.flags.tolist()) == {ERROR | TX}
    assert {row.tobytes() for row in frames.data} == {data}


def test_filters_leave_error_frames_alone() -> None:
    wanted = ({"can_id": 0x181, "can_mask": 0x7FF},)
    source = SocketCanSource(BusOptions("vcan0", "socketcan", "vcan0", filters=wanted))
    source.open()
    send(
        "vcan0",
        [*numbered(1, can_id=0x182), *numbered(1), FRAME.pack(1 << 29 | 4, 8, 0, 0, 0, b"")],
    )
    frames = read(source)
    source.close()
    assert frames.can_id.tolist() == [0x181, 4]


def test_a_controller_hears_the_other_nodes(tmp_path: Path) -> None:
    with recording_of(tmp_path, "can0", bitrate=500_000) as running:
        send("can1", numbered(200), pause_s=0.001)
        running.wait_for_frames(200)
    frames = running.contents.frames("can0")
    assert [struct.unpack("<Q", data)[0] for _, _, _, data in frames] == list(range(200))
    assert {flags for _, flags, _, _ in frames} == {0}
    assert running.contents.channel_metadata["/can/can0/frames"]["bitrate"] == "500000"
    assert running.contents.values("/can/can0/status")[-1].state == "active"


def test_what_is_told_of_an_interface() -> None:
    source = SocketCanSource(BusOptions("can0", "socketcan", "can0", bitrate=250_000))
    source.open()
    facts = source.facts
    source.close()
    assert (facts.bitrate, facts.state, facts.restart_ms) == (500_000, "active", 0)
    assert (facts.listen_only, facts.fd) == (False, False)
    assert facts.receive_buffer_bytes is not None
    assert facts.receive_buffer_bytes >= 32 << 20
    [told, acknowledges] = facts.notes
    assert told.startswith("can0 is set to 500000 bit/s, not to the 250000 bit/s")
    assert "ip link set can0 up type can bitrate 500000 listen-only on" in acknowledges


def test_two_buses_are_read_by_one_thread(tmp_path: Path) -> None:
    with recording_of(tmp_path, "vcan0", "can0") as running:
        other = threading.Thread(target=send, args=("can1", numbered(300, can_id=0x282), 0.001))
        other.start()
        send("vcan0", numbered(500), pause_s=0.0005)
        other.join()
        running.wait_for_frames(800)
    for bus, count, can_id in (("vcan0", 500, 0x181), ("can0", 300, 0x282)):
        frames = running.contents.frames(bus)
        assert {each[0] for each in frames} == {can_id}
        assert [struct.unpack("<Q", each[3])[0] for each in frames] == list(range(count))
    assert [name for name in running.threads if name.startswith("syncline read")] == [
        "syncline read"
    ]


def test_nothing_is_sent(tmp_path: Path) -> None:
    """A witness on each bus sees what the test sends, and nothing else."""
    with raw_socket("vcan0") as witness, raw_socket("can1") as other:
        witness.settimeout(0.5)
        other.settimeout(0.5)
        with recording_of(tmp_path, "vcan0", "can0") as running:
            send("vcan0", numbered(20))
            running.wait_for_frames(20)
        heard = [witness.recv(16) for _ in range(20)]
        assert heard == numbered(20)
        with pytest.raises(TimeoutError):
            witness.recv(16)
        with pytest.raises(TimeoutError):
            other.recv(16)


def test_the_command_line(tmp_path: Path) -> None:
    """`syncline record` reads SocketCAN natively, and its metadata tells of the interface."""
    target = tmp_path / "x.mcap"

    def send_when_it_listens() -> None:
        while not target.exists():
            time.sleep(0.01)
        send("vcan0", numbered(50))

    sender = threading.Thread(target=send_when_it_listens, daemon=True)
    words = ["record", "-i", "socketcan", "-c", "vcan0", "-o", str(target), "--for", "4s"]
    sender.start()
    done = CliRunner().invoke(cli, [*words, "--no-decode"])
    sender.join()
    assert done.exit_code == 0, done.output
    contents = read_capture(target)
    assert len(contents.frames("vcan0")) == 50
    about = contents.metadata["syncline"]
    assert about["vcan0.loss_counters"] == "queue, kernel, controller"
    assert int(about["vcan0.receive_buffer_bytes"]) >= 32 << 20
