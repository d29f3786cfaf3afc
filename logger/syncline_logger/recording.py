"""From collected frames to chunks: what every recording does, live or simulated."""

import platform
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from syncline_logger.adapter_clock import Knot
from syncline_logger.bus_condition import BusCondition, Change
from syncline_logger.capture_file import Block
from syncline_logger.capture_store import CaptureStore, StorePlan
from syncline_logger.clock import ClockReading
from syncline_logger.content import Content
from syncline_logger.decoding import Decoded
from syncline_logger.disk import Disk
from syncline_logger.live_status import LiveStatus, StatusSnapshot
from syncline_logger.manifest import MarkNote
from syncline_logger.notes import Note, OnNote, gap_text, utc_text
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder_messages import (
    CLOCK_CHANNEL,
    GAP_CHANNEL,
    MARK_CHANNEL,
    RecorderMessages,
    clock_message,
    knot_message,
    status_channel,
)
from syncline_logger.recording_folder import RecordingFolder
from syncline_logger.segments import SegmentNames
from syncline_logger.triggers.event_store import EventStore
from syncline_logger.triggers.watch import TriggerWatch
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.gap_message import DID_NOT_RUN, gap_message
from syncline_schemas.capture.layout import (
    AFTER_KEY,
    LEARNED_METADATA_NAME,
    Attachment,
    BusInfo,
    CaptureMetadata,
    description_attachment,
    device_attachment,
)
from syncline_schemas.capture.learned import Settings, learned_record
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import Device
from syncline_schemas.proto import syncline_pb2
from syncline_schemas.wording import counted

MAX_KEPT = 1000
"""Gaps and problems kept for the result; all of them are in the file."""

STOP_METADATA_NAME = "syncline.stop"
"""Metadata record: when and why the recording ended, and the frames known to be lost."""

SLEPT = "the machine slept"
BEHIND = "the date is behind the end of the last recording: how long the recorder did not run is not known"
LIVE_STATUS = "bus load and node states of the live status"
SNAPSHOT = "the live status"
TRIGGERS = "triggers"


@dataclass(frozen=True, slots=True)
class RecordResult:
    """What was recorded.

    Attributes:
        path: the file, or the first of several; it may have been deleted to make room.
        files: how many there were.
        frames: received, by bus name.
        frames_written: in all files; fewer than were received where only triggers are written.
        lost_frames: known to be lost, all buses together.
        gap_count: stretches in which a bus was not heard; `gaps` holds the first thousand.
        problems: words on what was not decoded and what changed, each with its bus's name; the
            first thousand.
    """

    path: Path
    frames: dict[str, int]
    lost_frames: int
    gap_count: int
    gaps: list[Gap]
    problems: list[str]
    bytes_written: int
    frames_written: int
    files: int = 1

    @property
    def frame_count(self) -> int:
        """All buses together."""
        return sum(self.frames.values())


