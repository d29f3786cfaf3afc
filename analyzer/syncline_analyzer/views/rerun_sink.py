"""Columns into a Rerun recording: the time axes of a capture and chunks of a good size."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from syncline_analyzer.views.words import Clock
from syncline_schemas.records import dataclass

ROWS_PER_CALL = 1 << 16
"""Rows of one chunk; the viewer fetches chunk by chunk and never splits one."""


@dataclass(frozen=True, slots=True)
class Axis:
    """The timelines of a capture."""

    clock: Clock

    @property
    def timelines(self) -> list[str]:
        """Names, the one to open with first."""
        if not self.clock.timed:
            return ["frame"]
        return ["capture", "utc"] if self.clock.dated else ["capture"]

    def columns(self, t_ns: NDArray[np.int64], seq: NDArray[np.int64]) -> list[rr.TimeColumn]:
        """Time columns of rows by their stamps, or by their place where there are no stamps."""
        if not self.clock.timed:
            return [rr.TimeColumn("frame", sequence=seq)]
        since = (t_ns - self.clock.first_ns).view("timedelta64[ns]")
        columns = [rr.TimeColumn("capture", duration=since)]
        if self.clock.dated:
            columns.append(rr.TimeColumn("utc", timestamp=t_ns.view("datetime64[ns]")))
        return columns


@dataclass(frozen=True, slots=True)
class Sink:
    """A recording being written."""

    recording: rr.RecordingStream
    axis: Axis

    def static(self, entity: str, *what: rr.AsComponents) -> None:
        """Log what holds at all times."""
        self.recording.log(entity, *what, static=True)

    def rows(
        self,
        entity: str,
        t_ns: Iterable[int] | NDArray[np.int64],
        seq: Iterable[int] | NDArray[np.int64],
        columns: Callable[[slice], Any],
    ) -> None:
        """Send rows in chunks; `columns` makes the component columns of a slice of rows."""
        stamps, places = _integers(t_ns), _integers(seq)
        if not self.axis.clock.timed and len(places) != len(stamps):
            return
        for start in range(0, len(stamps), ROWS_PER_CALL):
            part = slice(start, start + ROWS_PER_CALL)
            indexes = self.axis.columns(stamps[part], places[part])
            self.recording.send_columns(entity, indexes=indexes, columns=columns(part))


def _integers(values: Iterable[int] | NDArray[np.int64]) -> NDArray[np.int64]:
    if isinstance(values, np.ndarray):
        return values.astype(np.int64, copy=False)
    return np.array(list(values), np.int64)
