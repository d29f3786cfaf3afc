"""Which frames the kernel dropped, from the counter that travels with those that it kept."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

JOIN_NS = 100_000_000
"""Losses closer to each other than this are one stretch."""


@dataclass(frozen=True, slots=True)
class Dropped:
    """So many frames are missing between two times [ns] of a bus."""

    frames: int
    first_ns: int
    last_ns: int


class KernelDrops:
    """Follows the drop counter of one socket (SO_RXQ_OVFL), modulo 2**32.

    A frame carries the counter as it was when the frame was queued: what was dropped behind the
    last frame of the queue shows with the next frame, or by asking the socket (`settle`). Then a
    frame that was queued before the question may carry less than is known already.
    """

    def __init__(self, start_ns: int) -> None:
        self._known = 0
        self._seen_ns = start_ns

    def take(self, drops: NDArray[np.uint32], t_ns: NDArray[np.int64]) -> list[Dropped]:
        """Take in frames. drops: (n,) counter of each; t_ns: (n,) int64, their stamps."""
        if len(drops) == 0:
            return []
        before_ns, self._seen_ns = self._seen_ns, int(t_ns[-1])
        if int(drops[0]) == int(drops[-1]) == self._known:
            return []
        ahead = (drops - np.uint32(self._known)).astype(np.int32).astype(np.int64)
        highest = np.maximum.accumulate(np.maximum(ahead, 0))
        self._known = (self._known + int(highest[-1])) & 0xFFFF_FFFF
        missing = np.diff(highest, prepend=0)
        rows = np.flatnonzero(missing)
        first_ns = np.concatenate([[before_ns], t_ns[:-1]])[rows]
        return _stretches(missing[rows], first_ns, t_ns[rows])

    def settle(self, counter: int, now_ns: int) -> Dropped | None:
        """Take in the counter as the socket tells it after its queue was found empty."""
        missing = (counter - self._known) & 0xFFFF_FFFF
        if not 0 < missing < 1 << 31:
            return None
        self._known = counter & 0xFFFF_FFFF
        return Dropped(missing, min(self._seen_ns, now_ns), max(self._seen_ns, now_ns))


def _stretches(
    missing: NDArray[np.int64], first_ns: NDArray[np.int64], last_ns: NDArray[np.int64]
) -> list[Dropped]:
    """Losses joined where they are near to each other."""
    if len(missing) == 0:
        return []
    apart = np.flatnonzero(np.abs(first_ns[1:] - last_ns[:-1]) >= JOIN_NS) + 1
    begins, ends = np.concatenate([[0], apart]), np.concatenate([apart, [len(missing)]])
    return [
        Dropped(
            int(missing[begin:end].sum()),
            int(min(first_ns[begin:end].min(), last_ns[begin:end].min())),
            int(max(first_ns[begin:end].max(), last_ns[begin:end].max())),
        )
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)
    ]
