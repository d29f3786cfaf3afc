"""Frames received + frames reported lost = frames sent, however small the buffer."""

import time
from pathlib import Path

import pytest

from syncline_logger.batcher import FrameBuffer
from syncline_logger.bus_options import BusOptions
from syncline_logger.sources import socketcan
from syncline_logger.sources.socketcan import SocketCanSource
from tests.socketcan.can_bus import in_the_vm, numbered, send
from tests.socketcan.live_recording import recording_of

pytestmark = in_the_vm


@pytest.fixture(autouse=True)
def _small_buffer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socketcan, "RECEIVE_BUFFER_BYTES", 64 << 10)


def test_the_losses_behind_the_last_frame_are_known() -> None:
    source = SocketCanSource(BusOptions("vcan0", "socketcan", "vcan0"))
    source.open()
    begin_ns = time.time_ns()
    sent = send("vcan0", numbered(2000))
    end_ns = time.time_ns()
    buffer = FrameBuffer(time.time_ns)
    received = source.read(buffer, 0, 0)
    [loss] = buffer.take().losses
    assert loss.frames is not None
    assert 0 < received < sent
    assert received + loss.frames == sent
    assert begin_ns <= loss.first_ns <= end_ns <= loss.last_ns
    source.close()


def test_losses_between_frames_stand_where_they_were() -> None:
    source = SocketCanSource(BusOptions("vcan0", "socketcan", "vcan0"))
    source.open()
    buffer = FrameBuffer(time.time_ns)
    sent = received = 0
    for _ in range(3):
        sent += send("vcan0", numbered(1000))
        received += source.read(buffer, 0, 0)
        time.sleep(0.2)
    sent += send("vcan0", numbered(1))
    received += source.read(buffer, 0, 0)
    losses = buffer.take().losses
    source.close()
    assert len(losses) == 3
    assert received + sum(loss.frames or 0 for loss in losses) == sent


def test_a_flood_into_a_recording(tmp_path: Path) -> None:
    with recording_of(tmp_path, "vcan0") as running:
        sent = send("vcan0", numbered(3000))
        running.wait_for(lambda seen: seen.frames + seen.buses[0].dropped_frames >= sent)
    received = len(running.contents.frames("vcan0"))
    gaps = running.contents.values("/recorder/gap")
    lost = sum(gap.lost_frames for gap in gaps)
    assert received + lost == sent
    assert lost > 0
    assert running.contents.values("/can/vcan0/status")[-1].dropped_kernel == lost
    assert running.contents.metadata["syncline.stop"]["lost_frames"] == str(lost)
