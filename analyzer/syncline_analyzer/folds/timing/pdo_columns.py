"""What follows from one frame of a PDO to the next, for all PDOs of a block at once."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.pdo_state import PdoState
from syncline_analyzer.folds.timing.phase import UNTOLD
from syncline_analyzer.folds.timing.rhythm import Steps
from syncline_analyzer.folds.timing.sync_index import SyncIndex

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
        t_ns = self.block.batch.t_ns_by_id
        before = np.empty_like(t_ns)
        before[1:] = t_ns[:-1]
        first = zip(self._last_ns, t_ns[self._starts].tolist(), strict=True)
        before[self._starts] = [now if last is None else last for last, now in first]
        return np.subtract(t_ns, before, out=before)

    @cached_property
    def _period_limits(self) -> list[Limits]:
        return self._limits(self.periods)

    def period_limits(self, number: int) -> Limits | None:
        """The least and the longest of a PDO, None where no frame before is known."""
        return None if self._last_ns[number] is None else self._period_limits[number]

    @cached_property
    def repeated(self) -> list[int]:
        """(p,) how many frames of each PDO but its first bring the data of the one before."""
        words = self.block.batch.words_by_id
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
            each = self._steps_by(sync)
            self._steps[key] = each, self._limits(each)
        each, limits = self._steps[key]
        return Steps(each[self.places[number]], limits[number])

    def phases(self, sync: SyncIndex, number: int) -> Ints:
        """(UNTOLD,) how many frames of a PDO follow SYNCs of each number modulo that."""
        key = id(sync)
        if key not in self._phases:
            numbers = np.arange(len(sync.seq)) + sync.first_ordinal
            phase = (numbers % UNTOLD).take(sync.before_by_id)
            phase += self._numbers * UNTOLD
            counts = np.bincount(phase, minlength=(len(self.places) + 1) * UNTOLD)
            self._phases[key] = counts.reshape(-1, UNTOLD)
        own: Ints = self._phases[key][number]
        return own

    def _steps_by(self, sync: SyncIndex) -> Ints:
        at = sync.before_by_id
        steps = np.empty_like(at)
        np.subtract(at[1:], at[:-1], out=steps[1:])
        last = np.array([0 if each is None else each for each in self._last_sync])
        steps[self._starts] = at[self._starts] + sync.first_ordinal - last
        return steps

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
        edges = np.array([(place.start, place.stop) for place in self.places], np.intp).reshape(-1)
        return edges[:-1] if edges[-1] == len(self.block.batch.rows_by_id) else edges

    def _limits(self, values: NDArray[Any]) -> list[Limits]:
        least, most = (how.reduceat(values, self._edges)[::2] for how in (np.minimum, np.maximum))
        return list(zip(least.tolist(), most.tolist(), strict=True))
