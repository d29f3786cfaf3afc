"""Who may witness that the recorder's clock was set forward, and what only looks like it."""

from collections.abc import Iterable

import pytest

from syncline_analyzer.results import Analysis
from tests.analyzer.control_runs import MS, Row, remote
from tests.analyzer.whole_run import beats, every, ids, whole


def stepped(rows: Iterable[Row], at_ms: float, by_ms: float) -> Analysis:
    """What is told of frames whose recorder's clock is set at a moment."""
    line = sorted(rows, key=lambda row: row[0])
    moved = [(t + round(by_ms * MS) * (t >= at_ms * MS), *rest) for t, *rest in line]
    return whole(moved, in_order=False)  # type: ignore[arg-type]


def steps_ms(told: Analysis) -> list[float]:
    return [step.step_ns / MS for step in told.clock_steps]


def without(rows: Iterable[Row], start_ms: float, stop_ms: float) -> list[Row]:
    return [row for row in rows if not start_ms * MS <= row[0] < stop_ms * MS]


def answered(stop_ms: float, *can_ids: int) -> list[Row]:
    """SYNC of 20 ms and PDOs that answer it."""
    rows = every(0x80, 1, stop_ms, 20.003)
    for number, can_id in enumerate(can_ids):
        rows += every(can_id, 2 + number, stop_ms, 20.003, b"\1\2")
    return rows


@pytest.mark.triggers("clock.step_forward")
def test_a_step_just_before_the_end_is_witnessed_by_those_that_were_due() -> None:
    """Six slow heartbeats were not due again: that they did not come says nothing."""
    stop_ms = 15_400
    slow = [row for node in range(10, 16) for row in beats(node, node, stop_ms, 999.7)]
    rows = [*answered(stop_ms, 0x185), *beats(5, 7, stop_ms, 100.1), *beats(6, 9, stop_ms, 150.2)]
    told = stepped([*rows, *slow], 15_030, 1061)
    assert steps_ms(told) == [pytest.approx(1061, abs=1)]
    assert ids(told) == {"clock.step_forward"}


@pytest.mark.triggers("clock.step_forward")
@pytest.mark.near_miss("nmt.node_lost", "nmt.bus_silent")
def test_a_few_long_periods_do_not_make_a_heartbeat_unsteady() -> None:
    """Both nodes were off for a while in the first seconds of a short recording."""
    stop_ms = 9000
    node = without(beats(5, 7, stop_ms, 200.3), 500, 2000)
    other = without(without(beats(6, 9, stop_ms, 270.1), 500, 2000), 2400, 3000)
    told = stepped([*answered(stop_ms, 0x185), *node, *other], 7512, 787)
    assert steps_ms(told) == [pytest.approx(787, abs=1)]


@pytest.mark.triggers("clock.step_forward")
def test_pdos_that_a_command_stopped_before_the_step_say_nothing() -> None:
    """The nodes are set to PRE-OPERATIONAL; 0.2 s later the clock is set."""
    stop_ms = 12_000
    pdos = [
        row
        for node in (5, 6)
        for number, can_id in enumerate((0x180, 0x280, 0x380))
        for row in every(can_id + node, 3 + number, 7800, 515.1, b"\1")
    ]
    command: Row = (7801 * MS, 0, 0x000, 0, 2, b"\x80\0")
    own = [
        (t, bus, can_id, flags, dlc, b"\x7f" if t > command[0] else data)
        for t, bus, can_id, flags, dlc, data in [
            *beats(5, 7, stop_ms, 200.3),
            *beats(6, 9, stop_ms, 270.1),
        ]
    ]
    rows = [*every(0x80, 1, stop_ms, 25.003), *pdos, command, *own]
    assert steps_ms(stepped(rows, 8000, 787)) == [pytest.approx(787, abs=1)]


@pytest.mark.triggers("clock.step_forward")
def test_guard_requests_that_a_logger_wrote_down_as_data_hide_no_answers() -> None:
    stop_ms = 12_000
    guarded: list[Row] = []
    for node, period_ms in ((5, 200.3), (6, 270.1), (7, 333.3)):
        for k in range(int(stop_ms / period_ms)):
            t_ns = round((node + k * period_ms) * MS)
            state = bytes([0x05 | (k % 2) << 7])
            guarded += [(t_ns, 0, 0x700 + node, 0, 0, b"")]
            guarded += [(t_ns + 300_000, 0, 0x700 + node, 0, 1, state)]
    told = stepped(guarded, 8011, 2314)
    assert steps_ms(told) == [pytest.approx(2314, abs=1)]


@pytest.mark.near_miss("clock.step_forward")
def test_heartbeats_that_were_switched_on_at_the_same_moment_are_no_witnesses() -> None:
    """All nodes boot together and get 1017h together: each comes 48 ms later than one period."""
    stop_ms = 12_000
    boots = [(node * 100_000, 0, 0x700 + node, 0, 1, b"\0") for node in (5, 6, 7)]
    talk = every(0x605, 30, 47, 0.4, b"\x40\0\x10\0\0\0\0\0")
    rows = [
        *boots,
        *talk,
        *beats(5, 48.5, stop_ms, 100)[1:],
        *beats(6, 48.6, stop_ms, 250)[1:],
        *beats(7, 48.7, stop_ms, 250)[1:],
        *every(0x80, 400, stop_ms, 20),
    ]
    assert steps_ms(whole(rows)) == []


