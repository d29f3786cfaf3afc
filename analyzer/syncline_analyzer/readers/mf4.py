"""ASAM MDF 4 bus logs (CANedge, Vector, ETAS), by way of asammdf, which is no dependency.

asammdf runs native code that a damaged file can crash, prints, and has no bounds: it reads in a
process of its own, and what happens to that is a word about the file.
"""

import json
import pickle
import subprocess
import sys
import weakref
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from threading import Timer
from typing import IO, Any, Final

from syncline_analyzer.capture import CaptureFacts
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.errors import CaptureError
from syncline_schemas.named_tuples import NamedTuple

PIP_LINE: Final = "pip install 'syncline[mf4]'"
PATIENCE_S: Final = 90.0
"""How long a message may take, and for each 4 MB of the file a second more."""
_START: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    " from syncline_analyzer.readers.mf4_child import main; main(sys.argv[2])"
)


class Message(NamedTuple):
    """What the process that reads tells: the facts so far, and frames, an end, or why it refuses."""

    facts: CaptureFacts | None = None
    frames: FrameBatch | None = None
    refused: str | None = None
    ends: bool = False


class Mf4Reader:
    """The frames of all CAN groups, merged by their times.

    Raises:
        CaptureError: asammdf is not installed, the file cannot be read, or it holds no CAN frames.
    """

    def __init__(self, path: Path) -> None:
        self.facts = CaptureFacts(path, "mf4")
        if find_spec("asammdf") is None:
            raise CaptureError(
                f"{path}: is an ASAM MDF file; to read it, install the extra 'mf4': {PIP_LINE}"
            )
        self._path = path
        self._patience_s = PATIENCE_S + path.stat().st_size / 4e6
        self._process = _started(path)
        self._close = weakref.finalize(self, _ended, self._process)
        first = self._message()
        if first is None or first.refused is not None:
            self._close()
            why = first.refused if first else f"{path}: cannot be read as ASAM MDF: {self._death()}"
            raise CaptureError(why)
        self._take(first)

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in order of time; where the process that reads dies, what it gave is kept."""
        try:
            while True:
                message = self._message()
                if message is None or message.refused is not None:
                    why = message.refused if message else self._death()
                    self.facts.damage = f"the rest cannot be read: {why}"
                    return
                self._take(message)
                if message.frames is not None:
                    yield message.frames
                if message.ends:
                    return
        finally:
            self._close()

    def _take(self, message: Message) -> None:
        for each in fields(CaptureFacts):
            if message.facts is not None and each.name != "path":
                setattr(self.facts, each.name, getattr(message.facts, each.name))

    def _message(self) -> Message | None:
        """The next message; None where the process died, or took too long and was ended."""
        stream: IO[bytes] | None = self._process.stdout
        assert stream is not None
        timer = Timer(self._patience_s, self._process.kill)
        timer.daemon = True
        timer.start()
        try:
            told: Any = pickle.load(stream)
        except Exception:  # noqa: BLE001  half a message may be anything
            return None
        finally:
            timer.cancel()
        return told if isinstance(told, Message) else None

    def _death(self) -> str:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(5)
        return f"asammdf, which reads it, crashed or took too long (exit {self._process.poll()})"


def _started(path: Path) -> "subprocess.Popen[bytes]":
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-c", _START, json.dumps(list(map(str, sys.path))), str(path)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            # Windows: no console window of its own.
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError as error:
        raise CaptureError(
            f"{path}: the process that reads ASAM MDF cannot be started: {error}"
        ) from error


def _ended(process: "subprocess.Popen[bytes]") -> None:
    if process.stdout is not None:
        process.stdout.close()
    process.kill()
    process.wait()
