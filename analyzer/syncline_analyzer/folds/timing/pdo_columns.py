"""What follows from one frame of a PDO to the next, for all PDOs of a block at once."""

from collections.abc import Sequence
from dataclasses import field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.pdo_state import PdoState
from syncline_analyzer.folds.timing.phase import UNTOLD
from syncline_analyzer.folds.timing.repeats import Runs
from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_schemas import native
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

Ints = NDArray[np.int64]
Limits = tuple[int, int]


class AfterSync(NamedTuple):
    """Where the frames of all PDOs stand between the SYNCs of one identifier.

    Attributes:
        position: (k,) of the SYNC before each frame in the columns by identifier.
        since: (k,) time since that SYNC [ns].
        responses: the least and the longest such time of each PDO.
        steps: the least and the largest step of each PDO from one position to the next; that to the
            first frame has no meaning where no answer before is known.
        phases: (p, UNTOLD) how many frames of each PDO follow SYNCs of each number modulo that.
    """

    position: Ints
    since: Ints
    responses: list[Limits]
    steps: list[Limits]
    phases: Ints


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
    _after: dict[int, AfterSync] = field(default_factory=dict)

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
        before = [now if last is None else last for last, now in first]
        return self._differences(t_ns, np.array(before, np.int64))

    def period_limits(self, number: int) -> Limits | None:
        """The least and the longest of a PDO, None where no frame before is known."""
        return None if self._last_ns[number] is None else self._period_columns[1][number]

    @cached_property
    def runs(self) -> list[Runs]:
        """(p,) frames of each PDO in runs of equal data."""
        batch = self.block.batch
        if native.available():
            found = native.runs(self._table, batch.rows_by_id, batch.frames.data)
            return [Runs(*each) for each in found.tolist()]
        return [Runs.of(batch.words_by_id[place]) for place in self.places]

    def after(self, sync: SyncIndex) -> AfterSync:
        """By the SYNCs of one identifier."""
        key = id(sync)
        if key not in self._after:
            self._after[key] = self._after_sync(sync)
        return self._after[key]

    def steps(self, sync: SyncIndex, number: int) -> Limits | None:
        """Of a PDO, see `AfterSync`; None where no answer before is known."""
        return None if self._last_sync[number] is None else self.after(sync).steps[number]

    def _after_sync(self, sync: SyncIndex) -> AfterSync:
        batch, begun = self.block.batch, sync.first_ordinal
        last = np.array([0 if each is None else each - begun for each in self._last_sync], np.int64)
        if native.available():
            by_id = self._table, batch.rows_by_id, batch.t_ns_by_id
            position, since, limits, phases = native.after(
                *by_id, sync.rows, sync.t_ns, last, begun % UNTOLD, UNTOLD
            )
            return AfterSync(position, since, _pairs(limits[:, :2]), _pairs(limits[:, 2:]), phases)
        position = sync.before.take(batch.rows_by_id)
        since = batch.t_ns_by_id - sync.t_ns.take(position)
        _, steps = self._differences(position, last)
        kinds = (np.arange(len(sync.seq)) + begun) % UNTOLD
        return AfterSync(position, since, self._limits(since), steps, self._counts(position, kinds))

    def _counts(self, at: Ints, kind: Ints) -> Ints:
        """(p, UNTOLD) how many of the (k,) positions of each PDO are of each kind."""
        numbered = kind.take(at)
        numbered += self._numbers * UNTOLD
        counts = np.bincount(numbered, minlength=(len(self.places) + 1) * UNTOLD)
        return counts.reshape(-1, UNTOLD)[:-1]

    def _differences(self, values: Ints, before: Ints) -> tuple[Ints, list[Limits]]:
        """From each value of a PDO to the next, and the limits of that; from `before` to its first.

        What is told outside the PDOs has no meaning.
        """
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
        if not self.places:
            return []
        least, most = (how.reduceat(values, self._edges)[::2] for how in (np.minimum, np.maximum))
        return list(zip(least.tolist(), most.tolist(), strict=True))


def _pairs(limits: Ints) -> list[Limits]:
    return [(least, most) for least, most in limits.tolist()]
