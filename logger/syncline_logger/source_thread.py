"""Threads that read sources into the buffer, and open again what was lost."""

import contextlib
import selectors
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from queue import SimpleQueue

from syncline_logger.batcher import FrameBuffer
from syncline_logger.clock import RecorderClock
from syncline_logger.source import Source, SourceAsleep
from syncline_schemas.batch import Gap
from syncline_schemas.errors import SourceError

READ_TIMEOUT_S = 0.1
"""How long a stop, or a look after a quiet source, may wait for the next frame."""
COLLECT_S = 0.02
"""After a read of polled sources frames collect for so long: reading many at once is cheap."""
FIRST_RETRY_S = 1.0
LONGEST_RETRY_S = 30.0
"""A lost source is tried again after the first, twice that and so on up to the longest."""
LAST_READS = 1000
"""A saturated bus can hold up the end for so many reads."""
LONGEST_PAUSE_S = 1.0
"""A thread shows that it lives at least so often while it waits."""
HUNG_NS = 15_000_000_000
"""A thread that shows no life for so long hangs; opening a slow adapter takes a third of it."""
ENDED_NS = 1_000_000_000
"""A thread that ended is replaced after so long."""
LONGEST_LOOK_NS = 1_000_000_000
"""Looks at the threads that are further apart count for so much: the machine may have slept."""
HANGS = "reading hangs in the driver"
ENDED = "the thread that reads ended"


@dataclass(frozen=True, slots=True)
class SourceEvent:
    """A source was lost, is back, or has something to tell; `gap` is what was missed in between.

    `state` is the controller's state as the interface tells it, empty where it told nothing.
    """

    bus: int
    log_ns: int
    present: bool
    text: str
    gap: Gap | None = None
    state: str = ""


