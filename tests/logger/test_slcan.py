"""A real serial interface of python-can: slcan over a pseudo terminal."""

import os
import sys
import threading
import time
from pathlib import Path

import pytest

from syncline_logger.bus_options import BusOptions
from syncline_logger.recorder import record
from syncline_logger.sources.python_can import PythonCanSource
from tests.logger.capture_contents import doctor_complaints, read_capture

pytest.importorskip("serial")
if sys.platform == "win32":
    pytest.skip("no pseudo terminals on Windows", allow_module_level=True)


class Adapter:
    """The far end of a pseudo terminal: sends frames once it was opened, notes what it was told."""

    def __init__(self, lines: list[bytes]) -> None:
        self._far, near = os.openpty()
        self.port = os.ttyname(near)
        self._lines = lines
        self.told = b""
        self.sent = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while b"L\r" not in self.told:
            self.told += os.read(self._far, 100)
        time.sleep(0.5)
        for line in self._lines:
            os.write(self._far, line + b"\r")
        self.sent.set()
        while True:
            self.told += os.read(self._far, 100)


def test_frames_of_an_slcan_adapter(tmp_path: Path) -> None:
    numbered = [b"t1858" + n.to_bytes(8, "big").hex().upper().encode() for n in range(500)]
    adapter = Adapter([*numbered, b"T1ABCDE0521122", b"r7050", b"t0800"])
    stop = threading.Event()

    def started(path: Path) -> None:
        def stop_later() -> None:
            adapter.sent.wait(20)
            time.sleep(1)
            stop.set()

        threading.Thread(target=stop_later).start()

    source = PythonCanSource(
        BusOptions("a", "slcan", adapter.port, bitrate=500_000, arguments={"sleep_after_open": 0.1})
    )
    result = record([source], tmp_path, stop=stop, on_start=started)
    assert doctor_complaints(result.path) == []
    frames = read_capture(result.path).frames("a")
    assert frames[:500] == [(0x185, 0, 8, n.to_bytes(8, "big")) for n in range(500)]
    assert frames[500:] == [
        (0x1ABCDE05, 1, 2, b"\x11\x22"),
        (0x705, 2, 0, b""),
        (0x080, 0, 0, b""),
    ]
    commands = {line for line in adapter.told.split(b"\r") if line}
    assert commands <= {b"C", b"S6", b"L", b""}, "listen-only, and nothing was transmitted"
