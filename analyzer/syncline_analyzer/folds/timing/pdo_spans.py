"""PDOs of a node in stretches between the events that may change its state."""

from dataclasses import field
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from syncline_analyzer.distinct import distinct
from syncline_analyzer.folds.nmt.cadence import CANDIDATE_RATIO, MIN_PERIODS, Int64s, Mask
from syncline_analyzer.folds.nmt.events import PdoSpan
from syncline_schemas.records import dataclass

_NO_SEQ = np.zeros(0, np.intp)
MAX_SPANS = 20_000
"""Stretches of PDOs kept per node."""


class PdoSpans:
    """PDOs of one node between the events that may change its state."""

    def __init__(self) -> None:
        self._open: dict[int, PdoSpan] = {}
        self._closed: list[PdoSpan] = []
        self._cuts: list[tuple[int, int]] = []
        self._asked: dict[int, NDArray[np.intp]] = {}
        """`seq` of the last remote frame to each identifier."""

    def cut(self, cuts: list[tuple[int, int]]) -> None:
        """Take in (seq, t_ns) of what may change the state; only the last one before lives on."""
        self._cuts = sorted([*self._cuts[-1:], *cuts])

    def take(
        self,
        can_id: int,
        seq: NDArray[np.intp],
        t_ns: NDArray[np.int64],
        remote: NDArray[np.intp] = _NO_SEQ,
    ) -> None:
        """Take in the rows of one identifier, and the `seq` of the remote frames that asked for it."""
        if len(remote) or can_id in self._asked:
            remote = np.concatenate((self._asked.get(can_id, remote[:0]), remote))
            self._asked[can_id] = remote[-1:]
        since, begun = self._cuts[-1] if self._cuts else None, self._open.get(can_id)
        goes_on = begun is not None and begun.since == since and not len(remote)
        if begun is not None and goes_on and (since is None or seq[0] > since[0]):
            begun.extend(seq, t_ns)
            return
        edges = seq.searchsorted([cut[0] for cut in self._cuts], "right").tolist()
        for number, (begin, stop) in enumerate(pairwise((0, *edges, len(seq)))):
            if begin == stop:
                continue
            rows = slice(begin, stop)
            since = self._cuts[number - 1] if number else None
            begun = self._open.get(can_id)
            if begun is None or since != begun.since:
                if begun is not None:
                    self._close(begun)
                begun = PdoSpan(can_id, since)
                self._open[can_id] = begun
            begun.extend(seq[rows], t_ns[rows])
            last = int(np.searchsorted(remote, seq[stop - 1])) if len(remote) else 0
            after = since[0] if since else -1
            begun.asked = begun.asked or bool(last and remote[last - 1] > after)

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


@dataclass(slots=True)
class Quietness:
    """Finds where a node is heard again after a stretch that may be a silence.

    That is known at once, while the silence itself shows only with the next error control: each
    stretch that is longer than the node's periods and than those since its last message.
    """

    _beats: Int64s = field(default_factory=lambda: np.zeros(0, np.int64))
    """Times of the last messages of its error control."""
    _last_ns: int | None = None
    _longest_ns: int = 0
    """Of the stretches since the last of these messages."""
    shortest_ns: int = 0
    """Of the periods that the next stretches are held against, 0 where they are too few."""

    def follow(self, seq: Int64s, t_ns: Int64s, beat: Mask) -> list[tuple[int, int]]:
        """(seq - 1, t_ns) of the frames of a node that end such a stretch; all (n,)."""
        if not len(seq):
            return []
        passed = np.diff(t_ns, prepend=t_ns[0] if self._last_ns is None else self._last_ns)
        number: Int64s = np.cumsum(beat) - beat
        rows = np.flatnonzero(~beat & (passed > self._limits(t_ns, beat)[number]))
        found = []
        edges = np.concatenate(([-1], np.flatnonzero(beat), [len(seq)]))
        for segment in distinct(number[rows]):
            part = slice(edges[segment] + 1, edges[segment + 1])
            longest = np.maximum.accumulate(passed[part])
            before = np.concatenate(([0], longest[:-1]))
            before = np.maximum(before, self._longest_ns if segment == 0 else 0)
            fresh = np.flatnonzero(passed[part] > before) + part.start
            ends = np.intersect1d(fresh, rows, assume_unique=True)
            found += [(int(seq[row]) - 1, int(t_ns[row])) for row in ends]
        begun = self._longest_ns if not beat.any() else 0
        self._longest_ns = max(begun, int(passed[edges[-2] + 1 :].max(initial=0)))
        self._keep(t_ns[beat])
        self._last_ns = int(t_ns[-1])
        return found

    def go_on(self, beats_ns: Int64s, longest_ns: int, last_ns: int) -> None:
        """Take in messages between which nothing was silent for longer than a period.

        Args:
            beats_ns: (n,) their times.
            longest_ns: of the stretches since the last of them.
            last_ns: time of the last frame of the node.
        """
        self._keep(beats_ns)
        self._longest_ns, self._last_ns = longest_ns, last_ns

    def cut(self) -> None:
        """Begin anew, as after a gap."""
        self._beats, self._last_ns, self._longest_ns = self._beats[:0], None, 0
        self.shortest_ns = 0

    def _keep(self, beats_ns: Int64s) -> None:
        """Keep the times of the last messages."""
        if len(beats_ns):
            beats = np.concatenate((self._beats, beats_ns[-MIN_PERIODS - 1 :]))
            self._beats = beats[-MIN_PERIODS - 1 :]
            enough = len(self._beats) > MIN_PERIODS
            self.shortest_ns = int(np.diff(self._beats).min()) if enough else 0

    def _limits(self, t_ns: Int64s, beat: Mask) -> NDArray[np.float64]:
        """What a silence exceeds after each message: the shortest of the periods before it."""
        times = np.concatenate((self._beats, t_ns[beat]))
        held = len(self._beats)
        periods = np.diff(times)
        limits = np.full(len(times) + 1, np.inf)
        limits[1 : MIN_PERIODS + 1] = 0.0
        if len(periods) >= MIN_PERIODS:
            shortest = sliding_window_view(periods, MIN_PERIODS).min(axis=1)
            limits[MIN_PERIODS + 1 :] = CANDIDATE_RATIO * shortest
        return limits[held:]
