"""What is said of a SocketCAN interface."""

from dataclasses import replace

import pytest

from syncline_logger.bus_options import BusOptions
from syncline_logger.sources.link_wire import CanLink
from syncline_logger.sources.socketcan_notes import interface_notes, what_is_down, what_is_missing

LINK = CanLink(
    7,
    "can0",
    True,
    True,
    16,
    "can",
    500_000,
    listen_only=True,
    can_listen_only=True,
    state="active",
)
WANTED = 32 << 20


def notes(
    link: CanLink = LINK,
    buffer_bytes: int = WANTED,
    before: int | None = None,
    bitrate: int | None = 500_000,
    *,
    fd: bool = False,
    acknowledge: bool = False,
) -> list[str]:
    options = BusOptions("a", "socketcan", "can0", bitrate, fd=fd, acknowledge=acknowledge)
    return list(interface_notes(link, options, buffer_bytes, WANTED, before))


def test_an_interface_as_it_should_be_is_not_spoken_of() -> None:
    assert notes() == []
    assert notes(bitrate=None) == []
    assert notes(before=500_000) == []


def test_another_bit_rate_than_was_told() -> None:
    [note] = notes(bitrate=250_000)
    assert note.startswith("can0 is set to 500000 bit/s, not to the 250000 bit/s that were told")
    assert "'ip link set can0 up type can bitrate 250000'" in note


def test_another_bit_rate_than_before() -> None:
    assert notes(before=125_000) == ["can0 was set from 125000 to 500000 bit/s"]


def test_an_interface_that_acknowledges() -> None:
    loud = replace(LINK, listen_only=False)
    [note] = notes(loud)
    assert "'ip link set can0 up type can bitrate 500000 listen-only on'" in note
    assert notes(loud, acknowledge=True) == []
    [note] = notes(replace(loud, can_listen_only=False))
    assert note == "can0 acknowledges frames: its controller has no listen-only mode"


def test_no_can_fd() -> None:
    assert notes(fd=True) == ["can0 is not set up for CAN FD: frames of CAN FD are not heard"]
    assert notes(replace(LINK, mtu=72), fd=True) == []


def test_a_small_buffer() -> None:
    [note] = notes(buffer_bytes=425_984)
    assert note.startswith("the kernel's receive buffer holds about 560 frames instead of 44150")
    assert "sysctl net.core.rmem_max=16777216" in note


@pytest.mark.parametrize(
    ("kind", "command"),
    [("vcan", "ip link set can0 up'"), ("can", "ip link set can0 up type can bitrate 125000'")],
)
def test_an_interface_that_is_down(kind: str, command: str) -> None:
    assert what_is_down(replace(LINK, kind=kind), 125_000).endswith(command)


def test_no_interface() -> None:
    assert "ip link set can3 up type can bitrate 500000" in what_is_missing("can3", None)
