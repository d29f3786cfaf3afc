"""Readers of sources: what is heard, lost, asleep and back, by a clock of our own."""

import socket
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from queue import Empty, SimpleQueue

import pytest

from syncline_logger.batcher import FrameBuffer
from syncline_logger.clock import RecorderClock
from syncline_logger.source import Source, SourceAsleep, SourceFacts
from syncline_logger.source_thread import SourceEvent, SourceReader, SourceThreads
from syncline_schemas.batch import Gap
from syncline_schemas.errors import SourceError

S = 1_000_000_000
MS = 1_000_000


class ScriptedSource:
    """Each reading gives frames, or raises; each opening succeeds, or raises."""

    def __init__(self, *readings: int | Exception, openings: tuple[Exception | None, ...] = ()):
        self.facts = SourceFacts("a", "scripted", "x")
        self._readings = list(readings)
        self._openings = list(openings)
        self.closed = 0

    def open(self) -> None:
        failure = self._openings.pop(0) if self._openings else None
        if failure:
            raise failure

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        count = self._readings.pop(0) if self._readings else 0
        if isinstance(count, Exception):
            raise count
        for _ in range(count):
            buffer.append(0, bus, 0x181, 0, 0, b"")
        return count

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        self.closed += 1


class Reading:
    """A reader with a clock that only the test moves."""

    def __init__(self, source: Source, absent: SourceError | None = None) -> None:
        self.now_ns = 0
        clock = RecorderClock(lambda: self.now_ns, lambda: self.now_ns)
        self._events: SimpleQueue[SourceEvent] = SimpleQueue()
        self.buffer = FrameBuffer(clock.now_ns)
        self.reader = SourceReader(source, 3, self.buffer, clock, self._events, absent)

    def at(self, t_ms: int) -> int:
        """Take a turn at this time."""
        self.now_ns = t_ms * MS
        return self.reader.turn(0)

    def told(self) -> list[tuple[int, bool, str]]:
        """(milliseconds, present, text) of the events that say something."""
        return [(e.log_ns // MS, e.present, e.text) for e in self.events() if e.text]

    def gaps(self) -> list[Gap]:
        return [event.gap for event in self.events() if event.gap]

    def events(self) -> list[SourceEvent]:
        found = []
        while True:
            try:
                found.append(self._events.get_nowait())
            except Empty:
                return found


def test_a_lost_source_is_opened_again_and_its_gap_told() -> None:
    source = ScriptedSource(1, SourceError("unplugged"), 1)
    reading = Reading(source)
    assert reading.at(100) == 1
    assert reading.at(200) == 0
    assert (reading.reader.present, source.closed) == (False, 1)
    assert reading.reader.due_ns == 1200 * MS
    assert reading.at(1200) == 1
    assert reading.reader.present
    events = reading.events()
    assert [event.text for event in events] == ["unplugged", "listening again"]
    assert [event.gap for event in events] == [None, Gap(100 * MS, 1200 * MS, "unplugged", None, 3)]


def test_a_source_that_stays_away_is_tried_ever_less_often() -> None:
    gone = SourceError("gone")
    reading = Reading(ScriptedSource(gone, openings=(gone,) * 7))
    reading.at(0)
    waits = []
    for _ in range(8):
        due_ms = reading.reader.due_ns // MS
        waits.append((due_ms - reading.now_ns // MS) // 1000)
        reading.at(due_ms)
    assert waits == [1, 2, 4, 8, 16, 30, 30, 30]
    assert reading.reader.present
    assert reading.told() == [(0, False, "gone"), (121_000, True, "listening again")]


def test_a_source_that_opens_but_fails_at_once_is_tried_ever_less_often_too() -> None:
    reading = Reading(ScriptedSource(*[SourceError("half dead")] * 6))
    reading.at(0)
    waits = []
    for _ in range(5):
        due_ms = reading.reader.due_ns // MS
        waits.append((due_ms - reading.now_ns // MS) // 1000)
        reading.at(due_ms)
    assert waits == [1, 2, 4, 8, 16]


def test_a_frame_makes_the_next_try_soon_again() -> None:
    gone = SourceError("gone")
    reading = Reading(ScriptedSource(gone, gone, gone, 1, gone))
    for t_ms in (0, 1000, 3000, 7000, 7100):
        reading.at(t_ms)
    assert reading.reader.due_ns == 8100 * MS


def test_a_source_that_sleeps_stays_open_and_is_asked_soon() -> None:
    asleep = SourceAsleep("the interface went down")
    source = ScriptedSource(1, asleep, asleep, asleep, 2)
    reading = Reading(source)
    for t_ms in (100, 200, 300, 400):
        reading.at(t_ms)
    assert reading.reader.due_ns == 500 * MS
    assert reading.at(500) == 2
    assert source.closed == 0
    # The frames just read came after it was last seen down.
    assert reading.gaps() == [Gap(100 * MS, 400 * MS, "the interface went down", None, 3)]


def test_an_interface_that_is_missing_is_looked_for_often() -> None:
    missing = SourceAsleep("no interface")
    source = ScriptedSource(SourceError("lost"), openings=(missing, missing, missing))
    reading = Reading(source)
    reading.at(0)
    for t_ms in (1000, 1100, 1200):
        reading.at(t_ms)
        assert reading.reader.due_ns == (t_ms + 100) * MS
    reading.at(1300)
    assert reading.gaps() == [Gap(0, 1300 * MS, "lost", None, 3)]


def test_a_source_that_could_not_be_opened_at_the_start() -> None:
    reading = Reading(ScriptedSource(1), SourceError("not plugged in"))
    assert not reading.reader.present
    assert reading.at(1000) == 1
    events = reading.events()
    assert [(event.present, event.text) for event in events] == [
        (False, "not plugged in"),
        (True, "listening again"),
    ]
    assert events[1].gap == Gap(0, 1000 * MS, "not plugged in", None, 3)


def test_the_end_tells_the_gap_of_a_source_that_did_not_come_back() -> None:
    reading = Reading(ScriptedSource(1, SourceError("unplugged")))
    reading.at(100)
    reading.at(200)
    reading.events()
    reading.now_ns = 900 * MS
    reading.reader.finish()
    [event] = reading.events()
    assert (event.present, event.text) == (False, "")
    assert event.gap == Gap(100 * MS, 900 * MS, "unplugged", None, 3)


def test_the_end_takes_what_still_waits() -> None:
    reading = Reading(ScriptedSource(5, 5, 2))
    reading.reader.finish()
    assert len(reading.buffer.take()) == 12


def test_notes_and_state_are_told_once() -> None:
    source = ScriptedSource(SourceAsleep("down"), 0, SourceAsleep("down"), 0)
    source.facts = replace(source.facts, state="active", notes=("small buffer",))
    reading = Reading(source)
    assert [(event.state, event.text) for event in reading.events()] == [
        ("active", ""),
        ("", "small buffer"),
    ]
    reading.at(100)
    source.facts = replace(source.facts, state="off", notes=("small buffer", "other bit rate"))
    reading.at(200)
    assert [(event.state, event.text) for event in reading.events()] == [
        ("", "down"),
        ("", "listening again"),
        ("off", ""),
        ("", "other bit rate"),
    ]


class PipeSource(ScriptedSource):
    """A source with a file number: one frame per byte."""

    def __init__(self, pipe: socket.socket) -> None:
        super().__init__()
        self._pipe = pipe
        self.readers: set[str] = set()

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        self.readers.add(threading.current_thread().name)
        assert timeout_s == 0
        try:
            data = self._pipe.recv(100)
        except BlockingIOError:
            return 0
        if not data:
            raise SourceError("closed")
        for byte in data:
            buffer.append(1, bus, byte, 0, 0, b"")
        return len(data)

    def fileno(self) -> int:
        return self._pipe.fileno()


@pytest.fixture
def pipes() -> Iterator[list[tuple[socket.socket, socket.socket]]]:
    made = [socket.socketpair() for _ in range(2)]
    for _, receiver in made:
        receiver.setblocking(False)
    yield made
    for pair in made:
        for end in pair:
            end.close()


@pytest.mark.skipif(sys.platform == "win32", reason="sources with file numbers are POSIX")
def test_sources_with_file_numbers_share_a_thread(
    pipes: list[tuple[socket.socket, socket.socket]],
) -> None:
    arrived = threading.Semaphore(0)

    class Counting(FrameBuffer):
        def append(self, *row: object) -> None:
            super().append(*row)  # type: ignore[arg-type]
            arrived.release()

    clock = RecorderClock()
    buffer = Counting(clock.now_ns)
    sources = [PipeSource(receiver) for _, receiver in pipes]
    threads = SourceThreads(sources, buffer, clock, SimpleQueue())
    threads.start()
    for number in range(10):
        pipes[number % 2][0].send(bytes([number]))
        assert arrived.acquire(timeout=20)
    pipes[0][0].send(bytes([10, 11, 12]))
    threads.stop()
    taken = buffer.take().frames
    assert sorted(taken.can_id.tolist()) == list(range(13))
    assert taken.bus.tolist()[:4] == [0, 1, 0, 1]
    assert {name for source in sources for name in source.readers} == {"syncline read"}


def test_a_source_without_one_has_a_thread_of_its_own() -> None:
    class Blocking(ScriptedSource):
        def fileno(self) -> None:  # type: ignore[override]
            return None

        def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
            names.add(threading.current_thread().name)
            seen.set()
            threading.Event().wait(timeout_s / 10)
            return 0

    names: set[str] = set()
    seen = threading.Event()
    clock = RecorderClock()
    threads = SourceThreads([Blocking()], FrameBuffer(clock.now_ns), clock, SimpleQueue())
    threads.start()
    assert seen.wait(20)
    threads.stop()
    assert names == {"syncline read a"}


class StuckSource(ScriptedSource):
    """A reading or a closing that blocks until the test lets it go on."""

    def __init__(self, *readings: int | BaseException, stuck_in: str = "read") -> None:
        super().__init__(*readings)  # type: ignore[arg-type]
        self._stuck_in = stuck_in
        self.stuck = threading.Event()
        self.go_on = threading.Event()

    def fileno(self) -> None:  # type: ignore[override]
        return None

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        if self._readings:
            return self._next_reading(buffer, bus, timeout_s)
        if self._stuck_in == "read":
            self._block()
        threading.Event().wait(timeout_s / 10)
        return 0

    def _next_reading(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        if isinstance(self._readings[0], SystemExit):
            raise self._readings.pop(0)  # type: ignore[misc]
        return super().read(buffer, bus, timeout_s)

    def close(self) -> None:
        super().close()
        if self._stuck_in == "close":
            self._block()

    def _block(self) -> None:
        self.stuck.set()
        assert self.go_on.wait(20)


def events_of(queue: "SimpleQueue[SourceEvent]") -> list[SourceEvent]:
    found = []
    while not queue.empty():
        found.append(queue.get_nowait())
    return found


def test_a_reader_that_hangs_is_told_and_leaves_a_gap() -> None:
    clock = RecorderClock()
    events: SimpleQueue[SourceEvent] = SimpleQueue()
    source = StuckSource(1)
    threads = SourceThreads([source], FrameBuffer(clock.now_ns), clock, events)
    threads.start()
    assert source.stuck.wait(20)
    for second in range(15):
        threads.look_after(second * S)
        assert not threads.hang
    # The machine slept for an hour: that is no second sign.
    threads.look_after(3600 * S)
    assert threads.hang
    assert [(event.present, event.text) for event in events_of(events)] == [
        (False, "reading hangs in the driver")
    ]
    threads.stop(0.01)
    [last] = events_of(events)
    assert last.gap is not None
    assert last.gap.reason == "reading hangs in the driver"
    assert last.gap.start_ns == threads.readers[0].heard_ns < last.gap.end_ns
    source.go_on.set()


@pytest.mark.parametrize(("counters", "gaps"), [((), 1), (("kernel",), 0)])
def test_a_reader_that_goes_on_after_it_hung(counters: tuple[str, ...], gaps: int) -> None:
    clock = RecorderClock()
    events: SimpleQueue[SourceEvent] = SimpleQueue()
    source = StuckSource(1)
    source.facts = replace(source.facts, loss_counters=counters)
    threads = SourceThreads([source], FrameBuffer(clock.now_ns), clock, events)
    threads.start()
    assert source.stuck.wait(20)
    for second in range(20):
        threads.look_after(second * S)
    assert threads.hang
    source.go_on.set()
    for _ in range(2000):
        threads.look_after(20 * S)
        if events.qsize() > 1:
            break
        threading.Event().wait(0.01)
    told = events_of(events)
    assert [event.text for event in told] == ["reading hangs in the driver", "read again"]
    assert told[-1].present
    assert sum(event.gap is not None for event in told) == gaps
    threads.stop()


def test_closing_that_hangs_leaves_a_gap() -> None:
    clock = RecorderClock()
    events: SimpleQueue[SourceEvent] = SimpleQueue()
    source = StuckSource(1, SourceError("unplugged"), stuck_in="close")
    threads = SourceThreads([source], FrameBuffer(clock.now_ns), clock, events)
    threads.start()
    assert source.stuck.wait(20)
    threads.stop(0.01)
    told = events_of(events)
    assert [event.text for event in told] == ["unplugged", ""]
    assert told[-1].gap is not None
    assert told[-1].gap.reason == "unplugged"
    source.go_on.set()


def test_a_driver_that_wants_to_exit_is_opened_again() -> None:
    source = StuckSource(1, SystemExit(3), 1)
    reading = Reading(source)
    for t_ms in (100, 200, 1200):
        reading.at(t_ms)
    assert reading.told() == [(200, False, "SystemExit: 3"), (1200, True, "listening again")]


def test_a_thread_that_ended_is_replaced() -> None:
    class Ending(StuckSource):
        def fileno(self) -> None:  # type: ignore[override]
            return None

        @property
        def ends(self) -> bool:
            return not self.go_on.is_set()

    source = Ending(stuck_in="nowhere")
    clock = RecorderClock()
    events: SimpleQueue[SourceEvent] = SimpleQueue()
    threads = SourceThreads([source], FrameBuffer(clock.now_ns), clock, events)
    [ended] = threads._threads
    ended.run = lambda: None  # type: ignore[method-assign]
    threads.start()
    ended.join(20)
    for second in range(4):
        threads.look_after(second * S)
    assert [event.text for event in events_of(events)] == ["the thread that reads ended"]
    assert threads._threads[0].is_alive()
    threads.stop()
    assert events_of(events)[-1].gap is not None


def test_a_source_whose_closing_fails_is_tried_again() -> None:
    class Broken(ScriptedSource):
        def close(self) -> None:
            raise RuntimeError("driver: close failed")

    reading = Reading(Broken(SourceError("unplugged"), 1))
    for t_ms in (100, 1100):
        reading.at(t_ms)
    assert [text for _, _, text in reading.told()] == ["unplugged", "listening again"]
