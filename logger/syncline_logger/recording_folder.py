"""The folder of a recorder: what it recorded there, by the manifests and the files themselves."""

import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from syncline_logger.disk import Disk, is_being_written
from syncline_logger.manifest import SUFFIX as MANIFEST_SUFFIX
from syncline_logger.manifest import Manifest, MarkNote, Segment
from syncline_logger.retention import Keep, Surplus, surplus
from syncline_logger.segments import SUFFIX, is_part, whole_path
from syncline_logger.small_file import DRAFT_NAME
from syncline_logger.untold import told_of
from syncline_schemas.batch import Gap
from syncline_schemas.capture.layout import MARK_METADATA_NAME, PROFILE
from syncline_schemas.capture.record_file import RecordFile
from syncline_schemas.capture.recover import is_whole
from syncline_schemas.capture.scan import CaptureScan

_OWN_NAME = re.compile(r"\d{8}T\d{6}Z_(?P<id>[^_]+)(?:_(?P<segment>\d{4,}))?(?:\.part)?\.mcap")
"""Names that a recorder gives; a file that somebody renamed is not its own any more."""
RECOVERING = ".recovering"
"""Ending of a regular file that is being made of a cut one."""
SHORT_MANIFEST_CHARS = 100_000
"""Manifests up to this length, some 500 files, are written with every change."""
MANIFEST_CHARS_PER_S = 20_000
"""How much is written of longer ones: less than 2 GB a day, whatever the number of files."""


def _is_left_over(name: str) -> bool:
    """Whether a file was to take another one's place when its recorder was killed."""
    if RECOVERING in name:
        return ".mcap" in name and name.endswith((RECOVERING, f"{RECOVERING}.partial"))
    return f"{MANIFEST_SUFFIX}." in name and DRAFT_NAME.fullmatch(name) is not None


