"""PDOs that somebody asked for by a remote frame: they may answer that and not the SYNC."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass

Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]


@dataclass(slots=True)
class Requested:
    """Follows the remote frames to one PDO identifier from block to block (CiA 301 7.2.2.5.2)."""

    _open: bool = False
    """Asked for, and not come since."""
    _ordinal: int = -1
    """The last SYNC in whose period such a PDO came."""

    def follow(self, rows: Rows, requests: Rows) -> Mask | None:
        """(n,) which frames are the first after a request, or one written down as an empty frame.

        Both are rows of one block, in order; None where none of the frames is.
        """
        if not len(rows):
            self._open |= bool(len(requests))
            return None
        if not len(requests) and not self._open:
            return None
        until = np.searchsorted(requests, rows)
        asked: Mask = np.diff(until, prepend=-1 if self._open else 0) > 0
        asked |= np.isin(rows, requests)
        self._open = bool(until[-1] < len(requests))
        return asked if asked.any() else None

    def beside(self, ordinal: NDArray[np.int64], asked: Mask | None) -> Mask:
        """(n,) which frames came after or as such a one, by the number of the SYNC before each."""
        if not len(ordinal):
            return np.zeros(0, np.bool_)
        if asked is None:
            same: Mask = ordinal == self._ordinal
            return same
        last = np.maximum.accumulate(np.where(asked, ordinal, self._ordinal))
        self._ordinal = int(last[-1])
        found: Mask = last == ordinal
        return found

    def restart(self) -> None:
        """Forget what is open, as at a gap."""
        self._open = False
