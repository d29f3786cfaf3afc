"""Recording: from sources to a capture, live with threads, or simulated in virtual time."""

import contextlib
import threading
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from syncline_logger.batcher import Collected, FrameBuffer, LossPlace
from syncline_logger.clock import ClockReading, RecorderClock
from syncline_logger.decode_worker import DecodeWorker
from syncline_logger.decoding import LiveDecoder
from syncline_logger.guard import Guard
from syncline_logger.live_status import StatusSnapshot
from syncline_logger.live_view.taken import Begun, Heard, Taken
from syncline_logger.notes import OnNote
from syncline_logger.pace import WritePace
from syncline_logger.record_options import RecordOptions
from syncline_logger.recording import Recording, RecordResult
from syncline_logger.rehearsal import rehearse
from syncline_logger.source import Source, SourceFacts, StampedSource
from syncline_logger.source_thread import SourceEvent, SourceThreads
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.errors import SourceError, SynclineError, UsageError
from syncline_schemas.wording import counted

TICK_S = 0.1
"""How long a stop or a full chunk may wait for the writing loop."""
DECODE_WAIT = 0.05
"""Share of the chunk period that the writer waits for the decoder before it writes without it."""
LAST_DECODE_WAIT_S = 5.0

LOSS_REASONS: dict[LossPlace, str] = {
    "queue": "the recorder's queue was full",
    "kernel": "the kernel's receive buffer was full",
    "controller": "the controller's receive buffer overran",
    "adapter": "the adapter's buffer was full",
    "line": "lines of the adapter were damaged",
    "closed": "the adapter was reset or answers no more",
}


class FrameView(Protocol):
    """Shows frames while they are recorded."""

    def begin(self, begun: Begun) -> None:
        """The recording has begun."""
        ...

    def take(self, taken: Taken) -> None:
        """Take frames; returns at once."""
        ...


def record(
    sources: Sequence[Source],
    target: Path,
    options: RecordOptions | None = None,
    *,
    stop: threading.Event | None = None,
    duration_ns: int | None = None,
    on_start: Callable[[Path], None] | None = None,
    on_status: Callable[[StatusSnapshot], None] | None = None,
    status_period_ns: int = 1_000_000_000,
    on_turn: Callable[[], None] | None = None,
    asked: Callable[[], Iterable[str]] | None = None,
    on_note: OnNote | None = None,
    view: FrameView | None = None,
) -> RecordResult:
    """Record buses until `stop` is set or `duration_ns` has passed, and close the file.

    Every source is opened here and read by a thread of its own; what cannot be opened at the
    start is the user's mistake, what is lost later becomes a gap and is tried again every second.

    Args:
        target: an .mcap file that does not exist, or a folder for one.
        on_start: called with the file's path when recording has begun.
        on_status: called every `status_period_ns` and at the end.
        on_turn: called about ten times a second by the writing loop, while it does its work and no
            thread that reads hangs.
        asked: polled once per chunk; gives words for each mark that somebody asks for.
        on_note: called at once with everything that happens: files, gaps, marks, lost nodes.
        view: is shown the frames beside the recording; must not wait for anything.

    What these raise ends no recording: it is told once in the status, and they are called again.

    Raises:
        SourceError: a bus cannot be opened. UsageError: the file exists, or cannot be made.
    """
    recorder = LiveRecorder(sources, target, options or RecordOptions(), asked, on_note, view)
    return recorder.run(
        stop or threading.Event(), duration_ns, on_status, status_period_ns, on_turn, on_start
    )


def record_batches(
    items: Iterable[FrameBatch | Gap],
    buses: Sequence[BusInfo],
    target: Path,
    options: RecordOptions | None = None,
    *,
    host: str = "",
    source: str = "simulated",
) -> RecordResult:
    """Record frames that carry their own time, as fast as they come; the same file as `record`.

    `log_time` is the highest `t_ns` so far; status and clock messages stand at every full period
    of that time. Decoding is done in step, so that equal input gives an equal file (with
    `options.recording_id` given).
    """
    recorder = _VirtualRecorder(target, buses, options or RecordOptions(), host, source)
    try:
        for item in items:
            if isinstance(item, Gap):
                recorder.take_gap(item)
            elif len(item):
                recorder.take_frames(item)
        return recorder.finish()
    except BaseException:
        recorder.abandon()
        raise


