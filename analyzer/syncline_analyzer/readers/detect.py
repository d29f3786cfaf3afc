"""Which format a file has, found from its content, and the reader for it."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from syncline_analyzer.capture import CaptureReader
from syncline_analyzer.readers.formats import KNOWN_FORMATS
from syncline_analyzer.readers.magic import (
    BINARY_MAGIC,
    BLF_MAGIC,
    FOREIGN_MAGIC,
    MCAP_MAGIC,
    MF4_MAGIC,
    PCAP_MAGIC,
    PCAPNG_MAGIC,
    ZIP_MAGIC,
)
from syncline_analyzer.readers.source import (
    BLOCK_BYTES,
    GZIP_MAGIC,
    ZSTD_MAGIC,
    CaptureSource,
    LineSource,
)
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.errors import CaptureError

if TYPE_CHECKING:
    from syncline_analyzer.readers.lines import LineFormat

_LINES_LOOKED_AT = 2000


def open_capture(
    path: str | Path,
    *,
    start_ns: int | None = None,
    end_ns: int | None = None,
    block_bytes: int = BLOCK_BYTES,
) -> CaptureReader:
    """Reader for a capture or log of any known format, whatever the name of the file.

    Args:
        path: the file; gzip and zstd are unpacked on the way.
        start_ns, end_ns: only frames with `start_ns <= t_ns < end_ns`, in the log's own time.
        block_bytes: how much text is read at once.

    Raises:
        CaptureError: the file cannot be read, is empty, or is of no known format.
    """
    path = Path(path)
    if path.is_dir():
        raise CaptureError(f"{path}: is a directory; name the capture files in it")
    head = _head(path)
    if head.startswith(MCAP_MAGIC):
        return _indexed(path, lambda found: _mcap_reader(found, start_ns, end_ns))
    if head.startswith(ZIP_MAGIC):
        from syncline_analyzer.readers.bundled import BundledReader

        return BundledReader(path, lambda found: _mcap_reader(found, start_ns, end_ns))
    reader = _reader(path, head, block_bytes)
    if start_ns is None and end_ns is None:
        return reader
    return WindowReader(reader, start_ns, end_ns)


def _indexed(path: Path, opened: Callable[[Path], CaptureReader]) -> CaptureReader:
    """A reader of a format that is read through its index; packed files are unpacked first."""
    if not _is_packed(path):
        return opened(path)
    from syncline_analyzer.readers.packed import PackedReader

    return PackedReader(path, opened)


def _mcap_reader(path: Path, start_ns: int | None, end_ns: int | None) -> CaptureReader:
    from syncline_analyzer.readers.mcap import McapReader
    from syncline_schemas.capture.ros2_bag import bag_schemas

    if bag_schemas(path):
        from syncline_analyzer.readers.ros2 import Ros2Reader

        return Ros2Reader(path, start_ns, end_ns)
    return McapReader(path, start_ns, end_ns)


class WindowReader:
    """The frames of a capture with `start_ns <= t_ns < end_ns`; None is open."""

    def __init__(self, reader: CaptureReader, start_ns: int | None, end_ns: int | None) -> None:
        self.facts = reader.facts
        self._reader = reader
        info = np.iinfo(np.int64)
        self._start_ns = info.min if start_ns is None else start_ns
        self._end_ns = info.max if end_ns is None else end_ns

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches with at least one frame in the window, and gaps that touch it, cut to it."""
        for item in self._reader.batches():
            if isinstance(item, Gap):
                start, end = max(item.start_ns, self._start_ns), min(item.end_ns, self._end_ns)
                if start <= end:
                    yield Gap(start, end, item.reason, item.lost_frames, item.bus)
                continue
            inside = (item.t_ns >= self._start_ns) & (item.t_ns < self._end_ns)
            if inside.all():
                yield item
            elif inside.any():
                yield item[inside]


def _head(path: Path) -> bytes:
    try:
        if path.stat().st_size == 0:
            raise CaptureError(f"{path}: is empty; known are {KNOWN_FORMATS}")
    except OSError as error:
        if isinstance(error, CaptureError):
            raise
        raise CaptureError(f"{path}: cannot be opened: {error.strerror or error}") from error
    source = CaptureSource(path)
    try:
        head = LineSource(source).head if not _is_binary(path) else source.read(4096)
    finally:
        source.close()
    if not head:
        what = source.damage or "there is nothing in it"
        raise CaptureError(f"{path}: nothing can be read: {what}; known are {KNOWN_FORMATS}")
    return head


