"""Each rule on the control side: a case that triggers it, and a near miss that does not."""

import pytest

from syncline_analyzer.results import Finding
from syncline_analyzer.views.events import emcy_text
from syncline_schemas.batch import FrameFlag, Gap
from syncline_schemas.devices import load_device
from tests.analyzer.control_runs import MS, Row, Run, frame, remote, run
from tests.analyzer.test_nmt_fold import guarding, heartbeats, ordered

OTHER = heartbeats(0, 4000, node=9)
READ = "4000100000000000"
ANSWER = "4300100001000000"


def one(result: Run, rule: str) -> Finding:
    """The only finding of a rule, which names its evidence and what to do."""
    (finding,) = [f for f in result.findings() if f.id == rule]
    assert finding.evidence or rule == "capture.gap"
    assert finding.text.endswith(".")
    assert finding.cause
    assert finding.check_next
    return finding


def test_a_healthy_bus_is_silent() -> None:
    start = [frame(5, 0x705, "00"), frame(10, 0x000, "0105"), frame(15, 0x085, "0000000000000000")]
    sdo = [frame(20, 0x605, READ), frame(21, 0x585, ANSWER)]
    pdos = [frame(t, 0x185, "01") for t in range(150, 4000, 20)]
    result = run(*ordered(start, sdo, pdos, heartbeats(100, 4000), OTHER))
    assert result.findings() == []


def test_node_lost() -> None:
    result = run(*ordered(heartbeats(0, 1000), heartbeats(2000, 4000), OTHER))
    finding = one(result, "nmt.node_lost")
    assert (finding.node, finding.start_ns, finding.end_ns) == (5, 900 * MS, 2000 * MS)
    assert "without a boot-up" in finding.text
    near = run(*ordered(heartbeats(0, 1000), heartbeats(1040, 4000), OTHER))
    assert near.ids() == []


def test_node_lost_until_the_end() -> None:
    finding = one(run(*ordered(heartbeats(0, 1000), OTHER)), "nmt.node_lost")
    assert "up to the end" in finding.text


def test_the_whole_bus_switched_off_is_one_finding() -> None:
    off = ordered(heartbeats(0, 1000), heartbeats(0, 1000, node=9))
    on = ordered(
        [frame(5000, 0x705, "00"), frame(5001, 0x709, "00")],
        heartbeats(5100, 6000),
        heartbeats(5100, 6000, node=9),
    )
    finding = one(run(*off, *on), "nmt.bus_silent")
    assert (finding.node, finding.severity) == (None, "warning")
    assert "nodes 5, 9" in finding.text


def test_unexpected_reset() -> None:
    crash = [frame(1050, 0x705, "00"), *heartbeats(1100, 4000, state="7F")]
    finding = one(run(*ordered(heartbeats(0, 1000), crash, OTHER)), "nmt.unexpected_reset")
    assert finding.evidence == [row_seq(ordered(heartbeats(0, 1000), crash, OTHER), 1050)]
    commanded = [frame(1010, 0x000, "8100")]
    assert run(*ordered(heartbeats(0, 1000), commanded, crash, OTHER)).ids() == []


def restarted(after_ms: int, *extra: Row, end_ms: int = 4000) -> list[Row]:
    """Node 5 is silent from 900 ms on, boots so much later, and goes on."""
    back = heartbeats(1000 + after_ms, end_ms, state="7F")
    return ordered(heartbeats(0, 1000), [frame(900 + after_ms, 0x705, "00")], back, list(extra))


def test_a_restart_that_outlasts_the_heartbeat_is_an_unexpected_reset_and_no_loss() -> None:
    result = run(*ordered(restarted(494), OTHER))
    assert result.ids() == ["nmt.unexpected_reset"]
    finding = one(result, "nmt.unexpected_reset")
    assert (finding.severity, finding.node) == ("error", 5)
    assert (finding.start_ns, finding.end_ns) == (900 * MS, 1394 * MS)
    assert "after a silence of 494 ms" in finding.text
    assert result.states(5)[:3] == [
        ("OPERATIONAL", 0.0, 0.9),
        ("INITIALISING", 0.9, 1.394),
        ("PRE-OPERATIONAL", 1.394, result.states(5)[2][2]),
    ]