class _VirtualRecorder:
    """Collects frames into chunks by their own time."""

    def __init__(
        self,
        target: Path,
        buses: Sequence[BusInfo],
        options: RecordOptions,
        host: str,
        source: str,
    ) -> None:
        self._options = options
        self._decoder = LiveDecoder(
            {bus.number: bus.name for bus in buses}, options.description, options.triggers.values
        )
        self._begin = partial(Recording, target, buses, options, host=host, source=source)
        self._recording: Recording | None = None
        self._now_ns = self._next_status_ns = 0
        self._waiting: list[tuple[FrameBatch, NDArray[np.int64]]] = []
        self._waiting_frames = 0

    def _started(self, start_ns: int) -> Recording:
        if self._recording is None:
            self._recording = self._begin(start_ns=start_ns)
            self._now_ns = self._next_status_ns = start_ns
        return self._recording

    def take_gap(self, gap: Gap) -> None:
        """Note a gap between the frames before and after it."""
        recording = self._started(gap.start_ns)
        self._now_ns = max(self._now_ns, gap.end_ns)
        recording.add_gap(gap, self._now_ns)

    def take_frames(self, batch: FrameBatch) -> None:
        """Take frames; at each full period what waits becomes a chunk."""
        recording = self._started(int(batch.t_ns[0]))
        log_ns = np.maximum.accumulate(np.maximum(batch.t_ns, self._now_ns))
        self._now_ns = int(log_ns[-1])
        begin = 0
        while begin < len(batch):
            at_ns = int(log_ns[begin])
            if at_ns >= self._next_status_ns:
                self._write(recording)
                recording.add_clock(ClockReading(at_ns, at_ns, 0), at_ns)
                recording.add_all_status(at_ns)
                self._next_status_ns = at_ns + self._options.period_ns
            room = self._options.chunk_frames - self._waiting_frames
            end = min(int(np.searchsorted(log_ns, self._next_status_ns)), begin + room)
            self._waiting.append((batch[begin:end], log_ns[begin:end]))
            self._waiting_frames += end - begin
            if self._waiting_frames == self._options.chunk_frames:
                self._write(recording)
            begin = end

    def _write(self, recording: Recording) -> None:
        if not self._waiting:
            return
        frames = FrameBatch.concat([frames for frames, _ in self._waiting])
        log_ns = np.concatenate([times for _, times in self._waiting])
        self._waiting, self._waiting_frames = [], 0
        recording.take_frames(frames, log_ns)
        decoded = [self._decoder.decode(frames, log_ns)] if self._options.decode else []
        recording.write(frames, log_ns, decoded)

    def finish(self) -> RecordResult:
        """Write the rest and close the file."""
        recording = self._started(0)
        self._write(recording)
        recording.add_all_status(self._now_ns)
        recording.write(FrameBatch.empty(), np.zeros(0, np.int64))
        return recording.finish(self._now_ns, "end of input")

    def abandon(self) -> None:
        """Leave the file as it is; it can be read up to the last chunk."""
        if self._recording is not None:
            self._recording.store.abandon()


