"""What random scenarios found on NMT: each case small, written by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.folds.nmt.cadence import Twins
from syncline_analyzer.results import Finding
from syncline_schemas.batch import Gap
from syncline_schemas.devices import load_device
from tests.analyzer.control_runs import MS, Row, Run, frame, remote, run
from tests.analyzer.test_nmt_findings import NODE, boot, one, others, shifted, written
from tests.analyzer.test_nmt_fold import guarding, heartbeats, ordered
from tests.analyzer.whole_run import beats, every, ids, whole

JN2100 = {NODE: load_device("jn2100")}
LIR = {NODE: load_device("lir-da158a")}


def accusing(result: Run) -> list[str]:
    """Ids of findings above info that name a node."""
    return [f.id for f in result.findings() if f.severity != "info" and f.node is not None]


# -- the whole machine is off ----------------------------------------------------------------------


@pytest.mark.near_miss("nmt.unexpected_reset", "nmt.node_lost")
def test_a_master_that_starts_later_than_the_nodes_was_off_with_them() -> None:
    """Off for 3 s; the nodes boot at once, the master 850 ms later: its own silence is longer."""
    before = ordered(
        heartbeats(0, 1000), heartbeats(0, 1000, node=9), heartbeats(0, 1000, every_ms=500, node=1)
    )
    after = ordered(
        [boot(4000), boot(4007, 9), boot(4850, 1)],
        heartbeats(4100, 9000),
        heartbeats(4107, 9000, node=9),
        heartbeats(5350, 9000, every_ms=500, node=1),
    )
    assert run(*before, *after).ids() == ["nmt.bus_silent"]


@pytest.mark.near_miss("nmt.unexpected_reset", "nmt.node_lost")
def test_a_guarded_node_was_off_with_the_machine() -> None:
    """The guard requests come again before it boots: its silence has another length."""
    before = ordered(guarding(0, 1000), others(1000))
    after = ordered(
        [boot(4000, 9)],
        heartbeats(4100, 8000, node=9),
        guarding(4200, 4600, answers=False),
        [boot(4650)],
        guarding(4700, 8000),
    )
    assert accusing(run(*before, *after)) == []


@pytest.mark.triggers("nmt.boot_loop")
@pytest.mark.near_miss("nmt.bus_silent")
def test_nobody_switches_a_machine_off_for_a_fifth_of_a_second() -> None:
    """A node loops, and the bus is else silent but for the master."""
    loop = [boot(2200 + 900 * n) for n in range(4)]
    states = [
        row for n in range(4) for row in heartbeats(2300 + 900 * n, 2900 + 900 * n, state="7F")
    ] + heartbeats(5600, 7000, state="7F")
    master = heartbeats(0, 7000, every_ms=1000, node=1)
    result = run(*ordered(heartbeats(10, 2000), loop, states, master))
    assert result.ids() == ["nmt.boot_loop"]


@pytest.mark.near_miss("nmt.node_lost")
def test_a_machine_switched_off_before_a_gap_accuses_no_node() -> None:
    before = ordered(heartbeats(0, 1000), others(1000))
    gap = Gap(3000 * MS, 3500 * MS, "adapter lost", 0, 0)
    after = ordered([boot(3600), boot(3605, 9)], heartbeats(3700, 5000), others(0))
    result = run(*before, gap, *after, *[r for r in others(5000) if r[0] > 3700 * MS])
    assert accusing(result) == []


@pytest.mark.triggers("nmt.node_lost")
def test_a_node_lost_before_a_gap_was_lost_up_to_the_gap() -> None:
    gap = Gap(3000 * MS, 3500 * MS, "adapter lost", 0, 0)
    before = ordered(heartbeats(0, 1000), others(3000))
    after = [row for row in ordered(heartbeats(0, 5000), others(5000)) if row[0] >= 3500 * MS]
    text = one(run(*before, gap, *after), "nmt.node_lost").text
    assert "2.1 s up to the gap in the capture at +3.000 s" in text
    assert "the end" not in text


# -- restarts that were asked for ------------------------------------------------------------------


@pytest.mark.near_miss("nmt.node_lost", "nmt.unexpected_reset")
def test_a_write_that_resets_the_device_is_a_reset_command() -> None:
    """2002h = 1 of the JN2100; the node is back 255 ms later and was asked twice meanwhile."""
    reset = written(1050, 0x2002, 1, size=1)
    silent = guarding(1100, 1300, answers=False)
    rows = ordered(
        guarding(0, 1050), reset, silent, [boot(1306)], guarding(1310, 3000), others(3000)
    )
    result = run(*rows, devices=JN2100)
    assert accusing(result) == []
    (started,) = [
        row
        for row in result.analysis.nmt_states
        if row.node == NODE and row.state == "INITIALISING"
    ]
    assert started.cause.startswith("reset by SDO (2002h)")
    assert accusing(run(*rows)) != []


@pytest.mark.near_miss("nmt.node_lost")
def test_one_unanswered_guard_request_is_no_loss() -> None:
    single = guarding(1000, 1100, answers=False)
    result = run(*ordered(guarding(0, 1000), single, guarding(1100, 3000), others(3000)))
    assert "nmt.node_lost" not in result.ids()


@pytest.mark.near_miss("nmt.unexpected_reset")
@pytest.mark.parametrize("data", ["8105", "8200", "0105"])
def test_a_command_to_a_node_that_is_off_is_no_sign_of_it(data: str) -> None:
    command = [frame(1000, 0x000, data)]
    rows = ordered(
        heartbeats(100, 30_000, node=9), command, [boot(25_000)], heartbeats(25_100, 30_000)
    )
    assert "nmt.unexpected_reset" not in run(*rows).ids()


@pytest.mark.near_miss("nmt.unexpected_reset")
def test_a_first_boot_up_is_none_though_the_clock_steps_back_before_it() -> None:
    rows = ordered(heartbeats(100, 6000, node=9), [boot(3000)], heartbeats(3100, 6000))
    assert "nmt.unexpected_reset" not in run(*shifted(rows, -2500, after_ms=2999)).ids()


@pytest.mark.near_miss("nmt.unexpected_reset")
def test_a_reset_less_than_10_s_before_explains_it_though_the_clock_steps_forward() -> None:
    """The first of two boot-ups answers it; the second comes 7 s after it, by the stamps 14 s.

    No heartbeat is missed before it.
    """
    reset = [frame(1000, 0x000, "8105"), boot(1500)]
    rows = ordered(heartbeats(0, 1000), reset, heartbeats(1600, 8000), [boot(8000)], others(9000))
    stepped = shifted(rows, 7000, after_ms=4000)
    assert "nmt.unexpected_reset" not in run(*rows).ids()
    assert "nmt.unexpected_reset" not in run(*stepped).ids()


def test_the_first_7fh_after_a_reset_of_all_is_the_boot_up_of_a_lir() -> None:
    """The recording begins after its last heartbeat: it is silent for 4 s."""
    reset = [frame(1000, 0x000, "8200")]
    rows = ordered(others(7000), reset, heartbeats(5000, 7000, state="7F"))
    assert run(*rows, devices=LIR).nodes[NODE].boot_ups == 1
    assert run(*rows).nodes[NODE].boot_ups == 0


@pytest.mark.triggers("nmt.left_operational")
@pytest.mark.near_miss("nmt.unexpected_reset")
def test_a_lir_that_booted_with_00h_falls_to_7fh_by_itself() -> None:
    """1017h was written and not stored: its boot-up would carry 00h (trap 1)."""
    start = [boot(0), *written(10, 0x1017, 100), frame(105, 0x000, "0105")]
    beats = ordered(heartbeats(110, 2000), heartbeats(2050, 5000, state="7F"), others(5000))
    saved = [
        frame(30, 0x605, "23101001" + "73617665"),
        frame(31, 0x585, "60101001" + "00000000"),
    ]
    assert run(*ordered(start, beats), devices=LIR).ids() == ["nmt.left_operational"]
    stored = run(*ordered(start, saved, beats), devices=LIR)
    assert [i for i in stored.ids() if i.startswith("nmt.")] == ["nmt.unexpected_reset"]


def test_00h_long_after_a_remote_frame_that_changed_nothing_is_a_boot_up() -> None:
    """States went on after the remote frame; then the machine was off."""
    before = ordered(heartbeats(0, 3000), [remote(1050, 0x705)], others(3000))
    after = ordered([boot(6000), boot(6004, 9)], heartbeats(6100, 8000, state="7F"))
    result = run(*before, *after, end_ms=8000)
    assert result.nodes[NODE].boot_ups == 1
    assert result.tables.nmt.nodes[0, NODE].counts.empty == 0


# -- states ----------------------------------------------------------------------------------------


@pytest.mark.near_miss("nmt.left_operational")
def test_operational_that_only_a_pdo_implied_after_a_gap_is_not_left() -> None:
    """Node 5 was commanded to PRE-OPERATIONAL in the gap, and sends PDOs nevertheless."""
    gap = Gap(2000 * MS, 3000 * MS, "adapter lost", 0, 0)
    before = ordered(heartbeats(0, 2000), others(2000))
    pdo = [frame(3010, 0x185, "0102")]
    after = [r for r in ordered(heartbeats(0, 6000, state="7F"), others(6000)) if r[0] > 3010 * MS]
    assert accusing(run(*before, gap, *pdo, *after)) == []


@pytest.mark.near_miss("nmt.command_ignored")
def test_a_master_that_always_says_operational_does_not_follow_its_commands() -> None:
    """It says 05h 70 ms after "start": it never was anything else."""
    commands = [
        frame(1600, 0x000, "8000"),
        frame(1750, 0x000, "0100"),
        frame(3000, 0x000, "0200"),
    ]
    rows = ordered(heartbeats(0, 9000, every_ms=500, node=1), commands)
    assert run(*rows).ids() == []


@pytest.mark.triggers("nmt.command_ignored")
def test_what_a_node_ignored_before_its_number_was_taken_twice_is_told() -> None:
    command = [frame(2010, 0x000, "0205")]
    second = heartbeats(30_000, 60_000, every_ms=170, state="7F")
    rows = ordered(heartbeats(0, 60_000), command, second, others(60_000))
    assert {"nmt.command_ignored", "nmt.duplicate_node_id"} <= set(run(*rows).ids())


@pytest.mark.triggers("nmt.pdo_outside_operational")
def test_pdos_long_after_a_story_of_guarding_are_told_by_themselves() -> None:
    emcy = [frame(1400, 0x085, "3081110000000000")]
    slave = [
        *heartbeats(50, 1450),
        *heartbeats(1450, 4000, state="7F"),
        frame(4005, 0x000, "0105"),
        *heartbeats(4050, 10_000),
        frame(10_005, 0x000, "8005"),
        *heartbeats(10_050, 20_000, state="7F"),
    ]
    bound = written(20, 0x1800, 0x185, size=4, sub=1)
    pdos = [frame(15_000 + 50 * n, 0x185, "01") for n in range(10)]
    rows = ordered(bound, heartbeats(0, 1000, node=1), slave, emcy, pdos, others(20_000))
    assert {"nmt.guarding_lost", "nmt.pdo_outside_operational"} <= set(run(*rows).ids())


# -- guarding and heartbeats -----------------------------------------------------------------------


def stuck(rows: list[Row], first: int, count: int) -> list[Row]:
    """Guard answers of which so many do not change their toggle bit, and the rest goes on so."""
    answers = [at for at, row in enumerate(rows) if not row[3]]
    found, toggle = list(rows), 0
    for number, at in enumerate(answers):
        toggle ^= not first <= number < first + count and number > 0
        found[at] = (*rows[at][:5], bytes([rows[at][5][0] & 0x7F | toggle << 7]))
    return found


@pytest.mark.triggers("nmt.guard_toggle")
@pytest.mark.parametrize("count", [2, 3, 5])
def test_writes_that_began_the_toggle_bit_anew_excuse_no_later_repeats(count: int) -> None:
    """100Ch and 100Dh are written once, before guarding begins: each repeat counts."""
    life = [*written(1, 0x100C, 100), *written(3, 0x100D, 3, 1)]
    rows = ordered(life, stuck(guarding(10, 4000), 12, count), others(4000))
    result = run(*rows, devices=LIR)
    assert result.nodes[NODE].toggle_errors == count
    assert f"{count} times" in one(result, "nmt.guard_toggle").text


@pytest.mark.near_miss("nmt.guard_toggle")
def test_a_write_between_two_answers_excuses_a_repeated_toggle_bit() -> None:
    writes = [row for n in range(3) for row in written(1350 + 400 * n, 0x100C, 100)]
    rows = guarding(0, 1300)
    for n in range(4):
        rows += guarding(1400 + 400 * n, 1800 + 400 * n)
    plain = run(*ordered(rows, others(3000)), devices=LIR)
    excused = run(*ordered(rows, writes, others(3000)), devices=LIR)
    assert (plain.nodes[NODE].toggle_errors, excused.nodes[NODE].toggle_errors) == (1, 0)


@pytest.mark.near_miss("nmt.guard_unanswered")
def test_requests_to_a_node_that_was_off_while_the_clock_stepped_back() -> None:
    off = guarding(2000, 6000, answers=False)
    rows = ordered(guarding(0, 2000), off, [boot(6010)], guarding(6100, 9000), others(9000))
    assert "nmt.guard_unanswered" not in run(*shifted(rows, -3900, after_ms=4000)).ids()


@pytest.mark.triggers("config.rtr_on_heartbeat_node")
def test_remote_frames_to_a_heartbeat_node_are_told_up_to_the_last() -> None:
    ask = [remote(2050, 0x705), remote(3050, 0x705)]
    finding = one(run(*ordered(heartbeats(0, 4000), ask)), "config.rtr_on_heartbeat_node")
    assert (finding.start_ns, finding.end_ns) == (2050 * MS, 3050 * MS)
    assert len(finding.evidence) == 2


@pytest.mark.triggers("config.rtr_on_heartbeat_node")
@pytest.mark.near_miss("config.rtr_on_heartbeat_node")
def test_remote_frames_soon_after_a_gap() -> None:
    """Two heartbeats after it are enough of a node that sent them before; one may be an answer."""
    gap = Gap(3200 * MS, 4300 * MS, "adapter lost", None, None)
    before, after = heartbeats(0, 3200, every_ms=500), heartbeats(4500, 7000, every_ms=500)
    ask = [remote(5410 + 300 * n, 0x705) for n in range(3)]
    result = run(*before, gap, *ordered(after, ask))
    assert one(result, "config.rtr_on_heartbeat_node").start_ns == 5410 * MS
    answer = heartbeats(4305, 4400)
    assert run(*before, gap, *answer, *guarding(4400, 7000)).ids() == ["capture.gap"]


@pytest.mark.triggers("nmt.heartbeat_slow")
@pytest.mark.parametrize("shift", range(8))
def test_six_slow_heartbeats_between_regular_ones(shift: int) -> None:
    """660 ms instead of 300 ms for 4 s, wherever it begins."""
    slow_ms = 3000 + 300 * shift
    rows = ordered(
        written(1, 0x1017, 300),
        heartbeats(300, slow_ms + 300, every_ms=300),
        heartbeats(slow_ms + 660, slow_ms + 4620, every_ms=660),
        heartbeats(slow_ms + 4260, slow_ms + 9000, every_ms=300),
        others(14_000),
    )
    finding = one(run(*rows), "nmt.heartbeat_slow")
    assert "every 660 ms although 1017h is 300 ms" in finding.text


@pytest.mark.near_miss("nmt.duplicate_node_id")
def test_a_heartbeat_of_half_its_period_for_a_while_is_one_device() -> None:
    """A tool on no record set it and set it back; a second device stays."""
    fast = heartbeats(10_000, 14_000, every_ms=250)
    rows = ordered(
        heartbeats(0, 10_000, every_ms=500), fast, heartbeats(14_000, 30_000, every_ms=500)
    )
    assert run(*ordered(rows, others(30_000))).ids() == []


@pytest.mark.triggers("nmt.duplicate_node_id")
def test_states_between_empty_heartbeats_are_those_of_a_second_device() -> None:
    """A remote frame has emptied the heartbeats of a LIR; then a second device comes."""
    rows = ordered(
        heartbeats(0, 3000, every_ms=150),
        [remote(2960, 0x705)],
        heartbeats(3000, 15_000, every_ms=150, state="00"),
        heartbeats(6020, 15_000, every_ms=280),
        others(15_000),
    )
    result = run(*rows, devices=LIR)
    assert "nmt.duplicate_node_id" in result.ids()
    assert result.nodes[NODE].boot_ups == 0


def test_a_second_device_just_in_between_is_not_called_certain() -> None:
    first, second = heartbeats(0, 30_000, every_ms=500), heartbeats(10_255, 30_000, every_ms=500)
    found: Finding = one(run(*ordered(first, second, others(30_000))), "nmt.duplicate_node_id")
    assert found.severity == "warning"


# -- batches ---------------------------------------------------------------------------------------

_SPOILED = ordered(
    [boot(0), *written(10, 0x1017, 100), *written(30, 0x1029, 1, 1, sub=1)],
    heartbeats(110, 1000),
    [remote(930, 0x705)],
    heartbeats(1010, 1900, state="00"),
    [frame(2000 + 40 * n, 0x185, "01") for n in range(8)],
    [frame(2410, 0x000, "8105"), boot(2600), *written(2620, 0x1017, 100)],
    heartbeats(2750, 3500, state="7F"),
    [frame(3520, 0x000, "0105")],
    heartbeats(3550, 4500),
    [remote(4510, 0x705), boot(4610), *written(4640, 0x1017, 100)],
    [frame(4650 + 30 * n, 0x185, "01") for n in range(20)],
    heartbeats(5500, 6500, state="7F"),
    [remote(6700, 0x185), frame(6701, 0x185, "01"), frame(7900, 0x185, "01")],
    [boot(8000)],
    heartbeats(8100, 9000),
    heartbeats(9050, 10_000, state="7F"),
    guarding(10_050, 12_000),
    others(12_000),
)


@pytest.mark.parametrize("device", ["lir-da158a", "jn2100", None])
@pytest.mark.parametrize("batch", [1, 2, 3, 7, 11, 50])
def test_the_way_a_stream_is_cut_changes_nothing(batch: int, device: str | None) -> None:
    devices = {NODE: load_device(device)} if device else None
    whole, pieces = (run(*_SPOILED, devices=devices, batch=size) for size in (1 << 20, batch))
    for name in ("nmt_states", "nmt_commands", "nodes", "sdo", "emcy", "errors"):
        assert getattr(pieces.analysis, name) == getattr(whole.analysis, name), name
    assert pieces.findings() == whole.findings()
    for index in (0x1017, 0x1029):
        for sub in (0, 1):
            spans = [r.context.shadow.spans(0, NODE, index, sub) for r in (whole, pieces)]
            assert spans[0] == spans[1]
    found = [result.tables.nmt.nodes[0, NODE].violations for result in (whole, pieces)]
    assert found[0] == found[1]


@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
@settings(max_examples=60, deadline=None)
def test_two_cadences_are_found_however_the_heartbeats_are_cut(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    t_ns = np.sort(np.concatenate((np.arange(200) * 100, 33 + np.arange(30) * 703))) * MS
    seq = np.arange(len(t_ns))
    regular = rng.uniform(0, 1, len(t_ns)) > 0.01
    once, pieces = Twins(), Twins()
    once.note(seq, t_ns, regular)
    for at in range(0, len(seq), size):
        part = slice(at, at + size)
        pieces.note(seq[part], t_ns[part], regular[part])
    assert (once.periods_ns, once.at) == (pieces.periods_ns, pieces.at)
    assert once.periods_ns is None or once.span == pieces.span


# -- a node by itself, and what the recorder makes of it -------------------------------------------


@pytest.mark.near_miss("nmt.bus_silent")
def test_a_node_that_restarts_while_the_clock_is_set_was_not_off_with_the_machine() -> None:
    """Node 5 is away from 4.0 s on, the clock jumps by 2.3 s at 5.7 s; the others go on."""
    rows = ordered(
        heartbeats(0, 4000),
        [boot(6000)],
        heartbeats(6100, 16_000),
        heartbeats(0, 16_000, node=9),
        heartbeats(7, 16_000, every_ms=500, node=1),
    )
    moved = [(t_ns + (2_333 * MS if t_ns >= 5_700 * MS else 0), *rest) for t_ns, *rest in rows]
    result = run(*moved)  # type: ignore[arg-type]
    assert accusing(result) == []
    assert [state for state, _, _ in result.states(NODE)][1] == "INITIALISING"


@pytest.mark.near_miss("nmt.heartbeat_slow")
def test_a_gap_may_hide_that_1017h_was_lost_with_a_restart() -> None:
    before = ordered(heartbeats(0, 6000, every_ms=400), others(8000), written(6100, 0x1017, 200))
    after = ordered(heartbeats(11_000, 30_000, every_ms=400), others(30_000))
    after = [row for row in after if row[0] >= 11_000 * MS]
    gap = Gap(8_100 * MS, 11_000 * MS, "adapter lost", 20, 0)
    assert "nmt.heartbeat_slow" not in run(*before, gap, *after).ids()
    heard = ordered(heartbeats(0, 30_000, every_ms=400), others(30_000), written(6100, 0x1017, 200))
    assert "nmt.heartbeat_slow" in run(*heard).ids()


@pytest.mark.triggers("nmt.guarding_lost")
@pytest.mark.near_miss("nmt.left_operational")
def test_a_master_that_falls_silent_twice_is_one_story() -> None:
    """Both falls of the node belong to it."""

    def silence(at_ms: float) -> list[Row]:
        return [
            frame(at_ms, 0x085, "3081110000000000"),
            *guarding(at_ms + 200, at_ms + 700, state=0x7F),
            frame(at_ms + 700, 0x000, "0105"),
            *guarding(at_ms + 750, at_ms + 2000),
        ]

    rows = ordered([boot(0)], guarding(100, 2900), silence(3200), silence(5500))
    result = run(*ordered(rows, others(8000)), devices=JN2100)
    assert "nmt.left_operational" not in result.ids()
    assert "its PDOs stop, 2 times" in one(result, "nmt.guarding_lost").text


@pytest.mark.triggers("nmt.unexpected_reset")
@pytest.mark.near_miss("nmt.node_lost")
def test_a_restart_after_an_answered_reset_is_no_loss() -> None:
    """The reset was answered 6 s before; the node was away for 3.5 periods and booted by itself."""
    reset = [frame(1000, 0x000, "8105"), boot(1250)]
    rows = ordered(reset, heartbeats(1450, 7000), [boot(7250)], heartbeats(7350, 9000))
    result = run(*ordered(heartbeats(0, 1000), rows, others(9000)))
    assert accusing(result) == ["nmt.unexpected_reset"]
    text = one(result, "nmt.unexpected_reset").text
    assert "although it had booted since the last reset that was commanded" in text


@pytest.mark.near_miss("nmt.node_lost")
def test_a_clock_set_between_few_heartbeats_accuses_nobody() -> None:
    """Forward by 1075 ms at 1590 ms: both heartbeats are late by just so much."""
    beats = ordered(
        [boot(0), boot(600, 1), frame(700, 0x000, "8200"), boot(950)],
        written(980, 0x1017, 300),
        [frame(983, 0x000, "0105")],
        heartbeats(1281, 8000, every_ms=300),
        heartbeats(1100, 8000, every_ms=500, node=1),
    )
    assert accusing(run(*shifted(beats, 1075, after_ms=1590))) == []


@pytest.mark.triggers("nmt.node_lost")
def test_a_node_late_by_as_much_as_another_by_chance_is_lost_where_a_third_beats_on() -> None:
    rows = ordered(
        heartbeats(0, 2100, every_ms=300),
        heartbeats(3300, 8000, every_ms=300),
        heartbeats(10, 2110, every_ms=300, node=6),
        heartbeats(3310, 8000, every_ms=300, node=6),
        heartbeats(20, 8000, every_ms=500, node=1),
    )
    assert "nmt.node_lost" in run(*rows).ids()


@pytest.mark.near_miss("nmt.bus_silent")
def test_a_clock_set_while_the_machine_starts_does_not_accuse_a_node_of_being_off() -> None:
    """The machine was off from 8.3 to 12 s; the clock jumps by 3.6 s before the master's reset."""
    times = heartbeats(0, 8300, every_ms=200), heartbeats(30, 8300, every_ms=250, node=6)
    off = ordered(*times, heartbeats(100, 8300, every_ms=500, node=1))
    start = [boot(12_000), boot(12_007, 6), boot(12_600, 1), frame(12_700, 0x000, "8200")]
    on = ordered(
        start,
        heartbeats(12_200, 12_800, every_ms=200, state="7F"),
        heartbeats(12_257, 12_500, every_ms=250, state="7F", node=6),
        heartbeats(13_100, 24_000, every_ms=500, node=1),
        [boot(16_700), boot(16_701, 6)],
        heartbeats(16_900, 24_000, every_ms=200),
        heartbeats(16_950, 24_000, every_ms=250, node=6),
    )
    rows = shifted([*off, *on], 3639, after_ms=12_590)
    result = run(*rows, devices={5: load_device("lir-da158"), 6: load_device("lir-ma158k")})
    assert accusing(result) == []


