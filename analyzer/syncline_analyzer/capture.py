"""What every reader of captures and logs delivers: batches, gaps, and facts about the file."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Literal, Protocol

from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.adapter_fit import AdapterFit
from syncline_schemas.capture.learned import Settings
from syncline_schemas.capture.mark import Mark
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

TimeBase = Literal["utc", "relative", "none"]
"""Whether stamps are UTC, count from the start of the log, or are not in the log at all."""

MAX_KEPT_LINES = 100
"""Unparsed lines kept with their text; the rest is only counted."""
MAX_UNREAD = 1000
"""Places of unparsed lines that are kept."""


class Unread(NamedTuple):
    """Lines that could not be read between the frames of these stamps; a frame may be in each."""

    start_ns: int
    end_ns: int
    lines: int


@dataclass(slots=True)
class CaptureFacts:
    """What is known of a capture besides its frames; complete when the last batch was read.

    `resolution_ns` is the step of the time stamps, as far as the format or the file tells.
    `damage` says in words what could not be read of a damaged capture. `notes` hold what the
    format could not tell ("remote frames are not marked in this format").
    """

    path: Path
    format: str
    buses: list[str] = field(default_factory=list)
    time_base: TimeBase = "utc"
    resolution_ns: int = 1
    clock: str = "unknown"
    bitrates: dict[str, int] = field(default_factory=dict)
    data_bitrates: dict[str, int] = field(default_factory=dict)
    unparsed_lines: list[tuple[int, str]] = field(default_factory=list)
    unparsed_count: int = 0
    unread: list[Unread] = field(default_factory=list)
    """Where the unparsed lines are, as far as the format tells; the first thousand places."""
    description_toml: str | None = None
    eds_files: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    damage: str | None = None
    learned: Mapping[tuple[int, int], Settings] = field(default_factory=dict)
    """By (bus number, node): what the segments before this one revealed of objects."""
    foreign_errors: set[str] = field(default_factory=set)
    """Buses whose error frames hold no SocketCAN classes, but what another driver puts there."""
    notes: list[str] = field(default_factory=list)
    remote_lost: bool = False
    """Whether remote frames, were there any, are not marked: they stand as empty data frames."""
    marks: list[Mark] = field(default_factory=list)
    """Moments that the recorder marked; of one file at most a thousand."""
    adapter_fits: dict[str, AdapterFit] = field(default_factory=dict)
    """By bus name, of adapters whose own clock stamped the frames."""

    def bus_number(self, name: str) -> int:
        """Number of the bus of this name, which is appended when it is new."""
        if name not in self.buses:
            self.buses.append(name)
        return self.buses.index(name)

    def add_unparsed(self, line_number: int, line: str) -> None:
        """Count a line that could not be read; the first hundred are kept with their text."""
        self.unparsed_count += 1
        if len(self.unparsed_lines) < MAX_KEPT_LINES:
            self.unparsed_lines.append((line_number, line[:200]))

    def add_unread(self, place: Unread) -> None:
        """Note where lines could not be read; those between the same frames are one place."""
        last = self.unread[-1] if self.unread else None
        if last is not None and last[:2] == place[:2]:
            self.unread[-1] = place._replace(lines=last.lines + place.lines)
        elif len(self.unread) < MAX_UNREAD:
            self.unread.append(place)


def time_base(facts: Sequence[CaptureFacts]) -> TimeBase:
    """What the stamps of all files count from, "none" where the files do not agree."""
    bases: set[TimeBase] = {each.time_base for each in facts}
    return bases.pop() if len(bases) == 1 else "none"


class CaptureReader(Protocol):
    """A capture that can be read once, from the first frame to the last."""

    facts: CaptureFacts

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in file order, with a Gap between them where the recorder was blind."""
        ...
