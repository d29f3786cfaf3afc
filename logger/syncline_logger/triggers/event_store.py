"""Files for triggers alone: nothing is written until one comes, then what lies around it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from syncline_logger.capture_file import Block
from syncline_logger.capture_store import LAST_FINISH_S, CaptureStore, StorePlan
from syncline_logger.clocks_in_force import ClocksInForce
from syncline_logger.content import Content
from syncline_logger.disk_trouble import DiskTrouble
from syncline_logger.finishing import Finished, Finisher
from syncline_logger.gap_notes import gap_block
from syncline_logger.manifest import MarkNote, Segment
from syncline_logger.recording_folder import RecordingFolder
from syncline_logger.triggers.plan import TriggerPlan
from syncline_logger.triggers.ring import Ring
from syncline_logger.waiting_room import WaitingRoom
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.layout import Attachment

TRIGGER_METADATA_NAME = "syncline.trigger"
"""Metadata record of a file that was written because of a trigger: why it begins where it does."""
DRAIN_FRAMES = 1 << 17
"""Frames of the time before a trigger that are written at once beside what comes in: the ring of
four full buses is on the disk after about a minute."""

RING_FULL = "the memory for the time before a trigger was full"
ALWAYS_NS = 1 << 62
"""An event is kept to its end, in however many files."""


class EventStore:
    """Looks like a CaptureStore; each event becomes a recording of its own.

    An event begins with what the ring holds and ends `after_ns` after its last trigger. Triggers
    that come meanwhile extend it. Its file carries all attachments and metadata given so far.

    Args:
        untold: gaps of earlier recordings that stand in no file; the first event tells them.

    Attributes: as those of CaptureStore; `path` is the folder while nothing is written.
    """

    def __init__(
        self,
        plan: StorePlan,
        triggers: TriggerPlan,
        *,
        folder: RecordingFolder | None = None,
        attachments: Sequence[Attachment] = (),
        finishes: bool = False,
        untold: Sequence[Gap] = (),
    ) -> None:
        self._untold = untold
        self._plan = plan
        self._triggers = triggers
        self._folder = folder
        self._attachments = {each.name: each for each in attachments}
        self._metadata: dict[str, Mapping[str, str]] = {}
        self._clocks = ClocksInForce()
        self._ring = Ring(triggers.before_ns, triggers.ring_bytes, self._clocks)
        self._store: CaptureStore | None = None
        self._ends_ns = 0
        self._events = 0
        self._closed_bytes = self._closed_files = self._closed_frames = 0
        self._lost: dict[int, int] = {}
        self._nothing = WaitingRoom()
        self.unwritten: list[Gap] = []
        self._cut: list[tuple[str, Segment]] = []
        """Files of events that could not be finished yet."""
        self.notes: list[str] = []
        self.path = self.first_path = plan.names.folder
        self._finisher: Finisher | None = None
        with suppress(OSError):
            plan.names.folder.mkdir(parents=True, exist_ok=True)
        if folder and finishes:
            self._finisher = Finisher(folder.path, plan.disk, plan.keep.reserve_bytes or 0)
            self._finisher.add(
                (each.recording_id, segment) for each, segment in folder.unfinished()
            )

    @property
    def bytes_written(self) -> int:
        """Of all files of all events."""
        return self._closed_bytes + (self._store.bytes_written if self._store else 0)

    @property
    def frames_written(self) -> int:
        """In all files of all events."""
        return self._closed_frames + (self._store.frames_written if self._store else 0)

    @property
    def file_count(self) -> int:
        """Files that hold something."""
        return self._closed_files + (self._store.file_count if self._store else 0)

    @property
    def trouble(self) -> DiskTrouble | None:
        """What the disk refuses; None while all is well or nothing is to be written."""
        return self._store.trouble if self._store else None

    @property
    def waiting(self) -> WaitingRoom:
        """What the disk refused and what was lost by that."""
        return self._store.waiting if self._store else self._nothing

    @property
    def refused_frames(self) -> Mapping[int, int]:
        """Frames that the disk cost, by bus number, in all events."""
        return _sum(self._lost, self.waiting.lost_frames)

    def attach(self, attachment: Attachment) -> None:
        """Attach a file to this event and all that follow."""
        self._attachments[attachment.name] = attachment
        if self._store:
            self._store.attach(attachment)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record into this event and all that follow."""
        self._metadata[name] = values
        if self._store:
            self._store.add_metadata(name, values)

    def carry(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record into what follows."""
        self._metadata[name] = values
        if self._store:
            self._store.carry(name, values)

    def mark(self, note: MarkNote, end_ns: int | None = None) -> None:
        """A trigger: an event begins, or the running one lasts longer."""
        self._ends_ns = max(self._ends_ns, note.t_ns + self._triggers.after_ns)
        if self._store is None:
            self._begin(note)
        else:
            self._store.mark(note)

    def date_set(self, ahead_ns: int) -> None:
        """Log time goes ahead by so much without that time having passed."""
        if self._store:
            self._store.date_set(ahead_ns)

    def write(self, content: Content, now_ns: int) -> None:
        """Take what was recorded until `now_ns`."""
        self._look_after()
        if self._store is None:
            self._ring.add(content, now_ns)
            return
        self._drain(DRAIN_FRAMES + len(content.frames), now_ns)
        if len(self._ring) or self.trouble:
            self._hold(self._store, content)
        else:
            self._store.write(content, now_ns)
        # An event ends on the disk: what was lost there has to be told in its file.
        if not len(self._ring) and now_ns >= self._ends_ns and self.trouble is None:
            self._end_event(now_ns)

    def retry(self, now_ns: int, *, last: bool = False) -> None:
        """Try the disk again when it is time to, or because it is the last time."""
        if self._store:
            self._store.retry(now_ns, last=last)

    def take_missed(self) -> tuple[list[Gap], list[Block]]:
        """Once the disk is back: what was lost meanwhile, and the notes that were to be written."""
        if self._store is None:
            return [], []
        self.notes += self._store.notes
        self._store.notes.clear()
        return self._store.take_missed()

    def finish(self, name: str, values: Callable[[], Mapping[str, str]], end_ns: int) -> None:
        """Write what is left of a running event and close it."""
        if self._store:
            store = self._store
            self._drain(None, end_ns)
            store.finish(name, lambda: self._event_values(store, values), end_ns)
            self.notes += store.notes
        if self._finisher:
            self._finish_cut(last=True)
            self._finisher.add(self._cut)
            self._take_finished(self._finisher.close(LAST_FINISH_S))

    def abandon(self) -> None:
        """Leave the files as they are; they can be read up to the last chunk."""
        if self._store:
            self._store.abandon()

    def _begin(self, note: MarkNote) -> None:
        """Begin an event with what the ring holds.

        Whatever keeps its file from being made, it is tried again as after a trouble of the disk,
        and what that costs is told.
        """
        first_ns = self._ring.first_ns
        start_ns = note.t_ns if first_ns is None else min(first_ns, note.t_ns)
        number = self._events
        run = self._plan.metadata.recording_id
        recording_id = f"{run}-{number:04d}"
        about = replace(self._plan.metadata, recording_id=recording_id)
        names = replace(self._plan.names, recording_id=recording_id)
        record = {
            "run": run,
            "event": str(number),
            "t_ns": str(note.t_ns),
            "reason": note.reason,
            "begins": self._why_it_begins(first_ns, note.t_ns),
            "before_ns": str(self._triggers.before_ns),
            "after_ns": str(self._triggers.after_ns),
            "chunks_without_decoded_channels": str(self._ring.thinned),
        }
        store = CaptureStore(
            replace(self._plan, metadata=about, names=names),
            start_ns,
            folder=self._folder,
            attachments=list(self._attachments.values()),
            clocks=self._clocks,
            starts_anyway=True,
        )
        for name, values in {**self._metadata, TRIGGER_METADATA_NAME: record}.items():
            store.add_metadata(name, values)
        store.mark(note, ALWAYS_NS)
        if self._untold:
            told = [gap_block(self._untold, start_ns)]
            store.write(Content(FrameBatch.empty(), np.zeros(0, np.int64), told), note.t_ns)
            self._untold = ()
        self._store = store
        self._events += 1
        self.path = store.path
        self.first_path = store.first_path if number == 0 else self.first_path

    def _why_it_begins(self, first_ns: int | None, t_ns: int) -> str:
        if first_ns is None:
            return "with the trigger: nothing was recorded before it"
        span = f"{(t_ns - first_ns) / 1e9:.0f} s before the trigger"
        if self._ring.short:
            return f"{span}: the memory of {self._triggers.ring_bytes} bytes holds no more"
        if t_ns - first_ns < self._triggers.before_ns * 9 // 10:
            return f"{span}: where the recorder began, or the last event ended"
        return f"{span}, as wanted"

    def _hold(self, store: CaptureStore, content: Content) -> None:
        """Let a content wait in the ring; what that pushes out is lost, and told in the event."""
        for gone in self._ring.hold(content) if content else ():
            store.waiting.lose(gone, store.trouble.text if store.trouble else RING_FULL)

    def _drain(self, frames: int | None, now_ns: int) -> None:
        """Write the oldest contents of the ring, about so many frames, while the disk takes them.

        frames: None = all, whatever the disk does.
        """
        assert self._store is not None
        written = 0
        while len(self._ring) and (frames is None or (written < frames and not self.trouble)):
            content = self._ring.pop()
            self._store.write(content, now_ns)
            written += len(content.frames)

    def _end_event(self, now_ns: int) -> None:
        assert self._store is not None
        after_s = self._triggers.after_ns / 1e9
        reason = f"{after_s:.0f} s after the last trigger"
        lost = str(self._store.lost_frames)
        values = {"end_ns": str(now_ns), "reason": reason, "lost_frames": lost}
        self._store.retry(now_ns, last=True)
        self._store.finish("syncline.stop", lambda: values, now_ns)
        self.notes += self._store.notes
        self._finish_cut(last=True)
        self._lost = _sum(self._lost, self._store.waiting.lost_frames)
        self._closed_bytes += self._store.bytes_written
        self._closed_frames += self._store.frames_written
        self._closed_files += self._store.file_count
        self.first_path = self.first_path if self._events > 1 else self._store.first_path
        self._store = None
        self.path = self._plan.names.folder
        self._ring.short = False

    def _event_values(
        self, store: CaptureStore, values: Callable[[], Mapping[str, str]]
    ) -> Mapping[str, str]:
        """What is said at the end of the last event: its own losses, not those of the whole run."""
        self.unwritten = store.unwritten
        return {**values(), "lost_frames": str(store.lost_frames)}

    def _finish_cut(self, *, last: bool = False) -> None:
        """Have cut files finished; at the end of an event also those with which that failed."""
        if self._finisher and self._store:
            again, self._cut = (self._cut, []) if last else ([], self._cut)
            self._finisher.add([*again, *self._store.take_cut(last=last)])

    def _look_after(self) -> None:
        self._finish_cut()
        self._take_finished(self._finisher.done() if self._finisher else ())

    def _take_finished(self, finished: Iterable[Finished]) -> None:
        run = self._plan.metadata.recording_id
        for done in finished:
            if done.segment.state == "cut" and done.recording_id.startswith(f"{run}-"):
                self._cut.append((done.recording_id, done.segment))
            self.notes += [done.text] if done.text else []
            if self._folder:
                self._folder.take_finished(done.recording_id, done.segment)


def _sum(first: Mapping[int, int], second: Mapping[int, int]) -> dict[int, int]:
    return {bus: first.get(bus, 0) + second.get(bus, 0) for bus in sorted({*first, *second})}