def test_errors_explain_a_fall_of_a_lir_only_at_once() -> None:
    """It tells bus-off at 9 s and beats on for 3 s; then it falls three times: it restarts."""
    error = [frame(9010, 0x085, "1075100000000000"), frame(9100, 0x085, "0000000000000000")]
    falls = [
        row
        for at in (12_070, 13_000, 13_950)
        for row in (
            frame(at, 0x705, "7F"),
            frame(at + 30, 0x000, "0105"),
            *heartbeats(at + 100, at + 900),
        )
    ]
    begin = [frame(0, 0x000, "8105"), frame(150, 0x705, "7F"), frame(180, 0x000, "0105")]
    rows = ordered(begin, heartbeats(250, 12_000), error, falls, others(15_000))
    result = run(*rows, devices=LIR)
    assert accusing(result) == ["nmt.boot_loop", "error.bus_off"]
    at_once = ordered(
        begin,
        heartbeats(250, 9000),
        error,
        heartbeats(9050, 15_000, state="7F"),
        others(15_000),
    )
    assert accusing(run(*at_once, devices=LIR)) == ["error.bus_off"]


@pytest.mark.triggers("nmt.heartbeat_slow")
def test_a_heartbeat_that_kept_1017h_after_a_gap_and_is_slow_later() -> None:
    before = ordered(written(10, 0x1017, 250), heartbeats(100, 6000, every_ms=250), others(6000))
    after = ordered(
        heartbeats(7100, 9100, every_ms=250),
        heartbeats(9200, 14_000, every_ms=425),
        heartbeats(7000, 14_000, node=9),
    )
    gap = Gap(6_000 * MS, 7_000 * MS, "adapter lost", 20, 0)
    assert "nmt.heartbeat_slow" in run(*before, gap, *after).ids()


