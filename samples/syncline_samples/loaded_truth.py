"""What really happened on a loaded bus, frame by frame.

All times are true ones, ns since the UNIX epoch. `seq` counts the frames that the recorder took, as
an analyzer does; it is None for what passed while the recorder was blind.
"""

from dataclasses import dataclass, field
from typing import NamedTuple


class SentFrame(NamedTuple):
    """A frame from the start of its SOF to the end of its EOF; `bits` with the intermission."""

    seq: int | None
    can_id: int
    start_ns: int
    end_ns: int
    bits: int


class SentPdo(NamedTuple):
    """A PDO that was sent.

    Attributes:
        node: whose it is by its number; the node that takes it for an RPDO.
        sync_ns, sync_number: the SYNC that it answers, None for other types. SYNCs count from 0.
        ready_ns: when the sender asked for it to be sent.
        asked_ns: when it began to take part in arbitration: later than `ready_ns` where the sender
            hands over one frame after the other.
    """

    seq: int | None
    node: int
    can_id: int
    sync_ns: int | None
    sync_number: int | None
    ready_ns: int
    asked_ns: int
    start_ns: int
    end_ns: int


class Unsent(NamedTuple):
    """A PDO that was due and was not sent: scripted, or because the one before was still waiting."""

    can_id: int
    sync_ns: int | None
    scripted: bool


@dataclass(slots=True)
class LoadedTruth:
    """Everything about a run; complete when it has ended."""

    frames: list[SentFrame] = field(default_factory=list)
    pdos: list[SentPdo] = field(default_factory=list)
    unsent: list[Unsent] = field(default_factory=list)
    due: dict[int, list[int]] = field(default_factory=dict)
    """Numbers of the SYNCs on which each synchronous PDO was due."""
    syncs: list[SentFrame] = field(default_factory=list)
    blind: list[tuple[int, int]] = field(default_factory=list)
    started_ns: int = 0
    """Since when all nodes have been at work."""
