"""Messages of error control that may tell that a node started anew."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.folds.nmt.columns import Columns
from syncline_analyzer.folds.nmt.kinds import BOOT_UP, HEARTBEAT
from syncline_schemas.canopen.nmt import STATE_OF_BYTE, NmtState
from syncline_schemas.named_tuples import NamedTuple

STARTED = (0x04, 0x05)
"""State bytes of STOPPED and OPERATIONAL, into which a node does not boot."""
_BOOTED = np.isin(
    np.arange(256), [b for b, s in STATE_OF_BYTE.items() if s is NmtState.PRE_OPERATIONAL]
)


class LastTold(NamedTuple):
    """The last message of a node that is no request."""

    seq: int
    kind: int
    state: int


class Restart(NamedTuple):
    """A boot-up (`since_seq` is None), or a heartbeat that may be one of a device that boots so.

    That heartbeat falls to PRE-OPERATIONAL, the state `byte`, from a state that was told at
    `since_seq` last.
    """

    seq: int
    t_ns: int
    byte: int
    since_seq: int | None


def restarts(last: LastTold | None, beats: Columns, kinds: NDArray[np.int8]) -> Iterator[Restart]:
    """What among messages of a node, all but the requests, may be a restart, in order of `seq`.

    Args:
        last: the message before them.
        beats: the messages.
        kinds: (n,) of each.
    """
    before = last or LastTold(-1, BOOT_UP, 0)
    state = beats.byte & np.uint8(0x7F)
    seq_before = np.concatenate(([before.seq], beats.seq[:-1]))
    state_before = np.concatenate(([before.state], state[:-1]))
    beating = kinds == HEARTBEAT
    beat_before = np.concatenate(([before.kind == HEARTBEAT], beating[:-1]))
    fell = beating & beat_before & np.isin(state_before, STARTED) & _BOOTED[state]
    booted = kinds == BOOT_UP
    for row in np.flatnonzero(fell | booted).tolist():
        since_seq = None if booted[row] else int(seq_before[row])
        yield Restart(int(beats.seq[row]), int(beats.t_ns[row]), int(state[row]), since_seq)
