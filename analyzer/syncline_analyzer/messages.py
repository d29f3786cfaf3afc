"""Objects that hold large arrays, sent from one process to another through a pipe.

A message is a pickled object (protocol 5) whose arrays stand behind it: head, length of each array,
object, arrays. Nothing is copied but into and out of the pipe.
"""

import os
import pickle
import struct
import sys
from io import RawIOBase
from queue import Queue
from threading import Thread
from types import TracebackType
from typing import Any, Self

import numpy as np

AHEAD = 3
"""Messages that wait to be written at most."""
_IN_LINE = 4096
"""Arrays of fewer bytes stand within the object."""
_MARK = b"Syncline"
"""What every message begins with: whatever else a process may write, is none."""
_MOST_PARTS = 1024
"""Linux and macOS write so many at once."""
_HEAD = struct.Struct("<8sQI")
"""Mark, bytes of the object, number of arrays."""


class MessageWriter:
    """Sends messages; a thread writes them while the next ones are made.

    Where nobody reads them any more, the process ends at once: it has no other purpose.
    """

    def __init__(self, out: RawIOBase) -> None:
        self._out = out
        self._waiting: Queue[list[memoryview] | None] = Queue(AHEAD)
        self._thread = Thread(target=self._write, name="syncline-messages", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._waiting.put(None)
        self._thread.join()

    def put(self, message: object) -> None:
        """Send a message, later; its arrays must stay as they are."""
        arrays: list[memoryview] = []

        def stands_within(buffer: pickle.PickleBuffer) -> bool:
            raw = buffer.raw()
            if raw.nbytes >= _IN_LINE:
                arrays.append(raw)
            return raw.nbytes < _IN_LINE

        pickled = pickle.dumps(message, 5, buffer_callback=stands_within)
        lengths = np.array([array.nbytes for array in arrays], "<u8")
        head = _HEAD.pack(_MARK, len(pickled), len(arrays)) + lengths.tobytes() + pickled
        self._waiting.put([memoryview(head), *arrays])

    def _write(self) -> None:
        while (parts := self._waiting.get()) is not None:
            self._write_all(parts)

    def _write_all(self, parts: list[memoryview]) -> None:
        try:
            while parts:
                written = self._written(parts)
                while parts and written >= len(parts[0]):
                    written -= len(parts.pop(0))
                if written:
                    parts[0] = parts[0][written:]
        except OSError:
            os._exit(1)

    def _written(self, parts: list[memoryview]) -> int:
        """Bytes that one call wrote: after each the thread must wait for the interpreter."""
        if sys.platform == "win32":
            return self._out.write(parts[0]) or 0
        else:
            return os.writev(self._out.fileno(), parts[:_MOST_PARTS])


def read_message(stream: RawIOBase) -> Any:
    """The next message; its arrays are its own.

    Raises:
        EOFError: there is none, or not all of it, or what comes is no message.
    """
    mark, size, count = _HEAD.unpack(_read(stream, _HEAD.size).data)
    if mark != _MARK:
        raise EOFError
    rest = _read(stream, 8 * count + size)
    lengths = np.frombuffer(rest, "<u8", count)
    arrays = [_read(stream, length) for length in lengths.tolist()]
    return pickle.loads(rest.data[8 * count :], buffers=arrays)


def _read(stream: RawIOBase, size: int) -> np.ndarray:
    """(size,) uint8 from the stream, in memory of its own."""
    found = np.empty(size, np.uint8)
    left = memoryview(found.data)
    while left:
        count = stream.readinto(left)
        if not count:
            raise EOFError
        left = left[count:]
    return found