class SourceReader:
    """One source: heard, asleep (open, but its interface is down) or lost; used by one thread.

    Attributes:
        bus: its number.
        present: whether it is heard.
        changes: grows whenever the source's file number may be another one.
        due_ns: when it is to be looked after though it has nothing to read [ns, log time].
        listening_ns: since when it has listened without a gap [ns, log time].
        heard_ns: what came before this is in the buffer [ns, log time].
        finished: its last words are told.
    """

    def __init__(
        self,
        source: Source,
        bus: int,
        buffer: FrameBuffer,
        clock: RecorderClock,
        events: "SimpleQueue[SourceEvent]",
        absent: SourceError | None = None,
    ) -> None:
        self.source = source
        self.bus = bus
        self.present = self._is_open = True
        self.finished = False
        self.changes = 0
        self._buffer = buffer
        self._clock = clock
        self._events = events
        self._reason = ""
        self._retry_s = FIRST_RETRY_S
        self._notes: tuple[str, ...] = ()
        self.listening_ns = self.heard_ns = self._tried_ns = self.due_ns = clock.now_ns()
        if absent is None:
            self._tell_facts()
        else:
            self._lost(str(absent), is_open=False)

    def turn(self, timeout_s: float) -> int:
        """Read what has come, after opening what was lost; the number of frames."""
        if not self._is_open and not self._opened_again():
            return 0
        begin_ns = self._clock.now_ns()
        self.due_ns = begin_ns + round(READ_TIMEOUT_S * 1e9)
        try:
            count = self.source.read(self._buffer, self.bus, timeout_s)
        except SourceAsleep as error:
            self._lost(str(error), is_open=True)
            return 0
        except BaseException as error:  # noqa: BLE001 - a driver may even exit; it is tried again
            self.drop(_words(error))
            return 0
        if not self.present:
            self._back(self._tried_ns)
        self.heard_ns = self._clock.now_ns() if timeout_s else begin_ns
        if count or self.heard_ns - self.listening_ns > LONGEST_RETRY_S * 1e9:
            self._retry_s = FIRST_RETRY_S
        return count

    def quiet_at(self, log_ns: int) -> None:
        """Nothing waited to be read at this log time."""
        if self.present:
            self.heard_ns = max(self.heard_ns, log_ns)

    def drop(self, reason: str) -> None:
        """Give the source up for now; it is opened again."""
        self._lost(reason, is_open=False)
        with contextlib.suppress(Exception):
            self.source.close()

    def hangs(self) -> None:
        """Nothing has been read for long, says another thread."""
        self._events.put(SourceEvent(self.bus, self._clock.now_ns(), False, HANGS))

    def goes_on(self, heard_ns: int) -> None:
        """It is read again after it hung, and was heard until then; what the kernel kept is not lost."""
        if not self.present:
            return
        now_ns = self._clock.now_ns()
        kept = "kernel" in self.source.facts.loss_counters
        gap = None if kept else Gap(heard_ns, max(now_ns, heard_ns), HANGS, None, self.bus)
        self._tell("read again", gap=gap)

    def unfinished(self, reason: str) -> None:
        """The recording ends, and the thread did not finish this reader."""
        if self.present:
            self.present, self._reason = False, reason
        self._tell("", gap=self._gap(self._clock.now_ns()))

    def finish(self) -> None:
        """Take what still waits; tell the gap of a source that is not heard."""
        for _ in range(LAST_READS):
            if not (self.present and self.turn(0)):
                break
        if not self.present:
            self._tell("", gap=self._gap(self._clock.now_ns()))
        self.finished = True

    def _opened_again(self) -> bool:
        try:
            self.source.open()
        except BaseException as error:  # noqa: BLE001 - as above
            self._retry_later(soon=isinstance(error, SourceAsleep))
            return False
        self._is_open = True
        self.changes += 1
        self._back(self._clock.now_ns())
        return True

    def _lost(self, reason: str, *, is_open: bool) -> None:
        self._is_open = is_open
        self.changes += 1
        if self.present:
            self.present = False
            self._reason = reason
            self._tell(reason)
        self._retry_later(soon=is_open)

    def _retry_later(self, *, soon: bool) -> None:
        """Set when to try again: soon where trying costs nothing, else ever later."""
        self._tried_ns = self._clock.now_ns()
        wait_s = READ_TIMEOUT_S if soon else self._retry_s
        self.due_ns = self._tried_ns + round(wait_s * 1e9)
        if not soon:
            self._retry_s = min(2 * self._retry_s, LONGEST_RETRY_S)

    def _back(self, since_ns: int) -> None:
        gap = self._gap(since_ns)
        self.present = True
        self.listening_ns = self.heard_ns = gap.end_ns
        self._tell("listening again", gap=gap)
        self._tell_facts()

    def _gap(self, end_ns: int) -> Gap:
        return Gap(self.heard_ns, max(end_ns, self.heard_ns), self._reason, None, self.bus)

    def _tell_facts(self) -> None:
        """Tell the controller's state, and what is new of the source's notes."""
        facts = self.source.facts
        if facts.state:
            self._tell("", state=facts.state)
        for note in facts.notes:
            if note not in self._notes:
                self._tell(note)
        self._notes = facts.notes

    def _tell(self, text: str, *, gap: Gap | None = None, state: str = "") -> None:
        now_ns = self._clock.now_ns()
        self._events.put(SourceEvent(self.bus, now_ns, self.present, text, gap, state))


def _words(error: BaseException) -> str:
    return str(error) if isinstance(error, SourceError) else f"{type(error).__name__}: {error}"


class ReadThread(threading.Thread):
    """Reads sources until it is stopped.

    Attributes:
        readers: what it reads; nobody else may use them while it runs.
        turns: grows while it lives.
    """

    def __init__(self, name: str, readers: Sequence[SourceReader], clock: RecorderClock) -> None:
        super().__init__(name=name, daemon=True)
        self.readers = readers
        self.turns = 0
        self._clock = clock
        self._stop_reading = threading.Event()

    def stop(self) -> None:
        """Make the thread end after what it is reading."""
        self._stop_reading.set()

    def again(self) -> "ReadThread":
        """A new thread for the same readers."""
        raise NotImplementedError


class SourceThread(ReadThread):
    """Reads one source that must be waited for by its own `read`."""

    def __init__(self, reader: SourceReader, clock: RecorderClock) -> None:
        super().__init__(f"syncline read {reader.source.facts.name}", [reader], clock)
        self._reader = reader

    def again(self) -> "SourceThread":
        """A new thread for the same source."""
        return SourceThread(self._reader, self._clock)

    def run(self) -> None:
        """Read until stopped."""
        reader = self._reader
        while not self._stop_reading.is_set():
            self.turns += 1
            wait_s = 0 if reader.present else (reader.due_ns - self._clock.now_ns()) / 1e9
            if wait_s > 0:
                self._stop_reading.wait(min(wait_s, LONGEST_PAUSE_S))
            else:
                reader.turn(READ_TIMEOUT_S)
        reader.finish()


