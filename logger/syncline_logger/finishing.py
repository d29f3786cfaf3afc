"""Making regular files of the cut ones that a killed recorder left, beside the recording."""

import os
import threading
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue

from syncline_logger.disk import Disk, is_being_written
from syncline_logger.manifest import Segment
from syncline_logger.recording_folder import RECOVERING, describe_segment
from syncline_logger.segments import whole_path
from syncline_schemas.capture.record_file import RecordFile
from syncline_schemas.capture.recover import is_whole, recover
from syncline_schemas.errors import SynclineError

DAMAGED = ".damaged"
"""Ending of an original that is kept because something inside it could not be read."""


@dataclass(frozen=True, slots=True)
class Finished:
    """What became of a cut file; `segment` tells of the file as it is now."""

    recording_id: str
    segment: Segment
    text: str


def finish_file(
    recording_id: str, segment: Segment, folder: Path, disk: Disk, reserve_bytes: int = 0
) -> Finished:
    """Give a cut file its end, in its place; never raises.

    The regular file is made beside the cut one and takes its place when it is on the disk. What
    holds nothing that can be read is left as it is.
    """
    path = folder / segment.file
    after = replace(segment, state="cut", marks=list(segment.marks))
    try:
        if is_being_written(path):
            return Finished(
                recording_id, after, f"{path.name} is being written by another recorder"
            )
        if segment.bytes:
            # The last chunk, which the disk did not confirm, was written again elsewhere.
            _cut_off(path, segment.bytes)
        text = _finish(path, disk, reserve_bytes)
        whole = whole_path(path)
        if whole.exists():
            after.file = whole.name
            with whole.open("rb") as file:
                describe_segment(after, RecordFile(file))
        return Finished(recording_id, after, text)
    except SynclineError as error:
        after.state = "unreadable"
        return Finished(recording_id, after, f"{path.name} is left as it is: {error}")
    except Exception as error:  # noqa: BLE001 - a broken file must not cost the recording
        return Finished(recording_id, after, f"{path.name} is left as it is: {error}")


def _cut_off(path: Path, size: int) -> None:
    if path.stat().st_size > size:
        os.truncate(path, size)


def _finish(path: Path, disk: Disk, reserve_bytes: int) -> str:
    whole = whole_path(path)
    if is_whole(path):
        if whole != path:
            disk.replace(path, whole)
        return ""
    free_bytes = disk.free_bytes(path.parent)
    if free_bytes < path.stat().st_size + reserve_bytes:
        return f"{path.name} has no end, and there is no room to write it anew"
    made = path.with_name(path.name + RECOVERING)
    try:
        result = recover(path, made)
        if result.lost_chunks > 1:
            disk.replace(path, path.with_name(path.name + DAMAGED))
        disk.replace(made, whole)
        if whole != path:
            disk.remove(path)
    finally:
        with suppress(OSError):
            disk.remove(made)
    lost = "" if result.lost_chunks <= 1 else f"; the original is kept as {path.name}{DAMAGED}"
    return f"{whole.name} was cut off and is finished now, {result.frames} frames{lost}"


class Finisher:
    """Finishes cut files one after the other in a thread of its own."""

    def __init__(self, folder: Path, disk: Disk, reserve_bytes: int = 0) -> None:
        self._folder = folder
        self._disk = disk
        self._reserve_bytes = reserve_bytes
        self._tasks: SimpleQueue[tuple[str, Segment] | None] = SimpleQueue()
        self._done: SimpleQueue[Finished] = SimpleQueue()
        self._thread: threading.Thread | None = None

    def add(self, tasks: Iterable[tuple[str, Segment]]) -> None:
        """Queue cut segments, each with its recording's id."""
        for task in tasks:
            self._tasks.put(task)
            if self._thread is None:
                self._thread = threading.Thread(
                    target=self._run, name="syncline finish", daemon=True
                )
                self._thread.start()

    def done(self) -> list[Finished]:
        """What was finished since the last call."""
        found = []
        with suppress(Empty):
            while True:
                found.append(self._done.get_nowait())
        return found

    def close(self, wait_s: float) -> list[Finished]:
        """Wait for what is still being finished; a file that is not stays cut until the next start."""
        if self._thread is not None:
            self._tasks.put(None)
            self._thread.join(wait_s)
        return self.done()

    def _run(self) -> None:
        while (task := self._tasks.get()) is not None:
            recording_id, segment = task
            self._done.put(
                finish_file(recording_id, segment, self._folder, self._disk, self._reserve_bytes)
            )
