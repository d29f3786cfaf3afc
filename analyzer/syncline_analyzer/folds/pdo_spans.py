"""PDOs of a node in stretches between the events that may change its state."""

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.nmt_events import PdoSpan

MAX_SPANS = 20_000
"""Stretches of PDOs kept per node."""


class PdoSpans:
    """PDOs of one node between the events that may change its state."""

    def __init__(self) -> None:
        self._open: dict[int, PdoSpan] = {}
        self._closed: list[PdoSpan] = []
        self._cuts: list[tuple[int, int]] = []

    def cut(self, cuts: list[tuple[int, int]]) -> None:
        """Take in (seq, t_ns) of what may change the state; only the last one before lives on."""
        self._cuts = sorted([*self._cuts[-1:], *cuts])

    def take(
        self, can_id: int, seq: NDArray[np.intp], t_ns: NDArray[np.int64], asked: bool
    ) -> None:
        """Take in the rows of one identifier; `asked` when remote frames asked for it."""
        part = np.searchsorted([cut[0] for cut in self._cuts], seq)
        edges = np.flatnonzero(np.diff(part)) + 1
        for rows in np.split(np.arange(len(seq)), edges):
            number = int(part[rows[0]])
            since = self._cuts[number - 1] if number else None
            begun = self._open.get(can_id)
            if begun is None or since != begun.since:
                if begun is not None:
                    self._close(begun)
                begun = PdoSpan(can_id, since, asked)
                self._open[can_id] = begun
            begun.extend(seq[rows], t_ns[rows])
            begun.asked = begun.asked or asked

    def close(self) -> None:
        """End all stretches, as at a gap."""
        for span in self._open.values():
            self._close(span)
        self._open.clear()

    def spans(self) -> list[PdoSpan]:
        """All stretches in order of their first frame."""
        return sorted([*self._closed, *self._open.values()], key=lambda span: span.first_seq)

    def _close(self, span: PdoSpan) -> None:
        if len(self._closed) < MAX_SPANS:
            self._closed.append(span)
