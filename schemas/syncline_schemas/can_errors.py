"""SocketCAN error frames in words: classes in the identifier, details in the data bytes.

The values are those of linux/can/error.h. Codes of the location are those of the SJA1000's error
code capture, which other controllers' drivers translate theirs to.
"""

from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.records import dataclass


class ErrorClass(IntFlag):
    """Bits of an error frame's identifier."""

    TX_TIMEOUT = 1 << 0
    LOST_ARBITRATION = 1 << 1
    """Detail in data byte 0."""
    CONTROLLER = 1 << 2
    """Detail in data byte 1."""
    PROTOCOL = 1 << 3
    """Type in data byte 2, location in data byte 3."""
    TRANSCEIVER = 1 << 4
    """Detail in data byte 4."""
    NO_ACK = 1 << 5
    BUS_OFF = 1 << 6
    BUS_ERROR = 1 << 7
    RESTARTED = 1 << 8
    COUNTERS = 1 << 9
    """Data bytes 6 and 7 hold the transmit and receive error counters (Linux 6.0 and later)."""


class Controller(IntFlag):
    """Bits of data byte 1 under `ErrorClass.CONTROLLER`."""

    RX_OVERFLOW = 1 << 0
    TX_OVERFLOW = 1 << 1
    RX_WARNING = 1 << 2
    TX_WARNING = 1 << 3
    RX_PASSIVE = 1 << 4
    TX_PASSIVE = 1 << 5
    ACTIVE = 1 << 6


WARNING_COUNT = 96
"""Error counter from which a controller is at its warning level (ISO 11898-1)."""
PASSIVE_COUNT = 128
SOCKETCAN_INTERFACES = frozenset({"slcan", "socketcan", "socketcand", "virtual"})
"""python-can's names of interfaces whose error frames carry these classes."""
ERROR_BYTES = 8
"""Data bytes of every error frame of SocketCAN (`CAN_ERR_DLC`)."""
RECORDER_OFF = "recorder bus-off"
"""Reason of a gap: the recorder's own controller was bus-off and heard nothing."""
RECORDER_OVERFLOW = "receive buffer of the recorder's controller overflowed"
"""Reason of a gap: frames were lost in the recorder's own controller."""
NOT_RECORDED = "error frame, kind not recorded"
"""What is said of an error frame whose log does not tell its class."""

_CLASSES = 0x3FF
_CONTROLLER = (
    (Controller.RX_OVERFLOW, "receive buffer overflow"),
    (Controller.TX_OVERFLOW, "transmit buffer overflow"),
    (Controller.RX_WARNING, "warning level of receive errors"),
    (Controller.TX_WARNING, "warning level of transmit errors"),
    (Controller.RX_PASSIVE, "error-passive by receive errors"),
    (Controller.TX_PASSIVE, "error-passive by transmit errors"),
    (Controller.ACTIVE, "back to error-active"),
)
_PROTOCOL = (
    (0x01, "bit error"),
    (0x02, "form error"),
    (0x04, "stuff error"),
    (0x08, "dominant bit could not be sent"),
    (0x10, "recessive bit could not be sent"),
    (0x20, "bus overload"),
    (0x40, "active error announcement"),
)
_ON_TRANSMISSION = 0x80
_ACK_SLOT = 0x19
_LOCATIONS: dict[int, str] = {
    0x02: "identifier bits 28 to 21",
    0x03: "start of frame",
    0x04: "substitute RTR bit",
    0x05: "IDE bit",
    0x06: "identifier bits 20 to 18",
    0x07: "identifier bits 17 to 13",
    0x08: "CRC sequence",
    0x09: "reserved bit 0",
    0x0A: "data field",
    0x0B: "data length code",
    0x0C: "RTR bit",
    0x0D: "reserved bit 1",
    0x0E: "identifier bits 4 to 0",
    0x0F: "identifier bits 12 to 5",
    0x12: "intermission",
    0x18: "CRC delimiter",
    _ACK_SLOT: "ACK slot",
    0x1A: "end of frame",
    0x1B: "ACK delimiter",
}
_TRANSCEIVER: dict[int, str] = {
    0x04: "CAN_H not connected",
    0x05: "CAN_H shorted to battery",
    0x06: "CAN_H shorted to supply",
    0x07: "CAN_H shorted to ground",
    0x40: "CAN_L not connected",
    0x50: "CAN_L shorted to battery",
    0x60: "CAN_L shorted to supply",
    0x70: "CAN_L shorted to ground",
    0x80: "CAN_L shorted to CAN_H",
}


@dataclass(frozen=True, slots=True)
class CanError:
    """What one error frame says.

    Attributes:
        classes: `ErrorClass` bits; none where the log does not tell the class.
        words: what happened, without the error counters.
        state: state of the controller that the frame tells, else None.
        overflow: whether frames were lost in the controller's receive buffer.
        no_ack: whether nobody acknowledged what the recorder sent.
        tx_errors, rx_errors: error counters, None where the frame holds none.
    """

    classes: ErrorClass
    words: str
    state: str | None
    overflow: bool
    no_ack: bool
    tx_errors: int | None
    rx_errors: int | None

    @property
    def destroyed(self) -> bool:
        """Whether it tells of a frame destroyed on the wire, and not of the controller alone."""
        wire = ErrorClass.PROTOCOL | ErrorClass.BUS_ERROR
        return not self.classes or bool(self.classes & wire)


