"""The exact worst cases of a quantity, each with the frame that ended it."""

from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import WorstRow
from syncline_schemas.records import dataclass

KEPT = 10
"""Values kept of each end."""

Ints = NDArray[np.int64]


@dataclass(slots=True)
class Largest:
    """The largest keys seen, from the largest on; of equal ones the earliest."""

    key: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    seq: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    t_ns: Ints = field(default_factory=lambda: np.zeros(0, np.int64))

    def takes(self, key: int) -> bool:
        """Whether a key would be one of them."""
        return len(self.key) < KEPT or key > int(self.key[-1])

    def add(self, key: Ints, seq: Ints, t_ns: Ints) -> None:
        """Take in keys in order of `seq`; all (n,)."""
        rows = _largest(key, int(self.key[-1]) if len(self.key) == KEPT else None)
        if not len(rows):
            return
        keys = np.concatenate((self.key, key[rows]))
        order = np.argsort(-keys, kind="stable")[:KEPT]
        self.key = keys[order]
        self.seq = np.concatenate((self.seq, seq[rows]))[order]
        self.t_ns = np.concatenate((self.t_ns, t_ns[rows]))[order]


@dataclass(slots=True)
class Extremes:
    """Both ends of a quantity, or the long one alone."""

    both: bool = True
    longest: Largest = field(default_factory=Largest)
    shortest: Largest = field(default_factory=Largest)

    def add(
        self, value_ns: Ints, seq: Ints, t_ns: Ints, limits: tuple[int, int] | None = None
    ) -> None:
        """Take in values, each with `seq` and stamp of the frame that ended it; all (n,).

        `limits` are the least and the largest of them, where they are known.
        """
        if not len(value_ns):
            return
        low, high = limits or limits_of(value_ns)
        if self.longest.takes(high):
            self.longest.add(value_ns, seq, t_ns)
        if self.both and self.shortest.takes(-low):
            self.shortest.add(-value_ns, seq, t_ns)

    def rows(self, bus: str, cob_id: int, node: int | None, quantity: str) -> list[WorstRow]:
        """The rows of the table, from the worst on."""
        ends: tuple[tuple[Literal["longest", "shortest"], int, Largest], ...] = (
            ("longest", 1, self.longest),
            ("shortest", -1, self.shortest),
        )
        return [
            WorstRow(bus, cob_id, node, quantity, extreme, sign * key / 1000, seq, t_ns)
            for extreme, sign, end in ends
            for key, seq, t_ns in zip(
                end.key.tolist(), end.seq.tolist(), end.t_ns.tolist(), strict=True
            )
        ]


def limits_of(values: Ints) -> tuple[int, int]:
    """The least and the largest of at least one value."""
    return int(np.minimum.reduce(values)), int(np.maximum.reduce(values))


def _largest(key: Ints, above: int | None) -> NDArray[np.intp]:
    """Rows of the largest keys, in order; only those above a limit where there is one."""
    rows = np.arange(len(key)) if above is None else np.flatnonzero(key > above)
    if len(rows) <= KEPT:
        return rows
    limit = np.partition(key[rows], -KEPT)[-KEPT]
    more = rows[key[rows] > limit]
    equal = rows[key[rows] == limit][: KEPT - len(more)]
    return np.sort(np.concatenate((more, equal)))
