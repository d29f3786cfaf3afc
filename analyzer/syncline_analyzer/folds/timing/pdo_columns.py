"""What follows from one frame of a PDO to the next, for all PDOs of a block at once."""

from collections.abc import Sequence
from dataclasses import field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.pdo_state import PdoState
from syncline_analyzer.folds.timing.phase import UNTOLD
from syncline_analyzer.folds.timing.rhythm import Steps
from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_schemas import native
from syncline_schemas.records import dataclass

Ints = NDArray[np.int64]
Limits = tuple[int, int]


@dataclass(eq=False)
class PdoColumns:
    """The frames of the PDOs of a bus in the columns by identifier, see `IndexedBatch`.

    Attributes:
        places: where those of each PDO are, none of them empty, ascending.
        states: what was kept of each of them before the block.
    """

    block: Block
    places: Sequence[slice]
    states: Sequence[PdoState]
    _steps: dict[int, tuple[Ints, list[Limits]]] = field(default_factory=dict)
    _responses: dict[int, list[Limits]] = field(default_factory=dict)
    _phases: dict[int, Ints] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # The states go on while their PDOs are followed.
        self._starts = np.array([place.start for place in self.places], np.intp)
        self._last_ns = [state.last_ns for state in self.states]
        self._last_sync = [state.rhythm.last for state in self.states]

    @cached_property
    def periods(self) -> Ints:
        """(k,) time since the frame before, 0 where none is known [ns]."""
        return self._period_columns[0]

    @cached_property
    def _period_columns(self) -> tuple[Ints, list[Limits]]:
        t_ns = self.block.batch.t_ns_by_id
        first = zip(self._last_ns, t_ns[self._starts].tolist(), strict=True)
        return self._differences(t_ns, [now if last is None else last for last, now in first])

    def period_limits(self, number: int) -> Limits | None:
        """The least and the longest of a PDO, None where no frame before is known."""
        return None if self._last_ns[number] is None else self._period_columns[1][number]

    @cached_property
    def repeated(self) -> list[int]:
        """(p,) how many frames of each PDO but its first bring the data of the one before."""
        words = self.block.batch.words_by_id
        if native.available():
            found: list[int] = native.repeated(self._table, words).tolist()
            return found
        same = np.empty(len(words), np.bool_)
        np.equal(words[1:], words[:-1], out=same[1:])
        same[self._starts] = False
        counts: list[int] = np.add.reduceat(same, self._edges, dtype=np.int64)[::2].tolist()
        return counts

    def responses(self, sync: SyncIndex, number: int) -> Limits:
        """The least and the longest time since a SYNC of a PDO."""
        key = id(sync)
        if key not in self._responses:
            self._responses[key] = self._limits(sync.since_by_id)
        return self._responses[key][number]

    def steps(self, sync: SyncIndex, number: int) -> Steps | None:
        """By the SYNCs of one identifier, None where no frame before is known."""
        if self._last_sync[number] is None:
            return None
        key = id(sync)
        if key not in self._steps:
            last = [0 if last is None else last - sync.first_ordinal for last in self._last_sync]
            self._steps[key] = self._differences(sync.before_by_id, last)
        each, limits = self._steps[key]
        return Steps(each[self.places[number]], limits[number])

    def phases(self, sync: SyncIndex, number: int) -> Ints:
        """(UNTOLD,) how many frames of a PDO follow SYNCs of each number modulo that."""
        key = id(sync)
        if key not in self._phases:
            numbers = np.arange(len(sync.seq)) + sync.first_ordinal
            self._phases[key] = self._counts(sync.before_by_id, numbers % UNTOLD)
        own: Ints = self._phases[key][number]
        return own

    def _counts(self, at: Ints, kind: Ints) -> Ints:
        """(p, UNTOLD) how many of the (k,) positions of each PDO are of each kind."""
        if native.available():
            return native.kinds(self._table, at, kind.astype(np.uint8), UNTOLD)
        numbered = kind.take(at)
        numbered += self._numbers * UNTOLD
        counts = np.bincount(numbered, minlength=(len(self.places) + 1) * UNTOLD)
        return counts.reshape(-1, UNTOLD)

    def _differences(self, values: Ints, first: list[int]) -> tuple[Ints, list[Limits]]:
        """From each value of a PDO to the next, and the limits of that; from `first` to its first.

        What is told outside the PDOs has no meaning.
        """
        before = np.array(first, np.int64)
        if native.available():
            steps, limits = native.differences(self._table, values, before)
            return steps, _pairs(limits)
        steps = np.empty_like(values)
        np.subtract(values[1:], values[:-1], out=steps[1:])
        steps[self._starts] = values[self._starts] - before
        return steps, self._limits(steps)

    @cached_property
    def _numbers(self) -> Ints:
        """(k,) number of the PDO of each frame, behind all of them for other frames."""
        numbers = np.full(len(self.block.batch.rows_by_id), len(self.places))
        for number, place in enumerate(self.places):
            numbers[place] = number
        return numbers

    @cached_property
    def _edges(self) -> NDArray[np.intp]:
        """Where the frames of each PDO begin and end by turns, for `reduceat`."""
        edges = self._table.reshape(-1)
        return edges[:-1] if edges[-1] == len(self.block.batch.rows_by_id) else edges

    @cached_property
    def _table(self) -> NDArray[np.intp]:
        """(p, 2) where the frames of each PDO begin and stop."""
        found = [(place.start, place.stop) for place in self.places]
        return np.array(found, np.intp).reshape(-1, 2)

    def _limits(self, values: Ints) -> list[Limits]:
        if native.available():
            return _pairs(native.limits(self._table, values))
        least, most = (how.reduceat(values, self._edges)[::2] for how in (np.minimum, np.maximum))
        return list(zip(least.tolist(), most.tolist(), strict=True))


def _pairs(limits: Ints) -> list[Limits]:
    return [(least, most) for least, most in limits.tolist()]