def test_an_empty_emcy_in_a_silence_tells_of_a_start() -> None:
    """hilch_ixxat1: node 9 announces its boot-up as devices made after DS-301 V3 do."""
    gone = [*heartbeats(0, 1000), *heartbeats(12_000, 16_000)]
    other = heartbeats(0, 16_000, node=9)
    started = one(run(*ordered(gone, [frame(9000, 0x085, "")], other)), "nmt.node_lost")
    assert "at +0.900 s for 11.1 s, up to +12.000 s; meanwhile it started anew" in started.text
    assert "a boot-up of the old kind (an empty EMCY" in started.text
    assert started.text.count("at +9.000 s") == 1
    assert started.cause.startswith("The node lost its supply or restarted")
    unheard = one(run(*ordered(gone, [frame(9000, 0x086, "")], other)), "nmt.node_lost")
    assert "empty EMCY" not in unheard.text
    twice = [*gone, *heartbeats(30_000, 34_000)]
    other = heartbeats(0, 34_000, node=9)
    again = one(run(*ordered(twice, [frame(9000, 0x085, "")], other)), "nmt.node_lost")
    assert "in 1 of these times it started anew meanwhile" in again.text
    both = [frame(9000, 0x085, ""), frame(20_000, 0x085, "")]
    always = one(run(*ordered(twice, both, other)), "nmt.node_lost")
    assert "; each time it started anew meanwhile" in always.text


def test_a_start_command_to_a_node_that_restarts_changes_nothing() -> None:
    result = run(*ordered(restarted(494, frame(1200, 0x000, "0105")), OTHER))
    assert result.states(5)[1] == ("INITIALISING", 0.9, 1.394)


def test_a_silence_too_long_for_a_restart_is_a_loss() -> None:
    other = heartbeats(0, 16000, node=9)
    result = run(*ordered(restarted(10_100, end_ms=16000), other))
    assert result.ids() == ["nmt.node_lost"]
    assert "LOST" in [state for state, _, _ in result.states(5)]
    assert run(*ordered(restarted(9_900, end_ms=16000), other)).ids() == ["nmt.unexpected_reset"]


def test_a_node_that_is_reset_because_it_is_silent_was_lost() -> None:
    result = run(*ordered(restarted(900, frame(1500, 0x000, "8105")), OTHER))
    assert result.ids() == ["nmt.node_lost"]


def test_a_restart_alone_on_the_bus_may_be_a_power_cycle() -> None:
    finding = one(run(*restarted(494)), "nmt.unexpected_reset")
    assert finding.severity == "warning"
    assert "cannot tell" in finding.text
    assert run(*restarted(2100)).ids() == ["nmt.bus_silent"]
    sync = [frame(10 * n + 3, 0x080) for n in range(500)]
    result = run(*ordered(restarted(494), sync))
    assert one(result, "nmt.unexpected_reset").severity == "error"


def test_two_boot_ups_200_ms_apart_are_two_starts() -> None:
    rows = [frame(0, 0x705, "00"), frame(200, 0x705, "00"), *heartbeats(1000, 4000, state="7F")]
    finding = one(run(*ordered(rows, OTHER)), "nmt.unexpected_reset")
    assert "two devices carry this number" in finding.cause
    pair = [frame(0, 0x705, "00"), frame(85, 0x705, "00"), *heartbeats(1000, 4000, state="7F")]
    assert run(*ordered(pair, OTHER)).ids() == []


def row_seq(rows: list[Row], t_ms: int) -> int:
    return next(n for n, row in enumerate(rows) if row[0] == t_ms * MS)


