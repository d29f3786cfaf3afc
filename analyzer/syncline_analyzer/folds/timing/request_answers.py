"""How soon a frame comes after a remote frame that asks for it (CiA 301 7.2.2.5.2, 7.2.8.3.1)."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.distribution import Distribution
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.timing.extremes import Extremes
from syncline_analyzer.folds.timing.rhythm import Missed
from syncline_schemas.records import dataclass

ANSWER_NS = 1_000_000_000
"""What comes later than this after a request is no answer to it."""
HURRIED_NS = 20_000_000
"""A request this soon before another is the same one: nobody had time to answer it."""


@dataclass(slots=True)
class RequestAnswers:
    """Pairs each request with the first frame after it; one that another one follows got none."""

    answered: int = 0
    time: Distribution = field(default_factory=Distribution)
    slowest: Extremes = field(default_factory=lambda: Extremes(both=False))
    missed: Missed = field(default_factory=Missed)
    """Requests that another one follows instead, or an answer that comes too late."""
    _open: tuple[int, int] | None = None
    """(`seq`, stamp) of a request that waits."""

    def add(
        self,
        batch: IndexedBatch,
        rows: NDArray[np.intp],
        requests: NDArray[np.intp],
        *,
        timed: bool,
    ) -> None:
        """Take in a block.

        Args:
            batch: its frames.
            rows: rows of the frames, and of requests that a logger wrote down as empty ones.
            requests: rows of the requests.
            timed: whether the stamps mean anything.
        """
        if not len(requests) and self._open is None:
            return
        t_ns, seqs = batch.frames.t_ns, batch.seqs
        sent = rows[~np.isin(rows, requests)]
        place, asked_ns = seqs[requests], t_ns[requests]
        if self._open is not None:
            place = np.concatenate(([self._open[0]], place))
            asked_ns = np.concatenate(([self._open[1]], asked_ns))
        before = np.searchsorted(place, seqs[sent]) - 1
        first = np.diff(before, prepend=-1) > 0
        answers, before = sent[first], before[first]
        waits = bool(len(place)) and (not len(answers) or before[-1] < len(place) - 1)
        self._open = (int(place[-1]), int(asked_ns[-1])) if waits else None
        waited = t_ns[answers] - asked_ns[before]
        soon = (waited >= 0) & (waited <= ANSWER_NS) if timed else np.ones(len(answers), np.bool_)
        lost = np.ones(len(place), np.bool_)
        lost[before[soon]] = False
        if waits:
            lost[-1] = False
        if timed:
            lost[:-1] &= np.diff(asked_ns) > HURRIED_NS
        if lost.any():
            self.missed.add(asked_ns[lost], place[lost])
        self.answered += int(np.count_nonzero(soon))
        if timed:
            self.time.add(waited[soon])
            self.slowest.add(waited[soon], seqs[answers[soon]], t_ns[answers[soon]])

    def restart(self) -> None:
        """Forget what is open, as at a gap."""
        self._open = None
