"""Gaps as messages on their way into a file: reading them back, joining them."""

from collections.abc import Iterable, Sequence

from syncline_logger.capture_file import Block
from syncline_logger.decoding import UNREGISTERED
from syncline_logger.recorder_messages import GAP_CHANNEL
from syncline_schemas.batch import Gap
from syncline_schemas.capture.gap_message import gap_message, gap_of
from syncline_schemas.capture.layout import GAP_TOPIC
from syncline_schemas.capture.message import MessageBlock
from syncline_schemas.proto import syncline_pb2

MORE = "further gaps of several reasons"
"""Reason of what was joined where there were too many reasons to name each."""


def gaps_of(blocks: Iterable[Block]) -> list[Gap]:
    """The gaps that these blocks tell of."""
    found = []
    for spec, block in blocks:
        if spec.topic == GAP_TOPIC:
            data, end = block.payload.tobytes(), 0
            for length in block.length.tolist():
                begin, end = end, end + length
                found.append(gap_of(syncline_pb2.Gap.FromString(data[begin:end])))
    return found


def gap_block(gaps: Sequence[Gap], log_ns: int) -> Block:
    """Messages of gaps, all of one log time."""
    times = [log_ns] * len(gaps)
    messages = [gap_message(gap) for gap in gaps]
    return GAP_CHANNEL, MessageBlock.of_messages(UNREGISTERED, times, times, messages)


def joined(first: Gap, second: Gap) -> Gap:
    """One gap over two of the same bus, with the reason of the first and the frames of both."""
    counts = [n for n in (first.lost_frames, second.lost_frames) if n is not None]
    return Gap(
        min(first.start_ns, second.start_ns),
        max(first.end_ns, second.end_ns),
        first.reason,
        sum(counts) if counts else None,
        first.bus,
    )


def join_into(found: dict[tuple[int | None, str], Gap], gap: Gap, most: int) -> None:
    """Add a gap to those of its bus and reason; beyond `most` of them to those of its bus alone."""
    key = gap.bus, gap.reason
    if key not in found and len(found) >= most:
        key = gap.bus, MORE
        gap = Gap(gap.start_ns, gap.end_ns, MORE, gap.lost_frames, gap.bus)
    found[key] = joined(found[key], gap) if key in found else gap