@dataclass(slots=True)
class RecordingFolder:
    """Recordings of this machine in one folder; nothing that lies there makes a method raise.

    Attributes:
        recordings: in the order in which they were made; the running one is the last.
        running: id of the recording that this recorder is writing.
        busy: ids of recordings that another recorder, which still runs, is writing.
    """

    path: Path
    host: str
    disk: Disk = field(default_factory=Disk)
    recordings: list[Manifest] = field(default_factory=list)
    busy: set[str] = field(default_factory=set)
    running: str | None = None
    elapsed_ns: Callable[[], int] = time.monotonic_ns
    pending: list[Gap] = field(default_factory=list)
    """Gaps of earlier recordings that the running one is to tell, until `told`."""
    _telling: list[Manifest] = field(default_factory=list)
    _unsaved: dict[str, Manifest] = field(default_factory=dict)
    _due_ns: dict[str, int] = field(default_factory=dict)
    """When a long manifest may be written again, by recording."""

    def load(self) -> None:
        """Look at what is there; manifests that are missing are made anew from the files."""
        files = _regular_files(self.path)
        for name, path in files.items():
            if _is_left_over(name):
                with suppress(OSError):
                    self.disk.remove(path)
            elif name.endswith(MANIFEST_SUFFIX):
                manifest = _read(path)
                # What another machine recorded was copied here: nothing of it is touched.
                if manifest and manifest.host == self.host:
                    self.recordings.append(manifest)
        self._reconcile(set(files))
        self._adopt(files)
        for each in self.recordings:
            if each.recording_id not in self.busy and each.spread_marks():
                self.save(each)
        self.recordings.sort(key=lambda each: (each.number, each.created_ns))
        self._spread_marks()

    def add(self, manifest: Manifest) -> None:
        """Take in a recording that begins."""
        manifest.number = max((each.number for each in self.recordings), default=0) + 1
        self.recordings.append(manifest)
        self.running = manifest.recording_id

    def save(self, manifest: Manifest) -> None:
        """Write a manifest; what the disk refuses is written with the next one.

        A long one of a recording that runs is written seldom: a kill costs nothing but the look at
        the files that it does not name.
        """
        self._unsaved[manifest.recording_id] = manifest
        for each in list(self._unsaved.values()):
            if each.end_ns is None and self.elapsed_ns() < self._due_ns.get(each.recording_id, 0):
                continue
            try:
                self._write(each)
            except OSError:
                return
            del self._unsaved[each.recording_id]

    def _write(self, manifest: Manifest) -> None:
        """Put a manifest beside its files, or take it away with the last of them. Raises OSError."""
        target = self.path / manifest.file_name
        needed = manifest.segments or manifest.untold or manifest.recording_id == self.running
        if not needed:
            self.disk.remove(target)
            return
        text = manifest.to_json()
        try:
            self.disk.write_text(target, text)
        except OSError:
            if not manifest.untold:
                raise
            # A full disk has no room for a second one, and what was lost would stand nowhere.
            self.disk.overwrite(target, text)
        if len(text) > SHORT_MANIFEST_CHARS:
            pause_ns = len(text) * 1_000_000_000 // MANIFEST_CHARS_PER_S
            self._due_ns[manifest.recording_id] = self.elapsed_ns() + pause_ns

    def unfinished(self) -> Iterator[tuple[Manifest, Segment]]:
        """Segments of earlier recordings that have no end."""
        for manifest in self.recordings:
            for segment in manifest.segments:
                if segment.state == "cut" and manifest.recording_id not in self.busy:
                    yield manifest, segment

    def take_finished(self, recording_id: str, finished: Segment) -> None:
        """Note what became of a cut file that was finished."""
        for manifest in self.recordings:
            for n, segment in enumerate(manifest.segments):
                if (manifest.recording_id, segment.segment) == (recording_id, finished.segment):
                    finished.marks = finished.marks or segment.marks
                    manifest.segments[n] = finished
                    manifest.spread_marks()
                    self.save(manifest)
                    self._spread_marks()

    def keep(self, note: MarkNote) -> None:
        """Mark what a mark keeps of recordings before the one in which it stands."""
        for manifest in self.recordings:
            if note.begin_ns is None or manifest.recording_id in (*self.busy, self.running):
                continue
            changed = False
            for segment in reversed(manifest.segments):
                if segment.end_ns is not None and segment.end_ns < note.begin_ns:
                    break
                if segment.is_kept_by(note) and (segment.start_ns or 0) <= note.t_ns:
                    segment.mark(note)
                    changed = True
            if changed:
                self.save(manifest)

    def kept_until(self, start_ns: int) -> MarkNote | None:
        """The mark of an earlier recording that keeps longest what begins at `start_ns`."""
        notes = [note for each in self.recordings for note in _notes(each)]
        reaching = [each for each in notes if each.t_ns <= start_ns < (each.end_ns or 0)]
        return max(reaching, key=lambda each: each.end_ns or 0, default=None)

    def _spread_marks(self) -> None:
        for manifest in self.recordings:
            for note in set(_notes(manifest)):
                if note.begin_ns is not None and note.begin_ns < manifest.created_ns:
                    self.keep(note)

    def make_room(
        self,
        keep: Keep,
        now_ns: int,
        writing_bytes: int,
        needed_bytes: int = 0,
        ran_ns: int = 0,
    ) -> list[Surplus]:
        """Delete what `keep` does not allow any more; what was deleted."""
        own = [each for each in self.recordings if each.recording_id not in self.busy]
        chosen = surplus(
            own,
            keep,
            now_ns=now_ns,
            writing_bytes=writing_bytes,
            free_bytes=self._free_bytes(),
            needed_bytes=needed_bytes,
            ran_ns=ran_ns,
        )
        deleted = [each for each in chosen if self._delete(each, now_ns)]
        for manifest in {each.manifest.recording_id: each.manifest for each in deleted}.values():
            self.save(manifest)
        return deleted

    def untold(self, buses: Mapping[str, int]) -> list[Gap]:
        """Gaps that recordings of the same buses could not write; `buses`: numbers by name."""
        for manifest in self.recordings:
            if set(manifest.buses) == set(buses) and manifest.recording_id not in self.busy:
                self._telling += [manifest] if manifest.untold else []
                self.pending += [told_of(each, buses) for each in manifest.untold]
        return self.pending

    def told(self) -> None:
        """What `untold` gave stands in a capture now."""
        telling, self._telling, self.pending = self._telling, [], []
        for manifest in telling:
            manifest.untold = []
            self.save(manifest)

    def last_place(self, buses: Iterable[str]) -> tuple[str, int] | None:
        """Recording id and number of the last file of the same buses; None where it is not known."""
        wanted = set(buses)
        for manifest in reversed(self.recordings):
            if set(manifest.buses) == wanted and manifest.recording_id not in self.busy:
                numbers = [each.segment for each in manifest.segments]
                numbers += [each.segment for each in manifest.deletions]
                if numbers:
                    return manifest.recording_id, max(numbers)
        return None

    def last_end_ns(self, buses: Iterable[str]) -> int | None:
        """Until when the last recording of the same buses heard them; None without one."""
        wanted = set(buses)
        for manifest in reversed(self.recordings):
            if set(manifest.buses) == wanted and manifest.recording_id not in self.busy:
                ends = [self._end_ns(segment) for segment in manifest.segments[-2:]]
                known = [end for end in (manifest.end_ns, *ends) if end is not None]
                if known:
                    return max(known)
        return None

    def _end_ns(self, segment: Segment) -> int | None:
        if segment.end_ns is not None:
            return segment.end_ns
        try:
            with (self.path / segment.file).open("rb") as file:
                return RecordFile(file).last_chunk_end_ns()
        except OSError:
            return None

    def _delete(self, chosen: Surplus, now_ns: int) -> bool:
        """Delete a file, if it is still the one that its manifest tells of."""
        path = self.path / chosen.segment.file
        try:
            if path.exists() and not _is_of(path, chosen.manifest):
                chosen.manifest.segments.remove(chosen.segment)
                return False
            self.disk.remove(path)
        except OSError:
            return False
        chosen.manifest.delete(chosen.segment, now_ns, chosen.why)
        return True

    def _free_bytes(self) -> int | None:
        try:
            return self.disk.free_bytes(self.path)
        except OSError:
            return None

    def _reconcile(self, names: set[str]) -> None:
        """Segments as they are on the disk: renamed by the recorder's last step, or gone."""
        for manifest in self.recordings:
            for segment in list(manifest.segments):
                whole = whole_path(Path(segment.file)).name
                if segment.file not in names and whole in names:
                    segment.file = whole
                if segment.file not in names:
                    manifest.segments.remove(segment)
                elif segment.state == "writing":
                    self._look_at(manifest, segment)

    def _look_at(self, manifest: Manifest, segment: Segment) -> None:
        """What became of a segment that was being written when the manifest was."""
        path = self.path / segment.file
        segment.state = "cut"
        with suppress(OSError):
            if is_being_written(path):
                segment.state = "writing"
                self.busy.add(manifest.recording_id)
            elif not is_part(path) and is_whole(path):
                self._describe(segment, path)

    def _adopt(self, files: dict[str, Path]) -> None:
        """Take in own files that no manifest names."""
        named = {segment.file for each in self.recordings for segment in each.segments}
        by_id = {each.recording_id: each for each in self.recordings}
        changed: dict[str, Manifest] = {}
        for name in sorted(files.keys() - named):
            match = _OWN_NAME.fullmatch(name)
            found = _manifest_of(files[name], self.host) if match else None
            if found is None or match is None or found.recording_id != match["id"]:
                continue
            manifest = by_id.setdefault(found.recording_id, found)
            if manifest is found:
                self.recordings.append(found)
            segment = Segment(int(match["segment"] or 0), name)
            manifest.segments.append(segment)
            manifest.segments.sort(key=lambda each: each.segment)
            self._look_at(manifest, segment)
            if segment.state == "cut":
                with suppress(OSError), files[name].open("rb") as file:
                    take_marks(segment, RecordFile(file))
            changed[manifest.recording_id] = manifest
        for manifest in changed.values():
            if manifest.recording_id not in self.busy:
                self.save(manifest)

    def _describe(self, segment: Segment, path: Path) -> None:
        """Take from a whole file what the manifest tells of it."""
        with path.open("rb") as file:
            records = RecordFile(file)
            describe_segment(segment, records)