def _is_binary(path: Path) -> bool:
    source = CaptureSource(path)
    try:
        magic = source.read(16)
    finally:
        source.close()
    return magic.startswith(BINARY_MAGIC)


def _is_packed(path: Path) -> bool:
    with path.open("rb") as file:
        magic = file.read(4)
    return magic.startswith(GZIP_MAGIC) or magic == ZSTD_MAGIC


def _reader(path: Path, head: bytes, block_bytes: int) -> CaptureReader:
    if head.startswith(BLF_MAGIC):
        from syncline_analyzer.readers.blf import BlfReader

        return BlfReader(path)
    if head.startswith(PCAPNG_MAGIC):
        from syncline_analyzer.readers.pcapng import PcapngReader

        return PcapngReader(path)
    if head[:4] in PCAP_MAGIC:
        from syncline_analyzer.readers.pcap import PcapReader

        return PcapReader(path)
    if head.startswith(MF4_MAGIC):
        from syncline_analyzer.readers.mf4 import Mf4Reader

        return _indexed(path, Mf4Reader)
    for magic, what in FOREIGN_MAGIC.items():
        if head.startswith(magic):
            raise CaptureError(
                f"{path}: is {what}, which cannot be read; known are {KNOWN_FORMATS}"
            )
    return _text_reader(path, head, block_bytes)


def _text_reader(path: Path, head: bytes, block_bytes: int) -> CaptureReader:
    from syncline_analyzer.readers.candump import CandumpFormat, is_candump_log
    from syncline_analyzer.readers.lines import MAX_PARSED_LINE, TextReader

    lines = [
        line[:MAX_PARSED_LINE].rstrip(b"\r")
        for line in head.split(b"\n", _LINES_LOOKED_AT)[:_LINES_LOOKED_AT]
    ]
    # The others take 20 ms to import.
    form = CandumpFormat(path) if is_candump_log(lines) else _line_format(path, lines)
    return TextReader(path, form, block_bytes=block_bytes)


def _line_format(path: Path, lines: list[bytes]) -> "LineFormat":
    from syncline_analyzer.readers.asc import AscFormat, is_asc
    from syncline_analyzer.readers.busmaster import BusmasterFormat, is_busmaster
    from syncline_analyzer.readers.candump import CandumpFormat, is_candump
    from syncline_analyzer.readers.canhacker import CanhackerFormat, is_canhacker
    from syncline_analyzer.readers.clx import ClxFormat, is_clx
    from syncline_analyzer.readers.csv_bare import bare_columns
    from syncline_analyzer.readers.csv_columns import csv_columns
    from syncline_analyzer.readers.csv_log import CsvFormat
    from syncline_analyzer.readers.ixxat import IxxatFormat, is_ixxat, is_plain
    from syncline_analyzer.readers.ixxat_table import IxxatTableFormat
    from syncline_analyzer.readers.kvaser import KvaserFormat, is_kvaser
    from syncline_analyzer.readers.memorator import MemoratorFormat, is_memorator
    from syncline_analyzer.readers.trc import TrcFormat, is_trc

    if is_ixxat(lines):
        table = None if is_plain(lines) else csv_columns(lines)
        return IxxatFormat(path) if table is None else IxxatTableFormat(path, table)
    if is_busmaster(lines):
        return BusmasterFormat(path)
    if is_canhacker(lines):
        return CanhackerFormat(path)
    if is_memorator(lines):
        return MemoratorFormat(path)
    if is_kvaser(lines):
        return KvaserFormat(path)
    if is_trc(lines):
        return TrcFormat(path)
    if is_asc(lines):
        return AscFormat(path)
    if is_candump(lines):
        return CandumpFormat(path)
    if (columns := csv_columns(lines) or bare_columns(lines)) is not None:
        return ClxFormat(path, columns) if is_clx(lines) else CsvFormat(path, columns)
    shown = next((line for line in lines if line.strip()), b"")[:60]
    raise CaptureError(
        f"{path}: no known format (it starts with {shown!r}); known are {KNOWN_FORMATS}"
    )
