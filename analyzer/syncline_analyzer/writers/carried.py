"""What else than frames is carried from one capture of ours into another."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from syncline_analyzer.capture import CaptureFacts
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import MARK_TOPIC
from syncline_schemas.capture.mark import Mark, mark_message
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.proto import syncline_pb2

NOT_SOCKETCAN: Final = "not SocketCAN"
"""Interface of a bus whose error frames hold another driver's bytes."""


def merged_marks(facts: Sequence[CaptureFacts], buses: Sequence[str]) -> list[Mark]:
    """The marks of all files in order of time, their buses as they are numbered in `buses`."""
    found = []
    for each in facts:
        for mark in each.marks:
            known = mark.bus is not None and mark.bus < len(each.buses)
            name = each.buses[mark.bus] if known and mark.bus is not None else None
            found.append(replace(mark, bus=buses.index(name) if name in buses else None))
    return sorted(found, key=lambda mark: mark.t_ns)


def write_marks(writer: CaptureWriter, marks: Sequence[Mark]) -> None:
    """Write marks, where there are any."""
    if not marks:
        return
    payloads = [mark_message(mark).SerializeToString() for mark in marks]
    channel = writer.add_channel(MARK_TOPIC, schema_of(syncline_pb2.Mark.DESCRIPTOR))
    times_ns = np.array([mark.t_ns for mark in marks], np.int64)
    lengths = np.array([len(payload) for payload in payloads], np.int64)
    data = np.frombuffer(b"".join(payloads), np.uint8)
    block = MessageBlock(channel, times_ns, times_ns, lengths, data)
    writer.write_chunk(FrameBatch.empty(), messages=[block])
