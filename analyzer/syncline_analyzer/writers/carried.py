"""What else than frames is carried from one capture of ours into another."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from syncline_analyzer.capture import CaptureFacts
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import MARK_TOPIC
from syncline_schemas.capture.learned import Settings
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


def merged_learned(
    facts: Sequence[CaptureFacts], buses: Sequence[str]
) -> dict[tuple[int, int], Settings]:
    """What segments before the earliest file revealed, its buses as they are numbered in `buses`.

    Nothing where the files are of several recordings: what held at the start of one of them is not
    known to hold at the start of the first.
    """
    firsts = _firsts(facts)
    if len(firsts) != 1:
        return {}
    return {
        (buses.index(firsts[0].buses[bus]), node): settings
        for (bus, node), settings in firsts[0].learned.items()
        if bus < len(firsts[0].buses) and firsts[0].buses[bus] in buses
    }


def learned_count(facts: Sequence[CaptureFacts]) -> int:
    """How many values of objects were revealed before the first file of each recording."""
    return sum(len(settings) for each in _firsts(facts) for settings in each.learned.values())


def _firsts(facts: Sequence[CaptureFacts]) -> list[CaptureFacts]:
    """The earliest file of each recording: what is known before the others stands in it."""
    ordered = sorted(facts, key=_created_ns, reverse=True)
    return list({each.metadata.get("recording_id"): each for each in ordered}.values())


def _created_ns(facts: CaptureFacts) -> int:
    text = facts.metadata.get("created_ns", "")
    return int(text) if text.isdecimal() else 0


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
