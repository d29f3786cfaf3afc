"""When a recording goes on in a new file, and what its files are called."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

SUFFIX = ".mcap"
PART = ".part"
"""Before the suffix of a segment that is being written: any other name is that of a whole file."""
LARGEST_INDEX = 8 << 20
"""The index of a file is kept in memory until it is closed: hours to days of it [bytes]."""


@dataclass(frozen=True, slots=True)
class Split:
    """At which size or full period of UTC a segment ends; None = never for that.

    A `time_ns` of five minutes ends segments at :00, :05, :10 ... of every hour. Whatever is asked
    for, a file whose index is as large as `index_bytes` goes on in a new one: recording takes no
    more memory after weeks than after a day.
    """

    size_bytes: int | None = None
    time_ns: int | None = None
    index_bytes: int = LARGEST_INDEX

    def __bool__(self) -> bool:
        return self.size_bytes is not None or self.time_ns is not None

    def is_full(self, bytes_written: int, chunk_bytes: int, index_bytes: int = 0) -> bool:
        """Whether a segment has no room for a further chunk like the last one."""
        full = self.size_bytes is not None and bytes_written + chunk_bytes > self.size_bytes
        return full or index_bytes >= self.index_bytes

    def ends_after(self, t_ns: int) -> int | None:
        """The next moment at which a segment ends that holds `t_ns`.

        >>> Split(time_ns=300).ends_after(599), Split(time_ns=300).ends_after(600)
        (600, 900)
        """
        return None if self.time_ns is None else (t_ns // self.time_ns + 1) * self.time_ns


@dataclass(frozen=True, slots=True)
class SegmentNames:
    """Paths of a recording's files.

    In a folder a name is UTC start and recording id, of a file that was named by the user it is
    that name; both with the segment's number, which the one file of an unsplit recording lacks.
    """

    target: Path
    recording_id: str
    split: bool = False

    @property
    def folder(self) -> Path:
        """Where the files are."""
        return self.target.parent if self.is_file else self.target

    @property
    def is_file(self) -> bool:
        """Whether the user named a file."""
        return not self.target.is_dir() and self.target.suffix == SUFFIX

    def whole(self, segment: int, start_ns: int) -> Path:
        """The path of a segment that is closed.

        >>> SegmentNames(Path("x.mcap"), "3f2a").whole(0, 0).name
        'x.mcap'
        >>> SegmentNames(Path("captures"), "3f2a", split=True).whole(7, 0).name
        '19700101T000000Z_3f2a_0007.mcap'
        """
        number = f"_{segment:04d}" if self.split or segment else ""
        if self.is_file:
            return self.target.with_name(f"{self.target.stem}{number}{SUFFIX}")
        start = datetime.fromtimestamp(start_ns // 1_000_000_000, UTC)
        return self.target / f"{start:%Y%m%dT%H%M%SZ}_{self.recording_id}{number}{SUFFIX}"

    def written(self, segment: int, start_ns: int) -> Path:
        """The path of a segment while it is being written."""
        path = self.whole(segment, start_ns)
        return path.with_name(f"{path.stem}{PART}{SUFFIX}") if self.split else path


def whole_path(path: Path) -> Path:
    """The path of a file when it is closed.

    >>> whole_path(Path("a_0001.part.mcap")).name, whole_path(Path("a.mcap")).name
    ('a_0001.mcap', 'a.mcap')
    """
    return path.with_name(path.name.removesuffix(PART + SUFFIX) + SUFFIX) if is_part(path) else path


def is_part(path: Path) -> bool:
    """Whether a name says that its file is not closed."""
    return path.name.endswith(PART + SUFFIX)
