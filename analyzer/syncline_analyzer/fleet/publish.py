"""Making captures stand in a data set, whole, and taking old ones away.

In a folder a capture is written beside (`.staging`), and appears by one rename. An object store has
no rename: there its `captures.parquet` is written last and removed first.
"""

import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from syncline_analyzer.fleet.captures import CaptureEntry
from syncline_analyzer.fleet.layout import CAPTURES_FILE, STAGING, Partition
from syncline_analyzer.fleet.storage import Storage

_TRIES = 20
"""Twins of a task, after a scheduler was lost, may publish the same capture at the same time."""
_RETIRED = "retired"
"""In place of the name of a run: what is on its way out."""
_ABANDONED_S = 7 * 86_400
"""A run stages something with every capture that it does; none takes a week."""


def standing(storage: Storage, partition: Partition) -> CaptureEntry | None:
    """The entry of a capture that stands at a place."""
    content = storage.read(f"{partition.folder}/{CAPTURES_FILE}")
    return None if content is None else CaptureEntry.of_bytes(content, partition)


def publish(storage: Storage, staged: Path, entry: CaptureEntry) -> None:
    """Make a capture stand; one that stands at its place goes.

    Args:
        staged: folder with its tables and nothing else, made by `staging`.
    """
    (staged / CAPTURES_FILE).write_bytes(entry.to_bytes())
    put(storage, staged, entry.partition.folder)


def put(storage: Storage, staged: Path, place: str) -> None:
    """Make a staged folder with a `captures.parquet` stand at a place; what stands there goes."""
    if storage.local:
        _rename(storage, staged, place)
        return
    take_away(storage, place)
    paths = sorted(staged.glob("*.parquet"), key=lambda path: path.name == CAPTURES_FILE)
    for path in paths:
        storage.fs.put_file(str(path), storage.path(f"{place}/{path.name}"))


def refresh(storage: Storage, entry: CaptureEntry) -> None:
    """Write the row of a capture that stands anew; its tables stay."""
    storage.write(f"{entry.partition.folder}/{CAPTURES_FILE}", entry.to_bytes())


def take_away(storage: Storage, place: str) -> None:
    """Take a folder away: out of sight at once, then what it held."""
    if not storage.local:
        storage.remove(f"{place}/{CAPTURES_FILE}")
        for relative in storage.files(place):
            storage.remove(relative)
        return
    folder = storage.folder(place)
    away = _new_folder(storage, _RETIRED)
    with suppress(FileNotFoundError):
        folder.rename(away / "capture")
    _remove_retired(away)
    _remove_empty(storage, folder.parent)


def put_beside(storage: Storage, made: Path, relative: str) -> None:
    """Put a file that was made, a report or a recording, at its place."""
    if not storage.local:
        storage.fs.put_file(str(made), storage.path(relative))
        return
    target = storage.folder(relative)
    target.parent.mkdir(parents=True, exist_ok=True)
    made.replace(target)


@contextmanager
def staging(storage: Storage, run: str) -> Iterator[Path]:
    """A new folder for the tables of a capture of a run, where nobody reads.

    Beside a data set that has folders, so that a rename makes it stand.
    """
    if not storage.local:
        with TemporaryDirectory(prefix="syncline-fleet-", ignore_cleanup_errors=True) as name:
            yield Path(name)
        return
    staged = _new_folder(storage, run)
    try:
        yield staged
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def _new_folder(storage: Storage, run: str) -> Path:
    folder = storage.folder(f"{STAGING}/{run}/{uuid.uuid4().hex}")
    folder.mkdir(parents=True)
    return folder


def remove_staging(storage: Storage, run: str) -> None:
    """Remove what a run left beside the data set, and what runs left that were killed."""
    if storage.local:
        for each in (run, *_abandoned(storage)):
            shutil.rmtree(storage.folder(f"{STAGING}/{each}"), ignore_errors=True)
        with suppress(OSError):
            storage.folder(STAGING).rmdir()


def _abandoned(storage: Storage) -> list[str]:
    """Runs that have put nothing beside the data set for so long that they cannot go on."""
    oldest_s = time.time() - _ABANDONED_S
    with suppress(FileNotFoundError):
        return [
            each.name
            for each in storage.folder(STAGING).iterdir()
            if each.stat().st_mtime < oldest_s
        ]
    return []


def _rename(storage: Storage, staged: Path, place: str) -> None:
    target = storage.folder(place)
    for left in reversed(range(_TRIES)):
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            if target.exists():
                away = _new_folder(storage, _RETIRED)
                target.rename(away / "capture")
                _remove_retired(away)
            staged.rename(target)
        except OSError:
            # Somebody else put its own there, or took the empty folder above away.
            if not left:
                raise
        else:
            return


def _remove_retired(away: Path) -> None:
    """Remove what was taken out of sight, and the folders around it where no other run uses them."""
    shutil.rmtree(away, ignore_errors=True)
    with suppress(OSError):
        away.parent.rmdir()
        away.parent.parent.rmdir()


def _remove_empty(storage: Storage, folder: Path) -> None:
    """Remove folders that hold nothing any more, up to the root."""
    root = storage.folder()
    with suppress(OSError):
        while folder != root and root in folder.parents:
            folder.rmdir()
            folder = folder.parent
