"""Moments that somebody wants to find again, as the recorder marked them."""

from typing import TYPE_CHECKING

from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    from syncline_schemas.proto import syncline_pb2

MAX_MARKS = 1000
"""Marks of one file that are kept; the rest is only counted."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A moment [ns]; `bus` is the bus number, None where no bus or node is concerned."""

    t_ns: int
    reason: str
    bus: int | None = None
    node: int | None = None


def mark_message(mark: Mark) -> "syncline_pb2.Mark":
    """The message of a mark."""
    from syncline_schemas.proto import syncline_pb2

    return syncline_pb2.Mark(t_ns=mark.t_ns, reason=mark.reason, bus=mark.bus, node=mark.node)


def mark_of(message: "syncline_pb2.Mark") -> Mark:
    """The mark that a message tells of."""
    return Mark(
        message.t_ns,
        message.reason,
        message.bus if message.HasField("bus") else None,
        message.node if message.HasField("node") else None,
    )
