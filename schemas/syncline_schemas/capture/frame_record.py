"""Frames as MCAP message records, and back, a column at a time.

A record with a `syncline.Frame` of n data bytes has 45 + n bytes, all numbers little-endian:

    0  opcode 05h              31  0Dh  can_id, 4 bytes
    1  length = 36 + n, 8      36  15h  flags, 4
    9  channel, 2              41  18h  dlc, 1
    11 sequence, 4             43  22h  n, 1
    15 log_time, 8             45  data, n
    23 publish_time, 8
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.records import dataclass

RECORD_HEAD = 31
"""Bytes of a message record before its payload."""
FRAME_HEAD = 45
"""Bytes of a frame's record before its data."""
MAX_DATA = 64
PADDING = 128
"""Bytes behind a chunk that the gather may read and never uses."""

_HEAD_FIELDS = [
    ("opcode", "u1"),
    ("record_length", "<u8"),
    ("channel", "<u2"),
    ("sequence", "<u4"),
    ("log_time", "<u8"),
    ("publish_time", "<u8"),
]
RECORD_DTYPE = np.dtype(_HEAD_FIELDS)
_FRAME_FIELDS = [
    ("tag_id", "u1"),
    ("can_id", "<u4"),
    ("tag_flags", "u1"),
    ("flags", "<u4"),
    ("tag_dlc", "u1"),
    ("dlc", "u1"),
    ("tag_data", "u1"),
    ("data_length", "u1"),
]
_MESSAGE = 0x05
_TAG_ID, _TAG_FLAGS, _TAG_DLC, _TAG_DATA = 0x0D, 0x15, 0x18, 0x22
_ID_TAGS = np.uint64(_TAG_ID | _TAG_FLAGS << 40)
_ID_BITS = np.uint64(0xFF | 0xE0 << 32 | 0xFF << 40)
"""Of the eight bytes from 31 on: both tags, and the three bits above an identifier."""
_DLC_TAGS = np.uint64(_TAG_DLC << 16 | _TAG_DATA << 32)
_DLC_BITS = np.uint64(0xFFFF | 0xFF << 16 | 0xFF << 32)
"""Of the eight bytes from 39 on: the upper half of the flags, and both tags."""
_LENGTH_OF_REST = np.uint64(FRAME_HEAD - 9)
_ONE, _THREE = np.uint64(1), np.uint64(3)
_TAKEN = 56
"""Bytes taken of a record: a frame's head and its first eight data bytes, in whole words."""


def data_length(batch: FrameBatch) -> NDArray[np.int64]:
    """(n,) data bytes of each row: none for remote frames, else `dlc`."""
    length = np.minimum(batch.dlc, batch.data.shape[1]).astype(np.int64)
    length[(batch.flags & FrameFlag.REMOTE) != 0] = 0
    return length


