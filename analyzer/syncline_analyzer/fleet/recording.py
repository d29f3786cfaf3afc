"""A recording: the files that a recorder split it into, and what each tells of it."""

from syncline_analyzer.fleet.machine import Source
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class File:
    """A file that may be a capture, and what its head tells of the recording that it is of.

    Attributes:
        recording_id: empty where it tells none; so are `host` and `machine`.
        created_ns: when this segment was begun, 0 where it is not told.
    """

    url: str
    size_bytes: int
    modified_ns: int | None = None
    etag: str | None = None
    recording_id: str = ""
    host: str = ""
    machine: str = ""
    segment: int = 0
    created_ns: int = 0
    sure: bool = True

    @property
    def stamp(self) -> tuple[str, int, str | int | None]:
        """What is different once the file was changed, as far as listing it tells."""
        return self.url, self.size_bytes, self.etag or self.modified_ns


@dataclass(frozen=True, slots=True)
class Recording:
    """Files that are analyzed together as one capture.

    Attributes:
        key: tells it from the others of a source.
        capture_id: empty where it has to be made from the content.
        files: in the order of their segments.
        copies: of the same segments, not read.
        machine: name of the machine.
        machine_source: where that was found.
    """

    key: str
    capture_id: str
    files: tuple[File, ...]
    machine: str
    machine_source: Source
    copies: tuple[File, ...] = ()

    @property
    def size_bytes(self) -> int:
        """Of all files."""
        return sum(file.size_bytes for file in self.files)