@pytest.mark.triggers("nmt.duplicate_node_id")
def test_restarts_long_before_a_second_device_are_no_sign_of_it() -> None:
    """The node restarts within 2 s of its start; the second device comes 12 s later."""
    rows = ordered(
        [boot(0), boot(1850)],
        heartbeats(100, 1800, every_ms=250),
        heartbeats(1950, 34_000, every_ms=250),
        heartbeats(17_023, 34_000, every_ms=250),
        [boot(16_900)],
        others(34_000),
    )
    finding = one(run(*rows), "nmt.duplicate_node_id")
    assert "it told at" not in finding.text
    assert min(finding.evidence) > 100


@pytest.mark.near_miss("nmt.duplicate_node_id")
def test_a_node_that_answers_two_sync_producers_is_one_device() -> None:
    """It boots twice before that; without the second producer its PDOs are those of two."""
    pdos = [*every(0x185, 2002, 20_000, 50, b"\1"), *every(0x185, 6021, 12_000, 50, b"\1")]
    syncs = every(0x80, 0, 20_000, 50)
    boots = [*every(0x705, 500, 501, 1, b"\0"), *every(0x705, 1400, 1401, 1, b"\0")]
    rows = [*boots, *pdos, *syncs, *beats(9, 0, 20_000)]
    assert "nmt.duplicate_node_id" in ids(whole(rows))
    assert "nmt.duplicate_node_id" not in ids(whole(rows, every(0x80, 6019, 12_000, 50)))


