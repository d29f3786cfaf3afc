"""Captures whose clocks went differently: files of a session moved in time, or given a date."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from syncline_analyzer.capture import CaptureReader
from syncline_analyzer.clock_repair import repair_clocks
from syncline_analyzer.moments import parse_moment
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

_SECONDS = re.compile(r"(?P<sign>[+-]?)(?P<whole>\d{1,9})(?:\.(?P<part>\d{1,9}))?s?")
_SIGNED = re.compile(r"(?P<sign>[+-])(?P<length>.+)")
_SECOND_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Offset:
    """By how much stamps move [ns]; or, when `dated`, the UTC time of the first frame [ns]."""

    ns: int
    dated: bool = False


def parse_offset(text: str) -> Offset:
    """An offset from "+3600", "-2.5", "+2h30m", or a time such as "2026-03-01T12:00:00Z".

    >>> parse_offset("-2.5"), parse_offset("+1h")
    (Offset(ns=-2500000000, dated=False), Offset(ns=3600000000000, dated=False))

    Raises:
        UsageError: the text is none of these.
    """
    text = text.strip()
    if found := _SECONDS.fullmatch(text):
        ns = int(found["whole"]) * _SECOND_NS + int((found["part"] or "").ljust(9, "0"))
        return Offset(-ns if found["sign"] == "-" else ns)
    signed = _SIGNED.fullmatch(text)
    try:
        moment = parse_moment(signed["length"] if signed else text)
    except UsageError:
        moment = None
    of_day = moment is not None and moment.relative and ":" in text
    if moment is None or of_day or (signed and not moment.relative):
        raise UsageError(
            f"{text!r} is no offset: write seconds such as +3600 or -2.5, or when the first frame"
            " was recorded, such as 2026-03-01T12:00:00Z"
        )
    ns = -moment.ns if signed and signed["sign"] == "-" else moment.ns
    return Offset(ns, dated=not moment.relative)


class ShiftedReader:
    """A capture all of whose stamps are moved, those of its gaps and marks as well."""

    def __init__(self, reader: CaptureReader, offset: Offset) -> None:
        self.facts = reader.facts
        self._reader = reader
        self._offset = offset
        self._by_ns: int | None = None if offset.dated else offset.ns

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in file order, with a Gap between them where the recorder was blind."""
        waiting: list[Gap] = []
        self._tell()
        for item in self._reader.batches():
            if self.facts.time_base == "none":
                raise UsageError(f"{self.facts.path}: has no times, so they cannot be moved")
            if self._offset.dated:
                self.facts.time_base = "utc"
            if self._by_ns is None:
                if isinstance(item, Gap) or not len(item):
                    waiting += [item] if isinstance(item, Gap) else []
                    continue
                self._by_ns = self._offset.ns - int(item.t_ns[0])
                self._tell()
                yield from (self._moved(gap) for gap in waiting)
            yield self._moved(item)
        by_ns = self._by_ns or 0
        facts = self.facts
        facts.marks = [replace(mark, t_ns=mark.t_ns + by_ns) for mark in facts.marks]
        facts.unread = [
            place._replace(start_ns=place.start_ns + by_ns, end_ns=place.end_ns + by_ns)
            for place in facts.unread
        ]

    def _moved(self, item: FrameBatch | Gap) -> FrameBatch | Gap:
        by_ns = self._by_ns or 0
        if isinstance(item, Gap):
            return replace(item, start_ns=item.start_ns + by_ns, end_ns=item.end_ns + by_ns)
        return replace(item, t_ns=item.t_ns + by_ns)

    def _tell(self) -> None:
        if self._by_ns is None:
            return
        by_s = f"{self._by_ns / _SECOND_NS:+.6f}".rstrip("0").rstrip(".")
        note = f"its times were moved by {by_s} s as --offset says"
        if note not in self.facts.notes:
            self.facts.notes.append(note)


def shifted(readers: Sequence[CaptureReader], offsets: Mapping[str, str]) -> list[CaptureReader]:
    """The readers, those of the files named moved in time; before the first batch.

    offsets: as `parse_offset` takes them, by path or name of the file.

    Raises:
        UsageError: a name is none of the files, or of several; or an offset makes no sense.
    """
    if not offsets:
        return list(readers)
    repair_clocks(readers)
    paths = [reader.facts.path for reader in readers]
    moved = {_place(name, paths): parse_offset(text) for name, text in offsets.items()}
    return [
        ShiftedReader(reader, moved[place]) if place in moved else reader
        for place, reader in enumerate(readers)
    ]


def _place(name: str, paths: Sequence[Path]) -> int:
    exact = [place for place, path in enumerate(paths) if path == Path(name)]
    found = exact or [place for place, path in enumerate(paths) if path.name == name]
    if len(found) != 1:
        told = ", ".join(str(path) for path in paths)
        what = "is none of the captures" if not found else "is the name of several captures"
        raise UsageError(f"--offset {name}: {what}; they are {told}")
    return found[0]