def classes_of(can_id: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """(n,) `ErrorClass` bits of error frames; 0 where the identifier cannot be a class."""
    return np.where(can_id & ~np.uint32(_CLASSES), np.uint32(0), can_id)


def can_error(can_id: int, data: bytes) -> CanError:
    """Decode an error frame; what cannot be an error class is `NOT_RECORDED`.

    >>> can_error(0x88, bytes([0, 0, 0x04, 0x0A, 0, 0, 0, 0])).words
    'bus error: stuff error in the data field'
    >>> can_error(0x204, bytes([0, 0x10, 0, 0, 0, 0, 0, 130])).rx_errors
    130
    """
    data = data[:8].ljust(8, b"\0")
    classes = ErrorClass(can_id if not can_id & ~_CLASSES else 0)
    tx_errors, rx_errors = _counters(classes, data)
    said = [text for text in _words(classes, data) if text]
    return CanError(
        classes,
        "; ".join(said) or (_UNTOLD_COUNTERS if classes else NOT_RECORDED),
        _state(classes, data, tx_errors, rx_errors),
        bool(classes & ErrorClass.CONTROLLER and data[1] & Controller.RX_OVERFLOW),
        bool(classes & ErrorClass.NO_ACK) or _no_ack_slot(classes, data),
        tx_errors,
        rx_errors,
    )


_UNTOLD_COUNTERS = "error counters"


def _words(classes: ErrorClass, data: bytes) -> list[str]:
    """One text per class, the gravest first."""
    return [
        "bus-off" if classes & ErrorClass.BUS_OFF else "",
        "controller restarted" if classes & ErrorClass.RESTARTED else "",
        _controller(data[1]) if classes & ErrorClass.CONTROLLER else "",
        "no acknowledgement" if classes & ErrorClass.NO_ACK else "",
        _protocol(classes, data[2], data[3]),
        _transceiver(data[4]) if classes & ErrorClass.TRANSCEIVER else "",
        _arbitration(data[0]) if classes & ErrorClass.LOST_ARBITRATION else "",
        "transmit timeout of the driver" if classes & ErrorClass.TX_TIMEOUT else "",
    ]


def _controller(bits: int) -> str:
    told = [text for bit, text in _CONTROLLER if bits & bit]
    return f"controller: {', '.join(told) or 'problem not told'}"


def _protocol(classes: ErrorClass, kind: int, location: int) -> str:
    """The protocol violation; "bus error" alone where the driver tells no more."""
    head = "bus error" if classes & ErrorClass.BUS_ERROR else "protocol violation"
    if not classes & (ErrorClass.PROTOCOL | ErrorClass.BUS_ERROR):
        return ""
    if not classes & ErrorClass.PROTOCOL or not (kind or location):
        return f"{head}, kind not recorded"
    told = [text for bit, text in _PROTOCOL if kind & bit]
    text = f"{head}: {', '.join(told) or 'kind not told'}"
    if location:
        text += f" in the {_LOCATIONS.get(location, f'place {location:02X}h')}"
    return text + (" while the recorder was sending" if kind & _ON_TRANSMISSION else "")


def _transceiver(status: int) -> str:
    """
    >>> _transceiver(0x70), _transceiver(0x44)
    ('transceiver: CAN_L shorted to ground', 'transceiver: CAN_H not connected, CAN_L not connected')
    """
    parts = [_TRANSCEIVER.get(status & mask) for mask in (0x0F, 0xF0)]
    told = [part for part in parts if part]
    return f"transceiver: {', '.join(told) or f'status {status:02X}h'}"


def _arbitration(bit: int) -> str:
    return f"arbitration lost in bit {bit}" if bit else "arbitration lost"


def _counters(classes: ErrorClass, data: bytes) -> tuple[int | None, int | None]:
    """(tx, rx) error counters; kernels before 6.0 fill them in without saying so."""
    if classes & ErrorClass.COUNTERS or (classes and (data[6] or data[7])):
        return data[6], data[7]
    return None, None


def _state(classes: ErrorClass, data: bytes, tx: int | None, rx: int | None) -> str | None:
    """State by the class, else by the error counters."""
    if classes & ErrorClass.BUS_OFF:
        return "bus-off"
    if classes & ErrorClass.RESTARTED:
        return "restarted"
    bits = data[1] if classes & ErrorClass.CONTROLLER else 0
    if bits & (Controller.RX_PASSIVE | Controller.TX_PASSIVE):
        return "passive"
    if bits & (Controller.RX_WARNING | Controller.TX_WARNING):
        return "warning"
    if bits & Controller.ACTIVE:
        return "active"
    if tx is None or rx is None:
        return None
    worst = max(tx, rx)
    return (
        "passive" if worst >= PASSIVE_COUNT else "warning" if worst >= WARNING_COUNT else "active"
    )


def _no_ack_slot(classes: ErrorClass, data: bytes) -> bool:
    """A bit error of the sender in the ACK slot, as drivers without the class tell it."""
    sending = bool(data[2] & _ON_TRANSMISSION)
    return bool(classes & ErrorClass.PROTOCOL) and sending and data[3] == _ACK_SLOT
