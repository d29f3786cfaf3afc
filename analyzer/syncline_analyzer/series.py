"""Columns over time in bounded memory: when there are too many, the extremes stay."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = dict[str, NDArray[Any]]


class Thinner:
    """Equally long columns, of which at most `limit` rows are kept; NaN where one is not added.

    While there are fewer, all rows stay. Beyond that, neighbouring rows are cut into runs of equal
    length, and of each run the rows with the smallest and the largest `key` stay (NaN never does
    while there is a number), so that no peak is ever lost.
    """

    def __init__(self, key: str, limit: int) -> None:
        self.stride = 1
        self._key = key
        self._limit = limit
        self._blocks: list[Columns] = []
        self._held = 0

    def add(self, columns: Columns) -> None:
        """Append rows; the arrays are not copied unless they are thinned."""
        if self.stride > 1 and len(columns[self._key]):
            columns = _thin(columns, self._key, 2 * self.stride)
        self.add_chosen(columns)

    def chosen(self, key: NDArray[np.float64]) -> NDArray[np.intp]:
        """Rows that will stay of a block with this key; the others need not be worked out."""
        if self.stride == 1 or not len(key):
            return np.arange(len(key))
        return extreme_rows(key, 2 * self.stride)

    def add_chosen(self, block: Columns) -> None:
        """Append rows of which only the `chosen` ones are given."""
        if not len(block[self._key]):
            return
        self._blocks.append(block)
        self._held += len(block[self._key])
        while self._held > self._limit:
            self._halve()

    def columns(self) -> Columns:
        """All rows that are kept, in order; no columns at all when nothing was added."""
        if not self._blocks:
            return {}
        if len(self._blocks) > 1:
            self._blocks = [_joined(self._blocks)]
        return self._blocks[0]

    def _halve(self) -> None:
        self._blocks = [_thin(self.columns(), self._key, 4)]
        held = len(self._blocks[0][self._key])
        self.stride *= 2
        self._held = held


def _joined(blocks: list[Columns]) -> Columns:
    names = dict.fromkeys(name for block in blocks for name in block)
    return {name: np.concatenate([_column(block, name) for block in blocks]) for name in names}


def _column(block: Columns, name: str) -> NDArray[Any]:
    """A column of a block, NaN where it has none of this name."""
    found = block.get(name)
    return found if found is not None else np.full(len(next(iter(block.values()))), np.nan)


def _thin(columns: Columns, key: str, run: int) -> Columns:
    rows = extreme_rows(columns[key].astype(np.float64), run)
    return {name: column[rows] for name, column in columns.items()}


def extreme_rows(value: NDArray[np.float64], run: int) -> NDArray[np.intp]:
    """Rows of the smallest and the largest value of each run of `run` rows, ascending.

    >>> extreme_rows(np.array([0.0, 9.0, 1.0, 2.0, -5.0, 3.0]), 3).tolist()
    [0, 1, 4, 5]
    """
    padded = np.concatenate([value, np.full(-len(value) % run, np.nan)]).reshape(-1, run)
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
