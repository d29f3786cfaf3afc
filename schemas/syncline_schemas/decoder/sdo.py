"""SDO frames as columns (CiA 301 7.2.4.3); what needs the transfer's state is left to its fold."""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass

Bytes = NDArray[np.uint8]
Mask = NDArray[np.bool_]


class SdoKind(IntEnum):
    """What one SDO frame says by its command specifier and direction."""

    UNKNOWN = 0
    """Reserved command specifier, or no data at all."""
    DOWNLOAD_REQUEST = 1
    """Client: initiate a write; expedited when it carries the data."""
    DOWNLOAD_ANSWER = 2
    UPLOAD_REQUEST = 3
    """Client: initiate a read."""
    UPLOAD_ANSWER = 4
    DOWNLOAD_SEGMENT = 5
    DOWNLOAD_SEGMENT_ANSWER = 6
    UPLOAD_SEGMENT_REQUEST = 7
    UPLOAD_SEGMENT = 8
    ABORT = 9
    BLOCK_DOWNLOAD = 10
    """Either side: initiate, end, or their answers; the low bits are in `command`."""
    BLOCK_UPLOAD = 11


@dataclass(frozen=True, slots=True, eq=False)
class SdoColumns:
    """SDO frames; all (n,) unless noted.

    Attributes:
        request: True on 600h + node (or its like), False for answers.
        command: uint8, byte 0 as sent.
        kind: uint8 of `SdoKind`.
        index, sub: uint16, uint8; meaningful where `addressed`.
        addressed: the frame carries index and subindex.
        expedited: the frame carries the whole value.
        size: int64, bytes of the value: given by an expedited frame with s = 1, or the total that
            a segmented initiate announces; -1 where it is not given (22h, 42h answers).
        length: uint8, data bytes of the value that are in this frame; where an expedited frame
            does not give the size: all that are there.
        payload: (n, 7) uint8, the value's bytes in this frame from column 0 on; the rest is 0.
        toggle: uint8, bit 4 of segments. last: no more segments follow (c bit).
        abort_code: uint32, 0 where `kind` is not ABORT.
    """

    request: Mask
    command: Bytes
    kind: Bytes
    index: NDArray[np.uint16]
    sub: Bytes
    addressed: Mask
    expedited: Mask
    size: NDArray[np.int64]
    length: Bytes
    payload: Bytes
    toggle: Bytes
    last: Mask
    abort_code: NDArray[np.uint32]


_CLIENT = np.array(
    [
        SdoKind.DOWNLOAD_SEGMENT,
        SdoKind.DOWNLOAD_REQUEST,
        SdoKind.UPLOAD_REQUEST,
        SdoKind.UPLOAD_SEGMENT_REQUEST,
        SdoKind.ABORT,
        SdoKind.BLOCK_UPLOAD,
        SdoKind.BLOCK_DOWNLOAD,
        SdoKind.UNKNOWN,
    ],
    np.uint8,
)
_SERVER = np.array(
    [
        SdoKind.UPLOAD_SEGMENT,
        SdoKind.DOWNLOAD_SEGMENT_ANSWER,
        SdoKind.UPLOAD_ANSWER,
        SdoKind.DOWNLOAD_ANSWER,
        SdoKind.ABORT,
        SdoKind.BLOCK_DOWNLOAD,
        SdoKind.BLOCK_UPLOAD,
        SdoKind.UNKNOWN,
    ],
    np.uint8,
)
_SEGMENTS = [SdoKind.DOWNLOAD_SEGMENT, SdoKind.UPLOAD_SEGMENT]
_SEGMENT_FRAMES = [*_SEGMENTS, SdoKind.DOWNLOAD_SEGMENT_ANSWER, SdoKind.UPLOAD_SEGMENT_REQUEST]
_INITIATES = [SdoKind.DOWNLOAD_REQUEST, SdoKind.UPLOAD_ANSWER]
_BLOCK_SUBCOMMAND_MASK = 0x03


def decode_sdo(request: Mask, data: Bytes, dlc: Bytes) -> SdoColumns:
    """SDO frames by direction (request = client to server); shorter frames read as far as they go.

    Block transfers: only the initiate frames of either side count as addressed; the segments of a
    running block look like anything and are for the transfer's state machine to claim.

    Args:
        request: (n,) bool; data: (n, 8) uint8; dlc: (n,) uint8.
    """
    data = data[:, :8]
    command = data[:, 0]
    kind = np.where(request, _CLIENT[command >> 5], _SERVER[command >> 5])
    kind[dlc == 0] = SdoKind.UNKNOWN
    carries = np.isin(kind, _INITIATES)
    segment = np.isin(kind, _SEGMENTS)
    expedited = carries & (command & 2 != 0)
    size = _size(command, data, carries, expedited, segment)
    word = data[:, 4:8].copy().view("<u4")[:, 0]
    return SdoColumns(
        request=request,
        command=command,
        kind=kind,
        index=data[:, 1:3].copy().view("<u2")[:, 0],
        sub=data[:, 3],
        addressed=_addressed(kind, command, request) & (dlc >= 4),
        expedited=expedited,
        size=size,
        length=_length(size, dlc, expedited, segment),
        payload=_payload(data, expedited, segment),
        toggle=np.where(np.isin(kind, _SEGMENT_FRAMES), command >> 4 & 1, 0).astype(np.uint8),
        last=segment & (command & 1 != 0),
        abort_code=np.where(kind == SdoKind.ABORT, word, 0).astype(np.uint32),
    )


def _size(
    command: Bytes, data: Bytes, carries: Mask, expedited: Mask, segment: Mask
) -> NDArray[np.int64]:
    given = (command & 1) != 0
    word = data[:, 4:8].copy().view("<u4")[:, 0].astype(np.int64)
    unused = (command >> 2 & 3).astype(np.int64)
    size = np.full(len(command), -1, np.int64)
    size = np.where(carries & given, np.where(expedited, 4 - unused, word), size)
    return np.where(segment, 7 - (command >> 1 & 7).astype(np.int64), size)


def _length(size: NDArray[np.int64], dlc: Bytes, expedited: Mask, segment: Mask) -> Bytes:
    header = np.where(segment, 1, 4)
    present = np.clip(dlc.astype(np.int64) - header, 0, np.where(segment, 7, 4))
    stated = np.where(size < 0, present, np.minimum(size, present))
    return np.where(expedited | segment, stated, 0).astype(np.uint8)


def _payload(data: Bytes, expedited: Mask, segment: Mask) -> Bytes:
    payload = np.zeros((len(data), 7), np.uint8)
    payload[expedited, :4] = data[expedited, 4:8]
    payload[segment] = data[segment, 1:8]
    return payload


def _addressed(kind: Bytes, command: Bytes, request: Mask) -> Mask:
    """Initiates, aborts, and the initiates of block transfers (CiA 301 7.2.4.3.9 and .12)."""
    plain = np.isin(
        kind,
        [SdoKind.DOWNLOAD_REQUEST, SdoKind.DOWNLOAD_ANSWER, SdoKind.UPLOAD_REQUEST,
         SdoKind.UPLOAD_ANSWER, SdoKind.ABORT],
    )  # fmt: skip
    block_up = (kind == SdoKind.BLOCK_UPLOAD) & np.where(
        request, command & _BLOCK_SUBCOMMAND_MASK == 0, command & 1 == 0
    )
    block_down = (kind == SdoKind.BLOCK_DOWNLOAD) & np.where(
        request, command & 1 == 0, command & _BLOCK_SUBCOMMAND_MASK == 0
    )
    addressed: Mask = plain | block_up | block_down
    return addressed