@pytest.mark.triggers("nmt.duplicate_node_id")
def test_two_cadences_on_a_slow_bus_where_one_waits_now_and_then() -> None:
    """Every fifth heartbeat goes out at once, the others 8 ms late behind PDOs."""
    waited = [frame(200 * n + (8 if n % 5 else 0), 0x705, "05") for n in range(120)]
    second = [frame(9344 + 330 * n, 0x705, "05") for n in range(44)]
    found = one(run(*ordered(waited, second, others(24_000))), "nmt.duplicate_node_id")
    assert "one heartbeat comes every 200 ms, the other every 330 ms" in found.text
    alone = run(*ordered(waited, others(24_000)))
    assert "nmt.duplicate_node_id" not in alone.ids()


@pytest.mark.triggers("nmt.heartbeat_slow")
def test_a_heartbeat_that_kept_1017h_for_a_while_within_the_window_of_the_slow_one() -> None:
    """Three periods as they should be after the gap, then four slow ones."""
    before = ordered(written(10, 0x1017, 500), heartbeats(100, 6000, every_ms=500), others(6000))
    after = ordered(
        heartbeats(7100, 9100, every_ms=500),
        [frame(t, 0x705, "05") for t in (9650, 10_500, 11_350, 12_200, 13_300, 13_800, 14_300)],
        heartbeats(7000, 14_400, node=9),
    )
    gap = Gap(6_000 * MS, 7_000 * MS, "adapter lost", 20, 0)
    assert "nmt.heartbeat_slow" in run(*before, gap, *after).ids()


