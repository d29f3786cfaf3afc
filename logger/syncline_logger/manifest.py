"""The manifest of a recording: which files it has, which it had, and what is in them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Self, TypeVar, get_args, get_origin, get_type_hints

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
    """A moment that somebody wants to find again.

    begin_ns: earlier segments that end at this log time or later are kept with it [ns].
    end_ns: later segments that begin before this log time are kept with it [ns].
    """

    t_ns: int
    reason: str
    begin_ns: int | None = None
    end_ns: int | None = None

    def reaches_before(self, other: Self) -> bool:
        """Whether it keeps earlier segments that the other one does not."""
        if self.begin_ns is None or other.begin_ns is None:
            return other.begin_ns is None
        return self.begin_ns < other.begin_ns


@dataclass(slots=True)
class Segment:
    """One file of a recording; times are log times of its messages [ns], None in an empty one.

    ran_ns: how long it was written, by a clock that no setting of the date moves; None where the
    recorder was killed.
    """

    segment: int
    file: str
    state: State = "writing"
    start_ns: int | None = None
    end_ns: int | None = None
    frames: int = 0
    bytes: int = 0
    marks: list[MarkNote] = field(default_factory=list)
    ran_ns: int | None = None

    def mark(self, note: MarkNote) -> None:
        """Note a mark; a marked segment is never deleted."""
        if len(self.marks) < KEPT_MARKS and note not in self.marks:
            self.marks.append(note)

    def is_kept_by(self, note: MarkNote) -> bool:
        """Whether a later mark keeps this segment and nothing else does yet."""
        reaches = note.begin_ns is not None and (self.end_ns or 0) >= note.begin_ns
        return reaches and not self.marks


@dataclass(frozen=True, slots=True)
class Deletion:
    """A segment that was deleted to make room."""

    segment: int
    file: str
    frames: int
    bytes: int
    deleted_ns: int
    why: str


@dataclass(frozen=True, slots=True)
class UntoldGap:
    """A gap that stands in no capture: the disk refused to the end. The next recording tells it.

    bus: its name; None = all buses.
    """

    start_ns: int
    end_ns: int
    reason: str
    lost_frames: int | None = None
    bus: str | None = None


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
        untold: gaps that stand in no capture yet.
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
    untold: list[UntoldGap] = field(default_factory=list)

    @property
    def file_name(self) -> str:
        """Name of the manifest."""
        return f"{self.recording_id}{SUFFIX}"

    def spread_marks(self) -> bool:
        """Mark the earlier segments that a mark keeps; whether there was one without a mark."""
        changed = False
        farthest: MarkNote | None = None
        for segment in sorted(self.segments, key=lambda each: each.segment, reverse=True):
            if farthest is not None and segment.is_kept_by(farthest):
                segment.mark(farthest)
                changed = True
            for note in segment.marks:
                if farthest is None or note.reaches_before(farthest):
                    farthest = note
        return changed

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
        """The manifest as text, a line per segment: there may be tens of thousands."""
        values = {name: getattr(self, name) for name in _OWN_FIELDS}
        head = json.dumps(
            {"schema": SCHEMA}
            | values
            | {"deletions": _rows(self.deletions), "untold": _rows(self.untold)}
        )
        lines = ",\n".join(map(json.dumps, map(_row, self.segments)))
        return f'{head[:-1]},\n"segments": [\n{lines}\n]}}\n'

    @classmethod
    def from_json(cls, text: str) -> Self | None:
        """A manifest from text; None when it is none, or broken in any way."""
        try:
            values = json.loads(text)
            if values.pop("schema") != SCHEMA:
                return None
            segments = [_segment(each) for each in values.pop("segments")]
            deletions = [_made(Deletion, each) for each in values.pop("deletions")]
            untold = [_made(UntoldGap, each) for each in values.pop("untold", [])]
            made = _made(cls, values)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return None
        made.segments, made.deletions, made.untold = segments, deletions, untold
        return made if _is_name(made.recording_id) else None


_OWN_FIELDS = [
    each.name for each in fields(Manifest) if each.name not in ("segments", "deletions", "untold")
]
_ROW_FIELDS = {
    kind: [each.name for each in fields(kind)] for kind in (Segment, Deletion, UntoldGap, MarkNote)
}


def _row(noted: Segment | Deletion | UntoldGap | MarkNote) -> dict[str, Any]:
    """The fields by name, without the copies that `asdict` makes of all that is in them."""
    row = {name: getattr(noted, name) for name in _ROW_FIELDS[type(noted)]}
    if isinstance(noted, Segment):
        row["marks"] = _rows(noted.marks)
    return row


def _rows(
    noted: Sequence[Deletion] | Sequence[MarkNote] | Sequence[UntoldGap],
) -> list[dict[str, Any]]:
    return [_row(each) for each in noted]


def _segment(values: dict[str, Any]) -> Segment:
    marks = [_made(MarkNote, each) for each in values.pop("marks", [])]
    made = _made(Segment, values)
    made.marks = marks
    if not _is_name(made.file):
        raise ValueError(f"{made.file} is no file of the folder")
    return made


def _is_name(text: str) -> bool:
    """Whether a text names something in the folder itself."""
    return text not in ("", ".", "..") and not set(text) & set("/\\:\0")


T = TypeVar("T")


def _made(kind: type[T], values: dict[str, Any]) -> T:
    """An object of the fields that this version knows; a later one may write more.

    Raises TypeError or ValueError where a value is none of the field's type.
    """
    hints = _HINTS[kind]
    known = {name: value for name, value in values.items() if name in hints}
    for name, value in known.items():
        if not _fits(value, hints[name]):
            raise ValueError(f"{name} is {value!r}")
    return kind(**known)


_HINTS: dict[type, dict[str, Any]] = {
    kind: get_type_hints(kind) for kind in (Manifest, Segment, Deletion, UntoldGap, MarkNote)
}


def _fits(value: object, hint: Any) -> bool:
    if get_origin(hint) is list:
        return isinstance(value, list) and all(_fits(each, get_args(hint)[0]) for each in value)
    if get_origin(hint) is Literal:
        return value in get_args(hint)
    allowed = get_args(hint) or (hint,)
    return type(value) in allowed
