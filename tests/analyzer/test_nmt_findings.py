"""Rules on NMT, error control and restarts: a fault that triggers each, and a near miss."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.findings.story import joined
from syncline_analyzer.results import Finding
from syncline_schemas.batch import Gap
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import load_device
from tests.analyzer.control_runs import MS, Row, Run, frame, remote, run
from tests.analyzer.test_nmt_fold import guarding, heartbeats, ordered

NODE = 5
OTHER = heartbeats(0, 4000, node=9)


def one(result: Run, rule: str) -> Finding:
    """The only finding of a rule, which names its evidence and what to do."""
    (finding,) = [f for f in result.findings() if f.id == rule]
    assert finding.evidence
    assert finding.text.endswith(".")
    assert finding.cause
    assert finding.check_next
    return finding


def written(t_ms: float, index: int, value: int, size: int = 2, sub: int = 0) -> list[Row]:
    """An expedited download that node 5 confirms 1 ms later."""
    command = {1: "2F", 2: "2B", 4: "23"}[size]
    place = index.to_bytes(2, "little").hex() + f"{sub:02X}"
    data = value.to_bytes(4, "little").hex()
    return [
        frame(t_ms, 0x605, command + place + data),
        frame(t_ms + 1, 0x585, f"60{place}00000000"),
    ]


def shifted(rows: list[Row], by_ms: float, after_ms: float = -1e12) -> list[Row]:
    """Rows later than a moment, stamped so much later; those before it as they are."""
    return [
        (t + round(by_ms * MS) * (t > after_ms * MS), bus, can_id, flags, dlc, data)
        for t, bus, can_id, flags, dlc, data in rows
    ]


def boot(t_ms: float, node: int = NODE) -> Row:
    return frame(t_ms, 0x700 + node, "00")


def others(end_ms: float) -> list[Row]:
    return heartbeats(0, end_ms, node=9)


# -- restarts --------------------------------------------------------------------------------------


@pytest.mark.triggers("nmt.boot_loop")
@pytest.mark.near_miss("nmt.unexpected_reset")
def test_a_boot_loop_is_one_finding() -> None:
    loop = [boot(1000 + 900 * n) for n in range(12)]
    states = [row for n in range(12) for row in heartbeats(1050 + 900 * n, 1850 + 900 * n)]
    result = run(*ordered(heartbeats(0, 1000), loop, states, others(11_800)))
    assert result.ids() == ["nmt.boot_loop"]
    finding = one(result, "nmt.boot_loop")
    assert (finding.severity, finding.node) == ("error", NODE)
    assert "12 times" in finding.text
    assert "again and again" in finding.text


@pytest.mark.triggers("nmt.unexpected_reset")
@pytest.mark.near_miss("nmt.boot_loop")
def test_restarts_far_apart_are_no_loop() -> None:
    at = (1000, 101_000, 201_000)
    beats = [
        row
        for begin, end in ((0, 1000), (1050, 101_000), (101_050, 201_000))
        for row in heartbeats(begin, end)
    ]
    result = run(*ordered(beats, [boot(t) for t in at], others(202_000)))
    assert result.ids() == ["nmt.unexpected_reset"] * 3


@pytest.mark.triggers("nmt.unexpected_reset")
@pytest.mark.parametrize(
    ("emcy", "watchdog"),
    [("1060010000000000", True), ("0060010000000000", False), ("0000000000000000", False)],
)
def test_a_watchdog_that_the_node_tells_of_is_the_cause(emcy: str, watchdog: bool) -> None:
    """6010h is a reset by the watchdog, whatever the node's make; 6000h may be any software."""
    told = [boot(2900), frame(2910, 0x085, emcy)]
    rows = ordered(heartbeats(0, 2000), told, heartbeats(3000, 6000), others(6000))
    finding = one(run(*rows), "nmt.unexpected_reset")
    assert ("Its watchdog reset it (EMCY 6010h)" in finding.cause) == watchdog
    assert ("for a watchdog EMCY" in finding.check_next) != watchdog
    assert ("CiA 402" in " ".join(finding.assumed)) == watchdog


@pytest.mark.triggers("nmt.unexpected_reset")
def test_a_device_whose_sheet_tells_of_the_watchdog_needs_no_assumption() -> None:
    told = [boot(2900), frame(2910, 0x085, "1060010000040000")]
    rows = ordered(heartbeats(0, 2000), told, heartbeats(3000, 6000), others(6000))
    finding = one(run(*rows, devices={NODE: load_device("lir-da158a")}), "nmt.unexpected_reset")
    assert finding.cause == "Its watchdog reset it (EMCY 6010h)."
    assert finding.assumed == []


@pytest.mark.triggers("nmt.reset_again")
@pytest.mark.near_miss("nmt.reset_again")
@pytest.mark.parametrize(("number", "told"), [(8, ["nmt.reset_again"]), (5, [])])
def test_a_master_that_resets_everybody_again_and_again(number: int, told: list[str]) -> None:
    rows = [
        row
        for n in range(number)
        for row in [
            frame(10_000 * n + 10, 0x000, "8100"),
            frame(10_000 * n + 20, 0x000, "8200"),
            boot(10_000 * n + 500),
            *heartbeats(10_000 * n + 600, 10_000 * n + 10_000, state="7F"),
        ]
    ]
    result = run(*ordered(rows))
    assert result.ids() == told
    for finding in result.findings():
        assert (finding.severity, finding.node) == ("info", None)
        assert "reset all nodes 8 times within 70 s" in finding.text


@pytest.mark.near_miss("nmt.boot_loop")
def test_two_restarts_soon_after_one_another_are_no_loop() -> None:
    beats = [*heartbeats(0, 1000), *heartbeats(1050, 20_000), *heartbeats(20_050, 40_000)]
    result = run(*ordered(beats, [boot(1000), boot(20_000)], others(40_000)))
    assert result.ids() == ["nmt.unexpected_reset"] * 2


def test_many_single_restarts_are_one_finding() -> None:
    rows = [
        row
        for n in range(7)
        for row in [
            boot(100_000 * n),
            *heartbeats(100_000 * n + 50, 100_000 * (n + 1), every_ms=500),
        ]
    ]
    result = run(*ordered(rows, heartbeats(0, 700_000, every_ms=500, node=9)))
    assert result.ids() == ["nmt.unexpected_reset"]
    assert "6 times" in one(result, "nmt.unexpected_reset").text


