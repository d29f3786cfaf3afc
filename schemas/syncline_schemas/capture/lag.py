"""How far `log_time` runs behind `t`: tells a reader of a time range which chunks to look in."""

from collections.abc import Mapping
from typing import Self

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class LagBounds:
    """Smallest and largest `log_time - t` of the frames of a file."""

    min_ns: int
    max_ns: int

    def to_record(self) -> dict[str, str]:
        """Keys of the metadata record at the end of a capture."""
        return {"min_lag_ns": str(self.min_ns), "max_lag_ns": str(self.max_ns)}

    @classmethod
    def from_record(cls, record: Mapping[str, str]) -> Self | None:
        """The bounds in a metadata record; None when it has none."""
        try:
            return cls(int(record["min_lag_ns"]), int(record["max_lag_ns"]))
        except (KeyError, ValueError):
            return None

    @classmethod
    def widened(
        cls, bounds: Self | None, log_time_ns: NDArray[np.int64], t_ns: NDArray[np.int64]
    ) -> Self | None:
        """The bounds with further frames taken in."""
        if len(t_ns) == 0:
            return bounds
        lag = log_time_ns - t_ns
        low, high = int(lag.min()), int(lag.max())
        if bounds is None:
            return cls(low, high)
        return cls(min(low, bounds.min_ns), max(high, bounds.max_ns))
