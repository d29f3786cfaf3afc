"""Whether 16 and 32 bits of one angle tell the same: they must agree modulo 65536."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.angle.samples import SDO_SOURCE, Key, Samples
from syncline_schemas.measurement import count_steps
from syncline_schemas.records import dataclass

WIDE = 0x100 << 8
"""From the object of 16 bits to that of the same axis in 32 bits (CiA 410)."""
NEAR_NS = 100_000_000
"""Samples no further apart than this are compared."""
SLACK_COUNTS = 3
LEAST = 16
LEAST_NS = 1_000_000_000
"""So many samples in a row, over so long, must differ."""
_ALL = 1 << 16

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Disagreement:
    """Since `seq` the two differ by `counts` (the shortest way modulo 65536)."""

    seq: int
    t_ns: int
    counts: int
    raw: tuple[int, int]


@dataclass(slots=True)
class Agreement:
    """Compares both objects of an axis from block to block."""

    _begun: Disagreement | None = None
    _count: int = 0
    _told: bool = False

    def compare(self, narrow: Samples, wide: Samples) -> list[Disagreement]:
        """Stretches that became long enough to be sure; PDOs only, for reads are too seldom."""
        one, two = _sent(narrow), _sent(wide)
        if not len(one.seq) or len(two.seq) < 2:
            return []
        at = np.clip(np.searchsorted(two.t_ns, one.t_ns), 1, len(two.t_ns) - 1)
        earlier = one.t_ns - two.t_ns[at - 1] < two.t_ns[at] - one.t_ns
        near = np.where(earlier, at - 1, at)
        away = _modulo(one.raw - two.raw[near])
        step = np.abs(_modulo(np.diff(two.raw)))
        # What moves between two samples may be in the one and not yet in the other.
        moving = np.maximum.reduce(
            [np.append(step, 0)[near], np.append(0, step)[near], np.abs(_steps(one.raw))]
        )
        good = np.abs(one.t_ns - two.t_ns[near]) <= NEAR_NS
        bad = good & (np.abs(away) > SLACK_COUNTS + 3 * moving)
        return self._runs(one, two.raw[near], away, bad)

    def _runs(
        self, one: Samples, other: Integers, away: Integers, bad: NDArray[np.bool_]
    ) -> list[Disagreement]:
        found: list[Disagreement] = []
        edges = np.flatnonzero(np.diff(bad)) + 1
        for rows in np.split(np.arange(len(bad)), edges):
            if not bad[rows[0]]:
                self._begun, self._count, self._told = None, 0, False
                continue
            first, last = int(rows[0]), int(rows[-1])
            self._count += len(rows)
            if self._begun is None:
                middle = int(np.median(away[rows]))
                raw = int(one.raw[first]), int(other[first])
                self._begun = Disagreement(int(one.seq[first]), int(one.t_ns[first]), middle, raw)
            lasted_ns = int(one.t_ns[last]) - self._begun.t_ns
            if not self._told and self._count >= LEAST and lasted_ns >= LEAST_NS:
                self._told = True
                found.append(self._begun)
        return found


class Agreements:
    """All axes that are sent in both widths."""

    def __init__(self) -> None:
        self._pairs: dict[Key, Agreement] = {}

    def compare(self, found: Mapping[Key, Samples]) -> dict[Key, list[Disagreement]]:
        """What disagrees in a block, by the key of the 16-bit object."""
        told: dict[Key, list[Disagreement]] = {}
        for key, narrow in found.items():
            wide = found.get((key[0], key[1], key[2] + WIDE))
            if wide is not None and (narrow.entry.bits, wide.entry.bits) == (16, 32):
                pair = self._pairs.setdefault(key, Agreement())
                told[key] = pair.compare(narrow, wide)
        return told


def _sent(samples: Samples) -> Samples:
    """The samples of PDOs that tell something, but for those whose stamps go back."""
    keep = samples.told & (samples.source != SDO_SOURCE)
    keep &= samples.t_ns >= np.maximum.accumulate(samples.t_ns)
    rows = np.flatnonzero(keep)
    return Samples(
        samples.entry,
        samples.seq[rows],
        samples.t_ns[rows],
        samples.raw[rows],
        samples.valid[rows],
        samples.source[rows],
    )


def _steps(raw: Integers) -> Integers:
    return count_steps(np.concatenate((raw[:1], raw)), _ALL)


def _modulo(away: Integers) -> Integers:
    """The shortest way modulo 65536."""
    short: Integers = (away + _ALL // 2) % _ALL - _ALL // 2
    return short
