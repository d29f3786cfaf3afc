"""Bus states from SocketCAN error frames; bytes from linux/can/error.h and a real controller."""

import numpy as np
import pytest

from syncline_logger.bus_condition import BusCondition
from syncline_schemas.batch import FrameBatch, FrameFlag


def feed(condition: BusCondition, *errors: tuple[int, str]) -> list[tuple[int, str]]:
    """Changes after error frames, taken at log times 1, 2, ..."""
    rows = [(0, 0, can_id, int(FrameFlag.ERROR), 8, bytes.fromhex(data)) for can_id, data in errors]
    times = np.arange(1, len(rows) + 1, dtype=np.int64)
    return [(c.log_ns, c.text) for c in condition.update(FrameBatch.from_rows(rows), times)]


WARNING = (0x204, "00 0C 00 00 00 00 60 00")
PASSIVE = (0x204, "00 30 00 00 00 00 80 10")
ACTIVE = (0x204, "00 40 00 00 00 00 00 00")
BUS_OFF = (0x040, "00 00 00 00 00 00 00 00")
RESTARTED = (0x100, "00 00 00 00 00 00 00 00")
ARBITRATION_LOST = (0x202, "05 00 00 00 00 00 00 00")
OVERRUN = (0x004, "00 01 00 00 00 00 00 00")


def test_the_way_to_bus_off_and_back() -> None:
    condition = BusCondition("socketcan")
    assert feed(condition, WARNING, PASSIVE, BUS_OFF, RESTARTED) == [
        (1, "unknown -> warning"),
        (2, "warning -> passive"),
        (3, "passive -> off"),
        (4, "off -> active"),
    ]
    status = condition.message()
    assert (status.state, status.tx_errors, status.rx_errors) == ("active", 0x80, 0x10)


def test_recovery_without_bus_off() -> None:
    condition = BusCondition("socketcan")
    feed(condition, PASSIVE, ACTIVE)
    assert condition.state == "active"


@pytest.mark.parametrize("error", [ARBITRATION_LOST, (0x288, "00 00 82 08 00 00 00 00")])
def test_other_errors_change_no_state(error: tuple[int, str]) -> None:
    condition = BusCondition("socketcan")
    feed(condition, WARNING)
    assert feed(condition, error) == []
    assert condition.state == "warning"
    assert condition.error_frames == 2


def test_an_overrun_is_counted_as_a_loss() -> None:
    condition = BusCondition("socketcan")
    [(_, text)] = feed(condition, OVERRUN)
    assert "overran" in text
    assert condition.message().dropped_controller == 1
    assert condition.state == "unknown"


def test_error_frames_of_other_interfaces_are_only_counted() -> None:
    condition = BusCondition("pcan")
    assert feed(condition, BUS_OFF) == []
    assert (condition.state, condition.error_frames) == ("unknown", 1)


def test_a_bus_without_errors_is_of_unknown_state_and_counts_frames() -> None:
    condition = BusCondition("socketcan")
    rows = [(0, 0, 0x705, 0, 1, b"\x05")] * 3
    condition.update(FrameBatch.from_rows(rows), np.zeros(3, np.int64))
    status = condition.message("text")
    assert (status.state, status.frames_received, status.text) == ("unknown", 3, "text")
    assert not status.HasField("tx_errors")
