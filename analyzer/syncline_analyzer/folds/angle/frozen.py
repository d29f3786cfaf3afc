"""Samples that stand still while the same quantity, sent another way, moves."""

from collections.abc import Callable, Hashable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.angle.samples import SDO_SOURCE, Key, Samples
from syncline_schemas.records import dataclass

LEAST = 50
"""Equal samples in a row from which on a value counts as frozen."""
LEAST_NS = 1_000_000_000
MOVED = 20
"""Counts that the other source must have moved meanwhile."""
VALUES = 10
"""Different values that it must have shown: a single step may be a matter of a moment."""


@dataclass(frozen=True, slots=True)
class _Way:
    """One way in which a quantity is sent: an object in one PDO, where it holds the value whole."""

    key: Key
    source: int
    rows: NDArray[np.intp]


def with_frozen(
    found: Mapping[Key, Samples], quantity: Callable[[Key], Hashable]
) -> dict[Key, Samples]:
    """The samples of a block with `frozen` set where a sibling of the same quantity moves.

    A sibling is the same object in another PDO, or the same axis in another width. Standstill
    makes all of them stand, and a repeat counter sends no long row of equal values.
    """
    ways: dict[Hashable, list[_Way]] = {}
    for key, samples in found.items():
        # Sources are COB-IDs or -1, so counting them beats sorting them.
        for source in (np.flatnonzero(np.bincount(samples.source + 1)) - 1).tolist():
            if source != SDO_SOURCE:
                rows = np.flatnonzero((samples.source == source) & samples.valid)
                ways.setdefault(quantity(key), []).append(_Way(key, source, rows))
    frozen = {key: np.zeros(len(samples.seq), np.bool_) for key, samples in found.items()}
    for siblings in ways.values():
        for way in siblings if len(siblings) > 1 else ():
            others = [other for other in siblings if other is not way]
            for begin, stop in _long_runs(found[way.key], way.rows):
                run = way.rows[begin:stop]
                span = found[way.key].t_ns[run[0]], found[way.key].t_ns[run[-1]]
                if any(_moves(found[other.key], other.rows, *span) for other in others):
                    frozen[way.key][run] = True
    return {
        key: replace(samples, frozen=frozen[key]) if frozen[key].any() else samples
        for key, samples in found.items()
    }


def _long_runs(samples: Samples, rows: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Half-open runs of equal values that are long in number and in time."""
    raw, t_ns = samples.raw[rows], samples.t_ns[rows]
    edges = np.concatenate(([0], np.flatnonzero(np.diff(raw)) + 1, [len(raw)]))
    long = np.flatnonzero(np.diff(edges) >= LEAST)
    runs = [(int(edges[k]), int(edges[k + 1])) for k in long.tolist()]
    return [(a, b) for a, b in runs if t_ns[b - 1] - t_ns[a] >= LEAST_NS]


def _moves(samples: Samples, rows: NDArray[np.intp], start_ns: int, end_ns: int) -> bool:
    t_ns = samples.t_ns[rows]
    values = samples.raw[rows[(t_ns >= start_ns) & (t_ns <= end_ns)]]
    if len(values) < VALUES:
        return False
    return int(values.max() - values.min()) >= MOVED and len(np.unique(values)) >= VALUES