def test_a_pair_of_boot_ups_is_one_restart() -> None:
    pair = [frame(1050, 0x705, "00"), frame(1095, 0x705, "00"), *heartbeats(1100, 4000)]
    finding = one(run(*ordered(heartbeats(0, 1000), pair, OTHER)), "nmt.unexpected_reset")
    assert "two boot-up frames" in finding.text


def test_nodes_that_restart_together_name_one_another_and_what_they_share() -> None:
    def booting(node: int, at_ms: int) -> list[Row]:
        boot = [frame(at_ms, 0x700 + node, "00")]
        after = heartbeats(at_ms + 50, 6000, node=node)
        return ordered(heartbeats(0, 1000, node=node), boot, after)

    other = heartbeats(0, 6000, node=9)
    result = run(*ordered(booting(5, 1900), booting(6, 2400), booting(7, 5500), other))
    found = {f.node: f for f in result.findings() if f.id == "nmt.unexpected_reset"}
    assert "Node 6 restarted" in found[5].text.partition(". ")[2]
    assert "Node 5 restarted" in found[6].text.partition(". ")[2]
    assert "common" in found[5].cause
    assert "common" in found[6].check_next
    assert "common" not in found[7].cause


def test_the_first_boot_up_of_a_capture_is_no_restart() -> None:
    assert run(*ordered([frame(50, 0x705, "00")], heartbeats(100, 4000), OTHER)).ids() == []


def test_a_reset_by_sdo_is_not_spontaneous() -> None:
    """JN29: 2002h = 1 restarts a JN2100 without an NMT command."""
    write = [frame(1005, 0x605, "2F02200001000000"), frame(1006, 0x585, "6002200000000000")]
    rows = ordered(heartbeats(0, 1000), write, [frame(1050, 0x705, "00")], heartbeats(1100, 4000))
    assert run(*ordered(rows, OTHER), devices={5: load_device("jn2100")}).ids() == []
    assert run(*ordered(rows, OTHER)).ids() == ["nmt.unexpected_reset"]


@pytest.mark.near_miss("nmt.unexpected_reset", "nmt.boot_loop")
@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_stop_start_or_reset_of_the_program_is_no_break_of_the_supply(order: int) -> None:
    """CiA 302-3: 1F51h stops, starts or resets a node's program, which boots anew."""
    write = frame(1005, 0x605, f"2F511F01{order:02X}000000")
    after = ordered([frame(2200, 0x705, "00")], heartbeats(2300, 4000))
    taken, refused = frame(1006, 0x585, "60511F0100000000"), frame(1006, 0x585, "80511F0122000008")
    beats = heartbeats(0, 1000)
    assert run(*ordered(beats, [write, taken], after, OTHER)).ids() == []
    assert run(*ordered(beats, [write], after, OTHER)).ids() == []
    assert "nmt.unexpected_reset" in run(*ordered(beats, [write, refused], after, OTHER)).ids()
    cleared = frame(1005, 0x605, "2F511F0103000000")
    assert "nmt.unexpected_reset" in run(*ordered(beats, [cleared, taken], after, OTHER)).ids()


def test_a_new_program_may_take_its_time_until_it_boots_once() -> None:
    other = heartbeats(0, 60_000, node=9)
    order = [frame(1005, 0x605, "2F511F0101000000"), frame(1006, 0x585, "60511F0100000000")]
    booted = ordered(heartbeats(0, 1000), order, [frame(31_000, 0x705, "00")])
    ran = ordered(booted, heartbeats(31_100, 60_000))
    assert "nmt.unexpected_reset" not in run(*ordered(ran, other)).ids()
    again = ordered(booted, heartbeats(31_100, 45_000), [frame(45_900, 0x705, "00")])
    crashed = run(*ordered(again, heartbeats(46_000, 60_000), other))
    assert one(crashed, "nmt.unexpected_reset").start_ns > 44_000 * MS


