"""Our own capture format, from frames that were recorded elsewhere."""

import hashlib
from importlib.metadata import version
from typing import BinaryIO

import numpy as np

from syncline_analyzer.redaction import REDACTED_KEY
from syncline_analyzer.writers.carried import NOT_SOCKETCAN, write_marks
from syncline_analyzer.writers.log import LogWriter, Survey
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.adapter_fit import fits_record
from syncline_schemas.capture.gap_message import gap_message
from syncline_schemas.capture.layout import (
    ADAPTERS_METADATA_NAME,
    GAP_TOPIC,
    LEARNED_METADATA_NAME,
    Attachment,
    BusInfo,
    CaptureMetadata,
)
from syncline_schemas.capture.learned import learned_record
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.proto import syncline_pb2


class McapWriter(LogWriter):
    """Writes frames and gaps; the recording id is made of what was converted."""

    def __init__(
        self, stream: BinaryIO, survey: Survey, attachments: tuple[Attachment, ...] = ()
    ) -> None:
        super().__init__(stream, survey)
        identity = f"{survey.source}|{survey.frames}|{survey.first_ns}"
        metadata = CaptureMetadata(
            version=version("syncline"),
            recording_id=hashlib.sha256(identity.encode()).hexdigest()[:16],
            created_ns=survey.first_ns,
            clock=survey.clock if survey.clock != "unknown" else "log",
            resolution_ns=survey.resolution_ns,
            time_base=survey.time_base,
            source=survey.source,
            extra={REDACTED_KEY: survey.redacted} if survey.redacted else {},
        )
        buses = [
            BusInfo(
                name,
                number,
                survey.bitrates.get(name),
                survey.data_bitrates.get(name),
                interface=NOT_SOCKETCAN if name in survey.foreign_errors else "",
            )
            for number, name in enumerate(survey.buses)
        ]
        self._writer = CaptureWriter(stream, metadata, buses, attachments=attachments)
        if learned := learned_record(survey.learned):
            self._writer.add_metadata(LEARNED_METADATA_NAME, learned)
        if adapters := fits_record(survey.adapter_fits):
            self._writer.add_metadata(ADAPTERS_METADATA_NAME, adapters)

    def write(self, batch: FrameBatch) -> None:
        """Write frames."""
        self._writer.write_frames(batch)

    def gap(self, gap: Gap) -> None:
        """Write a gap at its end, when the recorder could know of it."""
        payload = gap_message(gap).SerializeToString()
        channel = self._writer.add_channel(GAP_TOPIC, schema_of(syncline_pb2.Gap.DESCRIPTOR))
        end_ns = np.array([gap.end_ns], np.int64)
        length = np.array([len(payload)], np.int64)
        block = MessageBlock(channel, end_ns, end_ns, length, np.frombuffer(payload, np.uint8))
        self._writer.write_chunk(FrameBatch.empty(), messages=[block])

    def close(self) -> None:
        """Write the marks, summary and footer."""
        write_marks(self._writer, self._survey.marks)
        self._writer.finish()
