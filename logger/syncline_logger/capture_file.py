"""A capture on disk: written in whole chunks, each of them synced."""

import errno
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from syncline_logger.decoding import ChannelSpec
from syncline_logger.disk import Disk
from syncline_logger.segments import whole_path
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.chunk import ZSTD_LEVEL
from syncline_schemas.capture.layout import Attachment, BusInfo, CaptureMetadata, Compression
from syncline_schemas.capture.message import MessageBlock
from syncline_schemas.capture.writer import CaptureWriter

Block = tuple[ChannelSpec, MessageBlock]
"""Messages of one channel, before the file has given the channel an id."""


class CaptureFile:
    """One file of a recording. Everything that `write` returned from survives a power cut.

    Any method but `abandon` raises OSError when the disk refuses; then the file is to be abandoned.

    Attributes:
        path: where it is.
        begun_as: where it was begun.
        frames: in chunks that are on the disk.
        start_ns, end_ns: log times of the first and last message in such chunks; None before one.
        last_chunk_bytes: size of the last chunk.
    """

    def __init__(
        self,
        path: Path,
        about: CaptureMetadata,
        buses: Sequence[BusInfo],
        *,
        attachments: Sequence[Attachment] = (),
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        compression: Compression = "zstd",
        zstd_level: int = ZSTD_LEVEL,
        sync: bool = True,
        disk: Disk | None = None,
    ) -> None:
        self._disk = disk or Disk()
        if whole_path(path).exists():
            raise FileExistsError(errno.EEXIST, "recordings never overwrite a file", path)
        self.path = self.begun_as = path
        self._sync = sync
        self._attached = {attachment.name: attachment.data for attachment in attachments}
        self.frames = self.last_chunk_bytes = self._good_bytes = 0
        self.start_ns: int | None = None
        self.end_ns: int | None = None
        self._stream = self._disk.create(path)
        try:
            self._writer = CaptureWriter(
                self._stream,
                about,
                buses,
                compression=compression,
                zstd_level=zstd_level,
                attachments=attachments,
            )
            for name, values in (metadata or {}).items():
                self.add_metadata(name, values)
            self._commit()
            self._sync_folder()
        except BaseException:
            self.abandon()
            raise

    @property
    def bytes_written(self) -> int:
        """Size of the file so far."""
        return self._writer.bytes_written

    @property
    def index_bytes(self) -> int:
        """Size of the index, which is kept in memory until the file is finished."""
        return self._writer.index_bytes

    @property
    def bytes_on_disk(self) -> int:
        """Size of what is there for sure."""
        return self._good_bytes

    def write(
        self, frames: FrameBatch, log_ns: NDArray[np.int64], blocks: Iterable[Block] = ()
    ) -> None:
        """Write one chunk and wait until it is on the disk."""
        registered = [
            replace(
                block,
                channel=self._writer.add_channel(spec.topic, spec.schema, dict(spec.metadata)),
            )
            for spec, block in blocks
        ]
        self.last_chunk_bytes = self._writer.write_chunk(frames, log_ns, registered)
        self._commit()
        self.frames += len(frames)
        for times in (log_ns, *(block.log_time_ns for block in registered)):
            if len(times):
                first_ns, last_ns = int(times[0]), int(times[-1])
                self.start_ns = min(first_ns, self.start_ns or first_ns)
                self.end_ns = max(last_ns, self.end_ns or last_ns)

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
        """Write summary and footer, close the file and give it its name."""
        self._writer.finish()
        self._commit()
        self._stream.close()
        whole = whole_path(self.path)
        # A reader may hold the old name where that keeps files from being renamed: the next start
        # of a recorder gives the file its name then.
        with suppress(OSError):
            if whole != self.path:
                self._disk.replace(self.path, whole)
                self.path = whole

    def abandon(self) -> None:
        """Close the file where its last whole chunk ends; one without a chunk is taken away."""
        with suppress(OSError):
            if self._good_bytes:
                self._stream.truncate(self._good_bytes)
        with suppress(OSError):
            self._stream.close()
        if self.start_ns is None:
            with suppress(OSError):
                self._disk.remove(self.path)

    def _commit(self) -> None:
        if self._sync:
            self._stream.sync()
        self._good_bytes = self._writer.bytes_written

    def _sync_folder(self) -> None:
        if self._sync:
            self._disk.sync_folder(self.path.parent)