@pytest.mark.triggers("nmt.unknown_state")
@pytest.mark.near_miss("nmt.unknown_state")
def test_bytes_that_are_no_state_before_a_second_device_was_there() -> None:
    """Three even periods after them show that the node was alone; two might hide a second one."""
    odd = [frame(t, 0x705, "33") for t in (4000, 4500, 5000, 5500)]
    both = ordered(heartbeats(8400, 26_000, every_ms=500), heartbeats(8610, 26_000, every_ms=500))
    beats = [frame(t, 0x705, "05") for t in (6001, 6501, 7001, 7500)]
    for alone, told in ((beats, True), (beats[1:], False)):
        before = ordered(heartbeats(0, 4000, every_ms=500), odd, alone)
        ids = run(*ordered(before, both, [boot(8350)], others(26_000))).ids()
        assert "nmt.duplicate_node_id" in ids
        assert ("nmt.unknown_state" in ids) == told


@pytest.mark.triggers("nmt.unexpected_reset")
def test_silences_that_the_bus_often_makes_do_not_stretch_the_10_s_after_a_reset() -> None:
    rows = ordered(
        [frame(0, 0x000, "8205"), boot(250), boot(10_080)],
        heartbeats(450, 10_060, every_ms=200),
        heartbeats(10_280, 14_000, every_ms=200),
        [
            row
            for row in heartbeats(3, 14_000, every_ms=20, node=9)
            if row[0] % (500 * MS) > 90 * MS
        ],
    )
    assert "nmt.unexpected_reset" in run(*rows).ids()
    rows[1:] = [row for row in rows[1:] if row[:3] != boot(10_080)[:3]]
    assert "nmt.unexpected_reset" not in run(*rows).ids()