def test_command_ignored() -> None:
    stop = [frame(1010, 0x000, "0205")]
    finding = one(run(*ordered(heartbeats(0, 4000), stop, OTHER)), "nmt.command_ignored")
    assert "OPERATIONAL" in finding.text
    slow = ordered(heartbeats(0, 1100), stop, heartbeats(1100, 4000, state="04"), OTHER)
    assert run(*slow).ids() == []


def test_a_stop_that_is_ignored_is_one_story_with_the_pdos_sent_meanwhile() -> None:
    bind = [frame(1, 0x605, "4000180100000000"), frame(2, 0x585, "4300180185010000")]
    pdos = [frame(t, 0x185, "01") for t in range(500, 3000, 20)]
    stops = [frame(1010, 0x000, "0205"), frame(1035, 0x000, "0205"), frame(1062, 0x000, "0205")]
    beats = [*heartbeats(0, 1000), *heartbeats(1100, 4000)]
    result = run(*ordered(bind, beats, pdos, stops, OTHER))
    assert result.ids() == ["nmt.command_ignored"]
    finding = one(result, "nmt.command_ignored")
    assert finding.start_ns == 1010 * MS
    assert "goes on sending PDOs (185h)" in finding.text


def test_a_command_followed_late_is_not_a_fall() -> None:
    stop = [frame(1010, 0x000, "0205")]
    late = ordered(heartbeats(0, 1150), stop, heartbeats(1150, 4000, state="04"), OTHER)
    assert run(*late).ids() == []


def test_a_broadcast_is_not_ignored_by_the_master_itself() -> None:
    stop = [frame(1010, 0x000, "0200")]
    slave = [*heartbeats(0, 1100), *heartbeats(1100, 4000, state="04")]
    assert run(*ordered(slave, stop, OTHER)).ids() == []


def test_pdo_outside_operational() -> None:
    bind = [frame(1, 0x605, "4000180100000000"), frame(2, 0x585, "4300180185010000")]
    pdos = [frame(t, 0x185, "01") for t in range(1000, 2000, 100)]
    preop = heartbeats(10, 4000, state="7F")
    finding = one(run(*ordered(bind, preop, pdos, OTHER)), "nmt.pdo_outside_operational")
    assert "185h" in finding.text
    assert run(*ordered(preop, pdos, OTHER)).ids() == []
    asked = [remote(t - 1, 0x185) for t in range(1000, 2000, 100)]
    assert run(*ordered(bind, preop, pdos, asked, OTHER)).ids() == []


def test_guarding_lost_is_one_story_rooted_at_the_master() -> None:
    """JN12: no request for 300 ms, EMCY 8130h, back to PRE-OPERATIONAL."""
    story = ordered(
        guarding(0, 1000),
        [frame(1205, 0x085, "3081110000000000")],
        guarding(1400, 3000, state=0x7F),
        OTHER,
    )
    result = run(*story)
    finding = one(result, "nmt.guarding_lost")
    assert result.ids() == ["nmt.guarding_lost"]
    assert "305 ms" in finding.text
    assert "PRE-OPERATIONAL" in finding.text
    assert len(finding.evidence) == 3
    assert "not at node 5" in finding.cause
    assert run(*ordered(guarding(0, 1000), guarding(1400, 3000), OTHER)).ids() == []


def test_heartbeat_master_that_dies_is_the_root() -> None:
    master = heartbeats(0, 1000, node=1)
    slave = [*heartbeats(50, 1450), *heartbeats(1450, 4000, state="7F")]
    emcy = [frame(1400, 0x085, "3081110000000000")]
    result = run(*ordered(master, slave, emcy, OTHER))
    assert result.ids() == ["nmt.guarding_lost"]
    assert "Master (node 1)" in one(result, "nmt.guarding_lost").cause


