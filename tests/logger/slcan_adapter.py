"""A serial adapter over a pseudo terminal."""

import os
import select
import threading
from pathlib import Path

_adapters: list["Adapter"] = []


def unplug_all() -> None:
    """Take away every adapter that is still plugged in."""
    while _adapters:
        _adapters.pop().unplug()


def numbered(first: int, count: int) -> bytes:
    """Lines of frames with these numbers."""
    numbers = range(first, first + count)
    return b"".join(
        b"t1858%016X\r" % int.from_bytes(n.to_bytes(8, "big"), "little") for n in numbers
    )


class Adapter:
    """The far end of a pseudo terminal: answers commands, sends `frames` when it was opened.

    link: a name for its port that stays the same when it is plugged in again, as udev gives it.
    """

    def __init__(
        self,
        frames: bytes = b"",
        refuses: bytes = b"",
        mute: bool = False,
        status: bytes = b"",
        link: Path | None = None,
    ) -> None:
        self._far, near = os.openpty()
        self.port = os.ttyname(near)
        self.link = link
        if link:
            link.symlink_to(self.port)
        self._near = near
        self._frames, self._refuses, self._mute, self._status = frames, refuses, mute, status
        self.told: list[bytes] = []
        self.opened = threading.Event()
        self._unplugged = threading.Event()
        _adapters.append(self)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        rest = b""
        while not self._unplugged.is_set():
            if not select.select([self._far], [], [], 0.02)[0]:
                continue
            rest += os.read(self._far, 1000)
            *lines, rest = rest.split(b"\r")
            for line in lines:
                self._take(line)

    def _take(self, line: bytes) -> None:
        self.told.append(line)
        refused = line[:1] in [bytes([letter]) for letter in self._refuses]
        if line == b"F" and self._status:
            self.send(self._status + b"\r")
        elif not self._mute:
            self.send(b"\x07" if refused else b"\r")
        if line in (b"L", b"O") and not refused:
            self.send(self._frames)
            self.opened.set()

    def send(self, data: bytes) -> None:
        """Bytes to the recorder."""
        while data:
            data = data[os.write(self._far, data) :]

    def unplug(self) -> None:
        """Take the adapter away."""
        if self._unplugged.is_set():
            return
        self._unplugged.set()
        self._thread.join()
        if self.link:
            self.link.unlink()
        os.close(self._far)
        os.close(self._near)