class LiveRecorder:
    """Opened sources and an open file; `run` records until it is told to stop."""

    def __init__(
        self,
        sources: Sequence[Source],
        target: Path,
        options: RecordOptions,
        asked: Callable[[], Iterable[str]] | None = None,
        on_note: OnNote | None = None,
        view: FrameView | None = None,
    ) -> None:
        self._asked = asked
        self._view = view
        self._raised: list[str] = []
        self._guard = Guard(self._raised.append)
        unrehearsed = rehearse(options.compression, decode=options.decode)
        self._options = options
        self._sources = list(sources)
        self._clock = RecorderClock()
        self._buffer = FrameBuffer(
            self._clock.now_ns,
            options.queue_frames,
            min(options.chunk_frames, options.queue_frames),
        )
        self._events: SimpleQueue[SourceEvent] = SimpleQueue()
        self._start_ns = self._clock.now_ns()
        for source in self._sources:
            if isinstance(source, StampedSource):
                source.use_clock(self._clock)
        try:
            absent = self._open_sources()
            buses = [bus_info(source.facts, n) for n, source in enumerate(self._sources)]
            self._recording = _begun(
                target,
                partial(
                    Recording,
                    target,
                    buses,
                    options,
                    start_ns=self._start_ns,
                    source=", ".join(f"{bus.interface} {bus.channel}".strip() for bus in buses),
                    about=source_metadata(source.facts for source in self._sources),
                    resumes=True,
                    on_note=self._guarded(on_note) if on_note else None,
                ),
            )
        except BaseException:
            self._close_sources(self._sources)
            raise
        if unrehearsed:
            self._recording.add_status(0, self._start_ns, unrehearsed)
        if view:
            known = options.description
            begun = Begun(self._start_ns, tuple(buses), known.text, dict(known.files))
            self._guard.call("the live view", view.begin, begun)
        decoder = LiveDecoder(
            {bus.number: bus.name for bus in buses}, options.description, options.triggers.values
        )
        self._worker = DecodeWorker(decoder) if options.decode else None
        self._decode_was_behind = False
        self._threads = SourceThreads(
            self._sources, self._buffer, self._clock, self._events, absent
        )
        self._clock_step_ns = self._start_ns
        self._waiting: list[Collected] = []

    def _guarded(self, on_note: OnNote) -> OnNote:
        return lambda note: self._guard.call("the notes", on_note, note)

    @property
    def path(self) -> Path:
        """The file that is being written."""
        return self._recording.store.path

    def run(
        self,
        stop: threading.Event,
        duration_ns: int | None,
        on_status: Callable[[StatusSnapshot], None] | None,
        status_period_ns: int,
        on_turn: Callable[[], None] | None = None,
        on_start: Callable[[Path], None] | None = None,
    ) -> RecordResult:
        """Record; returns when the file is closed."""
        if on_start:
            self._guard.call("the start's output", on_start, self.path)
        self._threads.start()
        try:
            why = self._loop(stop, duration_ns, on_status, status_period_ns, on_turn)
            self._threads.stop()
            result = self._close(why)
        except BaseException:
            self._recording.store.abandon()
            raise
        finally:
            self._threads.stop()
            # Closing a source in whose driver a thread hangs would hang here too.
            self._close_sources(
                reader.source for reader in self._threads.readers if reader.finished
            )
        if on_status:
            self._show(on_status)
        result.problems.extend(self._raised)
        return result

    def _show(self, on_status: Callable[[StatusSnapshot], None]) -> None:
        snapshot = self._recording.snapshot(self._clock.now_ns())
        self._guard.call("the status output", on_status, snapshot)

    def _loop(
        self,
        stop: threading.Event,
        duration_ns: int | None,
        on_status: Callable[[StatusSnapshot], None] | None,
        status_period_ns: int,
        on_turn: Callable[[], None] | None,
    ) -> str:
        """Write a chunk each period, or when one is full, until there is a reason to stop."""
        # Elapsed time: setting the machine's clock shortens no recording.
        end_elapsed_ns = None if duration_ns is None else self._clock.elapsed_ns() + duration_ns
        next_chunk_ns = self._start_ns
        pace = WritePace(self._options)
        view_ns = self._start_ns + status_period_ns if on_status else None
        while True:
            now_ns = self._clock.now_ns()
            end_ns = None if end_elapsed_ns is None else end_elapsed_ns + self._clock.offset_ns
            if stop.is_set():
                return "stopped"
            if end_ns is not None and now_ns >= end_ns:
                return "time is over"
            if now_ns >= next_chunk_ns:
                self._write_period(now_ns)
                spent_ns = self._clock.now_ns() - now_ns
                next_chunk_ns = now_ns + pace.after(spent_ns)
            elif self._buffer.filled.is_set() or self._chunk_is_full:
                self._write_chunk(now_ns)
            if on_status and view_ns is not None and now_ns >= view_ns:
                self._take()
                self._show(on_status)
                view_ns = now_ns + status_period_ns
            self._threads.look_after(self._clock.elapsed_ns())
            if on_turn and not self._threads.hang:
                self._guard.call("the turn", on_turn)
            due_ns = min(each for each in (next_chunk_ns, view_ns, end_ns) if each is not None)
            wait_s = min(max((due_ns - self._clock.now_ns()) / 1e9, 0), TICK_S)
            self._buffer.filled.wait(wait_s)

    @property
    def _chunk_is_full(self) -> bool:
        return sum(len(each) for each in self._waiting) >= self._options.chunk_frames

    def _write_period(self, now_ns: int) -> None:
        self._sample_clocks(now_ns)
        asked = self._guard.call("requests for marks", self._asked) if self._asked else ()
        for text in asked or ():
            self._recording.ask(text, now_ns)
        self._write_chunk(now_ns, status=True)

    def _sample_clocks(self, now_ns: int) -> None:
        reading = self._clock.sample()
        self._recording.add_clock(reading, now_ns)
        for bus, source in enumerate(self._sources):
            if isinstance(source, StampedSource):
                for knot in source.clock_knots():
                    self._recording.add_knot(bus, knot, reading, now_ns)
        if reading.step_ns > 0:
            self._clock_step_ns = self._clock.now_ns()

    def _take(self) -> None:
        """Count what has come in; it waits for the next chunk."""
        self._note_events()
        for text in self._raised:
            self._recording.add_status(0, self._clock.now_ns(), text)
        self._raised.clear()
        # Read before the buffer is: what a thread heard until then is in it.
        heard_ns = [(each.bus, each.listening_ns, each.heard_ns) for each in self._threads.readers]
        collected = self._buffer.take()
        self._note_losses(collected)
        self._recording.take_frames(collected.frames, collected.log_ns)
        for bus, begin_ns, end_ns in heard_ns:
            self._recording.listened(bus, max(begin_ns, self._clock_step_ns), end_ns)
        if self._view:
            heard = tuple(Heard(bus, begin_ns, end_ns) for bus, begin_ns, end_ns in heard_ns)
            taken = Taken(collected.frames, collected.log_ns, heard)
            self._guard.call("the live view", self._view.take, taken)
        self._waiting.append(collected)

    def _write_chunk(self, now_ns: int, *, status: bool = False, last: bool = False) -> None:
        self._take()
        if last:
            self._recording.note_deafness(now_ns)
        frames = FrameBatch.concat([collected.frames for collected in self._waiting])
        log_ns = np.concatenate([collected.log_ns for collected in self._waiting])
        self._waiting.clear()
        if status:
            self._recording.add_all_status(max(now_ns, int(log_ns[-1]) if len(log_ns) else 0))
        decoded = []
        if self._worker:
            if len(frames):
                self._submit(self._worker, frames, log_ns, now_ns)
            wait_s = DECODE_WAIT * self._options.period_ns / 1e9
            decoded = (
                self._worker.finish(LAST_DECODE_WAIT_S) if last else self._worker.results(wait_s)
            )
        self._recording.write(frames, log_ns, decoded, now_ns)

    def _note_events(self) -> None:
        while True:
            try:
                event = self._events.get_nowait()
            except Empty:
                return
            self._recording.conditions[event.bus].adapter_present = event.present
            if event.state:
                self._recording.tell_state(event.bus, event.state, event.log_ns)
            if event.gap:
                self._recording.add_gap(event.gap, event.log_ns)
            if event.text:
                self._recording.add_status(event.bus, event.log_ns, event.text)

    def _note_losses(self, collected: Collected) -> None:
        for loss in collected.losses:
            self._recording.conditions[loss.bus].count_loss(loss)
            reason = LOSS_REASONS[loss.where]
            gap = Gap(loss.first_ns, loss.last_ns + 1, reason, loss.frames, loss.bus)
            self._recording.add_gap(gap, loss.log_ns)
            count = "" if loss.frames is None else f"; {counted(loss.frames, 'frame')} lost"
            text = f"{reason}{count}"
            self._recording.add_status(loss.bus, loss.log_ns, text, noted=True)

    def _submit(
        self, worker: DecodeWorker, frames: FrameBatch, log_ns: NDArray[np.int64], now_ns: int
    ) -> None:
        """Give frames to the decoder; say once that it fell behind, and once what it missed."""
        behind = not worker.submit(frames, log_ns)
        if behind and not self._decode_was_behind:
            text = "decoding is behind; frames are recorded but not decoded"
            self._recording.add_status(0, now_ns, text)
        elif self._decode_was_behind and not behind:
            text = f"decoding has caught up; {worker.dropped_frames} frames were not decoded"
            self._recording.add_status(0, now_ns, text)
        self._decode_was_behind = behind

    def _close(self, why: str) -> RecordResult:
        now_ns = self._clock.now_ns()
        self._sample_clocks(now_ns)
        self._write_chunk(now_ns, status=True, last=True)
        return self._recording.finish(self._clock.now_ns(), why)

    def _open_sources(self) -> dict[int, SourceError]:
        """By bus number, why a source cannot be opened yet."""
        absent = {}
        for bus, source in enumerate(self._sources):
            try:
                source.open()
            except SourceError as error:
                if not self._options.wait_for_bus:
                    raise
                absent[bus] = error
        return absent

    def _close_sources(self, sources: Iterable[Source]) -> None:
        for source in sources:
            with contextlib.suppress(Exception):
                source.close()


