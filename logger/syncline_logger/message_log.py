"""python-can's messages on their way into a capture: chunks of at most a second, synced to disk."""

import math
import os
import platform
import threading
import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import version
from typing import BinaryIO

from syncline_logger.can_message import fields_of, ns_of
from syncline_logger.lean_can import can
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo, CaptureMetadata, frames_topic
from syncline_schemas.capture.writer import FRAMES_PER_CHUNK, CaptureWriter
from syncline_schemas.errors import UsageError

SOURCE = "python-can"
"""`source` in the metadata of the captures that are written here."""
FLUSH_AFTER_S = 1.0
UNNAMED = "can"
"""Name of the bus of messages that tell no channel."""
MAX_BUSES = 256
_FIRST_UTC_NS = 946_684_800 * 1_000_000_000
"""2000-01-01: earlier stamps count from some start of their own."""

_Row = tuple[int, int, int, int, int, bytes]


class MessageLog:
    """Writes messages of any number of channels as one capture onto a binary stream.

    What `add` took is on the disk a second later at most, also when nothing follows. The stream
    stays the caller's to close. `add` and `finish` may be called from different threads.

    Raises:
        OSError: the disk refuses, also when that became known between two calls.
        UsageError: there are more than 256 channels.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._sync = _sync_of(stream)
        self._rows: list[_Row] = []
        self._rows_lock = threading.Lock()
        self._file_lock = threading.Lock()
        self._timer: threading.Timer | None = None
        self._writer: CaptureWriter | None = None
        self._buses: dict[str | int | None, BusInfo] = {}
        self._topics: set[str] = set()
        self._last_ns = 0
        self._resolution_ns = 1
        self._failure: OSError | None = None
        self._finished = False

    @property
    def bytes_written(self) -> int:
        """Bytes given to the stream so far."""
        return self._writer.bytes_written if self._writer else 0

    def add(self, message: can.Message) -> None:
        """Take a message; after `finish` it is ignored."""
        if self._failure is not None:
            raise self._failure
        with self._rows_lock:
            if self._finished:
                return
            can_id, flags, dlc, data = fields_of(message)
            t_ns, bus = self._t_ns(message.timestamp), self._bus(message.channel)
            self._rows.append((t_ns, bus, can_id, flags, dlc, bytes(data)))
            full = len(self._rows) >= FRAMES_PER_CHUNK
            if len(self._rows) == 1:
                self._timer = threading.Timer(FLUSH_AFTER_S, self._flush_in_time)
                self._timer.daemon = True
                self._timer.start()
        if full:
            self.flush()

    def flush(self) -> None:
        """Write what waits as a chunk and wait until it is on the disk."""
        with self._file_lock:
            with self._rows_lock:
                rows, self._rows = self._rows, []
                buses = list(self._buses.values())
                if self._timer is not None:
                    self._timer.cancel()
            try:
                if rows:
                    self._write(FrameBatch.from_rows(rows), buses)
            except OSError as error:
                self._failure = error
                raise

    def finish(self) -> None:
        """Write what waits, summary and footer; a second call does nothing."""
        with self._rows_lock:
            if self._finished:
                return
            self._finished = True
        self.flush()
        if self._failure is not None:
            raise self._failure
        with self._file_lock:
            self._opened(FrameBatch.empty()).finish()
            self._sync()

    def _flush_in_time(self) -> None:
        with suppress(OSError):  # kept, and raised by the next call
            self.flush()

    def _write(self, batch: FrameBatch, buses: list[BusInfo]) -> None:
        writer = self._opened(batch)
        for bus in buses[writer.bus_count :]:
            writer.add_bus(bus)
        writer.write_frames(batch)
        self._sync()

    def _opened(self, first: FrameBatch) -> CaptureWriter:
        """The writer; its metadata tell of the first frames what their stamps count from."""
        if self._writer is None:
            about = CaptureMetadata(
                version=version("syncline"),
                recording_id=uuid.uuid4().hex,
                host=platform.node(),
                created_ns=max(int(first.t_ns[0]), 0) if len(first) else 0,
                resolution_ns=self._resolution_ns,
                time_base=_time_base(first),
                source=SOURCE,
            )
            self._writer = CaptureWriter(self._stream, about, ())
        return self._writer

    def _t_ns(self, timestamp: float) -> int:
        """t of a stamp; one that is no number takes that of the message before."""
        if math.isfinite(timestamp) and abs(timestamp) < 9e9:
            self._last_ns = ns_of(timestamp)
            self._resolution_ns = max(self._resolution_ns, math.ceil(math.ulp(timestamp) * 1e9))
        return self._last_ns

    def _bus(self, told: str | int | Sequence[int] | None) -> int:
        channel = told if told is None or isinstance(told, str | int) else str(told)
        known = self._buses.get(channel)
        if known is None:
            if len(self._buses) == MAX_BUSES:
                raise UsageError(f"a capture holds {MAX_BUSES} channels, {channel!r} is one more")
            known = self._buses[channel] = self._new_bus(channel)
        return known.number

    def _new_bus(self, channel: str | int | None) -> BusInfo:
        text = "" if channel is None else str(channel)
        name, number = text or UNNAMED, len(self._buses)
        if frames_topic(name) in self._topics:
            name = f"{name} ({number})"
        self._topics.add(frames_topic(name))
        return BusInfo(name, number, channel=text)


def _time_base(first: FrameBatch) -> str:
    if not len(first) or int(first.t_ns.max()) >= _FIRST_UTC_NS:
        return "utc"
    return "relative" if len(first) == 1 or first.t_ns.any() else "none"


def _sync_of(stream: BinaryIO) -> Callable[[], None]:
    """What brings a stream's bytes onto the disk; one that is no file is only flushed."""
    try:
        number = stream.fileno()
        os.fsync(number)
    except (OSError, AttributeError):
        return stream.flush

    def sync() -> None:
        stream.flush()
        os.fsync(number)

    return sync
