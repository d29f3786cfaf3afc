"""Which copy of a segment is read: the one that gathering took may be the one that is damaged."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from syncline_analyzer.fleet.fetch import fetched
from syncline_analyzer.fleet.recording import File, Recording
from syncline_analyzer.readers import open_capture
from syncline_schemas.batch import FrameBatch
from syncline_schemas.errors import SynclineError
from syncline_schemas.named_tuples import NamedTuple


def with_whole_files(recording: Recording, options: Mapping[str, Any]) -> Recording:
    """The recording, with the copy that holds most in place of each file that is damaged.

    Args:
        recording: only files that have copies are looked at.
        options: of the file systems of the URLs.
    """
    files, copies = list(recording.files), list(recording.copies)
    for at, file in enumerate(files):
        own = [each for each in copies if _moment(each) == _moment(file)]
        best = _best(file, own, options) if own else file
        if best is not file:
            files[at] = best
            copies[copies.index(best)] = file
    return replace(recording, files=tuple(files), copies=tuple(copies))


def _moment(file: File) -> tuple[int, int]:
    return file.segment, file.created_ns


def _best(file: File, copies: list[File], options: Mapping[str, Any]) -> File:
    """The file where it is whole, else the copy with most frames; of equal ones the first."""
    held = {file: _held(file, options)}
    if not held[file].whole:
        held.update((copy, _held(copy, options)) for copy in copies)
    return max(held, key=lambda each: held[each])


class _Held(NamedTuple):
    """What can be read of a file: whole is more, and of damaged ones more frames are."""

    whole: bool
    frames: int


def _held(file: File, options: Mapping[str, Any]) -> _Held:
    try:
        with fetched((file,), options) as found:
            reader = open_capture(found.paths[0])
            frames = sum(len(item) for item in reader.batches() if isinstance(item, FrameBatch))
            return _Held(reader.facts.damage is None, frames)
    except (SynclineError, OSError):
        return _Held(whole=False, frames=0)
