"""Faults and healthy habits of error control that look alike: who is accused, and who is not."""

import math
import random

import pytest

from tests.analyzer.control_runs import Row, Run, frame, remote, run
from tests.analyzer.test_nmt_findings import NODE, boot, one, others, written
from tests.analyzer.test_nmt_fold import heartbeats, ordered
from tests.analyzer.traps.script import Script

PHASES = (0.001, 0.05, 0.2, 0.3, 0.33, 0.4, 0.43, 0.45, 0.48, 0.6, 0.75, 0.99)


def beating(
    start_ms: float, end_ms: float, every_ms: float, jitter_ms: float = 0.5, seed: int = 1
) -> list[Row]:
    """Heartbeats of node 5, each a little late."""
    late = random.Random(seed)
    number = math.ceil((end_ms - start_ms) / every_ms)
    times = (start_ms + n * every_ms + late.uniform(0, jitter_ms) for n in range(number))
    return [frame(t, 0x705, "05") for t in times]


# -- two devices of one period ---------------------------------------------------------------------


@pytest.mark.triggers("nmt.duplicate_node_id")
@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("every_ms", [100, 1000])
def test_two_devices_that_start_together_are_found_at_any_phase(
    phase: float, every_ms: int
) -> None:
    end_ms = 60 * every_ms
    first = beating(1500, end_ms, every_ms)
    second = beating(1500 + phase * every_ms, end_ms, every_ms, seed=2)
    rows = ordered([boot(500), boot(610)], first, second, others(end_ms))
    assert run(*rows).ids() == ["nmt.duplicate_node_id"]


@pytest.mark.near_miss("nmt.duplicate_node_id")
def test_a_pair_of_boot_ups_and_an_even_heartbeat_are_one_device() -> None:
    rows = ordered([boot(500), boot(585)], beating(1500, 60_000, 500), others(60_000))
    assert run(*rows).ids() == []


@pytest.mark.near_miss("nmt.duplicate_node_id")
@pytest.mark.parametrize("every_ms", [1000, 700, 500, 1500])
@pytest.mark.parametrize("at_ms", [1350, 10_350, 10_500])
def test_a_heartbeat_node_that_answers_a_tool_is_one_device(every_ms: int, at_ms: int) -> None:
    """The controller answers remote frames by itself, with the last state that it sent."""
    asked = range(at_ms, 40_000, every_ms)
    polls = [row for t in asked for row in (remote(t + 3, 0x705), frame(t + 4, 0x705, "05"))]
    result = run(*ordered(beating(1000, 60_000, 1000), polls, others(60_000)))
    assert "nmt.duplicate_node_id" not in result.ids()


@pytest.mark.triggers("nmt.duplicate_node_id")
def test_a_third_of_a_second_is_no_task() -> None:
    """Intervals of 330 and 670 ms would be one and two steps of a task, were it not so slow."""
    rows = ordered(beating(200, 60_000, 1000), beating(530, 60_000, 1000, seed=2), others(60_000))
    assert run(*rows).ids() == ["nmt.duplicate_node_id"]


@pytest.mark.near_miss("nmt.duplicate_node_id")
@pytest.mark.near_miss("nmt.node_lost")
@pytest.mark.parametrize("end_ms", [60_000, 60_200])
def test_a_producer_that_alternates_is_neither_two_nor_lost(end_ms: int) -> None:
    rows = ordered(beating(1000, 60_000, 1000), beating(1400, 60_000, 1000), others(end_ms))
    assert run(*rows).ids() == []


@pytest.mark.triggers("nmt.duplicate_node_id")
@pytest.mark.near_miss("nmt.node_lost")
@pytest.mark.parametrize("first_ms", [10_400, 30_400])
def test_a_second_device_that_comes_or_goes_on_the_grid_of_a_task(first_ms: int) -> None:
    second = beating(first_ms, first_ms + 30_000, 1000, seed=2)
    rows = ordered(beating(1000, 60_000, 1000), second, others(60_000))
    assert run(*rows).ids() == ["nmt.duplicate_node_id"]


# -- late, but not lost ----------------------------------------------------------------------------


