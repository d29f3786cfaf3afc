"""What is in a capture, and whether it is whole."""

from collections.abc import Callable
from dataclasses import field
from pathlib import Path

import numpy as np

from syncline_analyzer.capture import TimeBase
from syncline_analyzer.clock_repair import repair_clocks
from syncline_analyzer.extent import Extent, Stretch
from syncline_analyzer.readers import open_capture
from syncline_analyzer.redaction import Redaction
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.capture.adapter_fit import AdapterFit
from syncline_schemas.capture.mark import Mark
from syncline_schemas.records import dataclass


@dataclass(slots=True)
class CaptureInfo:
    """Facts of one capture.

    Attributes:
        frames: all frames: data, remote and error frames.
        extended_frames, fd_frames: those among them.
        frames_by_bus: in the order of the buses.
        first_ns, last_ns: earliest and latest stamp; None without frames or without times.
        start_utc_ns: `first_ns` where the log has a date.
        steps_back: stamps earlier than the one before.
        stretches: of stamps between steps back of the clock, where it was set back.
        adapter_fits: by bus, how well the adapter's own clock was mapped onto UTC.
        size_bytes: of the file as it is, packed or not.
    """

    path: Path
    format: str
    size_bytes: int
    frames: int = 0
    data_frames: int = 0
    remote_frames: int = 0
    error_frames: int = 0
    extended_frames: int = 0
    fd_frames: int = 0
    frames_by_bus: dict[str, int] = field(default_factory=dict)
    first_ns: int | None = None
    last_ns: int | None = None
    steps_back: int = 0
    stretches: list[Stretch] = field(default_factory=list)
    time_base: TimeBase = "utc"
    resolution_ns: int = 1
    clock: str = "unknown"
    bitrates: dict[str, int] = field(default_factory=dict)
    gaps: list[Gap] = field(default_factory=list)
    gap_count: int = 0
    unparsed_count: int = 0
    unparsed_lines: list[tuple[int, str]] = field(default_factory=list)
    has_description: bool = False
    eds_files: list[str] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    damage: str | None = None
    marks: list[Mark] = field(default_factory=list)
    adapter_fits: dict[str, AdapterFit] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Whether everything in the file could be read."""
        return self.damage is None

    @property
    def duration_ns(self) -> int:
        """What was recorded: from the earliest to the latest stamp, each stretch by itself; 0 without
        times."""
        if self.stretches:
            return sum(each.end_ns - each.start_ns for each in self.stretches)
        if self.first_ns is None or self.last_ns is None:
            return 0
        return self.last_ns - self.first_ns

    @property
    def start_utc_ns(self) -> int | None:
        """The earliest stamp, where the log has a date."""
        return self.first_ns if self.time_base == "utc" else None


MAX_KEPT_GAPS = 1000


def inspect(path: str | Path, progress: Callable[[int], None] | None = None) -> CaptureInfo:
    """Read a capture through and tell what is in it; `progress` is told the frames read so far.

    Raises:
        CaptureError: the file cannot be read, is empty, or is of no known format.
    """
    path = Path(path)
    reader = open_capture(path)
    repair_clocks([reader])
    info = CaptureInfo(path, reader.facts.format, path.stat().st_size)
    counts = np.zeros(256, np.int64)
    previous_ns: int | None = None
    extent = Extent()
    for item in reader.batches():
        if isinstance(item, Gap):
            info.gap_count += 1
            info.gaps += [item] if len(info.gaps) < MAX_KEPT_GAPS else []
        elif len(item):
            counts += np.bincount(item.bus, minlength=256)
            _count(info, item)
            previous_ns = _take_times(info, item, previous_ns)
            extent.update(item)
            if progress:
                progress(info.frames)
    facts = reader.facts
    info.frames_by_bus = {
        name: int(counts[number]) for number, name in enumerate(facts.buses[:256])
    }
    info.time_base, info.resolution_ns, info.clock = (
        facts.time_base,
        facts.resolution_ns,
        facts.clock,
    )
    if info.time_base == "none":
        info.first_ns = info.last_ns = None
    else:
        info.stretches = extent.stretches
    info.bitrates, info.metadata = dict(facts.bitrates), dict(facts.metadata)
    info.unparsed_count, info.unparsed_lines = facts.unparsed_count, list(facts.unparsed_lines)
    info.has_description = facts.description_toml is not None
    info.eds_files = sorted(facts.eds_files)
    info.notes, info.damage = list(facts.notes), facts.damage
    if redaction := Redaction.of_metadata([facts.metadata]):
        info.notes.append(f"the payload of {redaction.text} is redacted: zeros stand there")
    info.marks, info.adapter_fits = list(facts.marks), dict(facts.adapter_fits)
    return info


def _count(info: CaptureInfo, batch: FrameBatch) -> None:
    remote = _marked(batch, FrameFlag.REMOTE)
    error = _marked(batch, FrameFlag.ERROR)
    info.frames += len(batch)
    info.remote_frames += remote
    info.error_frames += error
    info.data_frames += len(batch) - remote - error
    info.extended_frames += _marked(batch, FrameFlag.EXTENDED)
    info.fd_frames += _marked(batch, FrameFlag.FD)


def _marked(batch: FrameBatch, flag: FrameFlag) -> int:
    return int(np.count_nonzero(batch.flags & flag))


def _take_times(info: CaptureInfo, batch: FrameBatch, previous_ns: int | None) -> int:
    t_ns = batch.t_ns
    first, last = int(t_ns.min()), int(t_ns.max())
    info.first_ns = first if info.first_ns is None else min(info.first_ns, first)
    info.last_ns = last if info.last_ns is None else max(info.last_ns, last)
    info.steps_back += int(np.count_nonzero(np.diff(t_ns) < 0))
    info.steps_back += previous_ns is not None and int(t_ns[0]) < previous_ns
    return int(t_ns[-1])
