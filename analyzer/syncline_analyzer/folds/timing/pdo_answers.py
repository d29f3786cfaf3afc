"""Answers of PDOs to SYNC in one block, several PDOs at a time."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.pdo_frames import PdoFrames
from syncline_analyzer.folds.timing.pdo_state import PdoState
from syncline_analyzer.folds.timing.sync_index import SyncIndex

_T = TypeVar("_T", np.int64, np.float64, np.bool_)
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class PdoAnswers:
    """Answers of one PDO; at least one.

    Attributes:
        can_id, state: of the PDO.
        frames: the answers.
        position: (r,) of the SYNC that each answers.
        response: (r,) time since that SYNC [ns].
    """

    can_id: int
    state: PdoState
    frames: PdoFrames
    position: Ints
    response: Ints


@dataclass(frozen=True, eq=False)
class AnswersTo:
    """Answers of several PDOs to the SYNCs of one identifier, all of them in order of arrival."""

    block: Block
    sync: SyncIndex
    pdos: Sequence[PdoAnswers]

    @cached_property
    def _counts(self) -> Ints:
        return np.array([len(each.position) for each in self.pdos])

    @cached_property
    def starts(self) -> Ints:
        """(p,) where those of each PDO begin when they are sorted `by_pdo`."""
        return np.cumsum(self._counts) - self._counts

    @property
    def parts(self) -> list[slice]:
        """The same, where they begin and end."""
        edges = zip(self.starts.tolist(), self._counts.tolist(), strict=True)
        return [slice(start, start + count) for start, count in edges]

    @cached_property
    def _numbers(self) -> Ints:
        """(n,) number by PDO of the answer in each row of the block, -1 for other frames."""
        numbers = np.full(len(self.block.frames), -1)
        numbers[np.concatenate([each.frames.rows for each in self.pdos])] = np.arange(
            int(self._counts.sum())
        )
        return numbers

    @cached_property
    def rows(self) -> NDArray[np.intp]:
        """(r,) rows in the block."""
        return np.flatnonzero(self._numbers >= 0)

    @cached_property
    def _number(self) -> Ints:
        return self._numbers.take(self.rows)

    @cached_property
    def pdo(self) -> NDArray[np.intp]:
        """(r,) number of the PDO of each."""
        return np.repeat(np.arange(len(self.pdos)), self._counts).take(self._number)

    @cached_property
    def seq(self) -> Ints:
        """(r,) position in the capture."""
        return self.block.batch.seqs.take(self.rows)

    @cached_property
    def position(self) -> Ints:
        """(r,) of the SYNC that each answers."""
        return self.sync.before.take(self.rows)

    @cached_property
    def sync_ns(self) -> Ints:
        """(r,) stamp of that SYNC."""
        return self.sync.t_ns.take(self.position)

    @cached_property
    def response(self) -> Ints:
        """(r,) time since that SYNC [ns]."""
        return self.block.frames.t_ns.take(self.rows) - self.sync_ns

    def by_pdo(self, column: NDArray[_T]) -> NDArray[_T]:
        """(r,) a column of theirs, those of one PDO behind those of the one before."""
        found = np.empty_like(column)
        found[self._number] = column
        return found