def test_leaving_operational_without_a_command() -> None:
    """1029h:1 = 2: a LIR goes to STOPPED after a bus error and is mute (trap 16)."""
    emcy = [frame(1050, 0x085, "1043010000000000")]
    beats = [*heartbeats(0, 1100), *heartbeats(1100, 4000, state="04")]
    result = run(*ordered(beats, emcy, OTHER))
    finding = one(result, "nmt.left_operational")
    assert "STOPPED" in finding.text
    assert "4310h" in finding.text
    commanded = [frame(1060, 0x000, "0205")]
    assert "nmt.left_operational" not in run(*ordered(beats, emcy, commanded, OTHER)).ids()
    self_start = [*heartbeats(0, 1100, state="7F"), *heartbeats(1100, 4000)]
    assert run(*ordered(self_start, OTHER)).ids() == []


def test_duplicate_node_id_by_cadence_and_by_state() -> None:
    twins = ordered(heartbeats(0, 4000), heartbeats(30, 4000))
    assert "nmt.duplicate_node_id" in run(*ordered(twins, OTHER)).ids()
    states = ordered(heartbeats(0, 4000), heartbeats(1033, 4000, every_ms=170, state="7F"))
    assert run(*ordered(states, OTHER)).ids() == ["nmt.duplicate_node_id"]
    shaky = [frame(t * 100 + (t * 37) % 20, 0x705, "05") for t in range(40)]
    assert run(*ordered(shaky, OTHER)).ids() == []


def test_guard_toggle_stuck() -> None:
    stuck = [row if row[3] else frame(row[0] / MS, 0x705, "05") for row in guarding(0, 1000)]
    assert run(*ordered(stuck, heartbeats(0, 1000, node=9))).ids() == ["nmt.guard_toggle"]


def test_heartbeat_slower_than_1017h() -> None:
    def written(ms: int) -> Run:
        data = "2B171000" + ms.to_bytes(2, "little").hex() + "0000"
        write = [frame(1, 0x605, data), frame(2, 0x585, "6017100000000000")]
        return run(*ordered(write, heartbeats(10, 4000, every_ms=500), OTHER))

    assert written(100).ids() == ["nmt.heartbeat_slow"]
    assert written(500).ids() == []


def test_rtr_on_a_heartbeat_node() -> None:
    ask = [remote(2050, 0x705)]
    assert run(*ordered(heartbeats(0, 4000), ask, OTHER)).ids() == ["config.rtr_on_heartbeat_node"]
    assert run(*ordered(guarding(0, 4000), OTHER)).ids() == []


def test_sdo_abort_of_a_search_is_information_and_of_a_write_a_warning() -> None:
    beats = ordered(heartbeats(0, 4000), OTHER)
    search = [frame(5, 0x605, READ), frame(6, 0x585, "8000100000000206")]
    finding = one(run(*ordered(search, search, beats)), "sdo.abort")
    assert finding.severity == "info"
    write = [frame(5, 0x605, "2B171000FA000000"), frame(6, 0x585, "8017100002000106")]
    finding = one(run(*ordered(write, beats)), "sdo.abort")
    assert finding.severity == "warning"
    assert "read-only" in finding.text
    good = [frame(5, 0x605, READ), frame(6, 0x585, ANSWER)]
    assert run(*ordered(good, beats)).ids() == []


def test_sdo_no_answer_only_from_nodes_that_are_there() -> None:
    beats = ordered(heartbeats(0, 4000), OTHER)
    asked = [frame(500, 0x605, READ), frame(700, 0x605, READ)]
    finding = one(run(*ordered(asked, beats)), "sdo.no_answer")
    assert "2 SDO requests" in finding.text
    nobody = [frame(500, 0x606, READ), frame(700, 0x606, READ)]
    timed_out = [frame(900, 0x606, "8000100000000405")]
    assert run(*ordered(nobody, timed_out, beats)).ids() == []


def test_sdo_requests_to_a_lost_node_belong_to_its_loss() -> None:
    asked = [frame(1500, 0x605, READ), frame(1700, 0x605, READ)]
    rows = ordered(heartbeats(0, 1000), heartbeats(2500, 4000), asked, OTHER)
    assert run(*rows).ids() == ["nmt.node_lost"]


