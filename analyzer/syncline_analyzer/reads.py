"""Reads of one object as columns."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.object_history import Known, Value
from syncline_schemas.records import dataclass

_LOW = 0xFFFFFFFF


def raw_of(value: Value) -> int:
    """The low 32 bits of a value, of bytes their first four."""
    number = value if isinstance(value, int) else int.from_bytes(value[:4], "little")
    return number & _LOW


def raw_values(values: NDArray[Any]) -> NDArray[np.int64]:
    """The same of many values: (n,) int64, or objects (bytes)."""
    if values.dtype == object:
        return np.fromiter(map(raw_of, values.tolist()), np.int64, len(values))
    raw: NDArray[np.int64] = values & _LOW
    return raw


@dataclass(frozen=True, slots=True)
class Reads:
    """Reads in order of `seq`: seq, t_ns and raw (the low 32 bits of the value), all (n,) int64."""

    seq: NDArray[np.int64]
    t_ns: NDArray[np.int64]
    raw: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.seq)

    @classmethod
    def of(cls, *known: Known) -> "Reads":
        """Reads that are known one by one."""
        columns = [(each.seq or 0, each.t_ns or 0, raw_of(each.value)) for each in known]
        return cls(*np.array(columns, np.int64).reshape(-1, 3).T)

    @classmethod
    def joined(cls, *parts: "Reads") -> "Reads":
        """All reads of several."""
        seq = np.concatenate([part.seq for part in parts])
        t_ns = np.concatenate([part.t_ns for part in parts])
        raw = np.concatenate([part.raw for part in parts])
        return cls(seq, t_ns, raw).part(np.argsort(seq, kind="stable"))

    def part(self, rows: slice | NDArray[np.intp]) -> "Reads":
        """Some of them."""
        return Reads(self.seq[rows], self.t_ns[rows], self.raw[rows])
