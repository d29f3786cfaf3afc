"""The files of one recording: segment after segment, also over troubles of the disk."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from syncline_logger.capture_file import Block, CaptureFile
from syncline_logger.clocks_in_force import ClocksInForce, knots_of
from syncline_logger.content import Content
from syncline_logger.disk import Disk
from syncline_logger.disk_trouble import DiskTrouble, is_trouble
from syncline_logger.finishing import Finisher
from syncline_logger.gap_notes import gaps_of
from syncline_logger.manifest import Manifest, MarkNote, Segment
from syncline_logger.recording_folder import RecordingFolder
from syncline_logger.retention import Keep
from syncline_logger.running_time import RunningTime
from syncline_logger.segments import SegmentNames, Split
from syncline_logger.untold import untold_of
from syncline_logger.waiting_room import WaitingRoom
from syncline_schemas.batch import Gap
from syncline_schemas.capture.chunk import ZSTD_LEVEL
from syncline_schemas.capture.layout import (
    FOLLOWS_KEY,
    MARK_METADATA_NAME,
    Attachment,
    BusInfo,
    CaptureMetadata,
    Compression,
)
from syncline_schemas.errors import UsageError
from syncline_schemas.wording import counted

HOUSEKEEPING_NS = 10_000_000_000
"""How often the free space and the budget are looked at."""
LAST_FINISH_S = 5.0
JUMP_TOLD_NS = 60_000_000_000
"""A date that goes further ahead at once is told where files are kept by their age."""
NEEDED_BYTES = 1 << 20
"""Must be free, beside what waits, for a new file on a disk that was full."""


@dataclass(frozen=True, slots=True)
class StorePlan:
    """How the files of a recording are made; `metadata` is that of the first one.

    `tell` hears of each file that is begun, closed, left or deleted.
    """

    names: SegmentNames
    metadata: CaptureMetadata
    buses: Sequence[BusInfo]
    compression: Compression = "zstd"
    zstd_level: int = ZSTD_LEVEL
    sync: bool = True
    split: Split = field(default_factory=Split)
    keep: Keep = field(default_factory=Keep)
    disk: Disk = field(default_factory=Disk)
    tell: Callable[[str], None] = lambda text: None


@dataclass(slots=True)
class _Open:
    """The segment that is being written."""

    file: CaptureFile
    segment: Segment


class CaptureStore:
    """Takes contents in order of log time; what the disk does is no reason to raise.

    While the disk refuses, contents wait in memory; what has no room there is counted as lost, and
    a new file is tried at growing intervals. Each segment begins with all attachments and metadata
    records that were given so far, and with the clocks of adapters that are in force.

    Attributes:
        path: of the file that was begun last.
        first_path: of the first one.
        trouble: what the disk refuses and since when; None while all is well.
        waiting: what waits and what was lost.
        file_count: files that hold something.
        notes: what happened to the files, in words; the reader takes them out.
        lost_frames: that the gaps of this recording tell of, in its files and unwritten.
        unwritten: what a disk that refused to the end cost, by bus; after `finish`.

    Args:
        starts_anyway: a first file that cannot be made for any reason is tried again like others.

    Raises:
        UsageError: the first file exists. OSError: it cannot be made, for a reason that is no
            trouble of the disk but a mistake (no right to write there).
    """

    def __init__(
        self,
        plan: StorePlan,
        start_ns: int,
        *,
        folder: RecordingFolder | None = None,
        attachments: Sequence[Attachment] = (),
        finishes: bool = False,
        clocks: ClocksInForce | None = None,
        starts_anyway: bool = False,
    ) -> None:
        self._starts_anyway = starts_anyway
        self._clocks = clocks or ClocksInForce()
        self._plan = plan
        self._folder = folder
        self._manifest = _manifest(plan, start_ns)
        self._attachments = {each.name: each for each in attachments}
        self._metadata: dict[str, Mapping[str, str]] = {}
        self.waiting = WaitingRoom()
        self.trouble: DiskTrouble | None = None
        self.notes: list[str] = []
        self.unwritten: list[Gap] = []
        self.lost_frames = 0
        self.file_count = self._number = self._closed_bytes = self._closed_frames = 0
        self._follows = -1
        self._open: _Open | None = None
        self._marks: list[MarkNote] = []
        self._kept_until_ns = 0
        self._kept_for: MarkNote | None = None
        self._cut: list[tuple[str, Segment]] = []
        self._cut_due = False
        self._told_cut: set[str] = set()
        self._left: set[Path] = set()
        """Files in which nothing is and that the disk did not let be taken away."""
        self._running = RunningTime(start_ns)
        self._described_ran_ns = 0
        self._reserve_told = False
        self._ends_ns = plan.split.ends_after(start_ns)
        self._housekeeping_ns = start_ns + HOUSEKEEPING_NS
        self.path = self.first_path = plan.names.written(0, start_ns)
        self._finisher: Finisher | None = None
        if folder and finishes:
            self._finisher = Finisher(folder.path, plan.disk, plan.keep.reserve_bytes or 0)
            self._finisher.add(
                (each.recording_id, segment) for each, segment in folder.unfinished()
            )
        if folder:
            self._kept_for = folder.kept_until(start_ns)
            self._kept_until_ns = self._kept_for.end_ns or 0 if self._kept_for else 0
            folder.add(self._manifest)
        self._make_room(start_ns)
        self._begin(start_ns)

    @property
    def bytes_written(self) -> int:
        """Of all files of the recording."""
        return self._closed_bytes + (self._open.file.bytes_written if self._open else 0)

    @property
    def frames_written(self) -> int:
        """In all files of the recording."""
        return self._closed_frames + (self._open.file.frames if self._open else 0)

    def attach(self, attachment: Attachment) -> None:
        """Attach a file to this segment and all that follow."""
        self._attachments[attachment.name] = attachment
        self._beside(lambda file: file.attach(attachment))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record into this segment and all that follow."""
        self.carry(name, values)
        self._beside(lambda file: file.add_metadata(name, values))

    def carry(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record into the segments that follow."""
        self._metadata[name] = values

    def mark(self, note: MarkNote, end_ns: int | None = None) -> None:
        """Keep the running segment for good, and those from `note.begin_ns` to `end_ns`."""
        if self._folder:
            self._folder.keep(note)
        begin_ns = note.begin_ns
        for segment in self._manifest.segments if begin_ns is not None else ():
            if segment.end_ns is not None and segment.end_ns >= (begin_ns or 0):
                segment.mark(note)
        if end_ns is not None and end_ns > self._kept_until_ns:
            self._kept_until_ns, self._kept_for = end_ns, note
        if self._open is None:
            self._marks.append(note)
            return
        before = len(self._open.segment.marks)
        self._open.segment.mark(note)
        if not before:
            self._beside(lambda file: file.add_metadata(MARK_METADATA_NAME, _record(note)))
        if len(self._open.segment.marks) > before:
            self._save()

    def date_set(self, ahead_ns: int) -> None:
        """Log time goes ahead by so much without that time having passed."""
        self._running.step(ahead_ns)

    def write(self, content: Content, now_ns: int) -> None:
        """Write what was taken until `now_ns`, in the segments to which it belongs."""
        self._look_after(now_ns)
        while self._ends_ns is not None and content and content.last_ns >= self._ends_ns:
            before, content = content.split(self._ends_ns)
            self._put(before, now_ns)
            self._ends_ns = self._plan.split.ends_after(content.first_ns)
            self._go_on(content.first_ns, now_ns)
        self._put(content, now_ns)

    def retry(self, now_ns: int, *, last: bool = False) -> None:
        """Try the disk again when it is time to, or because it is the last time."""
        if self.trouble is not None and (last or self.trouble.is_due(now_ns)):
            self._try_again(now_ns)

    def take_missed(self) -> tuple[list[Gap], list[Block]]:
        """Once the disk is back: what was lost meanwhile, and the notes that were to be written."""
        return ([], []) if self.trouble else self.waiting.take_missed()

    def finish(self, name: str, values: Callable[[], Mapping[str, str]], end_ns: int) -> None:
        """Write a last metadata record and close the file.

        What still waits is lost; `values` is asked after that.
        """
        if self.trouble is not None:
            self.waiting.give_up(self.trouble.text)
        self._note_unwritten()
        self._clear()
        record = values()
        self._beside(lambda file: file.add_metadata(name, record))
        if self._open:
            self._close(self._open)
        if self._finisher:
            self._finisher.add(self.take_cut(last=True))
            for done in self._finisher.close(LAST_FINISH_S):
                self._take_finished(done.recording_id, done.segment, done.text)
        self._manifest.end_ns = end_ns
        self._manifest.reason = record.get("reason", "")
        self._manifest.lost_frames = int(record.get("lost_frames", 0))
        self._save()

    @property
    def refused_frames(self) -> Mapping[int, int]:
        """Frames that the disk cost, by bus number."""
        return self.waiting.lost_frames

    def _note_unwritten(self) -> None:
        """Keep in the manifest what stands in no file; the next recording in the folder tells it."""
        self.unwritten, notes = self.waiting.take_missed()
        gaps = self._own([*self.unwritten, *gaps_of(notes)])
        self.lost_frames += sum(gap.lost_frames or 0 for gap in gaps)
        names = {bus.number: bus.name for bus in self._plan.buses}
        self._manifest.untold = untold_of(gaps, names)

    def _own(self, gaps: Sequence[Gap]) -> list[Gap]:
        """Those gaps that no earlier recording's manifest tells of."""
        earlier = self._folder.pending if self._folder else []
        return [gap for gap in gaps if gap not in earlier]

    def abandon(self) -> None:
        """Leave the files as they are; they can be read up to the last chunk."""
        if self._open:
            self._open.file.abandon()

    def _put(self, content: Content, now_ns: int) -> None:
        if not content:
            return
        file = self._open.file if self._open else None
        if file and self._plan.split.is_full(
            file.bytes_written, file.last_chunk_bytes, file.index_bytes
        ):
            self._go_on(content.first_ns, now_ns)
        if self._open:
            try:
                self._write(self._open.file, content)
                return
            except OSError as error:
                self._fail(error, self._open, now_ns)
        assert self.trouble is not None
        self.waiting.add(content, self.trouble.text)

    def _write(self, file: CaptureFile, content: Content) -> None:
        """Write a content; a new file begins with the clocks that are in force. Raises OSError."""
        whole = self._clocks.before(content) if file.start_ns is None else content
        file.write(whole.frames, whole.log_ns, whole.blocks)
        self._follows = self._number - 1
        self.lost_frames += sum(gap.lost_frames or 0 for gap in self._own(gaps_of(whole.blocks)))
        if self._folder:
            self._folder.told()
        self._clocks.note(knots_of(content))

    def _go_on(self, start_ns: int, now_ns: int) -> None:
        """Open the next segment, then close the last one; that goes on where no other can be."""
        last = self._open
        if last is None or last.file.start_ns is None:
            return
        following = self._plan.split.size_bytes or last.file.bytes_written
        self._make_room(now_ns, writing_bytes=last.file.bytes_written + following)
        with suppress(OSError):
            self._open = self._begun(start_ns)
            self._close(last)

    def _begin(self, start_ns: int) -> None:
        """Begin the first file; a disk that refuses is trouble, everything else a mistake."""
        try:
            self._open = self._begun(start_ns)
            self.first_path = self.path
        except OSError as error:
            if not (self._starts_anyway or is_trouble(error)):
                if isinstance(error, FileExistsError):
                    text = f"{self.path} exists; recordings never overwrite a file"
                    raise UsageError(text) from error
                raise
            self._note_trouble(DiskTrouble.first(error, start_ns))

    def _begun(self, start_ns: int) -> _Open:
        """A new file with all that every segment carries. Raises OSError."""
        plan = self._plan
        path = plan.names.written(self._number, start_ns)
        kept = self._kept_for if start_ns < self._kept_until_ns else None
        about = replace(plan.metadata, segment=self._number, created_ns=start_ns)
        if self._number > self._follows + 1 > 0:
            about = replace(about, extra={**about.extra, FOLLOWS_KEY: str(self._follows)})
        stood = path.exists()
        try:
            plan.names.folder.mkdir(parents=True, exist_ok=True)
            file = CaptureFile(
                path,
                about,
                plan.buses,
                attachments=list(self._attachments.values()),
                metadata=self._metadata | ({MARK_METADATA_NAME: _record(kept)} if kept else {}),
                compression=plan.compression,
                zstd_level=plan.zstd_level,
                sync=plan.sync,
                disk=plan.disk,
            )
        except FileExistsError:
            # A file that could not be taken away, or a stranger's: the next number is free.
            self._number += self._number > 0 or self.trouble is not None
            raise
        except OSError:
            if path.exists() and not stood:
                self._left.add(path)
            raise
        self._left.discard(path)
        segment = Segment(self._number, path.name, marks=[kept] if kept else [])
        self._manifest.segments.append(segment)
        self._number += 1
        self.path = path
        if not self.file_count and self.trouble is not None:
            self.first_path = path
        plan.tell(f"writing {path}")
        self._save()
        return _Open(file, segment)

    def _close(self, last: _Open) -> None:
        """Finish a file; one that cannot be is cut, and finished later."""
        try:
            last.file.finish()
        except OSError:
            self._leave(last)
            return
        self._describe(last)
        last.segment.state = "closed"
        self._plan.tell(f"closed {last.file.path}: {_contents(last.segment)}")
        if self._open is last:
            self._open = None
        self._save()

    def _leave(self, last: _Open) -> None:
        """Abandon a file; it is finished when the disk is back, and gone where nothing is in it."""
        last.file.abandon()
        self._describe(last)
        last.segment.state = "cut"
        self._plan.tell(f"left {last.file.path} without its end: {_contents(last.segment)}")
        if last.file.start_ns is None:
            self._manifest.segments.remove(last.segment)
            self._marks += last.segment.marks
            if last.file.path.exists():
                self._left.add(last.file.path)
            else:
                self._number = last.segment.segment
        else:
            self._cut.append((self._manifest.recording_id, last.segment))
        if self._open is last:
            self._open = None

    def _describe(self, last: _Open) -> None:
        segment, file = last.segment, last.file
        self.path = self.path if self._open is not last else file.path
        if self.first_path == file.begun_as:
            self.first_path = file.path
        segment.file, segment.bytes = file.path.name, file.bytes_on_disk
        segment.frames = file.frames
        segment.start_ns, segment.end_ns = file.start_ns, file.end_ns
        segment.ran_ns = self._running.ran_ns - self._described_ran_ns
        self._described_ran_ns = self._running.ran_ns
        self.file_count += file.start_ns is not None
        self._closed_bytes += segment.bytes
        self._closed_frames += segment.frames

    def _fail(self, error: OSError, last: _Open, now_ns: int) -> None:
        """The disk refused: leave the file as it is; a new one is tried later."""
        self._leave(last)
        self._note_trouble(DiskTrouble.first(error, now_ns))
        self._save()

    def _note_trouble(self, trouble: DiskTrouble) -> None:
        self.trouble = trouble
        self.notes.append(trouble.text)

    def _try_again(self, now_ns: int) -> None:
        assert self.trouble is not None
        waiting = self.waiting.contents
        self._make_room(now_ns, needed_bytes=NEEDED_BYTES)
        try:
            self._open = self._begun(waiting[0].first_ns if waiting else now_ns)
            while waiting:
                self._write(self._open.file, waiting[0])
                waiting.popleft()
        except OSError as error:
            if self._open:
                self._leave(self._open)
            self.trouble = self.trouble.again(error, now_ns)
            return
        self._clocks.note(self.waiting.lost_clocks)
        self.waiting.lost_clocks.clear()
        self.notes.append(self.trouble.over(now_ns))
        self.trouble = None
        marks, self._marks = self._marks, []
        for note in marks:
            self.mark(note)
        self._cut_due = True
        self._clear()

    def take_cut(self, *, last: bool = False) -> list[tuple[str, Segment]]:
        """Cut files that may be finished now: the disk is back, or has had time to be."""
        if self.trouble is not None or not (last or self._cut_due):
            return []
        self._cut_due = False
        cut, self._cut = self._cut, []
        return cut

    def _clear(self) -> None:
        """Take away the files in which nothing is."""
        for path in list(self._left):
            with suppress(OSError):
                self._plan.disk.remove(path)
                self._left.discard(path)

    def _beside(self, act: Callable[[CaptureFile], None]) -> None:
        """Write something between the chunks; a refusal shows at the next chunk."""
        if self._open:
            with suppress(OSError):
                act(self._open.file)

    def _look_after(self, now_ns: int) -> None:
        """What is done beside the writing: running time, cut files, budget, free space."""
        self._turn(now_ns)
        if self._finisher:
            self._finisher.add(self.take_cut())
        for done in self._finisher.done() if self._finisher else ():
            self._take_finished(done.recording_id, done.segment, done.text)
        if now_ns >= self._housekeeping_ns:
            self._housekeeping_ns = now_ns + HOUSEKEEPING_NS
            self._make_room(now_ns)
            self._tell_reserve()
            self._clear()
            self._cut_due = True

    def _turn(self, now_ns: int) -> None:
        before_ns = self._running.jumped_ns
        self._running.turn(now_ns)
        jumped_ns = self._running.jumped_ns - before_ns
        if jumped_ns >= JUMP_TOLD_NS and self._plan.keep.age_ns is not None:
            self.notes.append(
                f"the date went ahead by {jumped_ns / 3.6e12:.1f} h at once; that makes no file"
                " old: their age is the time recorded since"
            )

    def _make_room(self, now_ns: int, writing_bytes: int = 0, needed_bytes: int = 0) -> None:
        """Delete what has to go so that the open file, and what is told, has its place."""
        if self._folder and self._plan.keep:
            expected = self._plan.split.size_bytes or 0
            if self._open:
                expected = max(expected, self._open.file.bytes_written)
            for gone in self._folder.make_room(
                self._plan.keep,
                now_ns,
                max(writing_bytes, expected),
                needed_bytes,
                self._running.ran_ns - self._described_ran_ns,
            ):
                self._plan.tell(f"deleted {gone.segment.file}: {gone.why}")

    def _tell_reserve(self) -> None:
        """Say once that no room is left for others and nothing is there that may be deleted."""
        reserve_bytes = self._plan.keep.reserve_bytes
        if not reserve_bytes:
            return
        with suppress(OSError):
            broken = self._plan.disk.free_bytes(self._plan.names.folder) < reserve_bytes
            if broken and not self._reserve_told:
                self.notes.append(
                    "less is free on the disk than the reserve, and no file may be deleted;"
                    " recording goes on until the disk is full"
                )
            self._reserve_told = broken

    def _take_finished(self, recording_id: str, finished: Segment, text: str) -> None:
        if text and text not in self._told_cut:
            self.notes.append(text)
        if finished.state == "cut" and recording_id == self._manifest.recording_id:
            # The disk refused that too: it is tried again with the next look at the free space.
            self._told_cut.add(text)
            self._cut.append((recording_id, finished))
        if self._folder:
            self._folder.take_finished(recording_id, finished)

    def _save(self) -> None:
        if self._folder:
            self._folder.save(self._manifest)


def _contents(segment: Segment) -> str:
    return f"{counted(segment.frames, 'frame')}, {segment.bytes / 1e6:.1f} MB"


def _record(note: MarkNote) -> Mapping[str, str]:
    record = {"t_ns": str(note.t_ns), "reason": note.reason}
    for name, t_ns in (("begin_ns", note.begin_ns), ("end_ns", note.end_ns)):
        record |= {} if t_ns is None else {name: str(t_ns)}
    return record


def _manifest(plan: StorePlan, start_ns: int) -> Manifest:
    return Manifest(
        recording_id=plan.metadata.recording_id,
        version=plan.metadata.version,
        host=plan.metadata.host,
        source=plan.metadata.source,
        created_ns=start_ns,
        buses=[bus.name for bus in plan.buses],
    )
