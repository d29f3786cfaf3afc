"""Records that each tell their own length, found without a loop over them."""

import numpy as np
from numpy.typing import NDArray

_WINDOW = 1 << 15
"""Places looked at together: few enough for the processor's cache."""


def chained(lengths: NDArray[np.int64], step: int, end: int) -> tuple[NDArray[np.intp], int]:
    """Places of the whole records that follow each other from 0 on, and where the last one ends.

    Args:
        lengths: (m,) what the record at place `i * step` would be long [bytes]; 0 or less where
            none can begin. Only multiples of `step` are lengths.
        step: distance of the places looked at.
        end: number of bytes there are; a record must end there or before.
    """
    steps = lengths // step
    whole = (lengths > 0) & (steps * step == lengths)
    whole &= np.arange(len(lengths)) * step + lengths <= end
    jump = np.where(whole, np.minimum(steps, len(lengths)), 0).astype(np.int32)
    chains, at = [np.zeros(0, np.intp)], 0
    while at < len(jump) and jump[at]:
        part = _chain(jump[at : at + _WINDOW])
        chains.append(part + at)
        last = int(chains[-1][-1])
        at = last + int(jump[last])
    chain = np.concatenate(chains)
    return chain * step, at * step


def _chain(jump: NDArray[np.int32]) -> NDArray[np.intp]:
    """(n,) places reached from 0 by jumps, up to the end or to a place whose jump is 0.

    Every place's successor is known at once, so the chain doubles with each look: its first 2^k
    places, each moved on by 2^k jumps, are the next 2^k.
    """
    stop = len(jump)
    after = np.arange(stop + 1, dtype=np.int32)
    after[:-1] = np.where(jump > 0, np.minimum(after[:-1] + jump, stop), stop)
    chain = np.zeros(1, np.int32)
    while chain[-1] != stop:
        chain = np.concatenate((chain, after[chain]))
        after = after[after]
    reached = chain[: int(np.searchsorted(chain, stop))].astype(np.intp)
    return reached if jump[reached[-1]] > 0 else reached[:-1]
