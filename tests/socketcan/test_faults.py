"""Faults of real interfaces: each is a gap that says when and why, and the recording goes on."""

import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from syncline_logger.bus_options import BusOptions
from syncline_logger.sources.socketcan import SocketCanSource
from syncline_schemas.can_errors import RECORDER_OFF, RECORDER_OVERFLOW
from syncline_schemas.errors import SourceError
from tests.socketcan.can_bus import (
    FD_FRAME,
    fault,
    in_the_vm,
    ip_link,
    is_there,
    numbered,
    send,
    sent_by,
    set_up,
)
from tests.socketcan.live_recording import LiveRecording, recording_of

pytestmark = in_the_vm

MS = 1_000_000


@pytest.fixture(autouse=True)
def _can0_is_set_up_again_and_has_sent_nothing() -> Iterator[None]:
    yield
    if not is_there("can0"):
        fault("can0", "replug")
        time.sleep(1)
    elif "DOWN" not in ip_link("show", "can0"):
        assert sent_by("can0") == 0
    set_up("can0", 500_000, "restart-ms", "0")


def numbers(running: LiveRecording) -> list[int]:
    """The running numbers of the frames in the file."""
    frames = running.contents.frames("can0")
    return [struct.unpack("<Q", each[3])[0] for each in frames if each[0] == 0x181]


def gaps(running: LiveRecording) -> list[Any]:
    return running.contents.values("/recorder/gap")


def states(running: LiveRecording) -> list[str]:
    """The states of the bus, each once in a row."""
    seen: list[str] = []
    for status in running.contents.values("/can/can0/status"):
        if not seen or seen[-1] != status.state:
            seen.append(status.state)
    return seen


def test_error_states(tmp_path: Path) -> None:
    with recording_of(tmp_path, "can0") as running:
        for kind, state in (("warning", "warning"), ("passive", "passive"), ("active", "active")):
            fault("can0", kind)
            running.wait_for(lambda seen, state=state: seen.buses[0].state == state)  # type: ignore[misc]
    assert states(running)[-4:] == ["active", "warning", "passive", "active"]
    assert gaps(running) == []


def test_bus_off_is_a_gap_until_the_restart(tmp_path: Path) -> None:
    with recording_of(tmp_path, "can0") as running:
        send("can1", numbered(5))
        running.wait_for_frames(5)
        fault("can0", "busoff")
        running.wait_for(lambda seen: seen.buses[0].state == "off")
        off_ns = time.time_ns()
        send("can1", numbered(5, 5))
        time.sleep(0.3)
        on_ns = time.time_ns()
        ip_link("set", "can0", "type", "can", "restart")
        running.wait_for(lambda seen: seen.buses[0].state == "active")
        send("can1", numbered(5, 10))
        running.wait_for_frames(5 + 1 + 1 + 5)
    assert numbers(running) == [0, 1, 2, 3, 4, 10, 11, 12, 13, 14]
    [gap] = gaps(running)
    assert (gap.reason, gap.bus, gap.HasField("lost_frames")) == (RECORDER_OFF, 0, False)
    assert gap.start_ns <= off_ns < on_ns <= gap.end_ns


def test_a_controller_that_restarts_by_itself(tmp_path: Path) -> None:
    set_up("can0", 500_000, "restart-ms", "200")
    with recording_of(tmp_path, "can0") as running:
        fault("can0", "busoff")
        running.wait_for(lambda seen: seen.buses[0].state == "off")
        running.wait_for(lambda seen: seen.buses[0].state == "active")
    [gap] = gaps(running)
    assert 150 * MS < gap.end_ns - gap.start_ns < 3000 * MS


def test_an_overrun_of_the_controller_is_a_loss_of_unknown_size(tmp_path: Path) -> None:
    with recording_of(tmp_path, "can0") as running:
        fault("can0", "overrun")
        running.wait_for(lambda seen: seen.buses[0].dropped_frames > 0)
    [gap] = gaps(running)
    assert (gap.reason, gap.HasField("lost_frames")) == (RECORDER_OVERFLOW, False)
    assert running.contents.values("/can/can0/status")[-1].dropped_controller == 1


