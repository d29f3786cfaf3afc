"""Words for frames: frames of one kind and identifier, and what each of them says."""

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

Rows = NDArray[np.intp]


class Tone(StrEnum):
    """How loud a frame is."""

    PLAIN = "plain"
    QUIET = "quiet"
    """What comes all the time and tells nothing new."""
    ORDER = "order"
    """Somebody changes something: NMT commands, boot-ups."""
    GOOD = "good"
    BAD = "bad"


class Words(NamedTuple):
    """What one frame says; `opaque` where only its bytes are known."""

    text: str
    tone: Tone = Tone.PLAIN
    opaque: bool = False


@dataclass(frozen=True, slots=True)
class Head:
    """What frames have in common.

    Attributes:
        bus: number of the bus.
        can_id, extended: their identifier.
        service: "NMT", "TPDO1", "SDO request" and the like.
        family: the name by which they are chosen, one of `FAMILIES`.
        node: the node that they are of or for; 0 is all nodes, None is nobody known.
    """

    bus: int
    can_id: int
    service: str
    family: str
    node: int | None = None
    extended: bool = False


FAMILIES = ("nmt", "sync", "emcy", "time", "pdo", "sdo", "heartbeat", "lss", "error", "other")


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Frames of a batch with the same head.

    Attributes:
        head: what they have in common.
        rows: (m,) intp, their rows in the batch.
        first: (k,) intp, one row for each of `words`.
        words: what frames of equal content say.
        which: (m,) intp, index into `words` by row.
    """

    head: Head
    rows: Rows
    first: Rows
    words: list[Words]
    which: Rows


def distinct(frames: FrameBatch, rows: Rows) -> tuple[Rows, Rows]:
    """Rows with equal content: one row of each kind, and (m,) the number of the kind by row.

    Frames of CAN FD are all kept apart.
    """
    if frames.data.shape[1] > 8 and bool((frames.dlc[rows] > 8).any()):
        return rows, np.arange(len(rows))
    data = np.ascontiguousarray(frames.data[rows, :8]).view(np.uint64)[:, 0]
    length = frames.dlc[rows]
    if bool((data == data[0]).all()) and bool((length == length[0]).all()):
        return rows[:1], np.zeros(len(rows), np.intp)
    if bool((length == length[0]).all()):
        _, first, which = np.unique(data, return_index=True, return_inverse=True)
        return rows[first], which
    first, which = np.zeros(0, np.intp), np.zeros(len(rows), np.intp)
    for each in np.unique(length).tolist():
        mine = np.flatnonzero(length == each)
        _, at, kind = np.unique(data[mine], return_index=True, return_inverse=True)
        which[mine] = kind + len(first)
        first = np.concatenate((first, rows[mine[at]]))
    return first, which
