"""Segments of one recording as one capture: what the recorder split is whole again."""

from collections.abc import Iterator, Sequence

from syncline_analyzer.capture import CaptureFacts, CaptureReader
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.layout import FOLLOWS_KEY

Place = tuple[str, int]
"""Recording id and segment number."""


class SegmentChain:
    """Segments of one recording, in their order; a Gap where some between them are not there."""

    def __init__(self, segments: Sequence[tuple[int, CaptureReader]]) -> None:
        self._segments = segments
        self.facts: CaptureFacts = segments[0][1].facts
        self.last = segments[-1][1]

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches of all segments, without anything between those that follow each other."""
        last_ns, expected = None, self._segments[0][0]
        for number, reader in self._segments:
            missing = 0 if _follows(reader) == expected - 1 else number - expected
            for item in reader.batches():
                start_ns = _start_ns(item)
                if missing and start_ns is not None and last_ns is not None and last_ns < start_ns:
                    yield Gap(last_ns, start_ns, _missing(expected, number))
                    missing = 0
                yield item
                if isinstance(item, FrameBatch) and len(item):
                    last_ns = int(item.t_ns[-1])
            expected = number + 1


def _missing(first: int, until: int) -> str:
    if until - first == 1:
        return f"segment {first} of the recording is missing"
    return f"segments {first} to {until - 1} of the recording are missing"


def chained(readers: Sequence[CaptureReader]) -> list[CaptureReader]:
    """The readers, with those of one recording's segments joined; the order of the first stays.

    Files that hold the same segment twice (a copy, a repaired one) stay apart.
    """
    places = [_place(reader) for reader in readers]
    doubled = {place for place in places if place and places.count(place) > 1}
    chains: dict[str, list[tuple[int, CaptureReader]]] = {}
    for place, reader in zip(places, readers, strict=True):
        if place and place not in doubled:
            chains.setdefault(place[0], []).append((place[1], reader))
    joined = {recording: sorted(found, key=_number) for recording, found in chains.items()}
    result: list[CaptureReader] = []
    for place, reader in zip(places, readers, strict=True):
        if not place or place in doubled:
            result.append(reader)
        elif reader is joined[place[0]][0][1]:
            found = joined[place[0]]
            result.append(SegmentChain(found) if len(found) > 1 else reader)
    return result


def in_segment_order(readers: Sequence[CaptureReader]) -> list[CaptureReader]:
    """The readers with the segments of each recording in their order, at the recording's place."""
    places = [_place(reader) for reader in readers]
    firsts: dict[str, int] = {}
    keys = []
    for at, place in enumerate(places):
        recording, number = place or (f"\0{at}", 0)
        keys.append((firsts.setdefault(recording, at), number, at))
    return [readers[at] for _, _, at in sorted(keys)]


def _start_ns(item: FrameBatch | Gap) -> int | None:
    if isinstance(item, Gap):
        return item.start_ns
    return int(item.t_ns[0]) if len(item) else None


def last_place(reader: CaptureReader) -> str:
    """Id and number of the last segment that a reader reads, `3f2a/12`; empty where none is said."""
    last = reader.last if isinstance(reader, SegmentChain) else reader
    place = _place(last)
    return f"{place[0]}/{place[1]}" if place else ""


def _follows(reader: CaptureReader) -> int | None:
    """The segment before this one, as the file says where numbers between were never used."""
    number = reader.facts.metadata.get(FOLLOWS_KEY, "")
    return int(number) if number.isdecimal() else None


def _number(segment: tuple[int, CaptureReader]) -> int:
    return segment[0]


def _place(reader: CaptureReader) -> Place | None:
    metadata = reader.facts.metadata
    recording, number = metadata.get("recording_id", ""), metadata.get("segment", "")
    return (recording, int(number)) if recording and number.isdecimal() else None