def test_an_interface_that_is_down_for_a_while(tmp_path: Path) -> None:
    with recording_of(tmp_path, "can0") as running:
        send("can1", numbered(5))
        running.wait_for_frames(5)
        ip_link("set", "can0", "down")
        running.wait_for_presence(False)
        down_ns = time.time_ns()
        send("can1", numbered(5, 5))
        time.sleep(0.3)
        up_ns = time.time_ns()
        set_up("can0")
        send("can1", numbered(5, 10))
        running.wait_for_presence(True)
        running.wait_for_frames(10)
    assert numbers(running) == [0, 1, 2, 3, 4, 10, 11, 12, 13, 14]
    [gap] = gaps(running)
    assert (gap.bus, gap.HasField("lost_frames")) == (0, False)
    assert "went down" in gap.reason
    first_after = running.contents.messages["/can/can0/frames"][5][1]
    assert gap.start_ns <= down_ns < up_ns - 200 * MS <= gap.end_ns <= first_after
    texts = [s.text for s in running.contents.values("/can/can0/status") if s.text]
    assert any("went down" in text for text in texts)
    assert "listening again" in texts


def test_an_adapter_that_is_unplugged_and_plugged_in_again(tmp_path: Path) -> None:
    with recording_of(tmp_path, "can0") as running:
        send("can1", numbered(5))
        running.wait_for_frames(5)
        fault("can0", "unplug")
        running.wait_for_presence(False)
        send("can1", numbered(5, 5))
        fault("can0", "replug")
        time.sleep(1)
        set_up("can0")
        running.wait_for_presence(True)
        send("can1", numbered(5, 10))
        running.wait_for_frames(10)
    assert numbers(running) == [0, 1, 2, 3, 4, 10, 11, 12, 13, 14]
    [gap] = gaps(running)
    assert gap.end_ns - gap.start_ns > 1000 * MS


def test_a_changed_bit_rate_is_told(tmp_path: Path) -> None:
    with recording_of(tmp_path, "can0") as running:
        ip_link("set", "can0", "down")
        running.wait_for_presence(False)
        set_up("can0", 250_000)
        running.wait_for_presence(True)
    texts = [s.text for s in running.contents.values("/can/can0/status")]
    assert "can0 was set from 500000 to 250000 bit/s" in texts


def test_an_interface_that_is_set_up_for_fd_meanwhile(tmp_path: Path) -> None:
    ip_link("add", "vcan8", "type", "vcan")
    try:
        ip_link("set", "vcan8", "mtu", "16")
        ip_link("set", "vcan8", "up")
        with recording_of(tmp_path, "vcan8") as running:
            ip_link("set", "vcan8", "down")
            running.wait_for_presence(False)
            ip_link("set", "vcan8", "mtu", "72")
            ip_link("set", "vcan8", "up")
            running.wait_for_presence(True)
            send("vcan8", [FD_FRAME.pack(0x181, 48, 0, 0, 0, bytes(48))])
            running.wait_for_frames(1)
        assert [len(data) for _, _, _, data in running.contents.frames("vcan8")] == [48]
    finally:
        ip_link("del", "vcan8")


def test_an_interface_that_is_not_there_or_down() -> None:
    with pytest.raises(SourceError, match=r"no interface 'can7'.*ip link set can7 up type can"):
        SocketCanSource(BusOptions("can7", "socketcan", "can7")).open()
    ip_link("set", "can0", "down")
    with pytest.raises(SourceError, match=r"down; 'ip link set can0 up type can bitrate 250000'"):
        SocketCanSource(BusOptions("can0", "socketcan", "can0", bitrate=250_000)).open()
    with pytest.raises(SourceError, match="no CAN interface"):
        SocketCanSource(BusOptions("lo", "socketcan", "lo")).open()
