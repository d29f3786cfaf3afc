"""A Gap as the message of `/recorder/gap`, and back."""

from typing import TYPE_CHECKING

from syncline_schemas.batch import Gap

if TYPE_CHECKING:
    from syncline_schemas.proto import syncline_pb2

DID_NOT_RUN = "the recorder did not run"
"""Reason of the gap at the head of a recording that follows another one in the same folder."""


def gap_message(gap: Gap) -> "syncline_pb2.Gap":
    """The message of a gap."""
    from syncline_schemas.proto import syncline_pb2

    return syncline_pb2.Gap(
        start_ns=gap.start_ns,
        end_ns=gap.end_ns,
        reason=gap.reason,
        lost_frames=gap.lost_frames,
        bus=gap.bus,
    )


def gap_of(message: "syncline_pb2.Gap") -> Gap:
    """The gap that a message tells of."""
    return Gap(
        message.start_ns,
        message.end_ns,
        message.reason,
        message.lost_frames if message.HasField("lost_frames") else None,
        message.bus if message.HasField("bus") else None,
    )
