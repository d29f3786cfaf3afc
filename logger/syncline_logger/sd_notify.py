"""Talking to systemd: ready, alive, status words, stopping (sd_notify(3))."""

import os
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import suppress


class ServiceManager:
    """The service manager that started this process, if it is one; else every call does nothing.

    Reads NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID.
    """

    def __init__(
        self,
        environ: Mapping[str, str] = os.environ,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._monotonic_ns = monotonic_ns
        self._socket = _connected(environ.get("NOTIFY_SOCKET", ""))
        self._period_ns = _watchdog_period_ns(environ) if self._socket else None
        self._next_ns = 0

    def ready(self, status: str) -> None:
        """The start is complete."""
        self._send(f"READY=1\nSTATUS={_one_line(status)}\nMAINPID={os.getpid()}")

    def status(self, text: str) -> None:
        """What `systemctl status` shows."""
        self._send(f"STATUS={_one_line(text)}")

    def alive(self) -> None:
        """The caller has just done its work; sent twice per watchdog time, however often called."""
        now_ns = self._monotonic_ns()
        if self._period_ns is not None and now_ns >= self._next_ns:
            self._next_ns = now_ns + self._period_ns
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """The end begins."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Say nothing more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> None:
        if self._socket is not None:
            # A manager that restarts, or reads slowly, is no reason to fail or to wait.
            with suppress(OSError):
                self._socket.send(text.encode())


def _connected(address: str) -> socket.socket | None:
    if not address or not hasattr(socket, "AF_UNIX"):
        return None
    sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        sender.connect("\0" + address[1:] if address.startswith("@") else address)
    except OSError:
        sender.close()
        return None
    sender.setblocking(False)
    return sender


def _watchdog_period_ns(environ: Mapping[str, str]) -> int | None:
    """Half of the time after which the watchdog bites, None where there is none for us."""
    if environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    text = environ.get("WATCHDOG_USEC", "")
    return int(text) * 1000 // 2 if text.isdecimal() and int(text) else None


def _one_line(text: str) -> str:
    return " ".join(text.split())
