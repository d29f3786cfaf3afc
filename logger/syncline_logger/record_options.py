"""How to record."""

from dataclasses import dataclass, field

from syncline_logger.retention import Keep
from syncline_logger.segments import Split
from syncline_logger.triggers.plan import TriggerPlan
from syncline_schemas.capture.chunk import ZSTD_LEVEL
from syncline_schemas.capture.layout import Compression
from syncline_schemas.description import BusDescription


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """How to record; the defaults are right for most.

    Attributes:
        flush_ns: at most this much is lost to a power cut [ns].
        chunk_frames: a chunk is closed earlier when it holds so many frames (about 1 MiB).
        sync: wait for the disk after each chunk; only a simulated recording can do without.
        decode: write decoded channels beside the raw frames.
        description: what is known of the buses and their nodes.
        recording_id: the recording's name; None makes one.
        queue_frames: frames that may wait for the writer, all buses together.
        zstd_level: how hard zstd works; 1 is fast and, for these records, also small.
        split: when the recording goes on in a new file.
        keep: how much of what was recorded may stay in the folder.
        wait_for_bus: begin although a bus cannot be opened yet, and open it when that is possible.
        triggers: which events become marks, and whether only what lies around them is written.
    """

    flush_ns: int = 1_000_000_000
    chunk_frames: int = 1 << 15
    compression: Compression = "zstd"
    sync: bool = True
    decode: bool = True
    description: BusDescription = field(default_factory=BusDescription)
    recording_id: str | None = None
    queue_frames: int = 1 << 17
    wait_for_bus: bool = False
    zstd_level: int = ZSTD_LEVEL
    split: Split = field(default_factory=Split)
    keep: Keep = field(default_factory=Keep)
    triggers: TriggerPlan = field(default_factory=TriggerPlan)

    @property
    def period_ns(self) -> int:
        """How often a chunk is written: a tenth of `flush_ns` is kept for writing it."""
        return self.flush_ns * 9 // 10

    def period_after(self, spent_ns: int) -> int:
        """How soon the next chunk follows one that took so long to write: a slow disk is given work
        earlier, so that `flush_ns` holds for it too.

        >>> options = RecordOptions()
        >>> [options.period_after(ms * 1_000_000) // 1_000_000 for ms in (50, 300, 5000)]
        [900, 700, 500]
        """
        return max(min(self.period_ns, self.flush_ns - spent_ns), self.flush_ns // 2)

    @property
    def file_split(self) -> Split:
        """When a recording goes on in a new file: as is said, or so that a budget can be kept."""
        if self.split or not self.keep.split_bytes:
            return self.split
        return Split(size_bytes=self.keep.split_bytes)