class PollThread(ReadThread):
    """Reads all sources that have a file number."""

    def __init__(self, readers: Sequence[SourceReader], clock: RecorderClock) -> None:
        super().__init__("syncline read", readers, clock)
        self._selector = selectors.DefaultSelector()
        self._registered: list[tuple[int, int | None]] = []

    def again(self) -> "PollThread":
        """A new thread for the same sources."""
        return PollThread(self.readers, self._clock)

    def run(self) -> None:
        """Read until stopped."""
        while not self._stop_reading.is_set():
            self.turns += 1
            self._register()
            ready = {key.data for key, _ in self._selector.select(READ_TIMEOUT_S)}
            now_ns = self._clock.now_ns()
            for number, reader in enumerate(self.readers):
                if number in ready or now_ns >= reader.due_ns:
                    reader.turn(0)
                else:
                    reader.quiet_at(now_ns)
            if ready:
                self._stop_reading.wait(COLLECT_S)
        for reader in self.readers:
            reader.finish()
        self._selector.close()

    def _register(self) -> None:
        registered = [(reader.changes, reader.source.fileno()) for reader in self.readers]
        if registered == self._registered:
            return
        self._selector.close()
        self._selector = selectors.DefaultSelector()
        for number, (_, file_number) in enumerate(registered):
            if file_number is not None and file_number >= 0:
                self._selector.register(file_number, selectors.EVENT_READ, number)
        self._registered = registered


class SourceThreads:
    """All threads that read."""

    def __init__(
        self,
        sources: Sequence[Source],
        buffer: FrameBuffer,
        clock: RecorderClock,
        events: "SimpleQueue[SourceEvent]",
        absent: Mapping[int, SourceError] | None = None,
    ) -> None:
        """absent: by bus number, why a source could not be opened; it is tried again."""
        self.readers = [
            SourceReader(source, bus, buffer, clock, events, (absent or {}).get(bus))
            for bus, source in enumerate(sources)
        ]
        polled = [each for each in self.readers if each.source.fileno() is not None]
        self._threads: list[ReadThread] = [
            SourceThread(each, clock) for each in self.readers if each not in polled
        ]
        if polled:
            self._threads.append(PollThread(polled, clock))
        self._pulses = [_Pulse() for _ in self._threads]
        self._looked_ns: int | None = None
        self._stopped = False

    @property
    def hang(self) -> bool:
        """Whether a thread hangs: only a restart of the process helps."""
        return any(each.hung_since for each in self._pulses)

    def look_after(self, elapsed_ns: int) -> None:
        """Notice threads that hang, and replace those that ended.

        elapsed_ns: time that no clock setting moves [ns].
        """
        before_ns = elapsed_ns if self._looked_ns is None else self._looked_ns
        self._looked_ns = elapsed_ns
        passed_ns = min(max(elapsed_ns - before_ns, 0), LONGEST_LOOK_NS)
        for number, (thread, pulse) in enumerate(zip(self._threads, self._pulses, strict=True)):
            if thread.turns != pulse.turns:
                for reader, heard_ns in zip(thread.readers, pulse.hung_since, strict=False):
                    reader.goes_on(heard_ns)
                self._pulses[number] = _Pulse(thread.turns)
                continue
            pulse.silent_ns += passed_ns
            if not thread.is_alive() and pulse.silent_ns >= ENDED_NS:
                self._replace(number)
            elif pulse.silent_ns >= HUNG_NS and not pulse.hung_since:
                pulse.hung_since = [reader.heard_ns for reader in thread.readers]
                for reader in thread.readers:
                    reader.hangs()

    def _replace(self, number: int) -> None:
        ended = self._threads[number]
        for reader in ended.readers:
            reader.drop(ENDED)
        self._threads[number], self._pulses[number] = ended.again(), _Pulse()
        self._threads[number].start()

    def start(self) -> None:
        """Start to read."""
        for thread in self._threads:
            thread.start()

    def stop(self, timeout_s: float = 2.0) -> None:
        """Make all threads end, and wait for them at most so long."""
        for thread in self._threads:
            thread.stop()
        if self._stopped:
            return
        self._stopped = True
        for thread in self._threads:
            thread.join(timeout_s)
            for reader in thread.readers:
                if not reader.finished:
                    reader.unfinished(HANGS if thread.is_alive() else ENDED)


@dataclass(slots=True)
class _Pulse:
    """What was last seen of a thread; `hung_since`: when each reader was heard last, if it hangs."""

    turns: int = 0
    silent_ns: int = 0
    hung_since: list[int] = field(default_factory=list)
