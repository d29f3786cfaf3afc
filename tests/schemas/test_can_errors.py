"""Error frames in words, by the values of linux/can/error.h."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from syncline_schemas.can_errors import NOT_RECORDED, ErrorClass, can_error, classes_of

PROT, CRTL = 0x008, 0x004


def data(**places: int) -> bytes:
    """Eight data bytes, given by place: d0 ... d7."""
    found = bytearray(8)
    for place, value in places.items():
        found[int(place[1])] = value
    return bytes(found)


@pytest.mark.parametrize(
    ("can_id", "payload", "words"),
    [
        (0x001, data(), "transmit timeout of the driver"),
        (0x002, data(), "arbitration lost"),
        (0x002, data(d0=13), "arbitration lost in bit 13"),
        (0x004, data(d1=0x01), "controller: receive buffer overflow"),
        (0x004, data(d1=0x02), "controller: transmit buffer overflow"),
        (0x004, data(d1=0x04), "controller: warning level of receive errors"),
        (0x004, data(d1=0x08), "controller: warning level of transmit errors"),
        (0x004, data(d1=0x10), "controller: error-passive by receive errors"),
        (0x004, data(d1=0x20), "controller: error-passive by transmit errors"),
        (0x004, data(d1=0x40), "controller: back to error-active"),
        (0x004, data(), "controller: problem not told"),
        (0x008, data(d2=0x01, d3=0x19), "protocol violation: bit error in the ACK slot"),
        (0x008, data(d2=0x02, d3=0x1A), "protocol violation: form error in the end of frame"),
        (0x088, data(d2=0x04, d3=0x0A), "bus error: stuff error in the data field"),
        (0x088, data(d2=0x04, d3=0x08), "bus error: stuff error in the CRC sequence"),
        (
            0x088,
            data(d2=0x88, d3=0x02),
            (
                "bus error: dominant bit could not be sent in the identifier bits 28 to 21 while the"
                " recorder was sending"
            ),
        ),
        (0x088, data(d2=0x10), "bus error: recessive bit could not be sent"),
        (0x088, data(d2=0x20), "bus error: bus overload"),
        (0x088, data(d2=0x40, d3=0x12), "bus error: active error announcement in the intermission"),
        (0x088, data(), "bus error, kind not recorded"),
        (0x080, data(), "bus error, kind not recorded"),
        (0x010, data(d4=0x04), "transceiver: CAN_H not connected"),
        (0x010, data(d4=0x05), "transceiver: CAN_H shorted to battery"),
        (0x010, data(d4=0x06), "transceiver: CAN_H shorted to supply"),
        (0x010, data(d4=0x07), "transceiver: CAN_H shorted to ground"),
        (0x010, data(d4=0x50), "transceiver: CAN_L shorted to battery"),
        (0x010, data(d4=0x60), "transceiver: CAN_L shorted to supply"),
        (0x010, data(d4=0x70), "transceiver: CAN_L shorted to ground"),
        (0x010, data(d4=0x80), "transceiver: CAN_L shorted to CAN_H"),
        (0x010, data(), "transceiver: status 00h"),
        (0x020, data(), "no acknowledgement"),
        (0x040, data(), "bus-off"),
        (0x100, data(), "controller restarted"),
        (0x200, data(d6=5), "error counters"),
        (0x0A8, data(d2=0x01), "no acknowledgement; bus error: bit error"),
        (0x000, data(), NOT_RECORDED),
        (0x18A, b"", "controller restarted; bus error, kind not recorded; arbitration lost"),
        (0x400, data(), NOT_RECORDED),
        (0x1C000123, data(d1=0x10), NOT_RECORDED),
    ],
)
def test_words(can_id: int, payload: bytes, words: str) -> None:
    assert can_error(can_id, payload).words == words


@pytest.mark.parametrize(
    ("can_id", "payload", "state"),
    [
        (CRTL, data(d1=0x40), "active"),
        (CRTL, data(d1=0x04), "warning"),
        (CRTL, data(d1=0x0C), "warning"),
        (CRTL, data(d1=0x10), "passive"),
        (CRTL, data(d1=0x24), "passive"),
        (CRTL, data(d1=0x01), None),
        (0x040, data(), "bus-off"),
        (0x044, data(d1=0x30), "bus-off"),
        (0x100, data(), "restarted"),
        (PROT, data(), None),
        (PROT, data(d7=95), "active"),
        (PROT, data(d7=96), "warning"),
        (PROT, data(d6=127), "warning"),
        (PROT, data(d6=128), "passive"),
        (0x200, data(), "active"),
        (0x000, data(d7=200), None),
    ],
)
def test_state_by_class_and_counters(can_id: int, payload: bytes, state: str | None) -> None:
    """Thresholds 96 and 128: linux/can/error.h, CAN state thresholds."""
    assert can_error(can_id, payload).state == state


def test_counters_of_old_and_new_kernels() -> None:
    told = can_error(0x204, data(d1=0x40))
    assert (told.tx_errors, told.rx_errors) == (0, 0)
    old = can_error(0x004, data(d1=0x08, d6=96))
    assert (old.tx_errors, old.rx_errors) == (96, 0)
    assert can_error(0x004, data(d1=0x40)).tx_errors is None


def test_what_destroys_a_frame() -> None:
    assert can_error(0x088, data()).destroyed
    assert can_error(0x008, data(d2=0x04)).destroyed
    assert can_error(0x000, b"").destroyed
    assert not can_error(0x002, data()).destroyed
    assert not can_error(0x004, data(d1=0x10)).destroyed
    assert not can_error(0x040, data()).destroyed


def test_no_acknowledgement_by_class_or_by_place() -> None:
    assert can_error(0x020, data()).no_ack
    assert can_error(0x088, data(d2=0x80, d3=0x19)).no_ack
    assert not can_error(0x088, data(d3=0x19)).no_ack


def test_an_identifier_that_is_no_class_has_none() -> None:
    ids = np.array([0x40, 0x3FF, 0x400, 0x1FFFFFFF], np.uint32)
    assert classes_of(ids).tolist() == [0x40, 0x3FF, 0, 0]


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8))
def test_nothing_raises(can_id: int, payload: bytes) -> None:
    told = can_error(can_id, payload)
    assert told.words
    assert ErrorClass(told.classes) == told.classes