def _begun(target: Path, begin: Callable[[], Recording]) -> Recording:
    """A recording that could be begun. Raises UsageError where no file can be made."""
    try:
        return begin()
    except SynclineError:  # some of which are an OSError too
        raise
    except OSError as error:
        reason = error.strerror or str(error)
        raise UsageError(
            f"nothing can be written to {target}: {reason}; name a folder in which files can be"
            " made with -o"
        ) from error


def source_metadata(sources: Iterable[SourceFacts]) -> dict[str, str]:
    """What the capture's metadata says of each source beside its bus; keys begin with its name."""
    values = {}
    for facts in sources:
        about = {
            "loss_counters": ", ".join(("queue", *facts.loss_counters)),
            "listen_only": "yes" if facts.listen_only else "no",
            "receive_buffer_bytes": facts.receive_buffer_bytes,
            "restart_ms": facts.restart_ms,
        }
        values.update(
            {f"{facts.name}.{key}": str(it) for key, it in about.items() if it is not None}
        )
    return values


def bus_info(facts: SourceFacts, number: int) -> BusInfo:
    """What the capture says of a source's bus."""
    return BusInfo(
        name=facts.name,
        number=number,
        bitrate=facts.bitrate,
        data_bitrate=facts.data_bitrate,
        interface=facts.interface,
        channel=facts.channel,
        filters=facts.filters,
        clock=facts.clock,
        resolution_ns=facts.resolution_ns,
    )
