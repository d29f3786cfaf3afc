"""NMT states, error control and guarding from frames written by hand."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.control import ControlFold
from syncline_analyzer.shadow import Shadow
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.devices import load_device
from tests.analyzer.control_runs import MS, Row, Run, S, frame, remote, run

NODE = 5


def heartbeats(
    begin_ms: float, end_ms: float, *, every_ms: float = 100.0, state: str = "05", node: int = NODE
) -> list[Row]:
    """Heartbeats in [begin, end)."""
    count = round((end_ms - begin_ms) / every_ms)
    return [frame(begin_ms + k * every_ms, 0x700 + node, state) for k in range(count)]


def guarding(
    begin_ms: float, end_ms: float, *, state: int = 5, answers: bool = True, toggle: int = 0
) -> list[Row]:
    """Guard requests every 100 ms, and answers 1 ms later with an alternating toggle bit."""
    rows = []
    for number in range(round((end_ms - begin_ms) / 100)):
        t_ms = begin_ms + 100 * number
        rows.append(remote(t_ms, 0x700 + NODE))
        if answers:
            byte = state | 0x80 * ((toggle + number) % 2)
            rows.append(frame(t_ms + 1, 0x700 + NODE, f"{byte:02X}"))
    return rows


def ordered(*parts: list[Row]) -> list[Row]:
    return sorted((row for part in parts for row in part), key=lambda row: row[0])


def test_boot_up_command_and_confirmation() -> None:
    result = run(
        frame(0, 0x701, "05"),
        frame(100, 0x705, "00"),
        *heartbeats(200, 500, state="7F"),
        frame(530, 0x000, "0105"),
        *heartbeats(600, 1000),
    )
    assert result.states(NODE) == [
        ("UNKNOWN", 0.0, 0.1),
        ("PRE-OPERATIONAL", 0.1, 0.53),
        ("OPERATIONAL", 0.53, 0.9),
    ]
    assert [row.certainty for row in result.analysis.nmt_states if row.node == NODE] == [
        "assumed",
        "observed",
        "observed",
    ]
    assert result.analysis.nmt_commands[0].confirmed_ms == pytest.approx(70.0)
    node = result.nodes[NODE]
    assert (node.boot_ups, node.heartbeats, node.heartbeat_period_ms) == (1, 7, 100.0)


def test_a_command_that_nothing_confirms_stays_commanded() -> None:
    result = run(frame(0, 0x705, "7F"), frame(50, 0x000, "0105"), frame(90, 0x701, "05"))
    last = [row for row in result.analysis.nmt_states if row.node == NODE][-1]
    assert (last.state, last.certainty) == ("OPERATIONAL", "commanded")
    assert result.analysis.nmt_commands[0].confirmed_ms is None


def test_reset_until_boot_up_is_initialising() -> None:
    result = run(
        *heartbeats(0, 1000),
        frame(1010, 0x000, "8105"),
        frame(1310, 0x705, "00"),
        *heartbeats(1400, 1700, state="7F"),
    )
    assert result.states(NODE)[1:3] == [
        ("INITIALISING", 1.01, 1.31),
        ("PRE-OPERATIONAL", 1.31, 1.6),
    ]
    assert result.analysis.nmt_commands[0].confirmed_ms == pytest.approx(300.0)
    assert result.ids() == []


def test_broadcast_is_confirmed_when_the_last_node_did() -> None:
    before = ordered(heartbeats(0, 500, state="7F"), heartbeats(20, 500, state="7F", node=6))
    after = ordered(heartbeats(500, 900), heartbeats(520, 900, node=6))
    result = run(*before, frame(505, 0x000, "0100"), *after[2:])
    assert result.analysis.nmt_commands[0].confirmed_ms == pytest.approx(115.0)


def test_silence_is_lost_after_one_and_a_half_periods() -> None:
    other = heartbeats(0, 3000, node=9)
    result = run(*ordered(heartbeats(0, 1000), other, heartbeats(2000, 3000)))
    assert result.states(NODE) == [
        ("OPERATIONAL", 0.0, 1.05),
        ("LOST", 1.05, 2.0),
        ("OPERATIONAL", 2.0, 2.9),
    ]
    lost = next(row for row in result.analysis.nmt_states if row.state == "LOST")
    assert "1.5 times its usual period of 100.0 ms" in lost.cause


def test_producer_time_and_consumer_time_come_before_the_median() -> None:
    """1017h read as 400 ms: LOST after 600 ms; node 9 watches with 250 ms: LOST after that."""
    read = [frame(1, 0x605, "4017100000000000"), frame(2, 0x585, "4B17100090010000")]
    watch = [frame(3, 0x609, "2316100190010500"), frame(4, 0x589, "6016100100000000")]
    watch[0] = frame(3, 0x609, "23161001FA000500")
    beats = ordered(heartbeats(10, 1000, every_ms=100), heartbeats(0, 3000, node=9))
    by_1017 = run(*read, *beats)
    state, start, _ = by_1017.states(NODE)[-1]
    assert state == "LOST"
    assert start == pytest.approx(0.909 + 0.6, abs=2e-3)
    by_1016 = run(*ordered(read, watch, beats))
    lost = by_1016.states(NODE)[-1]
    assert lost[0] == "LOST"
    assert lost[1] == pytest.approx(0.91 + 0.25, abs=2e-3)


@pytest.mark.parametrize("periods", [2, 3])
def test_fewer_than_three_periods_prove_no_loss(periods: int) -> None:
    few = heartbeats(0, 100 * (periods + 1))
    result = run(*ordered(few, heartbeats(0, 3000, node=9)))
    assert ("LOST" in [state for state, _, _ in result.states(NODE)]) == (periods >= 3)


def test_a_longer_period_is_no_loss() -> None:
    beats = heartbeats(0, 2000) + heartbeats(2000, 12_000, every_ms=1000)
    result = run(*ordered(beats, heartbeats(0, 12_000, node=9)))
    assert [state for state, _, _ in result.states(NODE)] == ["OPERATIONAL"]


def test_a_node_that_goes_on_sending_pdos_is_not_lost() -> None:
    pdos = [frame(t, 0x185, "0102") for t in range(5, 3000, 50)]
    result = run(*ordered(heartbeats(0, 1000), pdos, heartbeats(0, 3000, node=9)))
    assert [state for state, _, _ in result.states(NODE)] == ["OPERATIONAL"]


def test_the_silence_of_a_whole_bus_is_not_the_node_s() -> None:
    both = [*heartbeats(0, 1000), *heartbeats(7000, 8000)]
    result = run(*ordered(both, [(row[0] + MS, 0, 0x709, 0, 1, row[5]) for row in both]))
    assert [state for state, _, _ in result.states(NODE)] == [
        "OPERATIONAL",
        "UNKNOWN",
        "OPERATIONAL",
    ]
    assert result.ids() == []


def test_nothing_is_concluded_from_a_gap() -> None:
    gap = Gap(1050 * MS, 4000 * MS, "adapter lost", 30)
    beats = ordered(heartbeats(0, 1000), heartbeats(0, 1000, node=9))
    after = ordered(heartbeats(4000, 5000), heartbeats(4000, 5000, node=9))
    result = run(*beats, gap, *after)
    assert result.states(NODE) == [
        ("OPERATIONAL", 0.0, 1.05),
        ("UNKNOWN", 1.05, 4.0),
        ("OPERATIONAL", 4.0, 4.9),
    ]
    assert result.ids() == ["capture.gap"]


def test_a_node_lost_before_a_gap_is_lost_until_the_gap() -> None:
    gap = Gap(3000 * MS, 4000 * MS, "adapter lost")
    result = run(
        *ordered(heartbeats(0, 1000), heartbeats(0, 3000, node=9)), gap, frame(4000, 0x709, "05")
    )
    assert result.states(NODE)[1:] == [("LOST", 1.05, 3.0), ("UNKNOWN", 3.0, 4.0)]


def test_untimed_captures_tell_states_but_no_durations() -> None:
    rows = [frame(0, 0x705, "00"), frame(0, 0x000, "0105"), frame(0, 0x705, "05")]
    result = run(*rows, timed=False)
    assert [state for state, _, _ in result.states(NODE)] == ["PRE-OPERATIONAL", "OPERATIONAL"]
    assert result.analysis.nmt_commands[0].confirmed_ms is None
    assert result.nodes[NODE].heartbeat_period_ms is None


def test_a_step_back_of_the_clock_makes_no_negative_time() -> None:
    beats = heartbeats(5000, 6000) + heartbeats(2000, 3000)
    result = run(*beats, end_ms=2900)
    assert all(row.end_ns >= row.start_ns for row in result.analysis.nmt_states)
    assert result.nodes[NODE].heartbeat_period_ms == 100.0
    assert result.ids() == ["clock.step_back"]


def test_guarding_is_counted_apart_from_heartbeats() -> None:
    result = run(*guarding(0, 1000), frame(1000, 0x701, "05"))
    node = result.nodes[NODE]
    assert (node.guard_requests, node.guard_answers, node.heartbeats) == (10, 10, 0)
    assert (node.toggle_errors, result.states(NODE)[-1][0]) == (0, "OPERATIONAL")


def test_requests_that_a_logger_stored_as_empty_data_frames() -> None:
    rows = [frame(row[0] / MS, row[2]) if row[3] else row for row in guarding(0, 1000)]
    node = run(*rows, frame(1000, 0x701, "05")).nodes[NODE]
    assert (node.guard_requests, node.guard_answers, node.heartbeats) == (10, 10, 0)


def test_nobody_is_proven_by_requests_alone() -> None:
    stored_empty = [frame(t, 0x702) for t in range(0, 1000, 100)]
    asked = [remote(t, 0x703) for t in range(0, 1000, 100)]
    called = [frame(1, 0x000, "8104"), frame(2, 0x604, "4000100000000000")]
    result = run(*ordered(stored_empty, asked, called, heartbeats(0, 1000, node=1)))
    assert list(result.nodes) == [1]


def test_a_stuck_toggle_bit_is_counted() -> None:
    rows = [frame(t, 0x705, "05") if t % 10 else remote(t, 0x705) for t in _pairs(1000)]
    assert run(*rows).nodes[NODE].toggle_errors == 9


def _pairs(end_ms: int) -> list[int]:
    return sorted([*range(0, end_ms, 100), *range(1, end_ms, 100)])


def test_a_guarded_node_is_lost_when_it_stops_answering_and_not_when_nobody_asks() -> None:
    other = heartbeats(0, 3000, node=9)
    silent = run(*ordered(guarding(0, 1000), guarding(1000, 3000, answers=False), other))
    assert silent.states(NODE)[-1][0] == "LOST"
    unasked = run(*ordered(guarding(0, 1000), other))
    assert unasked.states(NODE)[-2:] == [("OPERATIONAL", 0.001, 1.051), ("UNKNOWN", 1.051, 2.9)]


@pytest.mark.parametrize("batch", [1, 7, 1 << 20])
def test_the_state_of_a_node_that_nobody_asks_is_known_for_its_life_time(batch: int) -> None:
    """100Ch x 100Dh = 800 ms; a frame of the node is a sign of life, a PDO tells its state."""
    life = [
        *(frame(t, 0x605, data) for t, data in ((1, "2B0C100064000000"), (3, "2F0D100008000000"))),
        *(frame(t, 0x585, data) for t, data in ((2, "600C100000000000"), (4, "600D100000000000"))),
    ]
    rows = ordered(life, guarding(10, 1000), heartbeats(0, 4000, node=9))
    assert run(*rows, batch=batch).states(NODE)[-1] == ("UNKNOWN", 1.711, 3.9)
    answer = frame(1500, 0x585, "4300100092010200")
    seen = run(*ordered(rows, [answer]), batch=batch)
    assert seen.states(NODE)[-1] == ("UNKNOWN", 2.3, 3.9)
    pdos = [frame(t, 0x185, "01") for t in range(5, 3900, 20)]
    sends = run(*ordered(rows, pdos), batch=batch)
    assert [state for state, _, _ in sends.states(NODE)] == ["UNKNOWN", "OPERATIONAL"]


@pytest.mark.parametrize("batch", [1, 7, 1 << 20])
def test_what_a_node_answers_after_a_pause_tells_how_it_was_in_it(batch: int) -> None:
    other = heartbeats(0, 4000, node=9)
    same = run(*ordered(guarding(0, 1000), guarding(2000, 4000), other), batch=batch)
    assert same.states(NODE)[1:] == [("OPERATIONAL", 0.001, 3.901)]
    later = guarding(2000, 4000, state=0x7F)
    fell = run(*ordered(guarding(0, 1000), later, other), batch=batch)
    states = [state for state, _, _ in fell.states(NODE)]
    assert states == ["UNKNOWN", "OPERATIONAL", "UNKNOWN", "PRE-OPERATIONAL"]
    assert fell.ids() == ["nmt.left_operational"]
    told = ordered(guarding(0, 1000), [frame(1500, 0x000, "8005")], later, other)
    assert run(*told, batch=batch).ids() == []


def missing(
    *more: Row, pdos_ms: int = 1250, batch: int = 1 << 20, device: str | None = None
) -> Run:
    """Node 5 is asked up to 900 ms, says 8130h at 1210 ms, and sends PDOs up to a time."""
    pdos = [frame(t, 0x185, "01") for t in range(5, pdos_ms, 20)]
    emcy = frame(1210, 0x085, "3081110000000000")
    rows = ordered(guarding(0, 1000), [emcy, *more], pdos, heartbeats(0, 4000, node=9))
    devices = {NODE: load_device(device)} if device else None
    return run(*rows, batch=batch, devices=devices)


def known(value: int) -> list[Row]:
    """1029h:1 of node 5 is read."""
    return [frame(11, 0x605, "4029100100000000"), frame(12, 0x585, f"4F291001{value:02X}000000")]


@pytest.mark.parametrize("batch", [1, 7, 1 << 20])
def test_a_guarded_node_that_misses_its_master_is_pre_operational(batch: int) -> None:
    result = missing(pdos_ms=1210, batch=batch)
    assert result.states(NODE)[1:] == [
        ("OPERATIONAL", 0.001, 1.21),
        ("PRE-OPERATIONAL", 1.21, 1.36),
        ("UNKNOWN", 1.36, 3.9),
    ]
    row = result.tables.nmt.timelines[0, NODE].intervals[-2]
    assert row.certainty == "implied"
    assert row.cause.endswith("(1029h:1 = 0, by default, it is not known here), and its PDOs ended")
    assert result.ids() == ["nmt.guarding_lost"]
    (emcy,) = result.analysis.emcy_context
    assert emcy.state == "OPERATIONAL", "it was, as it sent the EMCY"
    assert missing(pdos_ms=905).tables.nmt.timelines[0, NODE].intervals[-2].certainty == "assumed"


@pytest.mark.parametrize(("value", "state"), [(0, "PRE-OPERATIONAL"), (2, "STOPPED"), (1, None)])
def test_where_it_goes_is_what_1029h_says(value: int, state: str | None) -> None:
    states = [name for name, _, _ in missing(*known(value), pdos_ms=905).states(NODE)]
    assert states[1:] == ["OPERATIONAL", *([state] if state else []), "UNKNOWN"]


@pytest.mark.parametrize("value", [0, 1, 2])
def test_a_jn2100_goes_pre_operational_whatever_1029h_says(value: int) -> None:
    result = missing(*known(value), pdos_ms=905, device="jn2100")
    states = [name for name, _, _ in result.states(NODE)]
    assert states[1:] == ["OPERATIONAL", "PRE-OPERATIONAL", "UNKNOWN"]


def test_pdos_that_go_on_show_that_it_does_not_react() -> None:
    assert [state for state, _, _ in missing(pdos_ms=3900).states(NODE)][-1] == "OPERATIONAL"
    later = [frame(t, 0x185, "01") for t in range(3000, 3900, 20)]
    states = [state for state, _, _ in missing(*later, pdos_ms=1210).states(NODE)]
    assert "PRE-OPERATIONAL" not in states


@pytest.mark.parametrize(("state", "told"), [(5, []), (0x7F, ["PRE-OPERATIONAL"])])
def test_what_it_answers_later_says_whether_it_did(state: int, told: list[str]) -> None:
    result = missing(*guarding(2000, 4000, state=state), pdos_ms=1210)
    states = [name for name, _, _ in result.states(NODE)]
    assert states == ["UNKNOWN", "OPERATIONAL", *told]
    assert result.ids() == ["nmt.guarding_lost"]
    text = result.findings()[0].text
    assert ("node 5 goes PRE-OPERATIONAL" in text) == bool(told)


def test_a_node_that_is_asked_on_tells_its_state_itself() -> None:
    """8130h of a heartbeat that it watches: the answers go on as before."""
    emcy = frame(1210, 0x085, "3081110000000000")
    result = run(*ordered(guarding(0, 4000), [emcy], heartbeats(0, 4000, node=9)))
    assert [state for state, _, _ in result.states(NODE)] == ["UNKNOWN", "OPERATIONAL"]


def test_boot_up_byte_7fh_of_a_lir_with_heartbeat() -> None:
    """LB01: with 1017h stored the boot-up carries 7Fh."""
    rows = [*heartbeats(0, 1000), frame(1010, 0x000, "8105"), frame(3050, 0x705, "7F")]
    rows += heartbeats(3150, 3500, state="7F")
    lir = run(*rows, devices={NODE: load_device("lir-ma158k")})
    assert [(boot.byte, boot.command_ns) for boot in lir.tables.nmt.boot_ups] == [(0x7F, 1010 * MS)]
    assert (lir.nodes[NODE].boot_ups, lir.nodes[NODE].heartbeats) == (1, 14)
    assert ("INITIALISING", 1.01, 3.05) in lir.states(NODE)
    assert run(*rows).nodes[NODE].boot_ups == 0


LIR = {NODE: load_device("lir-ma158k")}


@pytest.mark.parametrize("device", ["lir-ma158k", "lir-da158a", "lir-918"])
def test_an_unasked_fall_to_7fh_is_the_restart_of_a_lir(device: str) -> None:
    """Sheet skbis-lir-canopen.md, trap 1: the boot-up byte is 7Fh when 1017h is stored."""
    rows = ordered(heartbeats(0, 1000), heartbeats(1050, 3000, state="7F"), other(3000))
    result = run(*rows, devices={NODE: load_device(device)})
    assert result.ids() == ["nmt.unexpected_reset"]
    assert "7Fh" in result.findings()[0].text
    assert result.states(NODE)[1:3] == [
        ("INITIALISING", 0.9, 1.05),
        ("PRE-OPERATIONAL", 1.05, 2.95),
    ]
    assert (result.nodes[NODE].boot_ups, result.nodes[NODE].heartbeats) == (1, 29)
    old = run(*rows, devices={NODE: load_device("lir-da158")})
    assert old.ids() == ["nmt.left_operational"]


@pytest.mark.parametrize("batch", [1, 10, 11, 1 << 20])
@pytest.mark.parametrize(
    ("at_ms", "found"),
    [(1000, "nmt.left_operational"), (1010, "nmt.unexpected_reset"), (990, "nmt.unexpected_reset")],
)
def test_a_heartbeat_that_keeps_its_rhythm_over_a_fall_is_no_restart(
    at_ms: int, found: str, batch: int
) -> None:
    """7Fh may be the boot-up of a LIR, which is silent for 4 s at a restart."""
    rows = ordered(heartbeats(0, 1000), heartbeats(at_ms, 3000, state="7F"), other(3000))
    result = run(*rows, devices=LIR, batch=batch)
    assert result.ids() == [found]
    fell = found == "nmt.left_operational"
    assert result.states(NODE)[1][0] == ("PRE-OPERATIONAL" if fell else "INITIALISING")
    assert result.nodes[NODE].boot_ups == (not fell)


@pytest.mark.parametrize("late_ms", [0, 20, 4000])
def test_a_fall_in_step_after_which_the_rhythm_breaks_is_a_restart(late_ms: int) -> None:
    rows = ordered(
        heartbeats(0, 1000),
        [frame(1000, 0x705, "7F")],
        heartbeats(1100 + late_ms, 8000, state="7F"),
        other(8000),
    )
    assert ("nmt.unexpected_reset" in run(*rows, devices=LIR).ids()) == (late_ms > 0)


@pytest.mark.parametrize("t_ms", [990, 1055])
@pytest.mark.parametrize("code", ["3081", "1075", "4081"])
def test_a_communication_error_explains_the_fall_of_a_lir(code: str, t_ms: int) -> None:
    """Trap 17: 1029h:1 = 0 looks like a restart; a node may tell its error late."""
    emcy = frame(t_ms, 0x085, code + "200000000000")
    beats = ordered(heartbeats(0, 1000), heartbeats(1050, 3000, state="7F"), other(3000), [emcy])
    assert "nmt.unexpected_reset" not in run(*beats, devices=LIR).ids()


@pytest.mark.parametrize(
    ("value", "found"), [(0, "nmt.left_operational"), (1, "nmt.unexpected_reset")]
)
def test_1029h_as_read_tells_a_reaction_from_a_restart(value: int, found: str) -> None:
    read = [frame(1, 0x605, "4029100100000000"), frame(2, 0x585, f"4F291001{value:02X}000000")]
    beats = [*heartbeats(10, 1000), *heartbeats(1050, 3000, state="7F")]
    assert run(*ordered(read, beats, other(3000)), devices=LIR).ids() == [found]


def test_two_devices_that_say_7fh_and_05h_in_turn_are_no_restarts() -> None:
    twins = ordered(heartbeats(0, 3000), heartbeats(533, 3000, every_ms=170, state="7F"))
    result = run(*ordered(twins, other(3000)), devices=LIR)
    assert result.ids() == ["nmt.duplicate_node_id"]
    assert result.nodes[NODE].boot_ups == 0


@pytest.mark.parametrize("batch", [1, 50, 1 << 20])
@pytest.mark.parametrize(("fast", "slow"), [(100, 700), (500, 700), (200, 230), (100, 1300)])
def test_two_cadences_under_one_number_are_two_devices(fast: int, slow: int, batch: int) -> None:
    twins = ordered(
        heartbeats(0, 110 * fast, every_ms=fast),
        heartbeats(33, 110 * fast, every_ms=slow * 1.003),
        other(110 * fast),
    )
    result = run(*twins, batch=batch)
    assert result.ids() == ["nmt.duplicate_node_id"]
    (finding,) = result.findings()
    assert f"one heartbeat comes every {fast} ms, the other every " in finding.text
    periods = result.tables.nmt.nodes[0, NODE].twins.periods_ns
    assert periods == pytest.approx((fast * MS, slow * 1.003 * MS), rel=1e-6)


@given(st.integers(0, 2**32 - 1), st.integers(50, 1000), st.floats(0.0, 1.5), st.booleans())
@settings(max_examples=150, deadline=None)
def test_one_device_is_not_taken_for_two(seed: int, period: int, jitter: float, grid: bool) -> None:
    """However unsteady: late by chance, on the grid of a slow task, with single ones left out."""
    rng = np.random.default_rng(seed)
    t_ms = np.arange(400) * period + rng.uniform(0, jitter * period, 400)
    t_ms = np.sort(t_ms)[rng.uniform(0, 1, 400) > 0.02]
    t_ms = np.floor(t_ms / (period / 3)) * (period / 3) if grid else t_ms
    result = run(*(frame(t, 0x705, "05") for t in np.unique(t_ms).tolist()))
    assert result.tables.nmt.nodes[0, NODE].twins.periods_ns is None


def test_a_commanded_fall_to_7fh_is_no_restart() -> None:
    beats = ordered(heartbeats(0, 1000), heartbeats(1050, 3000, state="7F"), other(3000))
    for t_ms in (980, 1040):
        assert run(*ordered(beats, [frame(t_ms, 0x000, "8005")]), devices=LIR).ids() == []


def test_a_change_at_the_end_of_a_batch_parts_the_pdos_all_the_same() -> None:
    rows = [frame(0, 0x185), frame(1, 0x705, "00"), frame(2, 0x185)]
    whole, pieces = run(*rows), run(*rows, batch=2)
    assert pieces.analysis.nmt_states == whole.analysis.nmt_states


def other(end_ms: float) -> list[Row]:
    """A second node that is heard all the time."""
    return heartbeats(0, end_ms, node=9)


@pytest.mark.parametrize("empty", ["00", ""])
def test_empty_heartbeats_after_a_remote_frame_are_no_boot_ups(empty: str) -> None:
    """LB03, LB04."""
    rows = [*heartbeats(0, 1000), remote(910, 0x705), *heartbeats(1000, 1900, state=empty)]
    result = run(*rows)
    node = result.nodes[NODE]
    assert (node.boot_ups, node.heartbeats, node.final_state) == (0, 10, "UNKNOWN")
    assert result.tables.nmt.nodes[0, NODE].counts.empty == 9
    assert result.ids() == ["config.rtr_on_heartbeat_node"]


def test_a_pdo_implies_operational_where_nothing_else_is_known() -> None:
    result = run(frame(0, 0x701, "05"), frame(10, 0x185, "01"), frame(20, 0x185, "02"))
    state = next(
        row for row in result.analysis.nmt_states if row.state == "OPERATIONAL" and row.node == NODE
    )
    assert (state.certainty, state.start_ns) == ("implied", 10 * MS)
    assert result.nodes[NODE].proof == ["pdo (guess)"]


def test_identifiers_of_a_bus_that_is_not_canopen_make_no_node() -> None:
    """A car: 181h, 201h, 381h, 581h, 601h, 701h with eight bytes each."""
    ids = (0x081, 0x181, 0x201, 0x381, 0x581, 0x601, 0x701, 0x72A)
    rows = [frame(t, can_id, "4F10203040506070") for t in range(0, 500, 10) for can_id in ids]
    result = run(*rows)
    analysis = result.analysis
    assert (analysis.nodes, analysis.nmt_states, analysis.emcy) == ([], [], [])
    assert not analysis.sdo
    assert result.findings() == []


def test_malformed_commands_are_counted() -> None:
    result = run(frame(0, 0x000, "01"), frame(1, 0x000, "010500"), frame(2, 0x000, "0105"))
    assert (len(result.analysis.nmt_commands), result.tables.nmt.malformed) == (1, 2)


_FRAMES = st.lists(
    st.tuples(
        st.sampled_from([0x000, 0x085, 0x185, 0x585, 0x605, 0x705, 0x706]),
        st.sampled_from(
            ["", "00", "05", "7F", "85", "FF", "8105", "0105", "0200", "3081110000000000"]
        ),
        st.integers(-20, 400),
        st.booleans(),
    ),
    min_size=1,
    max_size=60,
)


@given(_FRAMES, st.integers(1, 7))
@example([(0x185, "", 0, False), (0x705, "00", 1, False)], 1)
@settings(max_examples=100, deadline=None)
def test_batches_do_not_matter(frames: list[tuple[int, str, int, bool]], batch: int) -> None:
    t_ms, rows = 0, []
    for can_id, data, step, asks in frames:
        t_ms += step
        rows.append(remote(t_ms, can_id) if asks and can_id > 0x700 else frame(t_ms, can_id, data))
    end_ms = max(t_ms, 0) + 100
    whole, pieces = run(*rows, end_ms=end_ms), run(*rows, batch=batch, end_ms=end_ms)
    for name in ("nmt_states", "nmt_commands", "emcy", "errors", "sdo", "nodes"):
        assert getattr(whole.analysis, name) == getattr(pieces.analysis, name), name
    assert all(row.end_ns >= row.start_ns for row in whole.analysis.nmt_states)
    _tiles(whole)


def _tiles(result: Run) -> None:
    """Intervals of a node leave no time out and do not overlap."""
    by_node: dict[int, list[tuple[int, int]]] = {}
    for row in result.analysis.nmt_states:
        by_node.setdefault(row.node, []).append((row.start_ns, row.end_ns))
    for spans in by_node.values():
        assert all(a[1] == b[0] for a, b in pairwise(spans))


def test_many_heartbeats_fold_into_few_events() -> None:
    """A day of one heartbeat every 100 ms in one state stays one interval and few objects."""
    count = 200_000
    frames = FrameBatch(
        np.arange(count, dtype=np.int64) * 100 * MS,
        np.zeros(count, np.uint8),
        np.full(count, 0x705, np.uint32),
        np.zeros(count, np.uint16),
        np.ones(count, np.uint8),
        np.full((count, 8), [5, 0, 0, 0, 0, 0, 0, 0], np.uint8),
    )
    fold = ControlFold(Context(["can0"], Shadow(lambda _: "can0")))
    for start in range(0, count, 50_000):
        fold.update(IndexedBatch(frames[start : start + 50_000], start))
    tables = fold.finish(int(frames.t_ns[-1]))
    assert len(tables.nmt.states) == 1
    assert len(tables.nmt.timelines[0, NODE].history.beats) < 10
    assert tables.nmt.nodes[0, NODE].heartbeat_period_ns == S // 10