def uneven(late_ms: float, end_ms: float = 20_000) -> list[Row]:
    """Heartbeats of node 5 every 100 ms, each twentieth one after a longer time."""
    t_ms, rows = 1000.0, list[Row]()
    while t_ms < end_ms:
        rows.append(frame(t_ms, 0x705, "05"))
        t_ms += late_ms if len(rows) % 20 == 0 else 100
    return rows


def busy(end_ms: float) -> list[Row]:
    """A node that is heard all the time."""
    return heartbeats(0, end_ms, node=9, every_ms=20)


def allowed(ms: int) -> list[Row]:
    """Node 9 is told how long node 5 may be silent."""
    value = (5 << 16 | ms).to_bytes(4, "little").hex()
    return [frame(900, 0x609, f"23161001{value}"), frame(901, 0x589, "6016100100000000")]


@pytest.mark.triggers("nmt.consumer_time")
@pytest.mark.near_miss("nmt.node_lost")
@pytest.mark.parametrize(("ms", "late_ms"), [(150, 160), (120, 130)])
def test_a_consumer_time_within_the_spread_of_the_heartbeat_is_the_root(
    ms: int, late_ms: int
) -> None:
    found = run(*ordered(allowed(ms), uneven(late_ms), busy(20_000)))
    assert "nmt.node_lost" not in found.ids()
    assert f"times took up to {late_ms} ms" in one(found, "nmt.consumer_time").text


@pytest.mark.triggers("nmt.heartbeat_irregular")
@pytest.mark.near_miss("nmt.node_lost")
def test_a_heartbeat_that_is_late_again_and_again_is_irregular() -> None:
    assert run(*ordered(uneven(160), busy(20_000))).ids() == ["nmt.heartbeat_irregular"]


@pytest.mark.triggers("nmt.node_lost")
def test_heartbeats_that_are_missing_are_a_loss() -> None:
    assert "nmt.node_lost" in run(*ordered(allowed(150), uneven(260), busy(20_000))).ids()


# -- guarding --------------------------------------------------------------------------------------


