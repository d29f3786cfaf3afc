"""Bus states from SocketCAN error frames; bytes from linux/can/error.h and a real controller."""

import numpy as np
import pytest

from syncline_logger.batcher import Loss, LossPlace
from syncline_logger.bus_condition import OFF_BEFORE, BusCondition
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.can_errors import RECORDER_OFF, RECORDER_OVERFLOW

MS = 1_000_000
ERROR = int(FrameFlag.ERROR)


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


Told = tuple[int, int, str]


def rows(*frames: tuple[int, int, str, int]) -> FrameBatch:
    """Frames of bus 2 as (milliseconds, identifier, data, flags)."""
    listed = [(t * MS, 2, i, f, bytes.fromhex(d)) for t, i, d, f in frames]
    return FrameBatch.from_rows((t, b, i, f, len(d), d) for t, b, i, f, d in listed)


def gaps_of(condition: BusCondition, *frames: tuple[int, int, str, int]) -> list[Told]:
    """The gaps that frames taken at their own times make, in milliseconds."""
    batch = rows(*frames)
    changes = condition.update(batch, batch.t_ns)
    gaps = [change.gap for change in changes if change.gap]
    assert all(gap.bus == 2 and gap.lost_frames is None for gap in gaps)
    return [(gap.start_ns // MS, gap.end_ns // MS, gap.reason) for gap in gaps]


def error(t_ms: int, what: tuple[int, str]) -> tuple[int, int, str, int]:
    return (t_ms, *what, ERROR)


def heard(t_ms: int, flags: int = 0) -> tuple[int, int, str, int]:
    return (t_ms, 0x705, "05", flags)


def test_bus_off_is_a_gap_to_the_restart() -> None:
    condition = BusCondition("socketcan", 2)
    assert gaps_of(condition, heard(5), error(10, BUS_OFF)) == []
    assert gaps_of(condition, error(300, RESTARTED), heard(310)) == [(10, 300, RECORDER_OFF)]
    assert condition.deaf_until(400 * MS) is None


def test_bus_off_ends_with_the_first_frame_heard() -> None:
    """After `ip link set can0 down` and `up` no frame tells of the restart."""
    condition = BusCondition("socketcan", 2)
    sent = heard(200, int(FrameFlag.TX))
    assert gaps_of(condition, error(10, BUS_OFF), sent, heard(300), heard(310)) == [
        (10, 300, RECORDER_OFF)
    ]
    assert condition.state == "active"


def test_bus_off_to_the_end() -> None:
    condition = BusCondition("socketcan", 2)
    assert gaps_of(condition, error(10, BUS_OFF), error(20, BUS_OFF)) == []
    assert condition.deaf_until(900 * MS) == Gap(10 * MS, 900 * MS, RECORDER_OFF, None, 2)


def test_a_controller_that_was_bus_off_before() -> None:
    condition = BusCondition("socketcan", 2)
    [change] = condition.tell("off", 5 * MS)
    assert (change.text, change.gap) == ("unknown -> off", None)
    assert gaps_of(condition, heard(50)) == [(5, 50, OFF_BEFORE)]


def test_the_interface_is_up_again_before_the_frames_are_taken() -> None:
    condition = BusCondition("socketcan", 2)
    assert condition.tell("active", 500 * MS) == []
    assert gaps_of(condition, heard(5), error(10, BUS_OFF)) == [(10, 500, RECORDER_OFF)]
    assert condition.state == "active"


def test_the_interface_tells_that_bus_off_is_over() -> None:
    condition = BusCondition("socketcan", 2)
    gaps_of(condition, error(10, BUS_OFF))
    [change] = condition.tell("active", 500 * MS)
    assert change.gap == Gap(10 * MS, 500 * MS, RECORDER_OFF, None, 2)


def test_an_overrun_is_a_gap_from_the_frame_before() -> None:
    condition = BusCondition("socketcan", 2)
    assert gaps_of(condition, heard(5)) == []
    assert gaps_of(condition, error(10, OVERRUN), heard(20), error(300, OVERRUN)) == [
        (5, 10, RECORDER_OVERFLOW),
        (20, 300, RECORDER_OVERFLOW),
    ]


def test_many_overruns_are_one_gap_and_each_is_counted() -> None:
    condition = BusCondition("socketcan", 2)
    frames = [error(10 + t, OVERRUN) for t in range(0, 500, 5)]
    assert gaps_of(condition, heard(5), *frames) == [(5, 505, RECORDER_OVERFLOW)]
    assert condition.dropped_controller == 100


def test_counters_of_repeated_errors_are_the_last() -> None:
    condition = BusCondition("socketcan", 2)
    bus_errors = [error(t, (0x288, f"00 00 80 00 00 00 {t:02X} 07")) for t in range(1, 100)]
    assert gaps_of(condition, *bus_errors) == []
    assert (condition.tx_errors, condition.rx_errors) == (99, 7)


@pytest.mark.parametrize(
    ("where", "kernel", "controller", "queue"),
    [("kernel", 7, 0, 0), ("controller", 0, 7, 0), ("adapter", 0, 7, 0), ("queue", 0, 0, 7)],
)
def test_losses_are_counted_where_they_happened(
    where: LossPlace, kernel: int, controller: int, queue: int
) -> None:
    condition = BusCondition("socketcan", 2)
    condition.count_loss(Loss(2, where, 7, 0, 1, 1))
    status = condition.message()
    counted = (status.dropped_kernel, status.dropped_controller, status.dropped_queue)
    assert counted == (kernel, controller, queue)
    assert condition.dropped_frames == 7