@pytest.mark.near_miss("nmt.duplicate_node_id")
def test_a_heartbeat_that_was_slow_for_a_while_is_no_second_one_in_the_middle() -> None:
    slow = [frame(t, 0x705, "05") for t in (8533, 9633, 10_733)]
    rows = ordered(
        heartbeats(1783, 7300, every_ms=500),
        slow,
        heartbeats(11_933, 15_000, every_ms=500),
        others(15_000),
    )
    assert "nmt.duplicate_node_id" not in run(*rows).ids()


@pytest.mark.near_miss("nmt.node_lost")
def test_a_state_that_a_lir_was_told_to_take_while_the_clock_was_set_is_no_start() -> None:
    rows = ordered(
        heartbeats(0, 7300, every_ms=300),
        heartbeats(7550, 15_000, every_ms=300, state="7F"),
        heartbeats(20, 15_000, every_ms=500, node=1),
        [frame(t, 0x285, "01") for t in range(30, 7360, 80)],
        [frame(7364, 0x000, "8005")],
    )
    rows = [shifted([row], 507)[0] if row[0] > 7360 * MS else row for row in rows]
    assert "nmt.node_lost" not in accusing(run(*rows, devices=LIR))


@pytest.mark.near_miss("nmt.guard_toggle")
def test_heartbeats_soon_after_remote_frames_carry_no_toggle_bit() -> None:
    """After a gap the first of them look like answers."""
    asked = [remote(t, 0x705) for t in (7058, 7358, 7658)]
    before = ordered(written(10, 0x1017, 300), heartbeats(142, 6600, every_ms=300), others(6600))
    after = ordered(asked, heartbeats(7142, 12_000, every_ms=300), others(0))
    gap = Gap(6_632 * MS, 7_034 * MS, "adapter lost", 20, 0)
    assert "nmt.guard_toggle" not in run(*before, gap, *after).ids()


