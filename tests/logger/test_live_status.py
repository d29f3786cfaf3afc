"""The live line: rates, load, nodes and their states."""

import json

import numpy as np
import pytest

from syncline_logger.bus_condition import BusCondition
from syncline_logger.live_status import LiveStatus, StatusSnapshot
from syncline_logger.status_view import status_json, status_line
from syncline_schemas.batch import FrameBatch, FrameFlag
from syncline_schemas.capture.layout import BusInfo

S = 1_000_000_000


def heartbeat(t_ns: int, byte: int, node: int = 5, flags: int = 0) -> FrameBatch:
    return FrameBatch.from_rows([(t_ns, 0, 0x700 + node, flags, 1, bytes([byte]))])


def take(live: LiveStatus, frames: FrameBatch) -> None:
    """Feed frames that reach the recorder when they are on the wire."""
    live.update(frames, frames.t_ns)


def snapshot(live: LiveStatus, now_ns: int, *conditions: BusCondition) -> StatusSnapshot:
    return live.snapshot(now_ns, "x.mcap", 1000, conditions or [BusCondition("virtual")])


def states(live: LiveStatus, now_ns: int) -> dict[int, str]:
    """Of the nodes of bus 0, which was listened to all the time."""
    live.listened(0, 0, now_ns)
    return {node: str(state) for node, state in snapshot(live, now_ns).buses[0].nodes.items()}


def one_bus(bitrate: int | None = None) -> LiveStatus:
    return LiveStatus([BusInfo("a", 0, bitrate)], 0)


def test_rates_are_those_of_the_last_period() -> None:
    live = one_bus()
    for n in range(100):
        take(live, heartbeat(n, 5))
    assert snapshot(live, 2 * S).buses[0].frames_per_s == 50
    assert snapshot(live, 3 * S).buses[0].frames_per_s == 0


def test_bus_load_counts_bits_on_the_wire() -> None:
    live = one_bus(bitrate=125_000)
    frame = FrameBatch.from_rows([(0, 0, 0x555, 0, 8, bytes.fromhex("AA" * 8))])
    for _ in range(100):
        take(live, frame)
    load = snapshot(live, S).buses[0].load_percent
    # 111 bits with intermission and no stuff bit before the CRC; the CRC adds at most three.
    assert load == pytest.approx(100 * 111 * 100 / 125_000, rel=0.04)


@pytest.mark.parametrize(("data_bitrate", "fast_bits"), [(2_000_000, 106 / 4), (None, 106)])
def test_bus_load_of_frames_with_bit_rate_switch(
    data_bitrate: int | None, fast_bits: float
) -> None:
    """30 bits at the nominal rate and 106 at the data rate, or as slow as all where it is unknown."""
    live = LiveStatus([BusInfo("a", 0, 500_000, data_bitrate)], 0)
    flags = int(FrameFlag.FD | FrameFlag.BRS)
    take(live, FrameBatch.from_rows([(0, 0, 0x42, flags, 8, bytes(range(8)))] * 100))
    load = snapshot(live, S).buses[0].load_percent
    assert load == pytest.approx(100 * 100 * (30 + fast_bits) / 500_000)


def test_without_a_bit_rate_there_is_no_load() -> None:
    live = one_bus()
    take(live, heartbeat(0, 5))
    assert snapshot(live, S).buses[0].load_percent is None


@pytest.mark.parametrize(
    ("byte", "state"),
    [
        (0x00, "PRE-OPERATIONAL"),
        (0x05, "OPERATIONAL"),
        (0x85, "OPERATIONAL"),
        (0x7F, "PRE-OPERATIONAL"),
        (0x04, "STOPPED"),
        (0x33, "UNKNOWN"),
    ],
)
def test_a_nodes_state(byte: int, state: str) -> None:
    live = one_bus()
    take(live, heartbeat(0, byte))
    assert states(live, S) == {5: state}


def test_a_silent_node_is_lost_after_three_periods() -> None:
    live = one_bus()
    take(live, heartbeat(0, 5))
    take(live, heartbeat(S, 5))
    assert states(live, 4 * S) == {5: "OPERATIONAL"}
    assert states(live, 4 * S + 1) == {5: "LOST"}


def test_a_node_that_only_booted_is_never_lost() -> None:
    live = one_bus()
    take(live, heartbeat(0, 0))
    assert states(live, 1000 * S) == {5: "PRE-OPERATIONAL"}


def heard_every(period_ns: int, count: int) -> LiveStatus:
    """Of node 5, from 0 on."""
    live = one_bus()
    for n in range(count):
        take(live, heartbeat(n * period_ns, 5))
    return live


