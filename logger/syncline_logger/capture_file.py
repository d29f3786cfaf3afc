"""A capture on disk: named, written in whole chunks, each of them synced."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from syncline_logger.decoding import ChannelSpec
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import Attachment, BusInfo, CaptureMetadata, Compression
from syncline_schemas.capture.message import MessageBlock
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.errors import UsageError

SUFFIX = ".mcap"


def capture_path(target: Path, created_ns: int, recording_id: str) -> Path:
    """Where to write: `target` itself, or in that folder a name from UTC start and recording id.

    Raises UsageError when the file is there already.

    >>> capture_path(Path("x.mcap"), 0, "3f2a")
    PosixPath('x.mcap')
    """
    path = target
    if target.is_dir() or target.suffix != SUFFIX:
        start = datetime.fromtimestamp(created_ns // 1_000_000_000, UTC)
        path = target / f"{start:%Y%m%dT%H%M%SZ}_{recording_id}{SUFFIX}"
    if path.exists():
        raise UsageError(f"{path} exists; recordings never overwrite a file")
    return path


class CaptureFile:
    """The file of one recording. Everything that `write` returned from survives a power cut."""

    def __init__(
        self,
        path: Path,
        metadata: CaptureMetadata,
        buses: Sequence[BusInfo],
        *,
        attachments: Sequence[Attachment] = (),
        compression: Compression = "zstd",
        sync: bool = True,
    ) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._sync = sync
        self._attached = {attachment.name: attachment.data for attachment in attachments}
        self._stream = path.open("xb")
        try:
            self._writer = CaptureWriter(
                self._stream, metadata, buses, compression=compression, attachments=attachments
            )
            self._commit()
            self._sync_folder()
        except BaseException:
            self._stream.close()
            raise

    @property
    def bytes_written(self) -> int:
        """Size of the file so far."""
        return self._writer.bytes_written

    def write(
        self,
        frames: FrameBatch,
        log_ns: NDArray[np.int64],
        blocks: Iterable[tuple[ChannelSpec, MessageBlock]] = (),
    ) -> None:
        """Write one chunk and wait until it is on the disk."""
        registered = [
            replace(
                block,
                channel=self._writer.add_channel(spec.topic, spec.schema, dict(spec.metadata)),
            )
            for spec, block in blocks
        ]
        self._writer.write_chunk(frames, log_ns, registered)
        self._commit()

    def attach(self, attachment: Attachment) -> None:
        """Attach a file, once: the same content under the same name is there already."""
        if self._attached.get(attachment.name) == attachment.data:
            return
        self._attached[attachment.name] = attachment.data
        self._writer.attach(attachment)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self._writer.add_metadata(name, values)

    def finish(self) -> None:
        """Write summary and footer and close the file."""
        self._writer.finish()
        self._commit()
        self._stream.close()

    def abandon(self) -> None:
        """Close the file as it is; it can be read up to the last chunk."""
        self._stream.close()

    def _commit(self) -> None:
        self._stream.flush()
        if self._sync:
            os.fsync(self._stream.fileno())

    def _sync_folder(self) -> None:
        """Make the file's name durable too; Windows does that by itself."""
        if not self._sync or os.name != "posix":
            return
        folder = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
