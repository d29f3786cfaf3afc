"""Lines of degrees that encoders draw, as they wait for those of others on the same shaft."""

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.angle.samples import Samples
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

MAX_WAITING = 200_000
"""Samples of one encoder that wait for the other one."""

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Line(NamedTuple):
    """Samples of one encoder, all (n,): `segment` grows where the line breaks, `circle_deg` is
    what its angle is only known modulo (inf where turns are counted surely)."""

    t_ns: Integers
    seq: Integers
    deg: Floats
    segment: Integers
    circle_deg: Floats

    def of(self, part: slice) -> "Line":
        """Some of the samples."""
        return Line(
            self.t_ns[part],
            self.seq[part],
            self.deg[part],
            self.segment[part],
            self.circle_deg[part],
        )

    def followed_by(self, later: "Line") -> "Line":
        """Both, one after the other."""
        return Line(
            np.concatenate((self.t_ns, later.t_ns)),
            np.concatenate((self.seq, later.seq)),
            np.concatenate((self.deg, later.deg)),
            np.concatenate((self.segment, later.segment)),
            np.concatenate((self.circle_deg, later.circle_deg)),
        )


NOTHING = Line(
    np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64), np.zeros(0)
)


@dataclass(slots=True)
class Waiting:
    """One encoder's samples that the other one has not reached yet."""

    waiting: Line = NOTHING
    unsure: bool = False
    segment: int = -1
    last_ns: int = 0
    last_deg: float = 0.0

    def add(
        self, piece: Samples, deg: Floats, segment: int, circle_deg: float, max_rpm: float | None
    ) -> None:
        """Take in a piece; turns are not sure any more once a step was too long to tell."""
        if segment != self.segment:
            self.segment, self.unsure = segment, False
            self.last_ns, self.last_deg = int(piece.t_ns[0]), float(deg[0])
        span = np.diff(piece.t_ns, prepend=self.last_ns)
        doubtful = np.abs(np.diff(deg, prepend=self.last_deg)) > circle_deg / 4
        if max_rpm is not None:
            doubtful |= span * (max_rpm * 6 / 1e9) > circle_deg / 2
        unsure = np.maximum.accumulate(doubtful) | self.unsure
        self.unsure = bool(unsure[-1])
        self.last_ns, self.last_deg = int(piece.t_ns[-1]), float(deg[-1])
        known = np.where(unsure, circle_deg, np.inf)
        new = Line(piece.t_ns, piece.seq, deg, np.full(len(deg), segment, np.int64), known)
        self.waiting = self.waiting.followed_by(new).of(slice(-MAX_WAITING, None))
