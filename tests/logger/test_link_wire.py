"""Answers of rtnetlink, built attribute by attribute."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from syncline_logger.sources.link_wire import CanLink, link_of, link_request

UP, RUNNING = 0x1, 0x40
CAN = 280


def attribute(kind: int, content: bytes) -> bytes:
    """struct rtattr."""
    size = 4 + len(content)
    return struct.pack("=HH", size, kind) + content + bytes(-size % 4)


def number(kind: int, value: int) -> bytes:
    return attribute(kind, struct.pack("=I", value))


def bit_timing(kind: int, bitrate: int) -> bytes:
    """struct can_bittiming: bit rate, sample point, time quantum, four segments, prescaler."""
    return attribute(kind, struct.pack("=8I", bitrate, 875, 125, 6, 7, 2, 1, 1))


CONTROLLER = (
    bit_timing(1, 500_000)
    + attribute(3, struct.pack("=I", 8_000_000))
    + number(4, 2)
    + attribute(5, struct.pack("=II", 0, 0x12))
    + number(6, 100)
    + attribute(8, struct.pack("=HH", 130, 4))
    + bit_timing(9, 2_000_000)
    + attribute(17 | 0x8000, number(1, 0x33))
)


def answer(
    flags: int = UP | RUNNING,
    device: int = CAN,
    kind: str = "can",
    can: bytes = CONTROLLER,
    message: int = 16,
) -> bytes:
    info = attribute(1, kind.encode() + b"\0") + (attribute(2 | 0x8000, can) if can else b"")
    body = struct.pack("=BBHiII", 0, 0, device, 7, flags, 0)
    body += attribute(3, b"can0\0") + number(4, 72) + attribute(18 | 0x8000, info)
    return struct.pack("=IHHII", 16 + len(body), message, 0, 1, 99) + body


def test_a_controller() -> None:
    assert link_of(answer()) == CanLink(
        index=7,
        name="can0",
        up=True,
        is_can=True,
        mtu=72,
        kind="can",
        bitrate=500_000,
        data_bitrate=2_000_000,
        state="passive",
        listen_only=True,
        can_listen_only=True,
        restart_ms=100,
    )


def test_a_virtual_bus_has_no_controller() -> None:
    link = link_of(answer(kind="vcan", can=b""))
    assert link is not None
    assert (link.kind, link.bitrate, link.state, link.listen_only, link.restart_ms) == (
        "vcan",
        None,
        "",
        None,
        None,
    )
    assert link.takes_fd


def test_a_controller_that_is_down_and_not_set_up() -> None:
    link = link_of(answer(flags=0, can=number(4, 4) + bit_timing(1, 0)))
    assert link is not None
    assert (link.up, link.bitrate, link.state) == (False, None, "stopped")


def test_an_ethernet_interface() -> None:
    link = link_of(answer(device=1, kind="veth"))
    assert link is not None
    assert (link.is_can, link.bitrate, link.state) == (False, None, "")


@pytest.mark.parametrize("state", range(8))
def test_states(state: int) -> None:
    names = ["active", "warning", "passive", "off", "stopped", "stopped", "", ""]
    link = link_of(answer(can=number(4, state)))
    assert link is not None
    assert link.state == names[state]


def test_other_messages_are_no_interface() -> None:
    assert link_of(answer(message=2)) is None
    assert link_of(b"") is None


@given(st.integers(0, len(answer())), st.binary(max_size=40))
def test_cut_and_strange_answers_are_survived(cut: int, tail: bytes) -> None:
    link_of(answer()[:cut] + tail)


def test_the_request() -> None:
    length, kind, flags, sequence, port = struct.unpack_from("=IHHII", link_request(7, 3))
    assert (length, kind, flags, sequence, port) == (32, 18, 1, 3, 0)
    assert struct.unpack_from("=BBHiII", link_request(7, 3), 16) == (0, 0, 0, 7, 0, 0)
