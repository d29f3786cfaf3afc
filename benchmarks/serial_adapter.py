"""A serial adapter on a pseudo terminal that sends the frames of a log as slcan."""

import os
import threading
from itertools import islice
from pathlib import Path


class SerialAdapter:
    """Sends everything as fast as it is read, once it was told to open (`L` or `O`).

    Attributes:
        port: name of the terminal to open.
        frames: how many it sends.
    """

    def __init__(self, log: Path, frames: int | None = None) -> None:
        import can

        self._far, near = os.openpty()
        self.port = os.ttyname(near)
        lines = [_line(message) for message in islice(can.LogReader(log), frames)]
        self.frames = len(lines)
        self._data = b"".join(lines)
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        told = b""
        while not told.endswith((b"L\r", b"O\r")):
            told += os.read(self._far, 100)
            if told.endswith(b"C\r"):
                os.write(self._far, b"\r")
        os.write(self._far, b"\r")
        left = memoryview(self._data)
        while left:
            left = left[os.write(self._far, left[:4096]) :]


def _line(message: object) -> bytes:
    import can

    assert isinstance(message, can.Message)
    extended = message.is_extended_id
    letter = "rt"[not message.is_remote_frame]
    head = f"{message.arbitration_id:08X}" if extended else f"{message.arbitration_id:03X}"
    data = "" if message.is_remote_frame else bytes(message.data).hex().upper()
    return f"{letter.upper() if extended else letter}{head}{message.dlc}{data}\r".encode()