def strangers_without_end(folder: Path) -> list[Path]:
    """Captures in a folder that were cut off and that no recorder finishes by itself."""
    found = []
    for name, path in sorted(_regular_files(folder).items()):
        with suppress(OSError):
            if name.endswith(SUFFIX) and not _OWN_NAME.fullmatch(name) and not is_whole(path):
                found.append(path)
    return found


def _regular_files(folder: Path) -> dict[str, Path]:
    """Files of a folder by name; whatever else lies there, opening it may wait for ever."""
    found = {}
    with suppress(OSError):
        for path in folder.iterdir():
            with suppress(OSError):
                if path.is_file():
                    found[path.name] = path
    return found


def describe_segment(segment: Segment, records: RecordFile) -> None:
    """Fill in what a whole file's summary tells: times, frames, size, marks."""
    summary = records.summary()
    if summary is None:
        return
    segment.state = "closed"
    segment.bytes = records.size
    counts = summary.statistics
    frame_channels = {each.id for each in summary.channels if each.topic.endswith("/frames")}
    if counts is not None and counts.message_count:
        segment.start_ns, segment.end_ns = counts.message_start_time, counts.message_end_time
        segment.frames = sum(
            number
            for channel, number in counts.channel_message_counts.items()
            if channel in frame_channels
        )
    take_marks(segment, records)


