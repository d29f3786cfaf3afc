"""What every log writer has in common: frames in, and a count of what the format cannot hold."""

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping
from dataclasses import field
from typing import BinaryIO

import numpy as np

from syncline_analyzer.writers.formats import BUS_NAMES, GAPS, MARKS
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.capture.adapter_fit import AdapterFit
from syncline_schemas.capture.learned import Settings
from syncline_schemas.capture.mark import Mark
from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class Survey:
    """What has to be known of a capture before its first frame is written.

    Attributes:
        buses: names by number.
        bitrates, data_bitrates: bit/s by bus name, where known.
        first_ns: the earliest stamp, which need not be the first frame's.
        whole_us: whether all stamps are whole microseconds.
        time_base, clock, resolution_ns: as in `CaptureFacts`.
        source: what was converted, in words.
        marks: of the recorder, their buses as numbered here.
        redacted: identifiers whose payload is redacted, as `Redaction.text` has them.
        foreign_errors: buses whose error frames hold another driver's bytes.
        learned: by (bus as numbered here, node): what segments before the first file revealed.
        adapter_fits: by bus name, of adapters with a clock of their own.
    """

    buses: tuple[str, ...]
    bitrates: dict[str, int]
    data_bitrates: dict[str, int]
    frames: int
    first_ns: int
    whole_us: bool
    time_base: str
    clock: str
    resolution_ns: int
    source: str
    marks: tuple[Mark, ...] = ()
    redacted: str = ""
    foreign_errors: frozenset[str] = frozenset()
    learned: Mapping[tuple[int, int], Settings] = field(default_factory=dict)
    adapter_fits: Mapping[str, AdapterFit] = field(default_factory=dict)

    @property
    def origin_ns(self) -> int:
        """What stamps count from: the earliest one, or 0 where they are no dates and count already."""
        return self.first_ns if self.time_base == "utc" else min(self.first_ns, 0)


class LogWriter(ABC):
    """Writes one log; `lost` counts by kind what the format could not hold."""

    def __init__(self, stream: BinaryIO, survey: Survey) -> None:
        self.lost: Counter[str] = Counter()
        self._stream = stream
        self._survey = survey

    @abstractmethod
    def write(self, batch: FrameBatch) -> None:
        """Write frames."""

    def gap(self, gap: Gap) -> None:
        """Write that the recorder was blind; most formats have no word for it."""
        self.lost[GAPS] += 1

    def close(self) -> None:  # noqa: B027  most formats have nothing there
        """Write what belongs at the end; the stream stays open."""

    def _count_bus_names(self) -> None:
        """For formats that number their buses from 1."""
        numbers = (str(number + 1) for number in range(len(self._survey.buses)))
        renamed = sum(a != b for a, b in zip(self._survey.buses, numbers, strict=True))
        if renamed:
            self.lost[BUS_NAMES] += renamed

    def _plain_names(self, forbidden: re.Pattern[str]) -> list[bytes]:
        """Names of the buses, `_` for what a format cannot have in them; the changed are counted."""
        names = [forbidden.sub("_", name) or "_" for name in self._survey.buses]
        changed = sum(a != b for a, b in zip(names, self._survey.buses, strict=True))
        if changed:
            self.lost[BUS_NAMES] += changed
        return [name.encode("utf-8", "replace") for name in names]

    def _count_flag(self, batch: FrameBatch, flag: FrameFlag, what: str) -> None:
        marked = int(np.count_nonzero(batch.flags & flag))
        if marked:
            self.lost[what] += marked

    def _count_marks(self, batch: FrameBatch) -> None:
        self._count_flag(batch, FrameFlag.DLC_INVALID, MARKS)
