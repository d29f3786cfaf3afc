"""Which frames are wanted."""

import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.decode.part import FAMILIES, Head
from syncline_analyzer.fold import IndexedBatch
from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

_RANGE = re.compile(r"(?:0x)?([0-9a-f]{1,8})h?(?:-(?:0x)?([0-9a-f]{1,8})h?)?", re.IGNORECASE)
_FRAMES = re.compile(r"(\d+)(?:-(\d+))?")
_LAST_ID = 0x1FFFFFFF
_LAST = 1 << 62


@dataclass(frozen=True, slots=True)
class Choice:
    """What all of a frame must match; what is empty matches everything.

    Attributes:
        nodes: the node that it is of or for; what is for all nodes is wanted as well.
        families: of `FAMILIES`.
        ids: identifiers by inclusive ranges.
        seqs: inclusive range of places in the capture.
        low_ns, high_ns: half-open range of time.
    """

    nodes: frozenset[int] = frozenset()
    families: frozenset[str] = frozenset()
    ids: tuple[tuple[int, int], ...] = ()
    seqs: tuple[int, int] = (0, _LAST)
    low_ns: int = -_LAST
    high_ns: int = _LAST

    def rows(self, batch: IndexedBatch) -> NDArray[np.bool_]:
        """(n,) whether each frame matches by place, time and identifier."""
        frames, wanted = batch.frames, np.ones(len(batch), np.bool_)
        if (self.low_ns, self.high_ns) != (-_LAST, _LAST):
            wanted &= (frames.t_ns >= self.low_ns) & (frames.t_ns < self.high_ns)
        if self.seqs != (0, _LAST):
            wanted &= (batch.seqs >= self.seqs[0]) & (batch.seqs <= self.seqs[1])
        if self.ids:
            listed = np.zeros(len(batch), np.bool_)
            for low, high in self.ids:
                listed |= (frames.can_id >= low) & (frames.can_id <= high)
            wanted &= listed
        return wanted

    def head(self, head: Head) -> bool:
        """Whether frames match by service and node."""
        if self.families and head.family not in self.families:
            return False
        if not self.nodes:
            return True
        for_all = head.family == "nmt" and head.node == 0
        return for_all or head.node in self.nodes

    def gap(self, start_ns: int, end_ns: int) -> bool:
        """Whether a stretch without frames is to be told."""
        return start_ns < self.high_ns and end_ns > self.low_ns and self.seqs == (0, _LAST)

    def over(self, batch: IndexedBatch) -> bool:
        """Whether nothing wanted comes any more: the whole batch is behind the range."""
        behind = batch.seq0 > self.seqs[1]
        return behind or bool(len(batch) and (batch.frames.t_ns >= self.high_ns).all())


def id_ranges(texts: Iterable[str]) -> tuple[tuple[int, int], ...]:
    """Inclusive ranges of identifiers from "18A", "0x180-0x1FF", "80,700-77F".

    >>> id_ranges(["18A,200-27F"])
    ((394, 394), (512, 639))

    Raises:
        UsageError: a text is none of these.
    """
    found = []
    for part in (part.strip() for text in texts for part in text.split(",")):
        match = _RANGE.fullmatch(part)
        low = int(match[1], 16) if match else 0
        high = int(match[2] or match[1], 16) if match else -1
        if not low <= high <= _LAST_ID:
            raise UsageError(
                f"--cob-id {part!r}: write identifiers in hexadecimal digits as 18A or 180-1FF"
            )
        found.append((low, high))
    return tuple(found)


def frame_range(text: str | None) -> tuple[int, int]:
    """Inclusive range of places in the capture from "1200-1300" or "1200".

    >>> frame_range("1200-1300"), frame_range("7")
    ((1200, 1300), (7, 7))

    Raises:
        UsageError: the text is none of these.
    """
    if text is None:
        return 0, _LAST
    match = _FRAMES.fullmatch(text.strip())
    low = int(match[1]) if match else 0
    high = int(match[2] or match[1]) if match else -1
    if low > high:
        raise UsageError(f"--frames {text!r}: write it as 1200-1300, or as one number")
    return low, high


def node_numbers(texts: Iterable[str]) -> frozenset[int]:
    """Nodes from "5", "0x0A", "5,6".

    Raises:
        UsageError: a text is no node.
    """
    found = set()
    for part in (part.strip() for text in texts for part in text.split(",")):
        try:
            node = int(part, 0)
        except ValueError:
            node = 0
        if not 1 <= node <= 127:
            raise UsageError(f"--node {part!r}: a node is a number from 1 to 127")
        found.add(node)
    return frozenset(found)


def families(texts: Iterable[str]) -> frozenset[str]:
    """Services from "emcy", "sdo,pdo".

    Raises:
        UsageError: a text is none of `FAMILIES`.
    """
    found = {part.strip().lower() for text in texts for part in text.split(",")}
    if wrong := sorted(found - {*FAMILIES}):
        raise UsageError(f"--service {wrong[0]!r}: it is one of {', '.join(FAMILIES)}")
    return frozenset(found)
