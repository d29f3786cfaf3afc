"""What answers waited for, summed up by the frames ahead of them: `waiting_sums.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.native.library import AT, INT, Loop, check, column_of
from syncline_schemas.native.waiting import Bools, Floats, Ints, begins_and_edges

_DELAYS = Loop("delays", INT, *[AT] * 4, INT, AT, INT, INT, *[AT] * 5, INT, *[AT] * 8)
_SENDERS = 1 << 16
_NEVER = np.iinfo(np.int64).max


class DelayColumns(NamedTuple):
    """How many answers waited, and sums by PDO and key, or group, of the frames ahead of them.

    Attributes:
        waited: answers.
        frames, ns, worst_ns, worst_seq: (p, k), the last two of the answer that waited longest.
        again: (p, k) frames of a key beyond the first one ahead of an answer.
        group_again, group_worst_ns, group_worst_seq: (p, g) of the answers with several of a group.
    """

    waited: int
    frames: Ints
    ns: Floats
    worst_ns: Floats
    worst_seq: Ints
    again: Ints
    group_again: Ints
    group_worst_ns: Floats
    group_worst_seq: Ints


def delays(
    frames: tuple[Ints, Floats, NDArray[np.int16], Ints],
    group_of: NDArray[np.intp],
    groups: int,
    starts: Ints,
    answers: tuple[Ints, Ints, Bools],
    part: int,
) -> DelayColumns:
    """What answers waited for.

    frames: (n,) place of each one's key, its time on the wire, its sender and its `seq`.
    group_of: (k,) of `groups`, of each key. starts: (p,) where the answers of each PDO begin.
    answers: (r,) their rows, those of the first frames that they waited for, and whether that is
    known. part: times of so many answers are summed up at a time.
    """
    check(max(len(frames[0]), len(answers[0])) < 1 << 31 and part > 0)
    count, keys, pdos, asked = len(frames[0]), len(group_of), len(starts), len(answers[0])
    counts, times = np.zeros((pdos, keys, 3), np.int64), np.zeros((pdos, keys, 3))
    again, worst_ns = np.zeros((pdos, groups), np.int64), np.zeros((pdos, groups))
    counts[:, :, 2] = _NEVER
    worst_seq = np.full((pdos, groups), _NEVER)
    waited = _DELAYS(
        count,
        column_of(frames[0], np.int64, count),
        column_of(frames[1], np.float64, count),
        column_of(frames[2], np.int16, count),
        column_of(frames[3], np.int64, count),
        keys,
        column_of(group_of, np.int64, keys),
        groups,
        pdos,
        *begins_and_edges(starts, asked),
        column_of(answers[0], np.int64, asked),
        column_of(answers[1], np.int64, asked),
        column_of(answers[2], np.bool_, asked),
        part,
        *(counts, times, again, worst_ns, worst_seq),
        *(np.full(_SENDERS, -1, np.int32), _none(2 * keys), _none(2 * groups)),
    )
    check(waited >= 0)
    by_key = counts[:, :, 0], times[:, :, 0], times[:, :, 2], counts[:, :, 2], counts[:, :, 1]
    return DelayColumns(waited, *by_key, again, worst_ns, worst_seq)


def _none(count: int) -> Ints:
    return np.full(count, -1, np.int64)