@pytest.mark.near_miss("nmt.unexpected_reset")
def test_a_boot_up_right_after_a_gap_may_have_been_commanded_in_it() -> None:
    gap = Gap(1000 * MS, 30_000 * MS, "adapter lost", 3)
    before = ordered(heartbeats(0, 1000), others(1000))
    late = [boot(30_500), *heartbeats(30_600, 34_000)]
    after = ordered(late, heartbeats(30_000, 34_000, node=9))
    assert run(*before, gap, *after).ids() == ["capture.gap"]
    heard = ordered([frame(30_100, 0x705, "05")], after)
    assert "nmt.unexpected_reset" in run(*before, gap, *heard).ids()


@pytest.mark.near_miss("nmt.unexpected_reset")
@pytest.mark.parametrize("step_ms", [3_600_000, -3_600_000])
def test_a_clock_step_between_reset_and_boot_up_accuses_nobody(step_ms: int) -> None:
    t0 = 4_000_000
    before = ordered(heartbeats(t0, t0 + 1000), heartbeats(t0, t0 + 1100, node=9))
    back = t0 + 1100 + step_ms
    after = ordered(
        [boot(back + 200)],
        heartbeats(back + 300, back + 3000),
        heartbeats(back, back + 3000, node=9),
    )
    result = run(*before, frame(t0 + 1010, 0x000, "8105"), *after)
    assert [i for i in result.ids() if i.startswith("nmt.")] == []
    confirmed = result.analysis.nmt_commands[0].confirmed_ms
    assert confirmed is None


@pytest.mark.triggers("nmt.no_boot_up")
def test_a_node_that_never_comes_back_from_a_reset() -> None:
    beats = [*heartbeats(0, 1000), frame(1010, 0x000, "8105")]
    result = run(*ordered(beats, others(20_000)))
    assert result.ids() == ["nmt.no_boot_up"]
    finding = one(result, "nmt.no_boot_up")
    assert (finding.node, finding.start_ns) == (NODE, 1010 * MS)
    assert '"reset node" to it' in finding.text
    assert "up to the end" in finding.text
    late = [*beats, boot(9000), *heartbeats(9100, 20_000)]
    assert "only 7.99 s later" in one(run(*ordered(late, others(20_000))), "nmt.no_boot_up").text


def test_a_node_without_error_control_that_is_silent_after_a_reset() -> None:
    bound = [frame(1, 0x605, "4000180100000000"), frame(2, 0x585, "4300180185010000")]
    pdos = [frame(t, 0x185, "01") for t in range(20, 1000, 20)]
    reset = [frame(1010, 0x000, "8105")]
    result = run(*ordered(bound, pdos, reset, others(20_000)))
    assert result.ids() == ["nmt.no_boot_up"]
    alive = [frame(9000, 0x605, "4000100000000000"), frame(9001, 0x585, "4300100000000000")]
    assert run(*ordered(bound, pdos, reset, alive, others(20_000))).ids() == []


@pytest.mark.near_miss("nmt.no_boot_up")
def test_four_seconds_of_silence_after_a_reset_are_normal() -> None:
    """Sheet skbis-lir-canopen.md, trap 18."""
    rows = [*heartbeats(0, 1000), frame(1010, 0x000, "8105"), boot(5100), *heartbeats(5200, 9000)]
    assert run(*ordered(rows, others(9000))).ids() == []
    ended = [*heartbeats(0, 1000), frame(1010, 0x000, "8105")]
    assert run(*ordered(ended, others(4000))).ids() == []


def resets(*boot_ms: float) -> list[Row]:
    """A reset every 10 s, each with its boot-up so much later."""
    return [
        row
        for n, passed in enumerate(boot_ms)
        for row in [
            frame(10_000 * n, 0x000, "8105"),
            boot(10_000 * n + passed),
            *heartbeats(10_000 * n + passed + 100, 10_000 * (n + 1), every_ms=500),
        ]
    ]


@pytest.mark.triggers("nmt.slow_boot")
@pytest.mark.near_miss("nmt.slow_boot")
def test_one_slow_start_of_many() -> None:
    rows = heartbeats(-1000, 0, every_ms=500)
    slow = shifted([*rows, *resets(300, 310, 4200, 305, 300)], 1000)
    watched = heartbeats(0, 51_000, node=9)
    result = run(*ordered(slow, watched))
    finding = one(result, "nmt.slow_boot")
    assert finding.severity == "info"
    assert "took 4.2 s" in finding.text
    assert "305 ms" in finding.text
    boot_ms = result.nodes[NODE].boot_ms
    assert boot_ms is not None
    assert boot_ms.max == pytest.approx(4200)
    even = shifted([*rows, *resets(300, 310, 700, 305, 300)], 1000)
    assert run(*ordered(even, watched)).ids() == []


# -- silence ---------------------------------------------------------------------------------------


@pytest.mark.near_miss("nmt.node_lost", "nmt.bus_silent")
@pytest.mark.parametrize("step_ms", [60, 120, 300, 2000, 3_600_000])
def test_a_clock_step_forward_accuses_nobody(step_ms: int) -> None:
    """It looks like the silence of everybody, also when it is short against the heartbeats."""
    whole = ordered(heartbeats(0, 4000), heartbeats(30, 4000, every_ms=170, node=9))
    stepped = shifted(whole, step_ms, after_ms=2000)
    result = run(*stepped)
    assert [i for i in result.ids() if i.startswith("nmt.")] == []
    period = result.nodes[NODE].heartbeat_period_us
    assert period is not None
    assert period.max < 200_000


@pytest.mark.triggers("nmt.node_lost")
def test_a_node_that_dies_before_the_machine_is_switched_off_is_lost() -> None:
    beats = ordered(heartbeats(0, 1000), heartbeats(0, 5000, node=9))
    on = ordered(
        [boot(15_000), boot(15_001, 9)],
        heartbeats(15_100, 17_000),
        heartbeats(15_100, 17_000, node=9),
    )
    assert run(*beats).ids() == ["nmt.node_lost"]
    assert "nmt.bus_silent" in run(*beats, *on).ids()


@pytest.mark.triggers("nmt.bus_silent")
def test_a_machine_switched_off_and_on_accuses_no_node() -> None:
    off = ordered(heartbeats(0, 1000), others(1000))
    on = ordered(
        [boot(9000), boot(9004, 9)], heartbeats(9100, 11_000), heartbeats(9100, 11_000, node=9)
    )
    result = run(*off, *on)
    assert result.ids() == ["nmt.bus_silent"]
    assert one(result, "nmt.bus_silent").node is None


