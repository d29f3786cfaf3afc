"""About how many frames captures hold, from their size and a look at their start."""

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

from syncline_analyzer.readers.source import (
    GZIP_MAGIC,
    HEAD_BYTES,
    ZSTD_MAGIC,
    CaptureSource,
)
from syncline_schemas.errors import CaptureError

_MCAP_MAGIC = b"\x89MCAP"
_BLF_COUNT = struct.Struct("<4sL8xQQL")
"""Head of a BLF file up to the number of its objects."""
_PCAP_MAGIC = {b"\xd4\xc3\xb2\xa1": "<", b"\x4d\x3c\xb2\xa1": "<", b"\xa1\xb2\xc3\xd4": ">",
               b"\xa1\xb2\x3c\x4d": ">"}  # fmt: skip
_PCAP_HEAD, _PACKET_HEAD = 24, 16
_BINARY = (b"PK\x03\x04", b"\n\r\r\n", b"MDF     ", b"UnFinMF ")


def frames_expected(paths: Sequence[Path]) -> int | None:
    """Frames of all files together; None where one of them does not tell, or cannot be read."""
    try:
        counts = [_frames_of(path) for path in paths]
    except (OSError, CaptureError, ValueError, struct.error):
        return None
    known = [count for count in counts if count is not None]
    return sum(known) if len(known) == len(counts) else None


def _frames_of(path: Path) -> int | None:
    with path.open("rb") as file:
        magic = file.read(64)
    if magic.startswith(_MCAP_MAGIC):
        return _mcap_frames(path)
    if magic.startswith(b"LOGG"):
        return int(_BLF_COUNT.unpack_from(magic)[4])
    if magic.startswith(_BINARY):
        return None
    head, used = _head(path, packed=magic.startswith((GZIP_MAGIC, ZSTD_MAGIC)))
    if not head or head.startswith((_MCAP_MAGIC, b"LOGG", *_BINARY)):
        return None
    order = _PCAP_MAGIC.get(head[:4])
    units = head.count(b"\n") or head.count(b"\r") if order is None else _packets(head, order)
    return round(units * path.stat().st_size / used) if used else None


def _mcap_frames(path: Path) -> int | None:
    """Frames of a capture of ours by its summary; None of one without."""
    from syncline_schemas.capture.record_file import RecordFile

    with path.open("rb") as file:
        summary = RecordFile(file).summary()
    if summary is None or summary.statistics is None:
        return None
    counts = summary.statistics.channel_message_counts
    ids = {each.id for each in summary.channels if each.topic.endswith("/frames")}
    return sum(count for channel, count in counts.items() if channel in ids) or None


def _head(path: Path, *, packed: bool) -> tuple[bytes, int]:
    """The first unpacked bytes, and about how many bytes of the file they take."""
    source = CaptureSource(path)
    try:
        head = source.read(HEAD_BYTES)
    finally:
        source.close()
    if not packed:
        return head, len(head)
    # As if it were packed alone: what the unpacker has read is far ahead of what it gave.
    return head, min(len(zlib.compress(head, 6)), path.stat().st_size)


def _packets(head: bytes, order: str) -> int:
    """Packets of a pcap file in its first bytes."""
    at, count = _PCAP_HEAD, 0
    while at + _PACKET_HEAD <= len(head):
        (length,) = struct.unpack_from(f"{order}L", head, at + 8)
        at += _PACKET_HEAD + length
        count += 1
    return count
