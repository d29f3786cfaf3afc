"""Chunks: records of several channels merged by time, compressed, and indexed."""

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.capture.checksum import crc32
from syncline_schemas.capture.layout import Compression
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    import zstandard

ZSTD_LEVEL = 1
"""Makes smaller chunks than level 3 of these records, and faster."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordRun:
    """Message records back to back, ascending in time.

    Attributes:
        data: (total,) uint8.
        length: (n,) int64, bytes of each record.
        channel: (n,) uint16.
        log_time_ns: (n,) int64.
    """

    data: NDArray[np.uint8]
    length: NDArray[np.int64]
    channel: NDArray[np.uint16]
    log_time_ns: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """A chunk ready to be written: its fields and the message index of each channel."""

    start_ns: int
    end_ns: int
    uncompressed_size: int
    crc: int
    compression: str
    data: bytes | memoryview
    index: list[tuple[int, NDArray[np.uint64]]]
    """Channel id and (n, 2) uint64 of log_time and offset."""


def merge(runs: Sequence[RecordRun]) -> RecordRun:
    """One run with the records of all, in time order; of equal times the earlier run's first."""
    if len(runs) == 1:
        return runs[0]
    length = np.concatenate([run.length for run in runs])
    time = np.concatenate([run.log_time_ns for run in runs])
    order = np.argsort(time, kind="stable")
    ordered = length[order]
    start = np.empty(len(length), np.int64)
    start[order] = np.cumsum(ordered) - ordered
    data = np.empty(int(ordered.sum()), np.uint8)
    first = 0
    for run in runs:
        _copy_records(run, data, start[first : first + len(run.length)])
        first += len(run.length)
    return RecordRun(
        data,
        ordered,
        np.concatenate([run.channel for run in runs])[order],
        time[order],
    )


def _copy_records(run: RecordRun, target: NDArray[np.uint8], start: NDArray[np.int64]) -> None:
    """Copy each record to its place; those of one length at once, as there are few lengths."""
    source = np.cumsum(run.length) - run.length
    for length in np.unique(run.length).tolist():
        rows = np.flatnonzero(run.length == length)
        _windows(target, length)[start[rows]] = _windows(run.data, length)[source[rows]]


def _windows(data: NDArray[np.uint8], length: int) -> NDArray[np.void]:
    """The `length` bytes from each byte on, each as one value, without a copy."""
    return np.ndarray((len(data) - length + 1,), f"V{length}", data, 0, (1,))


def build_chunk(run: RecordRun, compression: Compression, zstd_level: int = ZSTD_LEVEL) -> Chunk:
    """Compress and index a run of at least one record."""
    offset = np.cumsum(run.length) - run.length
    plain = run.data.tobytes()
    return Chunk(
        start_ns=int(run.log_time_ns.min()),
        end_ns=int(run.log_time_ns.max()),
        uncompressed_size=len(plain),
        crc=crc32(plain),
        compression="" if compression == "none" else compression,
        data=compress(plain, compression, zstd_level),
        index=message_index(run.channel, run.log_time_ns, offset),
    )


def message_index(
    channel: NDArray[np.uint16], log_time_ns: NDArray[np.int64], offset: NDArray[np.int64]
) -> list[tuple[int, NDArray[np.uint64]]]:
    """The message index of each channel, as in `Chunk.index`."""
    order = np.argsort(channel, kind="stable")
    entries = np.stack([log_time_ns[order], offset[order]], axis=1).astype("<u8")
    ordered = channel[order]
    cuts = np.flatnonzero(np.diff(ordered)) + 1
    starts: Sequence[int] = [0, *cuts.tolist()]
    return [
        (int(ordered[start]), part)
        for start, part in zip(starts, np.split(entries, cuts), strict=True)
        if len(part)
    ]


def compress(plain: bytes, compression: Compression, zstd_level: int = ZSTD_LEVEL) -> bytes:
    """Chunk bytes in the compression asked for."""
    if compression == "zstd":
        import zstandard

        return bytes(zstandard.ZstdCompressor(level=zstd_level).compress(plain))
    if compression == "lz4":
        import lz4.frame

        return bytes(lz4.frame.compress(plain))
    return plain


def decompress(data: bytes | memoryview, compression: str, size: int) -> bytes | str:
    """The plain bytes, or in words why they cannot be had; never raises on damaged bytes."""
    if not is_plausible(size, len(data)):
        return f"claims {size} bytes"
    plain = _decompress(data, compression, size)
    if isinstance(plain, bytes) and len(plain) != size:
        return f"holds {len(plain)} bytes instead of {size}"
    return plain


def is_plausible(size: int, packed: int) -> bool:
    """Whether a chunk may have so many plain bytes; a damaged size must not take all memory."""
    return size <= MAX_CHUNK and (size <= _BOMB_BYTES or size <= _BOMB_RATIO * packed)


MAX_CHUNK = 1 << 30
"""Largest chunk that is read."""
_BOMB_BYTES = 64 << 20
_BOMB_RATIO = 200
"""No frames pack so well as a large chunk of zeros."""


def _decompress(data: bytes | memoryview, compression: str, size: int) -> bytes | str:
    if compression == "zstd":
        return _plain_of_zstd(data, size)
    if compression == "lz4":
        return _plain_of_lz4(data, size)
    return bytes(data) if compression == "" else f"compression {compression!r} is not known"


def _plain_of_zstd(data: bytes | memoryview, size: int) -> bytes | str:
    import zstandard

    try:
        claimed = zstandard.frame_content_size(data)
        if claimed not in (-1, size):
            return f"zstd says {claimed} bytes, the chunk {size}"
        plain: bytes = _zstd_decompressor().decompress(data, max_output_size=size)
        return plain
    except (zstandard.ZstdError, MemoryError) as error:
        return f"zstd: {error}"


_of_thread = threading.local()


def _zstd_decompressor() -> "zstandard.ZstdDecompressor":
    """One for each thread: to make one costs as much as to unpack the chunk of a second."""
    import zstandard

    found: zstandard.ZstdDecompressor | None = getattr(_of_thread, "zstd", None)
    if found is None:
        found = _of_thread.zstd = zstandard.ZstdDecompressor()
    return found


def _plain_of_lz4(data: bytes | memoryview, size: int) -> bytes | str:
    import lz4.frame

    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(bytes(data), max_length=size + 1))
    except (RuntimeError, ValueError, MemoryError) as error:
        return f"lz4: {error}"