def test_a_short_silence_of_a_fast_node_says_nothing() -> None:
    live = heard_every(S // 50, 10)
    last = 9 * S // 50
    assert states(live, last + S // 2) == {5: "OPERATIONAL"}
    assert states(live, last + S // 2 + 1) == {5: "LOST"}


def test_only_time_that_was_listened_to_is_silence() -> None:
    live = heard_every(S, 3)
    live.listened(0, 0, 2 * S)
    assert snapshot(live, 100 * S).buses[0].nodes == {5: "OPERATIONAL"}
    live.listened(0, 90 * S, 93 * S)
    assert snapshot(live, 100 * S).buses[0].nodes == {5: "OPERATIONAL"}
    live.listened(0, 90 * S, 93 * S + 1)
    assert snapshot(live, 100 * S).buses[0].nodes == {5: "LOST"}


def test_stamps_of_another_clock_make_nobody_lost() -> None:
    live = one_bus()
    for n in range(5):
        live.update(heartbeat(n * S - 3600 * S, 5), np.array([n * S]))
    assert states(live, 6 * S) == {5: "OPERATIONAL"}
    assert states(live, 8 * S) == {5: "LOST"}


def test_frames_that_arrive_together_keep_the_period_of_their_stamps() -> None:
    live = one_bus()
    burst = FrameBatch.concat([heartbeat(n * S, 5) for n in range(20)])
    live.update(burst, np.full(20, 20 * S))
    assert states(live, 22 * S) == {5: "OPERATIONAL"}


def test_a_period_set_anew_is_learned() -> None:
    live = heard_every(S // 10, 20)
    take(live, heartbeat(20 * S, 5))
    assert states(live, 29 * S) == {5: "OPERATIONAL"}
    take(live, heartbeat(30 * S, 5))
    assert states(live, 60 * S) == {5: "OPERATIONAL"}
    assert states(live, 61 * S) == {5: "LOST"}


@pytest.mark.parametrize("target", [0, 5])
@pytest.mark.parametrize("command", [0x81, 0x82])
def test_a_node_that_is_told_to_restart_may_be_silent_for_a_while(
    command: int, target: int
) -> None:
    """A LIR says nothing for 4 s after a reset (devices/skbis-lir-canopen.md section 5)."""
    live = heard_every(S // 10, 20)
    take(live, FrameBatch.from_rows([(2 * S, 0, 0, 0, 2, bytes([command, target]))]))
    assert states(live, 6 * S) == {5: "OPERATIONAL"}
    live.take_changes()
    take(live, heartbeat(6 * S, 0))
    assert [each.text for each in live.take_changes()] == [
        "node 5 boots, goes from OPERATIONAL to PRE-OPERATIONAL"
    ]


def test_a_node_that_does_not_come_back_from_a_restart_is_lost() -> None:
    live = heard_every(S // 10, 20)
    take(live, FrameBatch.from_rows([(2 * S, 0, 0, 0, 2, b"\x81\x05")]))
    assert states(live, 8 * S) == {5: "LOST"}


def test_the_restart_of_another_node_excuses_nobody() -> None:
    live = heard_every(S // 10, 20)
    take(live, FrameBatch.from_rows([(2 * S, 0, 0, 0, 2, b"\x81\x06")]))
    assert states(live, 4 * S) == {5: "LOST"}


def test_a_guard_request_is_no_sign_of_life() -> None:
    live = one_bus()
    take(live, heartbeat(0, 0, flags=int(FrameFlag.REMOTE)))
    assert states(live, S) == {}


def test_buses_are_kept_apart() -> None:
    live = LiveStatus([BusInfo("a", 0), BusInfo("b", 1)], 0)
    rows = [(0, 0, 0x705, 0, 1, b"\x05"), (0, 1, 0x706, 0, 1, b"\x04")]
    take(live, FrameBatch.from_rows(rows))
    done = snapshot(live, S, BusCondition("virtual"), BusCondition("virtual"))
    assert [list(bus.nodes) for bus in done.buses] == [[5], [6]]


def test_the_line_and_the_json_say_the_same() -> None:
    live = one_bus(bitrate=500_000)
    take(live, heartbeat(0, 5))
    condition = BusCondition("socketcan")
    condition.frames, condition.dropped_queue, condition.state = 1, 7, "passive"
    done = snapshot(live, 3661 * S, condition)
    values = json.loads(status_json(done))
    assert values["buses"][0]["nodes"] == {"5": "OPERATIONAL"}
    assert (values["frames"], values["buses"][0]["dropped_frames"]) == (1, 7)
    line = status_line(done).plain
    assert line.startswith("01:01:01  1 frame ")
    assert "| a 0/s 0.0 % passive 7 lost  5 OPERATIONAL" in line


def test_a_lost_adapter_is_shown() -> None:
    condition = BusCondition("virtual")
    condition.adapter_present = False
    assert "a adapter lost" in status_line(snapshot(one_bus(), S, condition)).plain