@pytest.mark.near_miss("nmt.node_lost")
def test_two_buses_with_the_same_node_ids_are_two_machines() -> None:
    here = heartbeats(0, 4000)
    there = [frame(t, 0x705, "05", bus=1) for t in range(33, 4000, 100)]
    assert run(*ordered(here, there)).ids() == []


@pytest.mark.triggers("nmt.heartbeat_stopped")
@pytest.mark.near_miss("nmt.node_lost")
def test_a_heartbeat_switched_off_by_1017h_is_not_lost() -> None:
    rows = ordered(heartbeats(0, 1030), written(1000, 0x1017, 0), others(20_000))
    result = run(*rows)
    assert result.ids() == ["nmt.heartbeat_stopped"]
    finding = one(result, "nmt.heartbeat_stopped")
    assert finding.severity == "info"
    assert "100 ms" in finding.text


@pytest.mark.near_miss("nmt.heartbeat_stopped", "nmt.node_lost")
def test_a_heartbeat_that_is_set_up_is_neither_off_nor_lost() -> None:
    again = [
        *written(1000, 0x1017, 0),
        *written(2000, 0x1017, 5000),
        *heartbeats(7000, 40_000, every_ms=5000),
    ]
    result = run(*ordered(heartbeats(0, 1000), again, others(40_000)))
    assert result.ids() == []
    slower = [*written(1000, 0x1017, 5000), *heartbeats(6000, 40_000, every_ms=5000)]
    assert run(*ordered(heartbeats(0, 1000), slower, others(40_000))).ids() == []


@pytest.mark.near_miss("nmt.heartbeat_stopped")
def test_a_heartbeat_that_was_off_for_a_few_seconds_may_be_set_up_still() -> None:
    rows = ordered(heartbeats(0, 1030), written(1000, 0x1017, 0), others(6000))
    assert "nmt.heartbeat_stopped" not in run(*rows).ids()


@pytest.mark.near_miss("nmt.node_lost")
def test_a_guarded_node_has_its_life_time() -> None:
    """100Ch x 100Dh = 800 ms: one answer that stays away for 500 ms is no loss."""
    life = [*written(1, 0x100C, 100), *written(3, 0x100D, 8, 1)]
    silent = ordered(guarding(10, 1000), guarding(1010, 1400, answers=False), guarding(1410, 4000))
    assert "nmt.node_lost" in run(*ordered(silent, others(4000))).ids()
    assert "nmt.node_lost" not in run(*ordered(life, silent, others(4000))).ids()


# -- two devices -----------------------------------------------------------------------------------


@pytest.mark.triggers("nmt.duplicate_node_id")
def test_a_second_device_of_the_same_period_half_apart() -> None:
    """500 ms in the middle of 500 ms looks like 250 ms: the old cadence goes on."""
    first = heartbeats(0, 30_000, every_ms=500)
    second = heartbeats(10_255, 30_000, every_ms=500)
    result = run(*ordered(first, second, others(30_000)))
    assert result.ids() == ["nmt.duplicate_node_id"]
    assert "in the middle" in one(result, "nmt.duplicate_node_id").text


@pytest.mark.near_miss("nmt.duplicate_node_id")
@pytest.mark.parametrize("phase", [0, 70, 130])
def test_a_heartbeat_that_was_set_to_half_its_period_is_one_device(phase: int) -> None:
    slow = heartbeats(0, 10_000, every_ms=500)
    fast = heartbeats(10_000 + phase, 30_000, every_ms=250)
    write = written(9_990, 0x1017, 250)
    assert run(*ordered(slow, write, fast, others(30_000))).ids() == []


