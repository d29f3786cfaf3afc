"""Frames of one node's error control, and its signs of life between them."""

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.nmt.cadence import Int64s, Mask
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass


class Columns(NamedTuple):
    """Frames of one node's error control in order of `seq`; all (n,)."""

    seq: Int64s
    t_ns: Int64s
    remote: Mask
    dlc: NDArray[np.uint8]
    byte: NDArray[np.uint8]

    def rows(self, chosen: slice | NDArray[np.intp]) -> "Columns":
        """Some of the rows."""
        return Columns(
            self.seq[chosen],
            self.t_ns[chosen],
            self.remote[chosen],
            self.dlc[chosen],
            self.byte[chosen],
        )

    def after(self, held: "Columns") -> "Columns":
        """These rows after others."""
        return Columns(
            np.concatenate((held.seq, self.seq)),
            np.concatenate((held.t_ns, self.t_ns)),
            np.concatenate((held.remote, self.remote)),
            np.concatenate((held.dlc, self.dlc)),
            np.concatenate((held.byte, self.byte)),
        )


def no_columns() -> Columns:
    """No frame."""
    none, bytes_ = np.zeros(0, np.int64), np.zeros(0, np.uint8)
    return Columns(none, none, np.zeros(0, np.bool_), bytes_, bytes_)


@dataclass(slots=True)
class Life:
    """Signs of life of the node since its last beat: the longest silence between them."""

    last_seq: int
    last_ns: int
    longest_ns: int = 0
    start: tuple[int, int] = (0, 0)
    end: tuple[int, int] = (0, 0)

    def hear(self, seq: Int64s, t_ns: Int64s) -> None:
        """Take in further frames of the node."""
        if not len(seq):
            return
        first = int(t_ns[0]) - self.last_ns
        if first > self.longest_ns:
            self.longest_ns = first
            self.start = (self.last_seq, self.last_ns)
            self.end = (int(seq[0]), int(t_ns[0]))
        if len(seq) > 1:
            passed = t_ns[1:] - t_ns[:-1]
            row = int(passed.argmax())
            if passed[row] > self.longest_ns:
                self.longest_ns = int(passed[row])
                self.start = (int(seq[row]), int(t_ns[row]))
                self.end = (int(seq[row + 1]), int(t_ns[row + 1]))
        self.last_seq, self.last_ns = int(seq[-1]), int(t_ns[-1])
