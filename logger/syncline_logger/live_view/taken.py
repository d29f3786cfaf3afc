"""What the recorder hands to the live view."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.description import BusDescription


class Heard(NamedTuple):
    """A bus was heard without a gap in [begin_ns, end_ns) of log time."""

    bus: int
    begin_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """Frames that the recorder took in.

    Attributes:
        frames: of all buses, in arrival order.
        log_ns: (n,) int64, when each was taken; never decreasing.
        heard: since when each bus is heard, and until when.
    """

    frames: FrameBatch
    log_ns: NDArray[np.int64]
    heard: tuple[Heard, ...] = ()


@dataclass(frozen=True, slots=True)
class Begun:
    """First of all: what is recorded."""

    start_ns: int
    buses: tuple[BusInfo, ...]
    description_toml: str
    files: dict[str, bytes]

    @property
    def description(self) -> BusDescription:
        """The bus description, read again."""
        if not self.description_toml:
            return BusDescription()
        return BusDescription.loads(self.description_toml, files=self.files)