@pytest.mark.near_miss("nmt.duplicate_node_id")
@pytest.mark.parametrize(("period", "grid"), [(50, 20), (25, 10), (150, 60), (70, 20)])
def test_heartbeats_on_the_grid_of_a_slow_task_alternate_but_come_from_one(
    period: int, grid: int
) -> None:
    times = sorted({-(-period * n // grid) * grid for n in range(200)})
    result = run(*ordered([frame(t, 0x705, "05") for t in times], others(200 * period)))
    assert result.ids() == []


@pytest.mark.near_miss("nmt.duplicate_node_id")
def test_a_recorder_that_takes_every_frame_twice_is_no_second_device() -> None:
    rows = ordered(heartbeats(0, 4000), heartbeats(0, 4000, node=9))
    twice = ordered(rows, shifted(rows, 0.15))
    assert run(*twice).ids() == []


@pytest.mark.triggers("nmt.duplicate_node_id")
def test_guard_requests_that_are_answered_twice() -> None:
    again = [
        frame(row[0] / MS + 2, row[2], row[5].hex()) for row in guarding(0, 2000) if not row[3]
    ]
    result = run(*ordered(guarding(0, 2000), again, others(2000)))
    assert result.ids() == ["nmt.duplicate_node_id"]
    assert "answered twice" in one(result, "nmt.duplicate_node_id").text


# -- heartbeats ------------------------------------------------------------------------------------


@pytest.mark.triggers("nmt.heartbeat_slow")
@pytest.mark.near_miss("nmt.heartbeat_fast")
def test_500_ms_against_1017h_of_100_ms() -> None:
    result = run(*ordered(written(1, 0x1017, 100), heartbeats(10, 4000, every_ms=500), OTHER))
    assert result.ids() == ["nmt.heartbeat_slow"]
    finding = one(result, "nmt.heartbeat_slow")
    assert "every 500 ms although 1017h is 100 ms (sdo-write)" in finding.text


@pytest.mark.triggers("nmt.heartbeat_fast")
@pytest.mark.near_miss("nmt.heartbeat_slow")
def test_100_ms_against_1017h_of_500_ms() -> None:
    result = run(*ordered(written(1, 0x1017, 500), heartbeats(10, 4000), OTHER))
    assert result.ids() == ["nmt.heartbeat_fast"]


@pytest.mark.near_miss("nmt.heartbeat_slow", "nmt.heartbeat_fast")
def test_1017h_written_in_the_middle_counts_from_there_on() -> None:
    rows = [*written(1, 0x1017, 1000), *heartbeats(10, 20_000, every_ms=1000)]
    rows += [*written(20_000, 0x1017, 100), *heartbeats(20_100, 24_000)]
    assert run(*ordered(rows, others(24_000))).ids() == []


def test_a_value_of_the_description_is_said_to_be_assumed() -> None:
    told = BusDescription.loads(
        '[bus.can0.node.5]\nname = "boom"\n[bus.can0.node.5.objects]\n"1017h" = 100\n'
    )
    result = run(*ordered(heartbeats(0, 8000, every_ms=500), others(8000)), description=told)
    finding = one(result, "nmt.heartbeat_slow")
    assert finding.text.startswith("Node 5 (boom) sends")
    assert finding.assumed == ["1017h is 100 ms (bus-description)"]


def late_beats(late_ms: float, times: int = 4) -> list[Row]:
    """Heartbeats every 100 ms of which some are late, and PDOs that go on."""
    beats, t_ms = [], 0.0
    for n in range(80):
        t_ms += 100 + (late_ms if n in range(20, 20 + 10 * times, 10) else 0)
        beats.append(frame(t_ms, 0x705, "05"))
    return ordered(beats, [frame(t, 0x185, "01") for t in range(5, 8000, 20)])


@pytest.mark.triggers("nmt.heartbeat_irregular")
@pytest.mark.near_miss("nmt.heartbeat_irregular", "nmt.node_lost")
def test_heartbeats_that_are_late_while_the_node_is_there() -> None:
    result = run(*ordered(late_beats(90), others(8400)))
    assert result.ids() == ["nmt.heartbeat_irregular"]
    finding = one(result, "nmt.heartbeat_irregular")
    assert finding.severity == "info"
    assert "4 times" in finding.text
    assert "by up to 90 ms" in finding.text
    period = result.nodes[NODE].heartbeat_period_us
    assert period is not None
    assert (period.min, period.max) == (100_000, 190_000)
    assert run(*ordered(late_beats(40), others(8400))).ids() == []
    assert run(*ordered(late_beats(90, times=2), others(8400))).ids() == []


def watching(ms: int, t_ms: float = 2) -> list[Row]:
    """Node 9 is told to watch node 5."""
    value = (NODE << 16 | ms).to_bytes(4, "little").hex()
    return [frame(t_ms, 0x609, "23161001" + value), frame(t_ms + 1, 0x589, "6016100100000000")]


@pytest.mark.triggers("nmt.consumer_time")
@pytest.mark.near_miss("nmt.consumer_time")
def test_a_consumer_time_shorter_than_the_heartbeat() -> None:
    beats = ordered(heartbeats(10, 9000, every_ms=500), others(9000))
    result = run(*ordered(watching(300), beats))
    assert result.ids() == ["nmt.consumer_time"]
    finding = one(result, "nmt.consumer_time")
    assert finding.node == 9
    assert "allows node 5 300 ms (1016h:01, sdo-write)" in finding.text
    assert "comes every 500 ms" in finding.text
    assert run(*ordered(watching(750), beats)).ids() == []


def test_a_consumer_time_that_single_heartbeats_exceed() -> None:
    result = run(*ordered(watching(150), late_beats(90, times=2), others(8400)))
    assert "2 times took up to 190 ms" in one(result, "nmt.consumer_time").text


@pytest.mark.triggers("nmt.unknown_state")
@pytest.mark.near_miss("nmt.unknown_state")
def test_bytes_that_are_no_state() -> None:
    odd = [frame(1050, 0x705, "06"), frame(2050, 0x705, "06"), frame(2350, 0x705, "0500")]
    result = run(*ordered(heartbeats(0, 4000), odd, OTHER))
    assert result.ids() == ["nmt.unknown_state"]
    finding = one(result, "nmt.unknown_state")
    assert "3 messages on 705h" in finding.text
    assert "state byte 06h (2 times); 2 instead of 1 byte" in finding.text
    assert [state for state, _, _ in result.states(NODE)] == ["OPERATIONAL"]
    extended = [(t, bus, 0x705, 0x1, 1, b"\x06") for t, bus, *_ in odd]
    assert run(*ordered(heartbeats(0, 4000), extended, OTHER)).ids() == []


# -- guarding --------------------------------------------------------------------------------------


def with_pdos(*parts: list[Row]) -> list[Row]:
    return ordered(*parts, [frame(t, 0x185, "01") for t in range(5, 4000, 20)], OTHER)


@pytest.mark.triggers("nmt.guard_unanswered")
@pytest.mark.parametrize("batch", [1, 7, 1 << 20])
def test_guard_requests_without_an_answer(batch: int) -> None:
    rows = with_pdos(guarding(0, 1000), guarding(1000, 1300, answers=False), guarding(1300, 4000))
    result = run(*rows, batch=batch)
    assert result.ids() == ["nmt.guard_unanswered"]
    finding = one(result, "nmt.guard_unanswered")
    assert "3 of 40 guard requests unanswered, up to 3 in a row" in finding.text
    node = result.nodes[NODE]
    assert node.guard_missed == 3
    assert node.guard_period_us is not None
    assert node.guard_period_us.median == 100_000


@pytest.mark.near_miss("nmt.guard_unanswered")
def test_single_answers_and_nodes_that_are_not_there_are_no_matter() -> None:
    rows = with_pdos(guarding(0, 1000), guarding(1000, 1100, answers=False), guarding(1100, 4000))
    assert run(*rows).ids() == []
    search = [remote(t, 0x706) for t in range(0, 4000, 100)]
    assert run(*ordered(guarding(0, 4000), search, OTHER)).ids() == []
    never = with_pdos(guarding(0, 4000, answers=False))
    assert run(*never).ids() == []


def hasty(boot_ms: float, *more: Row, end_ms: float = 20_000) -> list[Row]:
    """A master that resets node 5 and starts it at once, before it has booted."""
    sent = [frame(1000, 0x000, "8105"), frame(1050, 0x000, "0105"), *more]
    after = [boot(boot_ms), *heartbeats(boot_ms + 50, end_ms, state="7F")]
    return ordered(heartbeats(0, 1000), sent, after, heartbeats(0, end_ms, node=9))


@pytest.mark.near_miss("nmt.node_lost", "nmt.unexpected_reset", "nmt.no_boot_up")
@pytest.mark.triggers("nmt.command_ignored")
def test_a_start_before_the_boot_up_neither_ends_the_reset_nor_starts_the_node() -> None:
    result = run(*hasty(2000))
    assert result.ids() == ["nmt.command_ignored"]
    finding = one(result, "nmt.command_ignored")
    assert (finding.node, finding.start_ns) == (NODE, 1050 * MS)
    assert "PRE-OPERATIONAL" in finding.text
    assert "still starting" in finding.cause
    starting = [("INITIALISING", 1.0, 1.05), ("INITIALISING", 1.05, 2.0)]
    assert result.states(NODE)[-3:-1] == starting


@pytest.mark.near_miss("nmt.command_ignored")
def test_a_start_before_the_boot_up_that_is_sent_again_is_not_told() -> None:
    again = [frame(2100, 0x000, "0105"), *heartbeats(2200, 20_000)]
    sent = [frame(1000, 0x000, "8105"), frame(1050, 0x000, "0105"), boot(2000), *again]
    rows = ordered(heartbeats(0, 1000), sent, heartbeats(0, 20_000, node=9))
    assert run(*rows).ids() == []


@pytest.mark.near_miss("nmt.guard_toggle")
@pytest.mark.parametrize("apart_us", [1, 600, 5000])
def test_two_requests_that_are_answered_one_after_the_other_repeat_no_toggle_bit(
    apart_us: int,
) -> None:
    """Two masters that guard one node ask it at nearly the same time now and then."""
    rows: list[Row] = []
    bit = 0
    for k in range(40):
        twice = k % 5 == 4
        asked = [100.0 * k, 100.0 * k + apart_us / 1000][: 1 + twice]
        rows += [remote(t, 0x705) for t in asked]
        for n in range(1 + twice):
            rows.append(frame(100.0 * k + 6 + n, 0x705, f"{0x05 | bit:02X}"))
            bit ^= 0x80
    assert run(*ordered(rows, heartbeats(0, 4000, node=9))).ids() == []


@pytest.mark.triggers("nmt.guard_toggle")
def test_a_toggle_bit_that_is_stuck() -> None:
    stuck = [row if row[3] else frame(row[0] / MS, 0x705, "05") for row in guarding(0, 2000)]
    finding = one(run(*ordered(stuck, others(2000))), "nmt.guard_toggle")
    assert "always had the same toggle bit (20 of them)" in finding.text


@pytest.mark.near_miss("nmt.guard_toggle")
def test_one_toggle_bit_that_repeats_is_not_told() -> None:
    rows = ordered(guarding(0, 1000), guarding(1000, 2000, toggle=1), others(2000))
    assert run(*rows).nodes[NODE].toggle_errors == 1
    assert "nmt.guard_toggle" not in run(*rows).ids()


@pytest.mark.near_miss("nmt.guard_toggle")
def test_a_toggle_bit_that_a_reset_starts_again() -> None:
    again = [
        *guarding(0, 1000),
        frame(1010, 0x000, "8105"),
        boot(1100),
        *guarding(1200, 2000, state=0x7F),
    ]
    odd = [
        *guarding(0, 900),
        frame(910, 0x000, "8105"),
        boot(1000),
        *guarding(1100, 2000, state=0x7F),
    ]
    for rows in (again, odd):
        assert run(*ordered(rows, others(2000))).ids() == []


@pytest.mark.triggers("nmt.life_time")
@pytest.mark.near_miss("nmt.life_time")
def test_a_life_time_shorter_than_the_guard_period() -> None:
    def life(ms: int, factor: int) -> Run:
        settings = [*written(1, 0x100C, ms), *written(3, 0x100D, factor, 1)]
        return run(*ordered(settings, guarding(10, 4000), OTHER))

    finding = one(life(30, 3), "nmt.life_time")
    assert "asks node 5 every 100 ms, but its life time of 90 ms" in finding.text
    assert life(100, 3).ids() == []
    assert life(0, 3).ids() == []


@pytest.mark.triggers("config.rtr_on_heartbeat_node")
@pytest.mark.near_miss("config.rtr_on_heartbeat_node")
def test_remote_frames_to_a_heartbeat_node() -> None:
    ask = [remote(2050, 0x705)]
    assert run(*ordered(heartbeats(0, 4000), ask, OTHER)).ids() == ["config.rtr_on_heartbeat_node"]
    assert run(*ordered(guarding(0, 4000), OTHER)).ids() == []


def test_one_remote_frame_to_a_heartbeat_node_is_no_guarding() -> None:
    """A warning only where the master goes on, or the node's heartbeats are empty since."""
    rule = "config.rtr_on_heartbeat_node"
    once = one(run(*ordered(heartbeats(0, 4000), [remote(2050, 0x705)], OTHER)), rule)
    assert (once.severity, "asked once" in once.text) == ("info", True)
    assert "master guards" not in once.cause
    asked = [remote(2050, 0x705), remote(2550, 0x705)]
    assert one(run(*ordered(heartbeats(0, 4000), asked, OTHER)), rule).severity == "warning"


@pytest.mark.parametrize("batch", [1, 5, 1 << 20])
def test_heartbeats_emptied_by_a_request_that_was_stored_without_rtr(batch: int) -> None:
    """LB04 in a log that knows no remote frames: the node is alive, and its state unknown."""
    rows = [*heartbeats(0, 1000), frame(930, 0x705), *heartbeats(1000, 3000, state="")]
    result = run(*ordered(rows, others(3000)), batch=batch)
    node = result.nodes[NODE]
    assert (node.guard_requests, node.heartbeats, node.final_state) == (1, 10, "UNKNOWN")
    assert result.tables.nmt.nodes[0, NODE].counts.empty == 20
    assert "nmt.node_lost" not in result.ids()


def test_requests_stored_without_rtr_to_a_node_that_died_are_requests() -> None:
    dead = [frame(row[0] / MS, 0x705) for row in guarding(1000, 3000, answers=False)]
    stored = [frame(row[0] / MS, row[2]) if row[3] else row for row in guarding(0, 1000)]
    result = run(*ordered(stored, dead, others(3000)))
    assert result.ids() == ["nmt.node_lost"]
    assert result.nodes[NODE].guard_missed >= 19


# -- commands and states ---------------------------------------------------------------------------


@pytest.mark.triggers("nmt.left_operational")
@pytest.mark.near_miss("nmt.left_operational")
def test_operational_to_stopped_without_a_command() -> None:
    rows = ordered(heartbeats(0, 1000), heartbeats(1000, 4000, state="04"), OTHER)
    finding = one(run(*rows), "nmt.left_operational")
    assert "from OPERATIONAL to STOPPED" in finding.text
    stop = [frame(950, 0x000, "0205")]
    assert run(*ordered(rows, stop)).ids() == []


@pytest.mark.triggers("nmt.state_changed")
@pytest.mark.near_miss("nmt.state_changed")
def test_a_node_that_leaves_stopped_by_itself() -> None:
    rows = ordered(heartbeats(0, 1000, state="04"), heartbeats(1000, 4000, state="7F"), OTHER)
    finding = one(run(*rows), "nmt.state_changed")
    assert "from STOPPED to PRE-OPERATIONAL at +1.000 s without a command" in finding.text
    start = [frame(950, 0x000, "8000")]
    assert run(*ordered(rows, start)).ids() == []
    gap = Gap(1000 * MS, 1500 * MS, "overrun")
    before = ordered(heartbeats(0, 1000, state="04"), others(1000))
    after = ordered(heartbeats(1500, 4000, state="7F"), heartbeats(1500, 4000, node=9))
    assert run(*before, gap, *after).ids() == ["capture.gap"]


@pytest.mark.triggers("nmt.never_operational")
@pytest.mark.near_miss("nmt.never_operational")
def test_a_node_that_nobody_starts() -> None:
    waiting = heartbeats(0, 40_000, state="7F")
    result = run(*ordered(waiting, others(40_000)))
    assert result.ids() == ["nmt.never_operational"]
    assert one(result, "nmt.never_operational").severity == "info"
    all_wait = heartbeats(0, 40_000, state="7F", node=9)
    assert run(*ordered(waiting, all_wait)).ids() == []
    assert run(*ordered(heartbeats(0, 20_000, state="7F"), others(20_000))).ids() == []


@pytest.mark.triggers("nmt.command_ignored")
@pytest.mark.near_miss("nmt.command_ignored")
def test_a_command_is_not_ignored_across_a_clock_step() -> None:
    stop = frame(1010, 0x000, "0205")
    rows = ordered(heartbeats(0, 4000), [stop], OTHER)
    assert run(*rows).ids() == ["nmt.command_ignored"]
    followed = ordered(heartbeats(0, 1100), heartbeats(1100, 4000, state="04"), OTHER)
    assert run(*ordered(followed, [stop])).ids() == []
    in_flight = ordered(heartbeats(1, 1010), heartbeats(1101, 4000, state="04"), OTHER, [stop])
    stepped = shifted(in_flight, 60_000, after_ms=1010)
    assert "nmt.command_ignored" not in run(*stepped).ids()


@pytest.mark.triggers("nmt.pdo_outside_operational")
@pytest.mark.near_miss("nmt.pdo_outside_operational")
def test_pdos_in_pre_operational() -> None:
    bind = [frame(1, 0x605, "4000180100000000"), frame(2, 0x585, "4300180185010000")]
    pdos = [frame(t, 0x185, "01") for t in range(1000, 2000, 100)]
    preop = heartbeats(10, 4000, state="7F")
    assert run(*ordered(bind, preop, pdos, OTHER)).ids() == ["nmt.pdo_outside_operational"]
    assert run(*ordered(preop, pdos, OTHER)).ids() == []


@pytest.mark.triggers("nmt.malformed_command")
@pytest.mark.near_miss("nmt.malformed_command")
def test_frames_on_000h_that_are_none() -> None:
    result = run(*ordered(OTHER, [frame(1003, 0x000, "01")]))
    assert result.ids() == ["nmt.malformed_command"]
    assert run(*[frame(10 * n, 0x000, "01020304") for n in range(50)]).ids() == []


@pytest.mark.triggers("nmt.command_to_absent_node")
@pytest.mark.near_miss("nmt.command_to_absent_node")
def test_commands_to_nodes_that_are_not_there() -> None:
    called = [frame(503, 0x000, "8107"), frame(603, 0x000, "8108"), frame(703, 0x000, "0107")]
    result = run(*ordered(called, OTHER))
    finding = one(result, "nmt.command_to_absent_node")
    assert finding.severity == "info"
    assert "3 NMT commands were sent to nodes 7, 8" in finding.text
    search = [frame(500 + n, 0x000, f"81{n:02X}") for n in range(1, 128)]
    after = heartbeats(1000, 4000, state="7F", node=9)
    assert run(*ordered(heartbeats(0, 500, node=9), search, [boot(900, 9)], after)).ids() == []


@pytest.mark.triggers("nmt.guarding_lost")
@pytest.mark.near_miss("nmt.guarding_lost")
def test_a_master_that_pauses_is_told_only_where_a_node_misses_it() -> None:
    emcy = [frame(1205, 0x085, "3081110000000000")]
    life = [*written(1, 0x100C, 100), *written(3, 0x100D, 3, 1)]
    rows = ordered(life, guarding(10, 1000), emcy, guarding(1410, 3000, state=0x7F), OTHER)
    finding = one(run(*rows), "nmt.guarding_lost")
    assert "life time of 300 ms" in finding.text
    assert run(*ordered(guarding(0, 1000), guarding(1400, 3000), OTHER)).ids() == []


def unguarded(*more: list[Row], end_ms: float = 12_000) -> Run:
    """Node 5 is asked every 100 ms for 4 s, and never again."""
    return run(*ordered(guarding(0, 4000), others(end_ms), *more))


@pytest.mark.triggers("nmt.guarding_ended")
def test_guarding_that_ends_while_the_bus_lives_on() -> None:
    result = unguarded()
    assert result.ids() == ["nmt.guarding_ended"]
    finding = one(result, "nmt.guarding_ended")
    assert (finding.severity, finding.node) == ("info", NODE)
    assert "to node 5, every 100 ms until then, ended at +3.900 s" in finding.text
    assert finding.text.endswith("Nothing was heard of it after +3.901 s.")
    sends = one(
        unguarded([frame(t, 0x185, "01") for t in range(5, 12_000, 20)]), "nmt.guarding_ended"
    )
    assert "Nothing was heard" not in sends.text


@pytest.mark.triggers("nmt.guarding_ended")
def test_guarding_that_ends_is_a_warning_where_the_life_time_is_on() -> None:
    life = [*written(1, 0x100C, 100), *written(3, 0x100D, 3, 1)]
    finding = one(run(*ordered(life, guarding(10, 4000), others(20_000))), "nmt.guarding_ended")
    assert finding.severity == "warning"
    assert "The life time of 300 ms (100Ch x 100Dh, sdo-write) of node 5 ran out" in finding.text


@pytest.mark.triggers("nmt.guarding_ended")
@pytest.mark.parametrize("state", ["7F", "04"])
@pytest.mark.parametrize("can_id", [0x85, 0x80000085])
def test_a_node_that_sends_no_emcy_is_not_missed_one_of(state: str, can_id: int) -> None:
    life = [*written(1, 0x100C, 100), *written(3, 0x100D, 3, 1), *written(5, 0x1014, can_id, 4)]
    told = [
        (*row[:5], bytes([row[5][0] & 0x80 | int(state, 16)])) if row[5] else row
        for row in guarding(10, 4000)
    ]
    finding = one(run(*ordered(life, told, others(20_000))), "nmt.guarding_ended")
    tells = (state, can_id) == ("7F", 0x85)
    assert finding.severity == ("warning" if tells else "info")
    assert ("did not come" in finding.text) == tells


@pytest.mark.triggers("nmt.guarding_ended")
def test_guarding_that_ends_for_two_nodes_at_once_is_one_finding() -> None:
    second = [(row[0] + 7 * MS, row[1], 0x706, *row[3:]) for row in guarding(0, 4000)]
    finding = one(unguarded(second), "nmt.guarding_ended")
    assert finding.node is None
    assert "to nodes 5, 6," in finding.text
    assert "Nothing was heard of them" in finding.text


@pytest.mark.near_miss("nmt.guarding_ended")
@pytest.mark.parametrize(
    "more",
    [
        [frame(3950, 0x000, "0205")],
        [frame(4200, 0x000, "8200")],
        [*written(3990, 0x100C, 0), *written(3994, 0x100D, 0, 1)],
        [*written(3950, 0x1017, 100), *heartbeats(4050, 12_000)],
        [frame(4400, 0x085, "3081110000000000")],
        guarding(11_000, 12_000),
        guarding(4000, 5000, answers=False),
        [remote(3950, 0x705), remote(4045, 0x705)],
    ],
    ids=["stopped", "reset", "set to 0", "heartbeat", "8130h", "goes on", "no answers", "given up"],
)
def test_guarding_that_somebody_ended_or_the_node_tells_of(more: list[Row]) -> None:
    assert "nmt.guarding_ended" not in unguarded(more).ids()


@pytest.mark.near_miss("nmt.guarding_ended")
def test_guarding_that_ends_with_the_capture_or_was_none() -> None:
    assert "nmt.guarding_ended" not in unguarded(end_ms=8000).ids()
    few = ordered(guarding(0, 1000), others(12_000))
    assert "nmt.guarding_ended" not in run(*few).ids()
    gap = Gap(6000 * MS, 6500 * MS, "overrun")
    rows = ordered(guarding(0, 4000), others(6000))
    after = [row for row in others(20_000) if row[0] > 6500 * MS]
    assert "nmt.guarding_ended" not in run(*rows, gap, *after).ids()


def answers(begin_ms: float, end_ms: float, state: int = 5) -> list[Row]:
    """Guard answers of node 5 in a log without the requests."""
    return [row for row in guarding(begin_ms, end_ms, state=state) if not row[3]]


@pytest.mark.triggers("nmt.guarding_ended")
@pytest.mark.near_miss("nmt.node_lost")
@pytest.mark.parametrize("batch", [1, 7, 1 << 20])
def test_answers_that_end_in_a_log_without_requests_accuse_nobody_alone(batch: int) -> None:
    rows = ordered(answers(0, 4000), others(12_000))
    result = run(*rows, batch=batch)
    finding = one(result, "nmt.guarding_ended")
    assert result.ids() == ["nmt.guarding_ended"]
    assert (finding.severity, finding.node) == ("warning", NODE)
    assert "The guard answers of node 5, every 100 ms until then, ended at +3.901 s" in finding.text
    assert "nobody asked it any more, or it was lost." in finding.text
    assert result.states(NODE)[-1] == ("UNKNOWN", 4.051, 11.9)
    pdos = [frame(t, 0x185, "01") for t in range(5, 12_000, 20)]
    lives = one(run(*ordered(rows, pdos), batch=batch), "nmt.guarding_ended")
    assert lives.severity == "info"
    assert "went on: nobody asks it any more." in lives.text


@pytest.mark.triggers("nmt.node_lost")
@pytest.mark.near_miss("nmt.guarding_ended")
def test_heartbeats_that_end_in_a_log_without_requests_are_a_loss() -> None:
    asked_once = [frame(1050, 0x705, "85")]
    rows = ordered(heartbeats(0, 1000), asked_once, heartbeats(1100, 4000), others(12_000))
    assert "nmt.node_lost" in run(*rows).ids()
    assert run(*ordered(heartbeats(0, 4000), others(12_000))).ids() == ["nmt.node_lost"]


@pytest.mark.near_miss("nmt.guard_toggle")
def test_an_answer_that_is_missing_in_a_log_without_requests_repeats_no_bit() -> None:
    every = answers(0, 4000)
    assert run(*ordered([*every[:7], *every[8:15], *every[16:23], *every[24:]], OTHER)).ids() == []


def test_nodes_that_miss_one_master_are_one_finding_at_the_master() -> None:
    slaves = [
        row
        for node in (5, 9, 12)
        for row in (
            *heartbeats(50, 1450, node=node),
            frame(1380 + node, 0x080 + node, "3081110000000000"),
            *heartbeats(1450, 4000, state="7F", node=node),
        )
    ]
    result = run(*ordered(heartbeats(0, 1000, node=1), slaves))
    finding = one(result, "nmt.guarding_lost")
    assert (finding.node, [link.node for link in finding.chain]) == (1, [5, 9, 12])
    assert "nodes 5, 9 and 12 miss it, node 5 first" in finding.text
    assert result.ids() == ["nmt.guarding_lost"]


def test_the_master_is_the_node_that_is_watched_not_whoever_else_is_lost() -> None:
    """1016h:1 = node 1 every 300 ms; node 9 loses its supply at the same time."""
    watch = written(1, 0x1016, 0x0001012C, size=4, sub=1)
    slave = [*heartbeats(50, 1450), *heartbeats(1450, 4000, state="7F")]
    emcy = [frame(1400, 0x085, "3081110000000000")]
    gone = heartbeats(30, 1100, node=9)
    rows = ordered(watch, heartbeats(0, 1000, node=1), slave, emcy, gone, OTHER)
    assert one(run(*rows), "nmt.guarding_lost").text.startswith("Master (node 1) silent")


def test_a_master_that_comes_later_than_its_nodes_is_a_warning_with_its_end() -> None:
    """8130h at power-up, cleared 0.8 s later: no silence stands in the capture."""
    told = [frame(300, 0x085, "3081110000000000"), frame(1100, 0x085, "0000000000000000")]
    finding = one(run(*ordered(heartbeats(0, 4000), told, OTHER)), "nmt.guarding_lost")
    assert finding.severity == "warning"
    assert "cleared by the node 800 ms later" in finding.text
    assert len(finding.evidence) == 2
    left = one(run(*ordered(heartbeats(0, 4000), told[:1], OTHER)), "nmt.guarding_lost")
    assert (left.severity, "cleared" in left.text) == ("error", False)


def missing_a_node(*rows: list[Row]) -> Run:
    """Node 5 says 8130h at 1.4 s; node 1 was last heard at 0.9 s."""
    emcy = [frame(1400, 0x085, "3081110000000000")]
    return run(*ordered(heartbeats(50, 4000), heartbeats(0, 1000, node=1), emcy, OTHER, *rows))


def test_a_master_that_no_1016h_names_is_said_to_be_assumed() -> None:
    finding = one(missing_a_node(), "nmt.guarding_lost")
    assert finding.text.startswith("Master (node 1) silent")
    assert "1016h of node 5 is not known" in " ".join(finding.assumed)
    named = missing_a_node(written(1, 0x1016, 0x0001012C, size=4, sub=1))
    assert one(named, "nmt.guarding_lost").assumed == []


@pytest.mark.near_miss("nmt.guarding_lost")
@pytest.mark.parametrize(
    "shown",
    [
        [frame(t, 0x181, "01") for t in range(5, 900, 100)],
        [frame(1, 0x601, "4000100000000000"), frame(2, 0x581, "4300100092010200")],
        [frame(1200, 0x000, "0109")],
        heartbeats(30, 1000, node=7),
    ],
    ids=["sends PDOs", "answers SDO", "another one commands", "two are silent"],
)
def test_a_silent_node_that_may_be_no_master_is_only_a_suspect(shown: list[Row]) -> None:
    """Nobody is called the master, and the silent node's own loss is told."""
    result = missing_a_node(shown)
    finding = one(result, "nmt.guarding_lost")
    assert finding.text.startswith("Node 5 misses its master")
    assert "node 1 for" in finding.cause
    assert "1016h is not known" in finding.cause
    assert "nmt.node_lost" in result.ids()


def test_a_slave_that_is_watched_is_no_master_and_its_loss_the_root() -> None:
    """1016h:1 of node 5 names node 1, which sends PDOs."""
    watch = written(1, 0x1016, 0x0001012C, size=4, sub=1)
    result = missing_a_node(watch, [frame(t, 0x181, "01") for t in range(5, 900, 100)])
    finding = one(result, "nmt.guarding_lost")
    assert "node 5, which watches its heartbeat (1016h), misses it" in finding.text
    assert "Master" not in finding.text + finding.cause
    (story,) = [each for each in joined(result.findings()) if each.id == "nmt.node_lost"]
    assert (story.node, [link.id for link in story.chain]) == (1, ["nmt.guarding_lost"])


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.4), st.booleans())
@settings(max_examples=60, deadline=None)
def test_a_healthy_bus_is_silent_however_its_heartbeats_jitter(
    seed: int, jitter: float, guarded: bool
) -> None:
    """Start-up, commands, heartbeats that jitter by less than half a period, guarding: no finding."""
    rng = np.random.default_rng(seed)
    rows: list[Row] = [frame(50, 0x705, "00"), frame(57, 0x709, "00"), frame(500, 0x000, "0100")]
    for node, period in ((5, 100), (9, 250)):
        count = 20_000 // period
        times = 600 + period * np.arange(count) + rng.uniform(0, jitter * period, count)
        rows += [frame(t, 0x700 + node, "05") for t in times.tolist()]
    if guarded:
        rows += [
            frame(row[0] / MS + 600, 0x706, row[5].hex(), flags=row[3])
            for row in guarding(0, 20_000, state=5)
        ]
    assert run(*sorted(rows, key=lambda row: row[0])).ids() == []


def test_nodes_that_fall_silent_together_have_something_in_common() -> None:
    branch = [heartbeats(0, 1000, node=5), heartbeats(30, 1000, node=6)]
    result = run(*ordered(*branch, others(4000)))
    assert result.ids() == ["nmt.node_lost"] * 2
    for finding, companion in zip(result.findings(), ("Node 6", "Node 5"), strict=True):
        assert f"{companion} fell silent at the same moment" in finding.text
        assert "in common" in finding.cause
    alone = run(*ordered(heartbeats(0, 1000), heartbeats(0, 3000, node=6), others(6000)))
    assert all("at the same moment" not in f.text for f in alone.findings())


def test_a_command_that_is_refused_again_and_again_is_one_finding() -> None:
    starts = [frame(1010 + 1000 * n, 0x000, "0105") for n in range(20)]
    pause = [frame(1510 + 1000 * n, 0x000, "8005") for n in range(20)]
    rows = ordered(heartbeats(0, 22_000, state="7F"), starts, pause, others(22_000))
    finding = one(run(*rows), "nmt.command_ignored")
    assert "The same happened 19 times more, the last time at +20.2" in finding.text


@pytest.mark.near_miss("nmt.bus_silent")
def test_a_short_restart_on_a_bus_with_few_frames_is_that_of_the_node() -> None:
    """Nobody was heard for 180 ms by chance, and the others went on: no machine was switched off."""
    few = heartbeats(0, 4000, every_ms=300, node=9)
    back = [boot(1985), *heartbeats(2085, 4000)]
    result = run(*ordered(heartbeats(5, 1900), back, few))
    assert result.ids() == ["nmt.unexpected_reset"]
    assert one(result, "nmt.unexpected_reset").severity == "error"


@pytest.mark.near_miss("nmt.unexpected_reset")
def test_a_guarded_node_that_starts_with_the_whole_machine_is_not_accused() -> None:
    """Without its master nobody asks it, so its silence has no limit; the others start too."""
    off = ordered(guarding(0, 1000), others(1000))
    on = ordered([boot(4000, 9), boot(4050)], heartbeats(4100, 8000, node=9), guarding(5000, 8000))
    assert run(*off, *on).ids() == ["nmt.bus_silent"]
