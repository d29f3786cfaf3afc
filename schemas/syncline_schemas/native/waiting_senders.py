"""Who sent frames, by their identifiers: `waiting_senders.c`."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.native.library import AT, INT, Loop, column_of

_SEEN = Loop("seen", INT, AT, AT, INT, AT)
_SENT_BY = Loop("sent_by", INT, AT, AT, INT, AT, INT, AT)
_KEYS = Loop("keys", INT, *[AT] * 6)
_MOST_KEYS = 1 << 12
"""Identifiers of 11 bits, of data frames and of remote ones."""


def seen_ids(
    can_id: NDArray[np.uint32], flags: NDArray[np.uint16], others: int
) -> NDArray[np.bool_]:
    """(4096,) identifiers, those of remote frames last, of all frames with no flags of `others`."""
    count, seen = len(can_id), np.zeros(_MOST_KEYS, np.bool_)
    ids, kinds = column_of(can_id, np.uint32, count), column_of(flags, np.uint16, count)
    _SEEN(count, ids, kinds, others, seen)
    return seen


def sent_by(
    can_id: NDArray[np.uint32],
    flags: NDArray[np.uint16],
    others: int,
    sender_of: NDArray[np.int16],
    unknown: int,
) -> NDArray[np.int16]:
    """(n,) sender of each frame by its place in `seen_ids`; `unknown` for flags of `others`."""
    count, found = len(can_id), np.empty(len(can_id), np.int16)
    ids, kinds = column_of(can_id, np.uint32, count), column_of(flags, np.uint16, count)
    table = column_of(sender_of, np.int16, _MOST_KEYS)
    _SENT_BY(count, ids, kinds, others, table, unknown, found)
    return found


def short_keys(
    can_id: NDArray[np.uint32], flags: NDArray[np.uint16], sender: NDArray[np.int16]
) -> tuple[NDArray[np.int64], NDArray[np.int16], NDArray[np.int64]] | None:
    """Keys of 11-bit frames, the sender of each, and (n,) the place of each frame's key.

    None where a frame has an identifier of 29 bits.
    """
    count = len(can_id)
    place, found = np.empty(count, np.int64), np.empty(_MOST_KEYS, np.int64)
    senders = np.empty(_MOST_KEYS, np.int16)
    told = _KEYS(
        count,
        column_of(can_id, np.uint32, count),
        column_of(flags, np.uint16, count),
        column_of(sender, np.int16, count),
        *(place, found, senders),
    )
    return None if told < 0 else (found[:told], senders[:told], place)
