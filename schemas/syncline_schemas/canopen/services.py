"""Which service a frame belongs to by the predefined connection set (CiA 301 7.3.5)."""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag


class Service(IntEnum):
    """Service of an 11-bit data frame; everything else is NONE."""

    NONE = 0
    NMT = 1
    SYNC = 2
    EMCY = 3
    TIME = 4
    PDO = 5
    SDO_ANSWER = 6
    SDO_REQUEST = 7
    ERROR_CONTROL = 8
    LSS = 9


def _service_table() -> NDArray[np.uint8]:
    table = np.zeros(0x800, np.uint8)
    table[0x000] = Service.NMT
    table[0x080] = Service.SYNC
    table[0x081:0x100] = Service.EMCY
    table[0x100] = Service.TIME
    table[0x181:0x580] = Service.PDO
    table[0x581:0x600] = Service.SDO_ANSWER
    table[0x601:0x680] = Service.SDO_REQUEST
    table[0x701:0x780] = Service.ERROR_CONTROL
    table[[0x7E4, 0x7E5]] = Service.LSS
    return table


SERVICE_OF_ID = _service_table()
"""(2048,) uint8, `Service` by 11-bit identifier."""

_NOT_STANDARD = np.uint16(FrameFlag.EXTENDED | FrameFlag.ERROR | FrameFlag.FD)


def service_of(batch: FrameBatch) -> NDArray[np.uint8]:
    """Service of each row, data and remote frames alike; NONE for 29-bit, CAN FD and error frames.

    Returns: (n,) uint8 of `Service`.
    """
    service: NDArray[np.uint8] = SERVICE_OF_ID[batch.can_id & 0x7FF]
    service[(batch.flags & _NOT_STANDARD) != 0] = Service.NONE
    return service


def predefined_pdo(can_id: int) -> tuple[str, int, int] | None:
    """("tpdo" | "rpdo", number 1..4, node) of a predefined PDO identifier, else None.

    >>> predefined_pdo(0x28A)
    ('tpdo', 2, 10)
    """
    node = can_id & 0x7F
    if not 0x180 < can_id < 0x580 or node == 0:
        return None
    number = ((can_id >> 7) - 3) // 2 + 1
    return ("tpdo" if (can_id >> 7) % 2 == 1 else "rpdo"), number, node