def test_emcy_active_at_the_end_is_an_error_and_over_a_warning() -> None:
    beats = ordered(heartbeats(0, 4000), OTHER)
    raised = [frame(500, 0x085, "1043010000000000")]
    assert one(run(*ordered(raised, beats)), "emcy.active").severity == "error"
    cleared = [*raised, frame(900, 0x085, "0000000000000000")]
    finding = one(run(*ordered(cleared, beats)), "emcy.active")
    assert finding.severity == "warning"
    assert "400 ms" in finding.text
    nothing = [frame(500, 0x085, "0000000000000000")]
    assert run(*ordered(nothing, beats)).ids() == []


def test_bus_off_told_by_the_node_explains_its_silence() -> None:
    told = [frame(2001, 0x085, "4081110000000000"), frame(2050, 0x085, "0000000000000000")]
    rows = ordered(heartbeats(0, 1000), told, heartbeats(2100, 4000), OTHER)
    result = run(*rows)
    assert result.ids() == ["error.bus_off"]
    assert one(result, "error.bus_off").start_ns == 900 * MS


def test_bus_off_with_all_that_follows_is_one_story() -> None:
    """Silent, back, 8140h again and again, and PRE-OPERATIONAL by 1029h:1 = 0."""
    told = [frame(t, 0x085, "4081110000000000") for t in (2001, 2600)]
    rows = ordered(heartbeats(0, 1000), told, heartbeats(2100, 4000, state="7F"), OTHER)
    result = run(*rows)
    assert result.ids() == ["error.bus_off"]
    finding = one(result, "error.bus_off")
    assert "2 times" in finding.text
    assert "PRE-OPERATIONAL" in finding.text
    times = [rows[seq][0] // MS for seq in finding.evidence]
    assert times == [900, 2001, 2100, 2600]


def test_losses_that_are_alike_are_one_finding() -> None:
    """A machine switched off three times, and at the end a pause that accuses nobody."""
    cycles = [
        row
        for begin in (0, 5000, 12_000)
        for node in (5, 9)
        for row in [
            frame(begin, 0x700 + node, "00"),
            *heartbeats(begin + 100, begin + 2000, node=node),
        ]
    ]
    result = run(*ordered(cycles), frame(20_000, 0x080), frame(21_000, 0x080))
    lost = [f for f in result.findings() if f.id == "nmt.bus_silent"]
    finding, pause = sorted(lost, key=lambda f: f.start_ns)
    assert (finding.node, pause.node) == (None, None)
    assert "nodes 5, 9 came back with a boot-up each time" in finding.text
    assert (finding.severity, pause.severity) == ("warning", "info")
    assert "2 times (at +1.900 s, +6.900 s) for 3.1 s to 5.1 s" in finding.text
    assert len(finding.evidence) == 8
    shaky = [row for begin in (0, 2000, 5000) for row in heartbeats(begin, begin + 1000)]
    loose = one(run(*ordered(shaky, heartbeats(0, 6000, node=9))), "nmt.node_lost")
    assert "lost 2 times (at +0.900 s, +2.900 s) for 1.1 s to 2.1 s" in loose.text


def test_a_code_stands_once_in_a_text() -> None:
    emcy = [frame(1050, 0x085, "0031040000000000")]
    beats = [*heartbeats(0, 1100), *heartbeats(1100, 4000, state="04")]
    for finding in run(*ordered(beats, emcy, OTHER)).findings():
        assert finding.text.count("3100h") == 1, finding.text


def test_codes_that_nobody_knows_stand_once_in_a_line() -> None:
    emcy = [frame(1050, 0x085, "1050010000000000"), frame(1060, 0x085, "3412010000000000")]
    abort = [frame(500, 0x605, READ), frame(501, 0x585, "8000100000000108")]
    result = run(*ordered(heartbeats(0, 4000), emcy, abort, OTHER))
    hardware, unknown = map(emcy_text, result.analysis.emcy)
    assert hardware.startswith("5010h device hardware, raised")
    assert unknown.startswith("1234h unknown code, further")
    assert one(result, "sdo.abort").text.count("08010000h") == 1


def test_bus_off_of_the_recorder() -> None:
    off = frame(500, 0x40, "0000000000000000", flags=int(FrameFlag.ERROR))
    finding = one(run(*ordered([off], heartbeats(0, 4000))), "error.bus_off")
    assert finding.node is None
    passive = frame(500, 0x04, "0010000000000000", flags=int(FrameFlag.ERROR))
    assert run(*ordered([passive], heartbeats(0, 4000))).ids() == []


@pytest.mark.parametrize(("back_ms", "severity"), [(500.0, "warning"), (0.05, "info")])
def test_clock_step_back(back_ms: float, severity: str) -> None:
    rows = [*heartbeats(0, 1000), *heartbeats(900 - back_ms, 2000 - back_ms)]
    assert one(run(*rows), "clock.step_back").severity == severity
    assert run(*heartbeats(0, 2000)).ids() == []


def test_buses_have_their_own_order_of_stamps() -> None:
    rows = [
        frame(t + (20 if bus else 0), 0x705, "05", bus=bus)
        for t in range(0, 2000, 100)
        for bus in (1, 0)
    ]
    assert run(*rows).ids() == []


def test_capture_gap() -> None:
    gap = Gap(1000 * MS, 3000 * MS, "queue overrun", 12)
    finding = one(run(*heartbeats(0, 1000), gap, *heartbeats(3000, 4000)), "capture.gap")
    assert (finding.severity, finding.start_ns) == ("info", 1000 * MS)
    assert "12 frames" in finding.text


def test_untimed_captures_yield_no_finding_about_time() -> None:
    rows = [frame(0, 0x705, "05")] * 5 + [frame(0, 0x705, "00"), frame(0, 0x605, READ)]
    assert run(*rows, timed=False).ids() == []


@pytest.mark.parametrize("data", ["30810100", "408120", "30"])
def test_a_malformed_emcy_is_a_finding_of_its_own_and_no_error_story(data: str) -> None:
    fall = [*heartbeats(0, 1000), *heartbeats(1000, 2000, state="7F")]
    result = run(*ordered(fall, [frame(950, 0x085, data)], OTHER))
    finding = one(result, "emcy.malformed")
    assert (finding.node, finding.severity) == (5, "warning")
    assert f"{len(data) // 2} instead of 8 bytes" in finding.text
    assert "nmt.guarding_lost" not in result.ids()
    assert "after it reported" not in " ".join(f.text for f in result.findings())
    assert "error.bus_off" not in result.ids()
    assert run(*ordered(heartbeats(0, 4000), [frame(950, 0x085, data)], OTHER)).ids() == [
        "emcy.malformed"
    ]


@pytest.mark.parametrize(
    ("data", "wrong"),
    [
        ("01", "1 instead of 2 bytes"),
        ("010500", "3 instead of 2 bytes"),
        ("", "0 instead of 2 bytes"),
        ("9905", "unknown command specifier 99h"),
        ("01FF", "node number 255"),
    ],
)
def test_frames_on_000h_that_are_no_nmt_commands(data: str, wrong: str) -> None:
    """CiA 301 7.2.8.3.1: two bytes, five specifiers, nodes 0 to 127."""
    rows = ordered(OTHER, [frame(1003, 0x000, data), frame(1013, 0x000, data)])
    result = run(*rows)
    finding = one(result, "nmt.malformed_command")
    assert finding.severity == "warning"
    assert f"{wrong} (2 times)" in finding.text
    assert finding.evidence == [n for n, row in enumerate(rows) if row[2] == 0]
    assert len(result.analysis.nmt_commands) == (2 if len(data) == 4 else 0)
    assert result.ids() == ["nmt.malformed_command"]


def test_other_frames_on_000h_accuse_nobody_where_nothing_is_canopen() -> None:
    assert run(*[frame(10 * n, 0x000, "01020304") for n in range(50)]).ids() == []
