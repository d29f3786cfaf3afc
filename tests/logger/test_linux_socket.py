"""Many messages by one call, on a pair of sockets that every Linux has."""

import errno
import socket
import sys
from collections.abc import Iterator

import pytest

from syncline_logger.sources.linux_socket import (
    MessageRing,
    library_call,
    raise_receive_buffer,
    receive_buffer_bytes,
)

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or library_call("recvmmsg") is None, reason="Linux has recvmmsg"
)

AF_UNIX = 1


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Sender and receiver of datagrams."""
    sender, receiver = socket.socketpair(AF_UNIX, socket.SOCK_DGRAM)
    with sender, receiver:
        yield sender, receiver


def test_messages_come_in_order_and_with_their_lengths(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    sender, receiver = pair
    ring = MessageRing(4, 72)
    sent = [bytes([n]) * (16 if n % 2 else 72) for n in range(6)]
    for message in sent:
        sender.send(message)
    found = []
    for count in (4, 2, 0):
        received = ring.receive(receiver.fileno())
        assert len(received.frames) == count
        assert len(received.control) == len(received.flags) == count
        assert received.control_lengths.tolist() == [0] * count
        for row, length in enumerate(received.lengths.tolist()):
            found.append(received.frames[row, :length].tobytes())
    assert found == sent


def test_longer_messages_are_cut(pair: tuple[socket.socket, socket.socket]) -> None:
    sender, receiver = pair
    sender.send(bytes(range(72)))
    received = MessageRing(1, 16).receive(receiver.fileno())
    assert received.lengths.tolist() == [16]
    assert received.frames[0].tobytes() == bytes(range(16))


def test_an_error_of_the_socket_is_raised() -> None:
    with socket.socket(AF_UNIX, socket.SOCK_DGRAM) as receiver:
        number = receiver.fileno()
    with pytest.raises(OSError, match="descriptor") as raised:
        MessageRing(1, 16).receive(number)
    assert raised.value.errno == errno.EBADF


def test_the_receive_buffer_is_raised_but_never_lowered(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    _, receiver = pair
    before = receive_buffer_bytes(receiver)
    raise_receive_buffer(receiver, before // 2)
    assert receive_buffer_bytes(receiver) == before


def test_there_is_no_function_of_a_strange_name() -> None:
    assert library_call("no_such_function_anywhere") is None
