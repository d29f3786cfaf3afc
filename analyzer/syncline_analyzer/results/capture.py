"""The capture as a whole and its gaps."""

from dataclasses import field

from syncline_analyzer.extent import Stretch
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class GapRow:
    """A stretch in which the recorder was blind."""

    start_ns: int
    end_ns: int
    reason: str
    lost_frames: int | None
    bus: str | None = None


@dataclass(frozen=True, slots=True)
class MarkRow:
    """A moment that the recorder marked: a trigger, or somebody's wish; no fault by itself."""

    t_ns: int
    reason: str
    bus: str | None = None
    node: int | None = None


@dataclass(frozen=True, slots=True)
class CaptureRow:
    """The capture as a whole."""

    files: list[str]
    frames: int
    data_frames: int
    remote_frames: int
    error_frames: int
    extended_frames: int
    unparsed_lines: int
    start_utc_ns: int | None
    duration_ns: int
    """What was recorded: without what a step back of the clock makes the stamps tell twice."""
    buses: list[str]
    gaps: list[GapRow]
    first_ns: int = 0
    """Origin of capture time: first stamp of the whole capture, also where only a range was read."""
    time_base: str = "utc"
    resolution_ns: int = 1
    notes: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    """What could not be read of damaged files; empty when all are whole."""
    cut_ns: int | None = None
    """First stamp taken in where only a part of the capture was; capture time stays since `first_ns`."""

    marks: list[MarkRow] = field(default_factory=list)
    remote_lost: bool = False
    """Whether a log of it does not mark remote frames: they stand as empty data frames."""
    stretches: list[Stretch] = field(default_factory=list)
    """From the first to the last stamp between steps back of the clock, in order; empty where it
    was never set back. They make up `duration_ns`."""

    @property
    def begin_ns(self) -> int:
        """First stamp that was taken in."""
        if self.cut_ns is not None:
            return self.cut_ns
        return self.first_ns if self.start_utc_ns is None else self.start_utc_ns

    @property
    def end_ns(self) -> int:
        """Last stamp that was taken in."""
        if self.stretches:
            return max(each.end_ns for each in self.stretches)
        return self.begin_ns + self.duration_ns
