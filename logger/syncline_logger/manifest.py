"""The manifest of a recording: which files it has, which it had, and what is in them."""

import json
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal, Self

SCHEMA = "syncline.recording/1"
SUFFIX = ".json"
KEPT_DELETIONS = 100
"""Deleted files that are named one by one; older ones are only counted."""
KEPT_MARKS = 100
"""Marks of one segment that are named."""

State = Literal["writing", "closed", "cut", "unreadable"]
"""A segment is being written, whole, without its end, or so broken that nothing can be read."""


@dataclass(frozen=True, slots=True)
class MarkNote:
    """A moment that somebody wants to find again."""

    t_ns: int
    reason: str


@dataclass(slots=True)
class Segment:
    """One file of a recording; times are log times of its messages [ns], None in an empty one."""

    segment: int
    file: str
    state: State = "writing"
    start_ns: int | None = None
    end_ns: int | None = None
    frames: int = 0
    bytes: int = 0
    marks: list[MarkNote] = field(default_factory=list)

    def mark(self, note: MarkNote) -> None:
        """Note a mark; a marked segment is never deleted."""
        if len(self.marks) < KEPT_MARKS:
            self.marks.append(note)


@dataclass(frozen=True, slots=True)
class Deletion:
    """A segment that was deleted to make room."""

    segment: int
    file: str
    frames: int
    bytes: int
    deleted_ns: int
    why: str


@dataclass(slots=True)
class Manifest:
    """One recording, as `<recording id>.json` beside its files tells of it.

    Attributes:
        number: counts the recordings of a folder; tells their order even where clocks were wrong.
        end_ns: when it was stopped; None while it runs, or when it was cut off.
        reason: why it ended.
        lost_frames: known to be lost.
        deleted_segments, deleted_frames, deleted_bytes: all that were deleted to make room.
        deletions: the latest of them.
    """

    recording_id: str
    number: int = 0
    version: str = ""
    host: str = ""
    source: str = ""
    created_ns: int = 0
    buses: list[str] = field(default_factory=list)
    end_ns: int | None = None
    reason: str = ""
    lost_frames: int = 0
    deleted_segments: int = 0
    deleted_frames: int = 0
    deleted_bytes: int = 0
    deletions: list[Deletion] = field(default_factory=list)
    segments: list[Segment] = field(default_factory=list)

    @property
    def file_name(self) -> str:
        """Name of the manifest."""
        return f"{self.recording_id}{SUFFIX}"

    def delete(self, segment: Segment, now_ns: int, why: str) -> None:
        """Note that a segment's file is gone."""
        self.segments.remove(segment)
        self.deleted_segments += 1
        self.deleted_frames += segment.frames
        self.deleted_bytes += segment.bytes
        self.deletions.append(
            Deletion(segment.segment, segment.file, segment.frames, segment.bytes, now_ns, why)
        )
        del self.deletions[:-KEPT_DELETIONS]

    def to_json(self) -> str:
        """The manifest as text."""
        return json.dumps({"schema": SCHEMA} | asdict(self), indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Self | None:
        """A manifest from text; None when it is none, or broken."""
        try:
            values = json.loads(text)
            if values.pop("schema") != SCHEMA:
                return None
            return cls(
                **_known(cls, values)
                | {
                    "deletions": [
                        Deletion(**_known(Deletion, each)) for each in values["deletions"]
                    ],
                    "segments": [_segment(each) for each in values["segments"]],
                }
            )
        except (ValueError, TypeError, KeyError, AttributeError):
            return None


def _segment(values: dict[str, Any]) -> Segment:
    marks = [MarkNote(**_known(MarkNote, each)) for each in values.get("marks", [])]
    return Segment(**_known(Segment, values) | {"marks": marks})


def _known(kind: type[Any], values: dict[str, Any]) -> dict[str, Any]:
    """The values that this version knows; a later one may write more."""
    names = {each.name for each in fields(kind)}
    return {name: value for name, value in values.items() if name in names}