def pack_frames(
    batch: FrameBatch,
    channel_of_bus: NDArray[np.uint16],
    sequence: NDArray[np.uint32],
    log_time_ns: NDArray[np.int64],
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Message records of all rows, back to back, and the length of each.

    channel_of_bus: (256,) channel id by bus number. sequence, log_time_ns: (n,).
    Returns: (total,) uint8 and (n,) int64.
    """
    width = batch.data.shape[1]
    row_type = np.dtype([*_HEAD_FIELDS, *_FRAME_FIELDS, ("data", "u1", (width,))])
    rows = np.empty(len(batch), row_type)
    length = data_length(batch)
    rows["opcode"] = _MESSAGE
    rows["record_length"] = length + (FRAME_HEAD - 9)
    rows["channel"] = channel_of_bus[batch.bus]
    rows["sequence"] = sequence
    rows["log_time"] = log_time_ns.view(np.uint64)
    rows["publish_time"] = batch.t_ns.view(np.uint64)
    rows["tag_id"], rows["can_id"] = _TAG_ID, batch.can_id
    rows["tag_flags"], rows["flags"] = _TAG_FLAGS, batch.flags
    rows["tag_dlc"], rows["dlc"] = _TAG_DLC, np.minimum(batch.dlc, 0x7F)
    rows["tag_data"], rows["data_length"] = _TAG_DATA, length
    rows["data"] = batch.data
    row_bytes = rows.view(np.uint8).reshape(len(batch), FRAME_HEAD + width)
    return row_bytes[_KEPT[length, : FRAME_HEAD + width]], length + FRAME_HEAD


_KEPT = np.arange(FRAME_HEAD + MAX_DATA) < FRAME_HEAD + np.arange(MAX_DATA + 1)[:, None]
"""(65, 109) bool, which bytes of a row belong to a record with n data bytes."""


def pack_messages(
    channel: int,
    sequence: NDArray[np.uint32],
    log_time_ns: NDArray[np.int64],
    publish_time_ns: NDArray[np.int64],
    length: NDArray[np.int64],
    payload: NDArray[np.uint8],
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Message records of one channel around payloads that are there; see `pack_frames`."""
    heads = np.empty(len(length), RECORD_DTYPE)
    heads["opcode"] = _MESSAGE
    heads["record_length"] = length + (RECORD_HEAD - 9)
    heads["channel"] = channel
    heads["sequence"] = sequence
    heads["log_time"] = log_time_ns.view(np.uint64)
    heads["publish_time"] = publish_time_ns.view(np.uint64)
    head_bytes = heads.view(np.uint8).reshape(len(length), RECORD_HEAD)
    if len(length) and (length == length[0]).all():
        payloads = payload.reshape(len(length), int(length[0]))
        return np.hstack([head_bytes, payloads]).reshape(-1), length + RECORD_HEAD
    start = np.cumsum(length + RECORD_HEAD) - (length + RECORD_HEAD)
    out = np.empty(len(payload) + RECORD_HEAD * len(length), np.uint8)
    is_payload = np.ones(len(out), np.bool_)
    head_at = (start[:, None] + np.arange(RECORD_HEAD)).reshape(-1)
    is_payload[head_at] = False
    out[head_at] = head_bytes.reshape(-1)
    out[is_payload] = payload
    return out, length + RECORD_HEAD


@cache
def _column(number: str, at: int) -> np.dtype[np.void]:
    return np.dtype({"names": ["at"], "formats": [number], "offsets": [at], "itemsize": _TAKEN})


class RecordHeads:
    """The first 56 bytes of message records, taken at once, as columns of numbers.

    One copy of each record's head is as cheap as one of a single number out of it.
    """

    def __init__(self, heads: NDArray[np.void]) -> None:
        self._heads = heads

    @classmethod
    def at(cls, chunk: NDArray[np.uint8], offset: NDArray[np.int64]) -> "RecordHeads":
        """The records at these offsets of a decompressed chunk.

        chunk: (size + PADDING,) uint8. offset: (n,) int64, at most the size.
        """
        view = np.ndarray((len(chunk) - _TAKEN + 1,), f"V{_TAKEN}", chunk, 0, (1,))
        return cls(view[offset])

    def __len__(self) -> int:
        return len(self._heads)

    def rows(self, rows: NDArray[np.intp]) -> "RecordHeads":
        """Some of the records."""
        return RecordHeads(self._heads[rows])

    def u1(self, at: int) -> NDArray[np.uint8]:
        """(n,) the byte at a place of each record."""
        return self._heads.view(_column("<u1", at))["at"].copy()

    def u2(self, at: int) -> NDArray[np.uint16]:
        """(n,) the two bytes from a place of each record on."""
        return self._heads.view(_column("<u2", at))["at"].copy()

    def u4(self, at: int) -> NDArray[np.uint32]:
        """(n,) the four bytes from a place of each record on."""
        return self._heads.view(_column("<u4", at))["at"].copy()

    def u8(self, at: int) -> NDArray[np.uint64]:
        """(n,) the eight bytes from a place of each record on."""
        return self._heads.view(_column("<u8", at))["at"].copy()


@dataclass(frozen=True, slots=True, eq=False)
class GatheredFrames:
    """Frames read at offsets; only the rows in `regular` are to be believed."""

    frames: FrameBatch
    regular: NDArray[np.bool_]


def gather_frames(
    chunk: NDArray[np.uint8],
    offset: NDArray[np.int64],
    heads: RecordHeads,
    bus: NDArray[np.uint8],
) -> GatheredFrames:
    """Columns of the frames whose records begin at these offsets of a decompressed chunk.

    chunk: (size + PADDING,) uint8. offset: (n,) of records that end within `size` and whose length
    field is their distance to the next. heads: of the same records. bus: (n,) bus number.
    A row is regular when every tag and length in it is what `pack_frames` writes.
    """
    wrong = heads.u8(31) ^ _ID_TAGS
    wrong &= _ID_BITS
    wrong |= (heads.u8(39) ^ _DLC_TAGS) & _DLC_BITS
    flags, dlc, length = heads.u2(37), heads.u1(42), heads.u1(44)
    regular = (wrong == 0) & (heads.u8(1) == length + _LENGTH_OF_REST) & (length <= MAX_DATA)
    regular &= dlc <= MAX_DATA
    other = length != dlc
    if other.any() or bool((flags & FrameFlag.REMOTE).any()):
        remote = (flags & FrameFlag.REMOTE) != 0
        regular &= np.where(remote, length == 0, ~other)
    if not regular.all():
        length[~regular] = 0
    t_ns = heads.u8(23).view(np.int64)
    data = _gather_data(chunk, heads, offset, length)
    return GatheredFrames(FrameBatch(t_ns, bus, heads.u4(32), flags, dlc, data), regular)


def _gather_data(
    chunk: NDArray[np.uint8],
    heads: RecordHeads,
    offset: NDArray[np.int64],
    length: NDArray[np.uint8],
) -> NDArray[np.uint8]:
    # A shift by 64 gives 0, so eight bytes and more are all kept.
    mask = (_ONE << (np.minimum(length, 8).astype(np.uint64) << _THREE)) - _ONE
    first = heads.u8(FRAME_HEAD) & mask
    data = first.astype("<u8", copy=False).view(np.uint8).reshape(-1, 8)
    long_rows = np.flatnonzero(length > 8)
    if len(long_rows) == 0:
        return data
    wide = np.zeros((len(offset), MAX_DATA), np.uint8)
    wide[:, :8] = data
    place = np.arange(MAX_DATA)
    bytes_at = (offset[long_rows] + FRAME_HEAD)[:, None] + place
    wide[long_rows] = np.where(place < length[long_rows, None], chunk[bytes_at], 0)
    return wide