def empty_requests(end_ms: float, answers_ms: float) -> list[Row]:
    """Guard requests that the log holds as empty data frames, and their answers up to a moment."""
    rows = []
    for n in range(int(end_ms // 200)):
        rows.append(frame(n * 200, 0x705))
        if n * 200 < answers_ms:
            rows.append(frame(n * 200 + 1, 0x705, "85" if n % 2 else "05"))
    return rows


@pytest.mark.triggers("nmt.node_lost")
def test_the_last_of_many_empty_requests_is_no_sign_of_life() -> None:
    finding = one(run(*ordered(empty_requests(20_000, 10_000), others(20_000))), "nmt.node_lost")
    assert "up to the end" in finding.text
    assert len(finding.evidence) == 1


@pytest.mark.near_miss("nmt.node_lost")
@pytest.mark.near_miss("nmt.guard_toggle")
def test_single_guard_answers_that_were_not_recorded_are_no_loss() -> None:
    """The toggle bit goes on as if they had been sent."""
    rows = [remote(n * 100, 0x705) for n in range(300)]
    answers = [frame(n * 100 + 1, 0x705, "85" if n % 2 else "05") for n in range(300) if n % 50]
    found = run(*ordered(rows, answers, others(30_000)))
    assert found.ids() == ["nmt.guard_unanswered"]
    finding = one(found, "nmt.guard_unanswered")
    assert finding.severity == "info"
    assert "sent 5 of the answers" in finding.text


# -- commands --------------------------------------------------------------------------------------


def starting(at_ms: float, end_ms: float = 20_000) -> list[Row]:
    """Node 5, which is OPERATIONAL from a moment on."""
    return ordered(
        heartbeats(600, at_ms, state="7F"), heartbeats(at_ms, end_ms), [boot(500)], busy(end_ms)
    )


@pytest.mark.near_miss("nmt.command_ignored")
@pytest.mark.parametrize("took_ms", [400, 950])
def test_a_node_that_takes_its_time_to_start_follows(took_ms: int) -> None:
    assert run(*ordered([frame(2000, 0, "0105")], starting(2000 + took_ms))).ids() == []


@pytest.mark.near_miss("nmt.command_ignored")
def test_a_log_that_ends_soon_after_a_command_says_nothing_about_it() -> None:
    beats = heartbeats(600, 2700, state="7F")
    assert run(*ordered([frame(2000, 0, "0105"), boot(500)], beats, busy(2700))).ids() == []


@pytest.mark.triggers("nmt.command_ignored")
def test_a_command_that_was_followed_when_it_was_repeated() -> None:
    commands = [frame(2000, 0, "0105"), frame(4960, 0, "0105")]
    finding = one(run(*ordered(commands, starting(5000))), "nmt.command_ignored")
    assert finding.text.endswith("It followed when the command was repeated at +4.960 s.")
    assert "Does it follow" not in finding.check_next


@pytest.mark.triggers("nmt.command_ignored")
def test_a_command_that_was_followed_late() -> None:
    finding = one(run(*ordered([frame(2000, 0, "0105")], starting(5000))), "nmt.command_ignored")
    assert finding.text.endswith("It followed 3 s after the command, with no other one between.")


@pytest.mark.triggers("nmt.command_ignored")
@pytest.mark.parametrize("serves", [True, False])
def test_a_start_of_all_that_one_node_refuses(serves: bool) -> None:
    """The NMT master refuses its own command as well: a node that serves SDO is none."""
    answer = frame(702, 0x585, "4318100112000000")
    read = [frame(700, 0x605, "4018100100000000"), *([answer] if serves else [])]
    other = [boot(510, 6), *heartbeats(650, 2000, node=6, state="7F")]
    other += heartbeats(2050, 40_000, node=6)
    rows = ordered(read, [frame(2000, 0, "0100")], starting(40_000, 40_000), other)
    assert ("nmt.command_ignored" in run(*rows).ids()) == serves


def not_reset(*more: Row, every_ms: int = 500, at_ms: float = 10_000, end_ms: int = 30_000) -> Run:
    """Node 5 is told to reset; its heartbeats go on."""
    beats = [frame(t, 0x705, "05") for t in range(every_ms // 5, end_ms, every_ms)]
    return run(*ordered(beats, [frame(at_ms, 0x000, "8105"), *more], busy(end_ms)))


def bound_pdos(end_ms: int = 30_000) -> list[Row]:
    bind = [frame(1, 0x605, "4000180100000000"), frame(2, 0x585, "4300180185010000")]
    return [*bind, *(frame(t + 0.5, 0x185, "01") for t in range(10, end_ms, 10))]


@pytest.mark.triggers("nmt.command_ignored")
@pytest.mark.near_miss("nmt.pdo_outside_operational")
@pytest.mark.parametrize(
    "more",
    [[], bound_pdos(), [frame(5_000, 0x000, "0105")]],
    ids=["heartbeats", "and PDOs", "started before"],
)
def test_a_reset_that_a_node_does_not_follow(more: list[Row]) -> None:
    result = not_reset(*more)
    assert result.ids() == ["nmt.command_ignored"]
    finding = one(result, "nmt.command_ignored")
    assert '"reset node" at +10.000 s' in finding.text
    assert "100 ms later it still says OPERATIONAL" in finding.text
    assert finding.text.endswith("No boot-up came.")
    assert ("PDOs (185h)" in finding.text) == (len(more) > 1)
    assert [state for state, _, _ in result.states(NODE)][-1:] == ["OPERATIONAL"]
    assert "INITIALISING" not in [state for state, _, _ in result.states(NODE)]


@pytest.mark.triggers("nmt.command_ignored")
@pytest.mark.parametrize(
    ("then", "told"),
    [
        (
            beating(40_100, 80_000, 500, 0),
            "It was commanded 1 more time and did not follow then either.",
        ),
        (
            [boot(40_400), *heartbeats(41_000, 80_000, state="7F", every_ms=500)],
            "when the command was repeated at",
        ),
        ([], "No boot-up came."),
    ],
    ids=["not again", "boots", "dies"],
)
def test_what_became_of_the_reset_that_was_repeated(then: list[Row], told: str) -> None:
    resets = [frame(t, 0x000, "8105") for t in (10_000, 40_000)]
    rows = ordered(beating(100, 40_000, 500, 0), resets, then, busy(80_000))
    first = next(f for f in run(*rows).findings() if f.id == "nmt.command_ignored")
    assert told in first.text
    assert ("either" in first.text) == ("either" in told)


@pytest.mark.triggers("nmt.command_ignored")
@pytest.mark.near_miss("nmt.pdo_outside_operational")
def test_pdos_show_it_where_the_heartbeat_comes_a_period_after_the_reset() -> None:
    """Right after a heartbeat: the next one would come as late from a node that starts at once."""
    late = 10_103
    assert not_reset(*bound_pdos(), at_ms=late).ids() == ["nmt.command_ignored"]
    assert "nmt.command_ignored" not in not_reset(at_ms=late).ids()


@pytest.mark.near_miss("nmt.command_ignored")
@pytest.mark.parametrize(
    "more",
    [
        [boot(10_050)],
        [boot(15_000)],
        [frame(10_090, 0x000, "0105")],
        [frame(10_050, 0x085, "")],
        [frame(10_050, 0x085, "0000000000000000")],
    ],
    ids=["boots", "boots late", "started after it", "empty EMCY", "EMCY without an error"],
)
def test_a_reset_that_something_may_have_followed_is_not_held_against_a_node(
    more: list[Row],
) -> None:
    assert "nmt.command_ignored" not in not_reset(*more).ids()


@pytest.mark.near_miss("nmt.command_ignored")
def test_a_node_that_starts_itself_and_whose_boot_up_was_lost_beats_anew() -> None:
    before, after = heartbeats(100, 10_000, every_ms=500), heartbeats(10_560, 30_000, every_ms=500)
    rows = ordered(before, after, [frame(10_000, 0x000, "8105")], busy(30_000))
    assert "nmt.command_ignored" not in run(*rows).ids()


@pytest.mark.near_miss("nmt.command_ignored")
@pytest.mark.parametrize(
    ("reset_ms", "first_ms", "told"),
    [(9_900, 10_060, 0), (9_900, 10_105, 1), (9_900, 10_180, 0), (9_580, 10_130, 0)],
)
def test_a_restart_that_nothing_tells_but_heartbeats_out_of_step(
    reset_ms: int, first_ms: int, told: int
) -> None:
    before = heartbeats(100, 10_000, every_ms=500)
    after = heartbeats(first_ms, 30_000, every_ms=500)
    rows = ordered(before, after, [frame(reset_ms, 0x000, "8105")], busy(30_000))
    assert run(*rows).ids().count("nmt.command_ignored") == told


@pytest.mark.near_miss("nmt.command_ignored")
@pytest.mark.triggers("nmt.command_ignored")
@pytest.mark.parametrize(("booted", "state"), [(True, "05"), (True, "7F"), (False, "05")])
def test_a_slow_heartbeat_after_a_reset_tells_of_a_node_that_is_known_to_boot(
    booted: bool, state: str
) -> None:
    before = heartbeats(400, 40_000, every_ms=3000, state=state)
    after = heartbeats(43_000, 80_000, every_ms=3000, state=state)
    first = [boot(200)] if booted else []
    rows = ordered(first, before, after, [frame(40_700, 0x000, "8105")], busy(80_000))
    told = booted and state == "05"
    assert ("nmt.command_ignored" in run(*rows).ids()) == told


@pytest.mark.near_miss("nmt.command_ignored")
def test_a_log_that_ends_soon_after_a_reset_says_nothing_about_it() -> None:
    assert "nmt.command_ignored" not in not_reset(end_ms=15_000).ids()


# -- 1017h without effect --------------------------------------------------------------------------


@pytest.mark.triggers("nmt.heartbeat_fast")
@pytest.mark.triggers("nmt.heartbeat_slow")
@pytest.mark.parametrize(("ms", "rule"), [(500, "fast"), (30, "slow")])
def test_a_write_of_1017h_without_effect(ms: int, rule: str) -> None:
    rows = ordered(heartbeats(0, 30_000), written(5003, 0x1017, ms), busy(30_000))
    finding = one(run(*rows), f"nmt.heartbeat_{rule}")
    assert f"every 100 ms although 1017h is {ms} ms" in finding.text


@pytest.mark.near_miss("nmt.heartbeat_fast")
@pytest.mark.near_miss("nmt.heartbeat_slow")
@pytest.mark.parametrize("ms", [500, 30])
def test_a_write_of_1017h_that_a_reset_makes_good(ms: int) -> None:
    """Some devices heed it only when they start: it is saved, and the node reset."""
    save = [frame(5100, 0x605, "2310100173617665"), frame(5110, 0x585, "6010100100000000")]
    reset = [frame(9000, 0, "8105"), boot(9500)]
    late = heartbeats(9600, 30_000, every_ms=ms)
    rows = ordered(heartbeats(0, 9000), written(5003, 0x1017, ms), save, reset, late, busy(30_000))
    assert run(*rows).ids() == []


# -- PDOs whose identifier alone says whose they are -----------------------------------------------


def halted(pdos_from_ms: float) -> Run:
    """Node 5 is started at 2 s and sent back to PRE-OPERATIONAL at 10 s, 185h goes on."""
    beats = [*heartbeats(600, 2000, state="7F"), *heartbeats(2050, 10_000)]
    beats += heartbeats(10_050, 30_000, state="7F")
    pdos = [frame(pdos_from_ms + 20 * n, 0x185, "01") for n in range(1200)]
    commands = [boot(500), frame(2000, 0, "0105"), frame(10_000, 0, "8005")]
    return run(*ordered(commands, beats, pdos, busy(30_000)))


@pytest.mark.triggers("nmt.pdo_outside_operational")
def test_pdos_go_on_on_the_predefined_identifier_of_a_node() -> None:
    finding = one(halted(2300), "nmt.pdo_outside_operational")
    assert finding.assumed == ["185h is its TPDO1, as predefined"]


@pytest.mark.near_miss("nmt.pdo_outside_operational")
def test_pdos_that_were_there_before_the_node_was_started_may_be_anothers() -> None:
    assert "nmt.pdo_outside_operational" not in halted(700).ids()


# -- two devices without a heartbeat ---------------------------------------------------------------


def timer(start_ms: float, every_ms: float = 100, end_ms: float = 20_000) -> list[Row]:
    """A cyclic PDO of node 5."""
    number = round((end_ms - start_ms) / every_ms)
    return [frame(start_ms + n * every_ms, 0x185, "01") for n in range(number)]


@pytest.mark.triggers("nmt.duplicate_node_id")
@pytest.mark.parametrize("batch", [100, 1 << 20])
def test_two_boot_ups_and_a_pdo_in_two_cadences(batch: int) -> None:
    rows = ordered([boot(500), boot(530)], timer(2100), timer(2137), busy(20_000))
    finding = one(run(*rows, batch=batch), "nmt.duplicate_node_id")
    assert finding.severity == "warning"


@pytest.mark.near_miss("nmt.duplicate_node_id")
@pytest.mark.parametrize(
    ("boots", "second_ms"), [((500,), 2137), ((500, 545), 2100.02), ((500, 500.02), 2137)]
)
def test_one_of_the_two_signs_alone(boots: tuple[float, ...], second_ms: float) -> None:
    """One boot-up, a PDO that was recorded twice, or a boot-up that was."""
    rows = ordered([boot(t) for t in boots], timer(2100), timer(second_ms), busy(20_000))
    assert "nmt.duplicate_node_id" not in run(*rows).ids()


@pytest.mark.near_miss("nmt.duplicate_node_id")
def test_a_pair_of_boot_ups_and_a_timer_on_the_grid_of_a_task() -> None:
    """15 ms of a task of 10 ms is 10 and 20 ms."""
    rows = ordered([boot(500), boot(545)], timer(2100, 30), timer(2110, 30), busy(20_000))
    assert "nmt.duplicate_node_id" not in run(*rows).ids()


# -- bus-off ---------------------------------------------------------------------------------------


def test_a_bus_off_explains_only_the_silence_before_it() -> None:
    """A loose cable at 3 s, and a bus-off at 6 s that the node tells when it is back."""
    beats = [*beating(0, 3000, 100), *beating(4000, 6000, 100), *beating(7000, 9000, 100)]
    told = [frame(7001, 0x085, "4081110000000000"), frame(7101, 0x085, "0000000000000000")]
    result = run(*ordered(beats, told, others(9000)))
    assert sorted(result.ids()) == ["error.bus_off", "nmt.node_lost"]
    lost = one(result, "nmt.node_lost")
    assert "for 1.1" in lost.text
    assert one(result, "error.bus_off").start_ns > lost.end_ns


def test_a_silence_is_held_against_the_period_of_its_time() -> None:
    """The second device, with a slower heartbeat, comes long after the first one was away."""
    first = [*beating(0, 5000, 100), *beating(5270, 60_000, 100)]
    second = beating(20_030, 60_000, 230, seed=2)
    result = run(*ordered(first, second, others(60_000)))
    assert sorted(result.ids()) == ["nmt.duplicate_node_id", "nmt.node_lost"]


# -- devices that watch no heartbeat ---------------------------------------------------------------


def complaint(device: str | None) -> Script:
    """EMCY 8130h of an encoder for which nothing stands in the capture that it may have missed."""
    script = Script(device, 5).nmt(-1_000, 1).heartbeat(0, 20_000, period=500)
    return script.emcy(10_000, 0x8130, 0x20).emcy(11_000, 0, 0)


@pytest.mark.triggers("nmt.guarding_lost")
@pytest.mark.parametrize("device", ["lir-da158", "lir-da158a", "jn2100"])
def test_a_device_that_only_guarding_watches_sends_nobody_to_a_heartbeat(device: str) -> None:
    """Their sheets: 1016h has no effect, or is not there."""
    finding = complaint(device).told().finding("nmt.guarding_lost")
    assert finding.cause.startswith("The master stopped guarding node 5, or its requests did not")
    assert finding.check_next.endswith("compare its period with 100Ch x 100Dh of node 5.")


@pytest.mark.triggers("nmt.guarding_lost")
def test_a_silent_node_is_no_heartbeat_that_such_a_device_watches() -> None:
    script = complaint("lir-da158a").read(-500, 0x1016, 1, 0x0001_012C)
    script.every(3, 9_900, 100, "701#05").every(4, 20_000, 100, "709#05")
    (finding,) = (f for f in script.told().analysis.findings if "8130h" in f.text)
    assert "1016h" not in f"{finding.text} {finding.cause} {finding.check_next}"
    assert "which watches its heartbeat" not in finding.text


@pytest.mark.near_miss("nmt.guarding_lost")
def test_a_device_that_nobody_knows_may_watch_a_heartbeat() -> None:
    finding = complaint(None).told().finding("nmt.guarding_lost")
    assert "1016h of node 5" in finding.check_next
    assert "its heartbeat did not reach node 5" in finding.cause


# -- a node that is alone --------------------------------------------------------------------------


@pytest.mark.triggers("nmt.node_lost")
@pytest.mark.parametrize(
    ("other", "told"),
    [
        ("", "no other node is known here"),
        ("709#05", "the other nodes were heard all the time"),
        ("189#0102", "the other nodes were heard all the time"),
        ("589#4300100000000000", "nothing tells for sure whether the bus itself worked"),
        ("gone", "nothing tells for sure whether the bus itself worked"),
    ],
)
def test_other_nodes_speak_for_the_bus_only_where_they_are_heard(other: str, told: str) -> None:
    """Guard requests go on; the only other frames of the bus are those of the master."""
    script = Script("lir-da158a", 5).nmt(-10, 1)
    script.write(-50, 0x100C, 0, 500, size=2).write(-40, 0x100D, 0, 3, size=1)
    script.every(0, 30_000, 500, "705#R").every(
        1, 15_000, 500, lambda k: "705#85" if k % 2 else "705#05"
    )
    if other.startswith("589"):
        script.every(6, 30_000, 500, "609#4000100000000000")
    if other == "gone":
        script.every(7, 10_000, 500, "709#05")
    elif other:
        script.every(7, 30_000, 500, other)
    (finding,) = (each for each in script.told().findings("nmt.node_lost") if each.node == 5)
    assert told in finding.cause
