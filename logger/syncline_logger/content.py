"""What becomes one chunk of a capture."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_logger.capture_file import Block
from syncline_schemas.batch import FrameBatch


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """Frames with their log times, and other messages by channel; each ascending in log time."""

    frames: FrameBatch
    log_ns: NDArray[np.int64]
    blocks: list[Block] = field(default_factory=list)

    def __bool__(self) -> bool:
        return len(self.frames) > 0 or any(len(block) for _, block in self.blocks)

    @property
    def first_ns(self) -> int:
        """Log time of the first message; only where there is one."""
        return min(int(each[0]) for each in self._times())

    @property
    def last_ns(self) -> int:
        """Log time of the last message; only where there is one."""
        return max(int(each[-1]) for each in self._times())

    def split(self, log_ns: int) -> tuple["Content", "Content"]:
        """What was taken before a log time, and from it on."""
        at = int(np.searchsorted(self.log_ns, log_ns))
        parts = [(spec, *block.split(log_ns)) for spec, block in self.blocks]
        return (
            Content(self.frames[:at], self.log_ns[:at], [(s, b) for s, b, _ in parts if len(b)]),
            Content(self.frames[at:], self.log_ns[at:], [(s, b) for s, _, b in parts if len(b)]),
        )

    def _times(self) -> list[NDArray[np.int64]]:
        times = [self.log_ns, *(block.log_time_ns for _, block in self.blocks)]
        return [each for each in times if len(each)]