@pytest.mark.near_miss("clock.step_forward")
@pytest.mark.parametrize("boot", [b"\0", b"\x7f"])
def test_nodes_that_are_switched_off_and_on_together_are_no_witnesses(boot: bytes) -> None:
    """They booted together before, so all are silent for the same time and come back together."""
    own = [
        row
        for node, ms in ((5, 100), (6, 150), (7, 250))
        for row in beats(node, node / 10, 6010, ms)
    ]
    back = [
        row
        for node, ms in ((5, 100), (6, 150), (7, 250))
        for row in beats(node, 8753 + ms + node / 10, 15_000, ms)
    ]
    first = [row for n, row in enumerate(back) if row[2] not in {r[2] for r in back[:n]}]
    rest = [row for row in back if row not in first]
    boots = [(*row[:5], boot) for row in first]
    told = whole(own, boots, rest)
    assert steps_ms(told) == []


@pytest.mark.near_miss("clock.step_forward")
def test_a_producer_that_pauses_and_what_answers_it_are_one_witness() -> None:
    """No heartbeat says that anybody else was silent: SYNC paused for 487 ms, out of its phase."""
    before, after = answered(5000, 0x185, 0x285, 0x186), answered(5000, 0x185, 0x285, 0x186)
    rows = [*before, *((t + 5487 * MS, *rest) for t, *rest in after)]
    told = whole(rows)  # type: ignore[arg-type]
    assert steps_ms(told) == []
    assert "sync.missing" in ids(told)


@pytest.mark.near_miss("nmt.node_lost", "nmt.bus_silent")
@pytest.mark.triggers("clock.step_forward")
@pytest.mark.near_miss("sync.missing", "nmt.bus_silent")
def test_an_answer_that_was_on_its_way_is_a_witness_of_its_own() -> None:
    """The clock is set between a SYNC and its answer: that does not wait for the next SYNC."""
    stop_ms = 4202
    rows = [*every(0x80, 1, stop_ms, 50), *every(0x285, 1.65, stop_ms, 50, b"\1\2")]
    rows += [*every(0x185, 96.7, stop_ms, 100.002, b"\1\2"), *beats(127, 400, stop_ms, 500)]
    rows += beats(5, 94.5, stop_ms, 300.001)
    told = stepped(rows, 4051.3, 712)
    assert steps_ms(told) == [pytest.approx(712, abs=1)]
    assert ids(told) == {"clock.step_forward"}


@pytest.mark.parametrize("pause_ms", [700, 712])
def test_an_answer_to_the_sync_after_a_silence_is_none(pause_ms: float) -> None:
    """The producer paused; the PDO of a timer keeps its own phase or is silent as well."""
    early = [*every(0x80, 1, 4352, 50), *every(0x285, 1.65, 4352, 50, b"\1\2")]
    late = [*every(0x80, 4351 + pause_ms, 6000, 50)]
    late += every(0x285, 4351.65 + pause_ms, 6000, 50, b"\1\2")
    told = whole([*early, *late, *beats(5, 247.5, 4300, 300.001)])
    assert steps_ms(told) == []


def test_a_step_makes_no_loss_of_a_node_that_was_not_due_again() -> None:
    """Its last heartbeat was 0.3 s before the end of the recording; the clock was set by 1 s."""
    stop_ms = 13_700
    rows = [*answered(stop_ms, 0x185), *beats(5, 7, stop_ms, 100.1), *beats(6, 9, stop_ms, 150.2)]
    told = stepped([*rows, *beats(7, 401, stop_ms, 500)], 13_580, 1061)
    assert ids(told) == {"clock.step_forward"}


@pytest.mark.triggers("nmt.bus_silent")
def test_a_break_of_the_supply_just_after_a_step_back_accuses_no_node() -> None:
    """The stamps hide that the master was silent as well; its boot-up tells it started anew, too."""
    own = [*beats(5, 54, 12_300, 200), *beats(127, 400, 12_000, 500)]
    back = [*beats(5, 15_212, 20_000, 200), *beats(127, 16_112, 20_000, 500)]
    boots: list[Row] = [
        (15_012 * MS, 0, 0x705, 0, 1, b"\0"),
        (15_612 * MS, 0, 0x77F, 0, 1, b"\0"),
    ]
    told = stepped([*own, *boots, *back], 12_250, -3619)
    (finding,) = (each for each in told.findings if each.id == "nmt.bus_silent")
    assert finding.node is None
    assert "nodes 5, 127 came back with a boot-up" in finding.text


@pytest.mark.near_miss("nmt.guard_unanswered")
def test_guard_requests_in_a_time_that_the_stamps_go_through_twice_accuse_nobody() -> None:
    """The clock is set back while the node restarts: its boot-up is stamped before the reset."""
    rows: list[Row] = []
    for k in range(90):
        asked_ns = (10 + 200 * k) * MS
        rows += [remote(10 + 200 * k, 0x705)]
        if not 11_500 * MS < asked_ns < 15_500 * MS:
            rows += [(asked_ns + MS // 2, 0, 0x705, 0, 1, bytes([0x05 | (k % 2) << 7]))]
    rows += [(11_495 * MS, 0, 0x000, 0, 2, b"\x81\x05"), (15_495 * MS, 0, 0x705, 0, 1, b"\0")]
    told = stepped([*rows, *beats(9, 3, 18_000)], 11_600, -4319)
    assert "nmt.guard_unanswered" not in ids(told)


@pytest.mark.near_miss("nmt.bus_silent")
def test_a_silence_of_everybody_shortly_before_the_end_names_no_node() -> None:
    """600 ms, as long as six heartbeats: a step or a silence. Node 7 was not due again after it."""
    stop_ms = 9300
    rows = [*answered(stop_ms, 0x185), *beats(5, 7, stop_ms, 100), *beats(7, 401, stop_ms, 500)]
    told = whole(without(rows, 8522, 9122))
    assert [each.id for each in told.findings if each.node is not None] == []
    assert ids(told) <= {"bus.silent"}
