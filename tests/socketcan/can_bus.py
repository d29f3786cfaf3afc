"""What the tests do to the buses of the virtual machine: send, set up, break."""

import errno
import importlib.machinery
import importlib.util
import os
import socket
import struct
import subprocess
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

AF_CAN, CAN_RAW, SOL_CAN_RAW = 29, 1, 101
CAN_RAW_LOOPBACK_OF_OTHERS, CAN_RAW_FD_FRAMES = 3, 5
MSG_DONTROUTE, MSG_CONFIRM = 0x4, 0x800
FRAME = struct.Struct("=IBBBB8s")
FD_FRAME = struct.Struct("=IBBBB64s")

in_the_vm = pytest.mark.skipif("SOCKETCAN_VM" not in os.environ, reason="runs in socketcan-vm")


def shell(*words: str) -> str:
    """Run a command of the system; its output."""
    return subprocess.run(words, check=True, capture_output=True, encoding="utf-8").stdout


def ip_link(*words: str) -> str:
    """`ip link ...`."""
    return shell("ip", "link", *words)


@cache
def _harness() -> Any:
    loader = importlib.machinery.SourceFileLoader("socketcan_vm", os.environ["SOCKETCAN_VM"])
    spec = importlib.util.spec_from_loader("socketcan_vm", loader)
    assert spec
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def fault(interface: str, kind: str) -> None:
    """Make the emulated controller show a fault, or take it out and put it in again."""
    _harness().fault(interface, kind)


def is_there(interface: str) -> bool:
    """Whether there is such an interface."""
    return Path(f"/sys/class/net/{interface}").exists()


def set_up(interface: str, bitrate: int = 500_000, *options: str) -> None:
    """Bring a controller up anew."""
    ip_link("set", interface, "down")
    ip_link("set", interface, "up", "type", "can", "bitrate", str(bitrate), *options)


def sent_by(interface: str) -> int:
    """Frames that the controller has sent."""
    text = Path(f"/sys/class/net/{interface}/statistics/tx_packets").read_text(encoding="ascii")
    return int(text)


@contextmanager
def raw_socket(interface: str, *, fd: bool = False) -> Iterator[socket.socket]:
    """A socket on an interface, to send from or to witness what is on the bus."""
    with socket.socket(AF_CAN, socket.SOCK_RAW, CAN_RAW) as opened:
        if fd:
            opened.setsockopt(SOL_CAN_RAW, CAN_RAW_FD_FRAMES, 1)
        opened.bind((interface,))
        yield opened


def numbered(count: int, first: int = 0, can_id: int = 0x181) -> list[bytes]:
    """Frames with a running number in their data."""
    return [
        FRAME.pack(can_id, 8, 0, 0, 0, struct.pack("<Q", number))
        for number in range(first, first + count)
    ]


def send(interface: str, frames: Iterable[bytes], pause_s: float = 0.0) -> int:
    """Send frames from a socket of our own; how many."""
    count = 0
    with raw_socket(interface, fd=True) as sender:
        for frame in frames:
            _send_one(sender, frame)
            count += 1
            if pause_s:
                time.sleep(pause_s)
    return count


def _send_one(sender: socket.socket, frame: bytes) -> None:
    """Send; the queue of a slow controller may be full for a while."""
    while True:
        try:
            sender.send(frame)
        except OSError as error:
            if error.errno != errno.ENOBUFS:
                raise
            time.sleep(0.001)
        else:
            return
