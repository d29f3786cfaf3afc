"""Damaged lines of a serial adapter, told together: one loss a second however many there are."""

from dataclasses import dataclass

from syncline_logger.batcher import FrameBuffer

TOGETHER_NS = 1_000_000_000
"""Damage is held back for so long, and told as one loss from its first place to its last [ns]."""


@dataclass(slots=True)
class DamagedLines:
    """The damage of one bus that is not told yet.

    Attributes:
        frames: frames that were in the lines.
        first_ns, last_ns: none was damaged before or after these log times [ns].
    """

    frames: int = 0
    first_ns: int = 0
    last_ns: int = 0

    def add(self, frames: int, first_ns: int, last_ns: int) -> None:
        """Note damage between two times; later damage is never earlier than what was noted."""
        if not self.frames:
            self.first_ns = first_ns
        self.frames += frames
        self.last_ns = last_ns

    def tell(self, buffer: FrameBuffer, bus: int, now_ns: int | None = None) -> None:
        """Put what was held back for long enough into the buffer; all of it without `now_ns`."""
        if self.frames and (now_ns is None or now_ns - self.first_ns >= TOGETHER_NS):
            buffer.lose(bus, self.frames, "line", self.first_ns, self.last_ns)
            self.frames = 0
