"""NMT, SYNC, TIME, EMCY, error control and LSS frames as columns (CiA 301 7.2, CiA 305)."""

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass

Bytes = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class NmtColumns:
    """command (n,) uint8, node (n,) uint8 (0 = all), valid (n,) bool: exactly two bytes."""

    command: Bytes
    node: Bytes
    valid: Mask


def decode_nmt(data: Bytes, dlc: Bytes) -> NmtColumns:
    """NMT commands on 000h (CiA 301 7.2.8.3.1)."""
    return NmtColumns(data[:, 0], data[:, 1], dlc == 2)


def decode_sync(data: Bytes, dlc: Bytes) -> NDArray[np.int16]:
    """SYNC counter (CiA 301 7.2.5.3): (n,) int16, -1 where the frame carries none."""
    return np.where(dlc == 1, data[:, 0], np.int16(-1)).astype(np.int16)


@dataclass(frozen=True, slots=True, eq=False)
class EmcyColumns:
    """code (n,) uint16, register (n,) uint8, manufacturer (n, 5) uint8, valid (n,): eight bytes."""

    code: NDArray[np.uint16]
    register: Bytes
    manufacturer: Bytes
    valid: Mask


def decode_emcy(data: Bytes, dlc: Bytes) -> EmcyColumns:
    """EMCY messages (CiA 301 7.2.7.3); rows that are not valid hold zeros for missing bytes."""
    code = data[:, 0].astype(np.uint16) | data[:, 1].astype(np.uint16) << np.uint16(8)
    return EmcyColumns(code, data[:, 2], data[:, 3:8], dlc >= 8)


@dataclass(frozen=True, slots=True, eq=False)
class ErrorControlColumns:
    """Frames on 700h + node; all (n,).

    request: remote frame of a guarding master. empty: no state byte at all. boot_up: byte 00h.
    state: uint8, bits 6..0. toggle: uint8, bit 7. Whether a byte 00h or 7Fh is a boot-up on a
    device with quirks depends on what went before: that is the analysis's to say.
    """

    request: Mask
    empty: Mask
    boot_up: Mask
    state: Bytes
    toggle: Bytes


def decode_error_control(data: Bytes, dlc: Bytes, remote: Mask) -> ErrorControlColumns:
    """Boot-up, heartbeat and guarding frames (CiA 301 7.2.8.3.2)."""
    first = data[:, 0]
    empty = (dlc == 0) & ~remote
    boot_up = (dlc == 1) & ~remote & (first == 0)
    return ErrorControlColumns(remote, empty, boot_up, first & np.uint8(0x7F), first >> np.uint8(7))


@dataclass(frozen=True, slots=True, eq=False)
class TimeColumns:
    """ms (n,) uint32 of the day, days (n,) uint16 since 1984-01-01, t_ns (n,) int64, valid (n,)."""

    ms: NDArray[np.uint32]
    days: NDArray[np.uint16]
    t_ns: NDArray[np.int64]
    valid: Mask


_CIA_EPOCH_NS = 441_763_200 * 1_000_000_000
"""1984-01-01T00:00:00Z in ns since the UNIX epoch."""
_DAY_MS = 86_400_000


def decode_time(data: Bytes, dlc: Bytes) -> TimeColumns:
    """TIME messages (CiA 301 7.2.6.3, TIME_OF_DAY): t_ns is ns since the UNIX epoch."""
    raw = np.ascontiguousarray(data[:, :6])
    ms = raw[:, :4].copy().view("<u4")[:, 0] & np.uint32(0x0FFFFFFF)
    days = raw[:, 4:6].copy().view("<u2")[:, 0]
    total_ms = days.astype(np.int64) * _DAY_MS + ms.astype(np.int64)
    return TimeColumns(ms, days, _CIA_EPOCH_NS + total_ms * 1_000_000, dlc >= 6)


@dataclass(frozen=True, slots=True, eq=False)
class LssColumns:
    """command (n,) uint8 (named in `canopen.lss`), request (n,) bool, argument (n, 7) uint8."""

    command: Bytes
    request: Mask
    argument: Bytes
    valid: Mask


def decode_lss(can_id: NDArray[np.uint32], data: Bytes, dlc: Bytes) -> LssColumns:
    """LSS frames (CiA 305): requests on 7E5h, answers on 7E4h."""
    return LssColumns(data[:, 0], can_id == 0x7E5, data[:, 1:8], dlc == 8)
