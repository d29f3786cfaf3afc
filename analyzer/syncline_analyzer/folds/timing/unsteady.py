"""Stretches in which the SYNC period is off its mean again and again."""

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.results import SyncJitterRow
from syncline_schemas.records import dataclass

OFF = 0.1
"""A period is off when it differs by more than this share from the mean."""
MANY = 5
OFTEN = 0.1
"""Jitter is told where at least so many periods, and this share of them, are off."""
STEADY = 20
"""So many good periods end a stretch of jitter."""
BACKLOG = 0.5
"""Periods that are on average shorter than this share of the cycle were stamped in a bundle."""
MAX_STRETCHES = 1000
MAX_EVIDENCE = 100

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class _Off:
    """Periods that are off, in order; all (n,). `number` counts periods over the capture."""

    number: Ints
    t_ns: Ints
    seq: Ints
    start_ns: Ints
    by_ns: NDArray[np.float64]
    cycle_ns: NDArray[np.float64]

    def __getitem__(self, rows: slice) -> "_Off":
        return _Off(
            self.number[rows],
            self.t_ns[rows],
            self.seq[rows],
            self.start_ns[rows],
            self.by_ns[rows],
            self.cycle_ns[rows],
        )


@dataclass(slots=True)
class _Stretch:
    """A stretch that may still go on."""

    first: int
    last: int
    off: int
    start_ns: int
    end_ns: int
    cycle_ns: float
    worst_ns: float
    evidence: list[int]

    @property
    def periods(self) -> int:
        """All periods from the first that is off to the last."""
        return self.last - self.first + 1

    @property
    def unsteady(self) -> bool:
        """Whether enough periods are off, as those of a producer are and not of a backlog."""
        enough = self.off >= max(MANY, OFTEN * self.periods)
        return enough and self.end_ns - self.start_ns >= BACKLOG * self.periods * self.cycle_ns

    def join(self, other: "_Stretch") -> None:
        """Go on with what follows."""
        self.last, self.end_ns = other.last, max(self.end_ns, other.end_ns)
        self.off += other.off
        self.worst_ns = max(self.worst_ns, other.worst_ns)
        self.evidence = (self.evidence + other.evidence)[:MAX_EVIDENCE]


class Unsteady:
    """Gathers periods that are off to stretches; one that is off now and then makes none."""

    def __init__(self) -> None:
        self._periods = 0
        self._closed: list[_Stretch] = []
        self._open: _Stretch | None = None

    def add(
        self,
        t_ns: Ints,
        seq: Ints,
        periods: Ints,
        off: NDArray[np.bool_],
        cycles_ns: NDArray[np.float64],
    ) -> None:
        """Take in periods in order, each with the stamp and `seq` of its end, and its cycle."""
        rows = np.flatnonzero(off)
        found = _Off(
            rows + self._periods,
            t_ns[rows],
            seq[rows],
            t_ns[rows] - periods[rows],
            np.abs(periods[rows] - cycles_ns[rows]),
            cycles_ns[rows],
        )
        self._periods += len(off)
        if not len(rows):
            return
        cuts = np.flatnonzero(np.diff(found.number) > STEADY) + 1
        starts, stops = np.concatenate(([0], cuts)), np.append(cuts, len(rows))
        # Only the first and the last one may go on in another block.
        enough = stops - starts >= MANY
        enough[[0, -1]] = True
        for at in np.flatnonzero(enough).tolist():
            self._take(_stretch(found[int(starts[at]) : int(stops[at])]))

    def go_on(self, count: int) -> None:
        """Take in so many periods none of which is off."""
        self._periods += count

    def rows(self, bus: str, cob_id: int) -> list[SyncJitterRow]:
        """The stretches that hold enough periods off the mean."""
        return [
            SyncJitterRow(
                bus,
                cob_id,
                stretch.start_ns,
                stretch.end_ns,
                stretch.off,
                stretch.periods,
                stretch.cycle_ns / 1000,
                stretch.worst_ns / 1000,
                stretch.evidence,
            )
            for stretch in [*self._closed, *([self._open] if self._open else [])]
            if stretch.unsteady
        ]

    def _take(self, stretch: _Stretch) -> None:
        if self._open is not None and stretch.first - self._open.last <= STEADY:
            self._open.join(stretch)
            return
        if self._open is not None and self._open.unsteady and len(self._closed) < MAX_STRETCHES:
            self._closed.append(self._open)
        self._open = stretch


def _stretch(off: _Off) -> _Stretch:
    return _Stretch(
        int(off.number[0]),
        int(off.number[-1]),
        len(off.number),
        int(off.start_ns[0]),
        int(off.t_ns.max()),
        float(off.cycle_ns[0]),
        float(off.by_ns.max()),
        off.seq[:MAX_EVIDENCE].tolist(),
    )