@pytest.mark.near_miss("nmt.node_lost")
@pytest.mark.triggers("nmt.bus_silent")
def test_the_first_00h_after_the_machine_was_off_is_a_boot_up() -> None:
    """Its heartbeats were empty before; it was reset again before it told a state."""
    rows = ordered(
        [boot(10), *written(90, 0x1017, 100), remote(2950, 0x705), boot(15, 9)],
        heartbeats(100, 3000),
        heartbeats(3000, 6000, state="00"),
        heartbeats(100, 6000, node=9),
        [boot(9000), boot(9400, 9), frame(9500, 0x000, "8205"), boot(13_400)],
        heartbeats(9500, 16_000, node=9),
        written(13_450, 0x1017, 100),
        heartbeats(13_500, 16_000),
    )
    result = run(*rows)
    assert result.nodes[NODE].boot_ups == 3
    assert "nmt.node_lost" not in result.ids()
    alone = run(*[row for row in rows if row[:3] != boot(9400, 9)[:3]])
    assert alone.nodes[NODE].boot_ups == 2


@pytest.mark.near_miss("nmt.bus_silent")
def test_a_silence_at_the_end_that_is_a_step_of_the_clock_accuses_nobody() -> None:
    rows = ordered(heartbeats(0, 5000, every_ms=150), heartbeats(0, 5000, every_ms=20, node=9))
    rows = [row for row in rows if row[0] < 5000 * MS or row[2] != 0x705]
    last = max(row[0] for row in rows if row[2] == 0x705) / MS
    late = shifted([row for row in rows if row[0] < (last + 90) * MS], 147, last + 10)
    assert "nmt.bus_silent" not in run(*late).ids()