class Recording:
    """The chunks of one recording, fed in log time order."""

    def __init__(
        self,
        target: Path,
        buses: Sequence[BusInfo],
        options: RecordOptions,
        *,
        start_ns: int,
        host: str | None = None,
        source: str = "",
        about: Mapping[str, str] | None = None,
        resumes: bool = False,
        disk: Disk | None = None,
        on_note: OnNote | None = None,
    ) -> None:
        recording_id = options.recording_id or uuid.uuid4().hex[:8]
        self._buses = {bus.number: bus for bus in buses}
        self.conditions = {bus.number: BusCondition(bus.interface, bus.number) for bus in buses}
        self.live = LiveStatus(buses, start_ns)
        self._gaps: list[Gap] = []
        self._gap_count = self._lost_frames = self.marks = 0
        self._problems: list[str] = []
        self._messages = RecorderMessages()
        self._heard_ns = self._clock_ns = self._now_ns = self._start_ns = start_ns
        self._on_note = on_note
        self._off: set[str] = set()
        self._offset_ns: int | None = None
        self._settings: dict[tuple[int, int], Settings] = {}
        plan = StorePlan(
            names=SegmentNames(target, recording_id, bool(options.file_split)),
            metadata=CaptureMetadata(
                version=version("syncline"),
                recording_id=recording_id,
                host=platform.node() if host is None else host,
                created_ns=start_ns,
                clock=_one_of({bus.clock for bus in buses}, "mixed"),
                resolution_ns=max((bus.resolution_ns or 1 for bus in buses), default=1),
                source=source,
                extra=dict(about or {}),
            ),
            buses=buses,
            compression=options.compression,
            zstd_level=options.zstd_level,
            sync=options.sync,
            split=options.file_split,
            keep=options.keep,
            disk=disk or Disk(),
            tell=lambda text: self._tell(Note(self._now_ns, text)),
        )
        folder = _folder(plan)
        self._triggers = options.triggers
        self.watch = TriggerWatch(
            options.triggers.conditions, [bus.name for bus in buses], options.description
        )
        attachments = _attachments(options.description)
        last_end_ns = None
        numbers = {bus.name: bus.number for bus in buses}
        untold = folder.untold(numbers) if folder and resumes else []
        self.store: CaptureStore | EventStore
        if options.triggers.only:
            self.store = EventStore(
                plan,
                options.triggers,
                folder=folder,
                attachments=attachments,
                finishes=resumes,
                untold=untold,
            )
        else:
            if folder and resumes:
                last_end_ns = folder.last_end_ns(numbers)
                plan = _after(plan, folder.last_place(numbers))
            self.store = CaptureStore(
                plan, start_ns, folder=folder, attachments=attachments, finishes=resumes
            )
            for gap in untold:
                self._messages.add(GAP_CHANNEL, start_ns, gap_message(gap))
        if last_end_ns is not None:
            self.add_gap(Gap(min(last_end_ns, start_ns), start_ns, DID_NOT_RUN), start_ns)
            if last_end_ns > start_ns:
                self.add_status(0, start_ns, BEHIND)
        for bus in buses:
            for node, entry in options.description.described(bus.name).items():
                if entry.device:
                    self._recognised(bus.number, node, entry.device)

    def add_gap(self, gap: Gap, log_ns: int) -> None:
        """Note a stretch in which nothing was heard; it stands in the file at `log_ns`."""
        self._count(gap, log_ns)
        self._messages.add(GAP_CHANNEL, log_ns, gap_message(gap))
        self._beside(TRIGGERS, log_ns, lambda: self.watch.gap(gap, log_ns))

    def _count(self, gap: Gap, log_ns: int) -> None:
        self._gap_count += 1
        self._lost_frames += gap.lost_frames or 0
        if len(self._gaps) < MAX_KEPT:
            self._gaps.append(gap)
        self._tell(Note(log_ns, gap_text(gap), self._bus_name(gap.bus), serious=True))

    def mark(
        self,
        text: str,
        log_ns: int,
        *,
        bus: int | None = None,
        node: int | None = None,
        t_ns: int | None = None,
    ) -> None:
        """Note a moment that somebody wants to find again; what lies around it is kept for good.

        t_ns: when it was, where that is not when it became known.
        """
        message = syncline_pb2.Mark(
            t_ns=log_ns if t_ns is None else t_ns, reason=text, bus=bus, node=node
        )
        self._messages.add(MARK_CHANNEL, log_ns, message)
        when = "" if t_ns in (None, log_ns) else f" at {utc_text(message.t_ns)}"
        self._tell(Note(log_ns, f"mark{when}: {text}", self._bus_name(bus)))
        plan = self._triggers
        end_ns = log_ns + plan.after_ns
        self.store.mark(MarkNote(log_ns, text, log_ns - plan.before_ns, end_ns), end_ns)
        self.marks += 1

    def ask(self, text: str, log_ns: int) -> None:
        """Somebody asks for a mark."""
        if self._beside(TRIGGERS, log_ns, lambda: self.watch.ask(text, log_ns)):
            self._mark_triggers()
        else:
            self.mark(text, log_ns)

    def _mark_triggers(self) -> None:
        def mark() -> None:
            for each in self.watch.take():
                self.mark(each.text, each.log_ns, bus=each.bus, node=each.node, t_ns=each.t_ns)

        self._beside(TRIGGERS, self._heard_ns, mark)

    def add_clock(self, reading: ClockReading, log_ns: int) -> None:
        """Note what the clocks said."""
        self._messages.add(CLOCK_CHANNEL, log_ns, clock_message(reading))
        if reading.slept_ns:
            # It fell asleep some time after the last sample.
            begin_ns = min(self._clock_ns, log_ns - reading.slept_ns)
            self.add_gap(Gap(begin_ns, log_ns, SLEPT), log_ns)
        self._clock_ns = log_ns
        if reading.step_ns > 0:
            before_ns = reading.offset_ns - reading.step_ns
            ahead_ns = reading.offset_ns - max(self._offset_ns or before_ns, before_ns)
            self.store.date_set(ahead_ns)
        self._offset_ns = reading.offset_ns

    def add_knot(self, bus: int, knot: Knot, reading: ClockReading, log_ns: int) -> None:
        """Note how the stamps of a bus's adapter become t."""
        self.conditions[bus].clock_residual_ns = knot.residual_ns
        self._messages.add(CLOCK_CHANNEL, log_ns, knot_message(bus, knot, reading))

    def add_status(
        self, bus: int, log_ns: int, text: str = "", *, noted: bool = False, serious: bool = False
    ) -> None:
        """Note a bus's state and counters; `text` says what changed.

        noted: the note of a gap says it already, and who adds up the own log must not meet it twice.
        """
        channel = status_channel(self._buses[bus].name)
        self._messages.add(channel, log_ns, self.conditions[bus].message(text))
        if text and not noted:
            self._tell(Note(log_ns, text, self._buses[bus].name, serious=serious))
        if text and len(self._problems) < MAX_KEPT:
            self._problems.append(f"{self._buses[bus].name}: {text}")

    def add_all_status(self, log_ns: int) -> None:
        """Note the state and counters of every bus."""
        for bus in self._buses:
            self.add_status(bus, log_ns)

    def take_frames(self, frames: FrameBatch, log_ns: NDArray[np.int64]) -> None:
        """Count frames and follow the state of their buses; they are written by `write`."""
        if len(frames) == 0:
            return
        self._heard_ns = int(log_ns[-1])
        for bus, condition in self.conditions.items():
            rows = np.flatnonzero(frames.bus == bus)
            self._note_changes(bus, condition.update(frames[rows], log_ns[rows]))
        self._beside(LIVE_STATUS, self._heard_ns, lambda: self._look_at_nodes(frames, log_ns))
        self._beside(TRIGGERS, self._heard_ns, lambda: self.watch.update(frames, log_ns))
        self._mark_triggers()

    def _look_at_nodes(self, frames: FrameBatch, log_ns: NDArray[np.int64]) -> None:
        self.live.update(frames, log_ns)
        self._tell_changes()

    def _tell_changes(self) -> None:
        for change in self.live.take_changes():
            self._tell(Note(change.log_ns, change.text, change.bus))

    def _tell(self, note: Note) -> None:
        if self._on_note:
            self._on_note(note)

    def _bus_name(self, bus: int | None) -> str:
        return "" if bus is None else self._buses[bus].name

    def listened(self, bus: int, begin_ns: int, end_ns: int) -> None:
        """All frames that a bus gave in [begin_ns, end_ns) of log time are taken in."""
        self._beside(LIVE_STATUS, end_ns, lambda: self.live.listened(bus, begin_ns, end_ns))

    def _beside(self, what: str, log_ns: int, work: Callable[[], None]) -> bool:
        """Do what a bug must not end the recording by; whether it is done.

        The first failure turns it off for good, and is told.
        """
        if what in self._off:
            return False
        try:
            work()
        except Exception as error:  # noqa: BLE001 - a bug here must not cost the recording
            self._off.add(what)
            text = f"{what}: off after {type(error).__name__}: {error}"
            self.add_status(0, log_ns, text)
            if what == TRIGGERS and self._triggers.only:
                # Nothing would be written any more; this moment at least is.
                self.mark(text, log_ns)
            return False
        return True

    def tell_state(self, bus: int, state: str, log_ns: int) -> None:
        """Note the state of a bus's controller as the interface tells it."""
        self._note_changes(bus, self.conditions[bus].tell(state, log_ns))

    def note_deafness(self, end_ns: int) -> None:
        """Note the gaps of controllers that are bus-off at the end."""
        for condition in self.conditions.values():
            gap = condition.deaf_until(end_ns)
            if gap:
                self.add_gap(gap, end_ns)

    def _note_changes(self, bus: int, changes: Iterable[Change]) -> None:
        for change in changes:
            if change.gap:
                self.add_gap(change.gap, change.log_ns)
            self.add_status(bus, change.log_ns, change.text)
            self._beside(TRIGGERS, change.log_ns, partial(self._tell_watch, bus, change))

    def _tell_watch(self, bus: int, change: Change) -> None:
        self.watch.bus_state(bus, change.state, change.log_ns)

    def write(
        self,
        frames: FrameBatch,
        log_ns: NDArray[np.int64],
        decoded: Iterable[Decoded] = (),
        now_ns: int | None = None,
    ) -> None:
        """Write a chunk of these frames, what was decoded, and everything noted since.

        now_ns: log time; None takes that of the last frame.
        """
        now_ns = self._heard_ns if now_ns is None else now_ns
        self._now_ns = max(self._now_ns, now_ns)
        self.store.retry(now_ns)
        blocks = self._told_by_the_store(now_ns)
        for part in decoded:
            blocks += part.blocks
            for bus, text in part.problems:
                self.add_status(bus, self._heard_ns, text)
            for bus, node, device in part.devices:
                self._recognised(bus, node, device)
            self._beside(TRIGGERS, self._heard_ns, partial(self.watch.events, part.events))
            self._settings |= part.settings
            if part.settings:
                self.store.carry(LEARNED_METADATA_NAME, learned_record(self._settings))
        self._mark_triggers()
        blocks += self._messages.take()
        self.store.write(Content(frames, log_ns, blocks), now_ns)
        for bus, lost in self.store.refused_frames.items():
            self.conditions[bus].dropped_disk = lost

    def _told_by_the_store(self, now_ns: int) -> list[Block]:
        """Notes that could not be written before; what the disk cost becomes gaps."""
        gaps, blocks = self.store.take_missed()
        for gap in gaps:
            self.add_gap(gap, now_ns)
        for text in self.store.notes:
            self.add_status(0, now_ns, text, serious=self.store.trouble is not None)
        self.store.notes.clear()
        return blocks

    def snapshot(self, now_ns: int) -> StatusSnapshot:
        """The live state; begins the next period of its rates."""
        path, written = str(self.store.path), self.store.bytes_written
        trouble = self.store.trouble.text if self.store.trouble else ""
        found: list[StatusSnapshot] = []

        def look() -> None:
            conditions = list(self.conditions.values())
            found.append(
                self.live.snapshot(now_ns, path, written, conditions, self._gap_count, trouble)
            )
            self._tell_changes()

        if not self._beside(SNAPSHOT, now_ns, look):
            elapsed_ns = now_ns - self._start_ns
            found.append(
                StatusSnapshot(now_ns, elapsed_ns, path, written, (), self._gap_count, trouble)
            )
        return found[0]

    def finish(self, end_ns: int, why: str) -> RecordResult:
        """Write the end of the file and close it."""
        self._now_ns = max(self._now_ns, end_ns)
        self.store.retry(end_ns, last=True)
        self._beside(TRIGGERS, end_ns, lambda: self._finish_watch(end_ns))
        self.write(FrameBatch.empty(), np.zeros(0, np.int64), now_ns=end_ns)
        before = self._lost_frames

        def record() -> Mapping[str, str]:
            for gap in self.store.unwritten:
                self._count(gap, end_ns)
            lost = str(self._lost_frames)
            return {"end_ns": str(end_ns), "reason": why, "lost_frames": lost}

        self.store.finish(STOP_METADATA_NAME, record, end_ns)
        self._problems += self.store.notes
        if self._lost_frames > before:
            lost = counted(self._lost_frames - before, "frame")
            self._problems.append(f"{lost} could not be written when the recording ended")
        return self.result()

    def _finish_watch(self, end_ns: int) -> None:
        self.watch.finish(end_ns)
        self._problems += self.watch.uncounted()

    def result(self) -> RecordResult:
        """What was recorded so far."""
        return RecordResult(
            path=self.store.first_path,
            frames={bus.name: self.conditions[n].frames for n, bus in self._buses.items()},
            lost_frames=self._lost_frames,
            gap_count=self._gap_count,
            gaps=list(self._gaps),
            problems=list(self._problems),
            bytes_written=self.store.bytes_written,
            frames_written=self.store.frames_written,
            files=self.store.file_count,
        )

    def _recognised(self, bus: int, node: int, device: Device) -> None:
        self._attach(device)
        name = self._buses[bus].name
        self.store.add_metadata(
            f"syncline.device.{name}.node{node}",
            {"bus": name, "node": str(node), "device": device.name},
        )

    def _attach(self, device: Device) -> None:
        for name, data in device.files.items():
            self.store.attach(device_attachment(name, data))


def _after(plan: StorePlan, place: tuple[str, int] | None) -> StorePlan:
    """The plan of a recording that follows another one's last file."""
    if place is None:
        return plan
    extra = {**plan.metadata.extra, AFTER_KEY: f"{place[0]}/{place[1]}"}
    return replace(plan, metadata=replace(plan.metadata, extra=extra))


def _folder(plan: StorePlan) -> RecordingFolder | None:
    """The folder with its earlier recordings; None for a single file that the user named."""
    if plan.names.is_file and not plan.split:
        return None
    folder = RecordingFolder(plan.names.folder, plan.metadata.host, plan.disk)
    folder.load()
    return folder


def _attachments(description: BusDescription) -> list[Attachment]:
    files = [device_attachment(name, data) for name, data in description.files.items()]
    return ([description_attachment(description.text)] if description.text else []) + files


def _one_of(values: set[str], several: str) -> str:
    return next(iter(values)) or "unknown" if len(values) == 1 else several