def take_marks(segment: Segment, records: RecordFile) -> None:
    """Take the marks from a file whose manifest tells of none."""
    if segment.marks:
        return
    for record in records.metadata():
        if record.name == MARK_METADATA_NAME:
            segment.mark(_mark_of(record.metadata, segment))


def _notes(manifest: Manifest) -> Iterator[MarkNote]:
    return (note for segment in manifest.segments for note in segment.marks)


def _mark_of(values: Mapping[str, str], segment: Segment) -> MarkNote:
    """The mark of a metadata record; one with damaged numbers keeps its own file."""
    try:
        begin_ns, end_ns = (
            None if text is None else int(text)
            for text in (values.get("begin_ns"), values.get("end_ns"))
        )
        return MarkNote(int(values["t_ns"]), values.get("reason", ""), begin_ns, end_ns)
    except (KeyError, ValueError):
        return MarkNote(segment.start_ns or 0, "marked")


def _read(path: Path) -> Manifest | None:
    try:
        return Manifest.from_json(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        return None


def _manifest_of(path: Path, host: str) -> Manifest | None:
    """What a file tells of its recording; None unless this machine recorded it."""
    try:
        facts = CaptureScan(path).facts
    except OSError:
        return None
    about = facts.metadata
    if about is None or facts.profile != PROFILE or about.host != host:
        return None
    return Manifest(
        recording_id=about.recording_id,
        version=about.version,
        host=about.host,
        source=about.source,
        created_ns=about.created_ns,
        buses=[bus.name for bus in facts.buses],
    )


def _is_of(path: Path, manifest: Manifest) -> bool:
    try:
        about = CaptureScan(path).facts.metadata
    except OSError:
        return False
    if about is None:
        return False
    return (about.recording_id, about.host) == (manifest.recording_id, manifest.host)