@pytest.mark.near_miss("nmt.left_operational", "nmt.unexpected_reset")
def test_two_devices_that_show_only_after_the_clock_was_set_were_two_before_it() -> None:
    """The second one starts 7 s before the step: too short to part the two periods."""
    rows = ordered(
        heartbeats(0, 15_100, every_ms=500),
        heartbeats(15_500, 50_000, every_ms=500),
        [boot(15_250), frame(15_880, 0x705, "7F"), frame(16_300, 0x000, "0105")],
        heartbeats(16_510, 50_000, every_ms=630),
        *(heartbeats(n, 50_000, every_ms=90 + n, node=n) for n in range(9, 15)),
    )
    found = ids(whole(shifted(rows, 3584, 22_551)))
    assert "nmt.duplicate_node_id" in found
    assert not {"nmt.left_operational", "nmt.unexpected_reset"} & found


@pytest.mark.triggers("nmt.unexpected_reset")
def test_a_step_back_makes_no_reset_recent() -> None:
    """11.3 s after the reset in truth, 8.9 s by the stamps."""
    rows = ordered(
        [frame(1000, 0x000, "8200"), boot(1250), boot(1260, 9), boot(12_300)],
        heartbeats(1450, 12_250, every_ms=200),
        heartbeats(12_500, 15_000, every_ms=200),
        heartbeats(1360, 15_000, node=9),
    )
    assert "nmt.unexpected_reset" in run(*shifted(rows, -2434, 6870)).ids()
