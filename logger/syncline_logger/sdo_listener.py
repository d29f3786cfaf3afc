"""SDO frames in the light of the transfer they belong to: block segments, and values revealed."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch
from syncline_schemas.decoder import SdoColumns, SdoKind, decode_sdo

MAX_VALUE_BYTES = 256
"""Longer values (firmware, logs) say nothing about a mapping and are not collected."""

_FIRST_REQUEST = 0x600
_SEQUENCE = 0x7F
_LAST_SEGMENT = 0x80
_SUBCOMMAND = 0x03
_INITIATE, _END, _BLOCK_ANSWER, _START_UPLOAD = range(4)
"""Low bits of block commands (CiA 301 7.2.4.3.9, 7.2.4.3.12)."""


_KINDS = sorted(SdoKind)


@dataclass(slots=True)
class SdoFrame:
    """A row of `SdoColumns` as plain values, which are much cheaper to ask one by one."""

    request: bool
    command: int
    kind: SdoKind
    index: int
    sub: int
    addressed: bool
    expedited: bool
    last: bool
    abort_code: int
    payload: bytes


def sdo_frames(sdo: SdoColumns) -> list[SdoFrame]:
    """All rows one by one."""
    width, plain = sdo.payload.shape[1], sdo.payload.tobytes()
    payloads = [
        plain[n * width : n * width + length] for n, length in enumerate(sdo.length.tolist())
    ]
    return list(
        map(
            SdoFrame,
            sdo.request.tolist(),
            sdo.command.tolist(),
            [_KINDS[kind] for kind in sdo.kind.tolist()],
            sdo.index.tolist(),
            sdo.sub.tolist(),
            sdo.addressed.tolist(),
            sdo.expedited.tolist(),
            sdo.last.tolist(),
            sdo.abort_code.tolist(),
            payloads,
        )
    )


@dataclass(frozen=True, slots=True)
class LearnedValue:
    """A value that a node's object had when the frame of this row passed."""

    row: int
    node: int
    index: int
    sub: int
    data: bytes
    written: bool


@dataclass(frozen=True, slots=True, eq=False)
class SdoPass:
    """SDO frames of a batch, in bus order.

    Attributes:
        rows: (n,) row of each in its batch; node: (n,) the server's node id.
        columns: the frames taken one by one; wrong for block segments. frames: the same as rows.
        segment: (n,) bool, data of a block transfer, whose first byte is a sequence number.
        learned: what the frames reveal.
    """

    rows: NDArray[np.intp]
    node: NDArray[np.uint8]
    columns: SdoColumns
    frames: list[SdoFrame]
    segment: NDArray[np.bool_]
    learned: list[LearnedValue]


@dataclass(slots=True)
class _Transfer:
    """A transfer that has begun; `segments_by_client` says who sends block segments now, if any."""

    kind: SdoKind
    index: int = 0
    sub: int = 0
    data: bytearray = field(default_factory=bytearray)
    segments_by_client: bool | None = None
    last_sequence: int | None = None

    def take_segment(self, command: int) -> None:
        """Note whether a block segment is the last one."""
        self.last_sequence = command & _SEQUENCE if command & _LAST_SEGMENT else None

    def acknowledge(self, sequence: int) -> None:
        """Leave the segments when the last one was received; else they go on, or come again."""
        if sequence == self.last_sequence:
            self.segments_by_client = None
        self.last_sequence = None


class SdoListener:
    """Follows the default SDO channel of every node on one bus (CiA 301 7.2.4.3)."""

    def __init__(self) -> None:
        self._open: dict[int, _Transfer] = {}

    def update(self, frames: FrameBatch, rows: NDArray[np.intp]) -> SdoPass:
        """Take in the SDO frames of a batch, which stand in these rows."""
        frames = frames[rows]
        request = frames.can_id >= _FIRST_REQUEST
        node = (frames.can_id & 0x7F).astype(np.uint8)
        columns = decode_sdo(request, frames.data[:, :8], frames.dlc)
        done = SdoPass(rows, node, columns, sdo_frames(columns), np.zeros(len(rows), np.bool_), [])
        seconds = frames.data[:, 1].tolist()
        for i, number in enumerate(node.tolist()):
            self._take(i, number, done, seconds[i])
        return done

    def _take(self, i: int, node: int, done: SdoPass, second: int) -> None:
        sdo = done.frames[i]
        transfer, command, by_client = self._open.get(node), sdo.command, sdo.request
        if transfer and transfer.segments_by_client == by_client and command & _SEQUENCE:
            done.segment[i] = True
            transfer.take_segment(command)
            return
        kind = sdo.kind
        if by_client and sdo.addressed and kind != SdoKind.ABORT:
            transfer = _Transfer(kind, sdo.index, sdo.sub)
            if kind == SdoKind.DOWNLOAD_REQUEST and sdo.expedited:
                transfer.data += sdo.payload
            self._open[node] = transfer
        elif transfer is None:
            return
        elif kind in (SdoKind.BLOCK_DOWNLOAD, SdoKind.BLOCK_UPLOAD):
            self._take_block(node, transfer, command & _SUBCOMMAND, by_client, second)
        elif self._completes(transfer, sdo):
            del self._open[node]
            value = bytes(transfer.data)
            written = transfer.kind == SdoKind.DOWNLOAD_REQUEST
            if 0 < len(value) <= MAX_VALUE_BYTES:
                done.learned.append(
                    LearnedValue(
                        int(done.rows[i]), node, transfer.index, transfer.sub, value, written
                    )
                )
        elif kind in (SdoKind.ABORT, SdoKind.UNKNOWN):
            del self._open[node]

    def _take_block(
        self, node: int, transfer: _Transfer, subcommand: int, by_client: bool, second: int
    ) -> None:
        upload = transfer.kind == SdoKind.BLOCK_UPLOAD
        if subcommand == _BLOCK_ANSWER:
            transfer.acknowledge(second)
        elif subcommand == _START_UPLOAD and upload and by_client:
            transfer.segments_by_client = False
        elif subcommand == _INITIATE and not upload and not by_client:
            transfer.segments_by_client = True
        elif subcommand == _END and upload == by_client:
            del self._open[node]

    def _completes(self, transfer: _Transfer, sdo: SdoFrame) -> bool:
        """Whether this frame completes the transfer; what it carries is added to it."""
        kind = sdo.kind
        same = (transfer.index, transfer.sub) == (sdo.index, sdo.sub)
        writing = transfer.kind == SdoKind.DOWNLOAD_REQUEST
        if kind == SdoKind.DOWNLOAD_ANSWER:
            return writing and same
        if kind == SdoKind.UPLOAD_ANSWER and not writing and same and sdo.expedited:
            transfer.data += sdo.payload
            return True
        if kind == SdoKind.UPLOAD_SEGMENT and len(transfer.data) <= MAX_VALUE_BYTES:
            transfer.data += sdo.payload
        return kind == SdoKind.UPLOAD_SEGMENT and sdo.last
