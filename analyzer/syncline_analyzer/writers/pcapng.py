"""pcapng with LINKTYPE_CAN_SOCKETCAN, one interface per bus, stamps in ns: what Wireshark opens."""

import struct
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from syncline_analyzer.readers.can_packets import CAN_SOCKETCAN
from syncline_analyzer.readers.pcapng import BYTE_ORDER_MAGIC, INTERFACE, PACKET, SECTION
from syncline_analyzer.writers.compose import Chars, has, interleave, kinds_of, payload_length
from syncline_analyzer.writers.log import LogWriter, Survey
from syncline_schemas.batch import FrameBatch, FrameFlag

_NAME, _SPEED, _RESOLUTION, _APPLICATION = 2, 8, 9, 4
_INBOUND, _OUTBOUND = 1, 2
_FDF: Final = 4
_FRAMES_AT_ONCE: Final = 65_536


def _record(width: int) -> np.dtype[np.void]:
    """An enhanced packet block with room for `width` data bytes and the packet's direction."""
    return np.dtype(
        [
            ("type", "<u4"),
            ("total", "<u4"),
            ("interface", "<u4"),
            ("high", "<u4"),
            ("low", "<u4"),
            ("captured", "<u4"),
            ("original", "<u4"),
            ("id", ">u4"),
            ("length", "u1"),
            ("bits", "u1"),
            ("spare", "V2"),
            ("data", "u1", (width,)),
            ("option", "<u2"),
            ("option_size", "<u2"),
            ("direction", "<u4"),
            ("end_of_options", "<u4"),
            ("total_again", "<u4"),
        ]
    )


_CLASSIC: Final = _record(8)
_FD: Final = _record(64)


class PcapngWriter(LogWriter):
    """Everything but gaps and marks of a contradictory length."""

    def __init__(self, stream: BinaryIO, survey: Survey) -> None:
        super().__init__(stream, survey)
        section = struct.pack("<IHHq", BYTE_ORDER_MAGIC, 1, 0, -1)
        stream.write(_block(SECTION, section + _option(_APPLICATION, b"Syncline") + bytes(4)))
        stream.writelines(_block(INTERFACE, self._interface(name)) for name in survey.buses)

    def _interface(self, name: str) -> bytes:
        options = _option(_NAME, name.encode())
        speed = self._survey.bitrates.get(name)
        if speed:
            options += _option(_SPEED, struct.pack("<Q", speed))
        options += _option(_RESOLUTION, b"\x09") + bytes(4)
        return struct.pack("<HHI", CAN_SOCKETCAN, 0, 0) + options

    def write(self, batch: FrameBatch) -> None:
        """Write frames."""
        self._count_marks(batch)
        for start in range(0, len(batch), _FRAMES_AT_ONCE):
            part = batch[start : start + _FRAMES_AT_ONCE]
            kinds = kinds_of(part)
            self._stream.write(interleave([(rows, _packets(part[rows])) for rows in kinds]))


def _packets(batch: FrameBatch) -> Chars:
    """(n, width) blocks of frames of one kind."""
    fd = has(batch, FrameFlag.FD)
    records: NDArray[np.void] = np.zeros(len(batch), _FD if fd else _CLASSIC)
    size = records.dtype.itemsize
    records["type"], records["total"], records["total_again"] = PACKET, size, size
    records["interface"] = batch.bus
    stamp = batch.t_ns.view(np.uint64)
    records["high"], records["low"] = stamp >> np.uint64(32), stamp & np.uint64(0xFFFFFFFF)
    records["captured"] = records["original"] = 72 if fd else 16
    records["id"] = batch.can_id | np.uint32(_id_bits(batch))
    records["length"] = batch.dlc
    if fd:
        brs, esi = has(batch, FrameFlag.BRS), has(batch, FrameFlag.ESI)
        records["bits"] = _FDF | brs | esi << 1
    count = payload_length(batch)
    records["data"][:, :count] = batch.data[:, :count]
    records["option"], records["option_size"] = 2, 4
    records["direction"] = _OUTBOUND if has(batch, FrameFlag.TX) else _INBOUND
    return records.view(np.uint8).reshape(len(batch), size)


def _id_bits(batch: FrameBatch) -> int:
    if has(batch, FrameFlag.ERROR):
        return 0x20000000
    extended, remote = has(batch, FrameFlag.EXTENDED), has(batch, FrameFlag.REMOTE)
    return extended << 31 | remote << 30


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + value + bytes(-len(value) % 4)


def _block(kind: int, body: bytes) -> bytes:
    size = struct.pack("<I", len(body) + 12)
    return struct.pack("<I", kind) + size + body + size
