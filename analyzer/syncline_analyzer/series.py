"""Columns over time in bounded memory: when there are too many, the extremes stay."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_schemas import native

Columns = dict[str, NDArray[Any]]
_AT_ONCE = 4096
"""Rows that wait until they are thinned together."""


class Thinner:
    """Equally long columns, of which at most `limit` rows are kept; NaN where one is not added.

    While there are fewer, all rows stay. Beyond that, neighbouring rows are cut into runs of equal
    length, and of each run the rows with the smallest and the largest `key` stay (NaN never does
    while there is a number), so that no peak is ever lost. Which rows are added at a time changes
    nothing.

    Args:
        key: a column.
        limit: a multiple of four.
    """

    def __init__(self, key: str, limit: int) -> None:
        self.stride = 1
        self._key = key
        self._limit = limit
        self._added = 0
        self._blocks: list[Columns] = []
        self._waiting: list[Columns] = []
        """Rows that are not thinned yet: many at a time cost less."""
        self._waits = 0

    @property
    def empty(self) -> bool:
        """Whether nothing was added."""
        return not self._added

    def add(self, columns: Columns) -> None:
        """Append rows; no array is held on to."""
        count = len(columns[self._key])
        room = self._limit * self.stride - self._added
        if count > room:
            self.add(_part(columns, slice(0, room)))
            self._halve()
            self.add(_part(columns, slice(room, None)))
            return
        if not count:
            return
        self._added += count
        self._waits += count
        if self._waits >= max(_AT_ONCE, 2 * self.stride):
            self._waiting.append(columns)
            self._settle()
        else:
            self._waiting.append(_copied(columns))

    def columns(self) -> Columns:
        """All rows that are kept, in order; no columns at all when nothing was added."""
        if self._waits >= 2 * self.stride:
            self._settle()
        if self._waiting:
            last = _thin(self._waiting, self._key, 2 * self.stride)
            return _joined([*self._blocks, last])
        if len(self._blocks) > 1:
            self._blocks = [_joined(self._blocks)]
        return self._blocks[0] if self._blocks else {}

    def _halve(self) -> None:
        """Thin rows that are as many as may be kept: nothing but whole runs."""
        self._settle()
        self._blocks = [_thin(self._blocks, self._key, 4)]
        self.stride *= 2

    def _settle(self) -> None:
        """Thin the whole runs of what waits."""
        if not self._waiting:
            return
        waiting, count = self._waiting, self._waits
        if self.stride == 1:
            self._waiting, self._waits = [], 0
            self._blocks.append(_copied(waiting[0]) if len(waiting) == 1 else _joined(waiting))
            return
        run = 2 * self.stride
        self._waits = count % run
        self._blocks.append(_thin(waiting, self._key, run, count - self._waits))
        self._waiting = [_last_of(waiting, self._waits)] if self._waits else []


def _copied(columns: Columns) -> Columns:
    return {name: column.copy() for name, column in columns.items()}


def _last_of(blocks: list[Columns], count: int) -> Columns:
    """A copy of the last rows of several blocks."""
    last = blocks[-1]
    if len(next(iter(last.values()))) < count:
        last = _joined(blocks)
    return {name: column[-count:].copy() for name, column in last.items()}


def _rows_of(blocks: list[Columns], rows: NDArray[np.intp]) -> Columns:
    """A copy of some rows of several blocks, ascending and counted through all of them."""
    edges = np.cumsum([0, *(len(next(iter(block.values()))) for block in blocks)])
    cuts = rows.searchsorted(edges).tolist()
    parts = []
    for block, start, (first, last) in zip(blocks, edges.tolist(), pairwise(cuts), strict=False):
        own = rows[first:last] - start
        parts.append({name: column.take(own) for name, column in block.items()})
    return _joined(parts)


def _part(columns: Columns, rows: slice) -> Columns:
    return {name: column[rows] for name, column in columns.items()}


def _joined(blocks: list[Columns]) -> Columns:
    if len(blocks) == 1:
        return blocks[0]
    names = dict.fromkeys(name for block in blocks for name in block)
    return {name: np.concatenate([_column(block, name) for block in blocks]) for name in names}


def _column(block: Columns, name: str) -> NDArray[Any]:
    """A column of a block, NaN where it has none of this name."""
    found = block.get(name)
    return found if found is not None else np.full(len(next(iter(block.values()))), np.nan)


def _thin(blocks: list[Columns], key: str, run: int, count: int | None = None) -> Columns:
    """The extremes of each run of the rows of several blocks, or of the first `count` of them."""
    if native.available():
        rows = sum(len(block[key]) for block in blocks) if count is None else count
        kept = native.thinned(blocks, key, run, rows)
        if kept is not None:
            return kept
    # Of the other columns only the rows that stay are looked at.
    keys = np.concatenate([block[key] for block in blocks])[:count]
    return _rows_of(blocks, extreme_rows(keys.astype(np.float64, copy=False), run))


def extreme_rows(value: NDArray[np.float64], run: int) -> NDArray[np.intp]:
    """Rows of the smallest and the largest value of each run of `run` rows, ascending.

    >>> extreme_rows(np.array([0.0, 9.0, 1.0, 2.0, -5.0, 3.0]), 3).tolist()
    [0, 1, 4, 5]
    """
    if native.available():
        return native.extremes(value, run)
    if len(value) % run:
        value = np.concatenate([value, np.full(-len(value) % run, np.nan)])
    padded = value.reshape(-1, run)
    low = high = padded
    hole = np.isnan(padded)
    if hole.any():
        low, high = np.where(hole, np.inf, padded), np.where(hole, -np.inf, padded)
    base = np.arange(len(padded)) * run
    least, most = low.argmin(axis=1) + base, high.argmax(axis=1) + base
    pairs = np.stack([np.minimum(least, most), np.maximum(least, most)], axis=1).reshape(-1)
    apart = np.ones(len(pairs), np.bool_)
    apart[1::2] = least != most
    return pairs[apart]
