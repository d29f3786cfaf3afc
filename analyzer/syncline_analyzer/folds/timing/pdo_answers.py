"""Answers of PDOs to SYNC in one block, several PDOs at a time."""

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.timing.block import Block
from syncline_analyzer.folds.timing.pdo_columns import AfterSync
from syncline_analyzer.folds.timing.pdo_frames import PdoFrames
from syncline_analyzer.folds.timing.pdo_state import PdoState
from syncline_analyzer.folds.timing.sync_index import SyncIndex
from syncline_schemas.records import dataclass

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
    """Answers of several PDOs to the SYNCs of one identifier, those of a PDO behind one another."""

    block: Block
    sync: SyncIndex
    after: AfterSync
    pdos: Sequence[PdoAnswers]

    @cached_property
    def _counts(self) -> Ints:
        return np.array([len(each.position) for each in self.pdos])

    @cached_property
    def starts(self) -> Ints:
        """(p,) where those of each PDO begin."""
        return np.cumsum(self._counts) - self._counts

    @property
    def parts(self) -> list[slice]:
        """The same, where they begin and end."""
        edges = zip(self.starts.tolist(), self._counts.tolist(), strict=True)
        return [slice(start, start + count) for start, count in edges]

    @cached_property
    def _place(self) -> slice | None:
        """Where they stand in the columns by identifier, None where others lie between them."""
        places = [each.frames.place for each in self.pdos]
        whole = [place for place in places if isinstance(place, slice)]
        if len(whole) < len(places) or any(a.stop != b.start for a, b in pairwise(whole)):
            return None
        return slice(whole[0].start, whole[-1].stop)

    @cached_property
    def rows(self) -> NDArray[np.intp]:
        """(r,) rows in the block."""
        if self._place is not None:
            return self.block.batch.rows_by_id[self._place]
        return np.concatenate([each.frames.rows for each in self.pdos])

    @cached_property
    def seq(self) -> Ints:
        """(r,) position in the capture."""
        return np.concatenate([each.frames.seq for each in self.pdos])

    @cached_property
    def position(self) -> Ints:
        """(r,) of the SYNC that each answers."""
        if self._place is not None:
            return self.after.position[self._place]
        return np.concatenate([each.position for each in self.pdos])

    @cached_property
    def response(self) -> Ints:
        """(r,) time since that SYNC [ns]."""
        if self._place is not None:
            return self.after.since[self._place]
        return np.concatenate([each.response for each in self.pdos])
