"""Faults of a node that another story on the same node, or a quiet bus, hid."""

import pytest

from syncline_schemas.batch import Gap
from tests.analyzer.control_runs import MS, Row, frame, run
from tests.analyzer.test_nmt_findings import NODE, boot, one, others, shifted, written
from tests.analyzer.test_nmt_fold import guarding, heartbeats, ordered

# -- restarts --------------------------------------------------------------------------------------


@pytest.mark.triggers("nmt.unexpected_reset")
def test_the_silence_after_a_reset_of_all_is_no_step_of_the_clock() -> None:
    """The boot-up that answered it came at once; the next one 10.1 s after the command."""
    reset = [frame(1000, 0x000, "8200"), boot(1250), boot(1255, 9)]
    first = ordered(heartbeats(0, 1000), heartbeats(0, 1000, node=9))
    later = ordered(
        heartbeats(1350, 11_000), [boot(11_100)], heartbeats(11_200, 13_000), others(13_000)
    )
    rows = [*first, *reset, *(row for row in later if row[0] > 1300 * MS)]
    assert "nmt.unexpected_reset" in run(*rows).ids()


# -- guarding --------------------------------------------------------------------------------------


def paused(fall_ms: float) -> list[Row]:
    """The master does not guard for 1 s, node 5 says so, and falls to PRE-OPERATIONAL later."""
    started = [frame(5, 0x000, "0105"), *written(20, 0x100C, 100), *written(30, 0x100D, 2, 1)]
    emcy = [frame(2205, 0x085, "3081110000000000"), frame(3100, 0x085, "0000000000000000")]
    before = guarding(50, 2050)
    after = guarding(3050, fall_ms)
    fallen = guarding(fall_ms, fall_ms + 2000, state=0x7F, toggle=len(after) // 2)
    return ordered(started, before, emcy, after, fallen, others(fall_ms + 2000))


@pytest.mark.triggers("nmt.left_operational")
def test_a_fall_seconds_after_guarding_came_back_has_another_reason() -> None:
    ids = run(*paused(6050)).ids()
    assert {"nmt.guarding_lost", "nmt.left_operational"} <= set(ids)


@pytest.mark.near_miss("nmt.left_operational")
def test_a_fall_that_the_first_guard_answers_tell_is_that_of_lost_guarding() -> None:
    result = run(*paused(3150))
    assert "nmt.left_operational" not in result.ids()
    assert "goes PRE-OPERATIONAL" in one(result, "nmt.guarding_lost").text


@pytest.mark.triggers("nmt.left_operational", "error.bus_off")
@pytest.mark.parametrize(("fall_ms", "later"), [(2300, False), (5000, True)])
def test_a_fall_long_after_a_bus_off_has_another_reason(fall_ms: float, later: bool) -> None:
    told = [frame(2105, 0x085, "4081110000000000"), frame(2205, 0x085, "0000000000000000")]
    beats = [*heartbeats(0, 1000), *heartbeats(2100, fall_ms)]
    fallen = heartbeats(fall_ms, fall_ms + 2000, state="7F")
    result = run(*ordered(beats, told, fallen, others(fall_ms + 2000)))
    assert ("nmt.left_operational" in result.ids()) is later
    assert ("then it was PRE-OPERATIONAL" in one(result, "error.bus_off").text) is not later


# -- two devices -----------------------------------------------------------------------------------


@pytest.mark.triggers("nmt.unknown_state")
@pytest.mark.parametrize("every_ms", [500, 630])
def test_what_a_node_said_before_its_number_was_taken_twice_is_told(every_ms: int) -> None:
    """The even heartbeats between show that nobody else was there then."""
    odd = heartbeats(9000, 10_000, every_ms=500, state="33")
    first = [*heartbeats(0, 9000, every_ms=500), *heartbeats(10_000, 45_000, every_ms=500)]
    second = [boot(12_680), *heartbeats(12_680 + every_ms, 45_000, every_ms=every_ms)]
    rows = ordered(first, odd, second, others(45_000))
    assert {"nmt.duplicate_node_id", "nmt.unknown_state"} <= set(run(*rows).ids())


@pytest.mark.near_miss("nmt.unknown_state")
def test_what_a_number_says_that_two_devices_carry_is_not_told() -> None:
    first = heartbeats(0, 45_000, every_ms=500)
    second = [*heartbeats(10_130, 11_400, every_ms=630), *heartbeats(12_650, 45_000, every_ms=630)]
    odd = [frame(11_390, 0x705, "33"), frame(12_020, 0x705, "33")]
    ids = run(*ordered(first, second, odd, others(45_000))).ids()
    assert "nmt.duplicate_node_id" in ids
    assert "nmt.unknown_state" not in ids


@pytest.mark.near_miss("nmt.left_operational")
def test_a_second_device_that_came_before_a_gap_did_not_change_the_state_of_the_first() -> None:
    """The even heartbeats end before it; what it said before the gap is no fall of the first."""
    first = heartbeats(0, 24_000, every_ms=250)
    second = [
        boot(8360),
        *heartbeats(8743.2, 9000, every_ms=380, state="7F"),
        *heartbeats(9123.2, 24_000, every_ms=380),
    ]
    gap = Gap(10_740 * MS, 13_660 * MS, "adapter lost", 0, 0)
    rows = ordered(first, second, others(24_000))
    before = [row for row in rows if row[0] < gap.start_ns]
    after = [row for row in rows if row[0] >= gap.end_ns]
    ids = run(*before, gap, *after).ids()
    assert "nmt.duplicate_node_id" in ids
    assert "nmt.left_operational" not in ids


def in_step(begin_ms: float, end_ms: float, node: int = NODE) -> list[Row]:
    """A second device whose heartbeats come 0.2 ms after those of the first."""
    return heartbeats(begin_ms + 0.2, end_ms, every_ms=500, node=node)


@pytest.mark.triggers("nmt.duplicate_node_id")
@pytest.mark.near_miss("nmt.unexpected_reset")
@pytest.mark.parametrize("batch", [1, 9, 1 << 20])
def test_a_second_device_in_step_with_the_first(batch: int) -> None:
    first = heartbeats(0, 17_000, every_ms=500)
    rows = ordered(first, [boot(13_250)], in_step(13_500, 17_000), others(17_000))
    result = run(*rows, batch=batch)
    assert result.ids() == ["nmt.duplicate_node_id"]
    finding = one(result, "nmt.duplicate_node_id")
    assert (finding.severity, finding.end_ns) == ("warning", round(16_500.2 * MS))


@pytest.mark.near_miss("nmt.duplicate_node_id")
def test_the_recorder_that_takes_everything_twice_is_no_second_device() -> None:
    first = heartbeats(0, 17_000, every_ms=500)
    both = ordered(first, [boot(13_250)], in_step(13_500, 17_000))
    other = [*heartbeats(30, 17_000, every_ms=500, node=9), *in_step(13_530, 17_000, node=9)]
    assert "nmt.duplicate_node_id" not in run(*ordered(both, other)).ids()


@pytest.mark.near_miss("nmt.duplicate_node_id")
@pytest.mark.parametrize("boots", [[], [frame(13_240, 0x000, "8105"), boot(13_250)]])
def test_a_few_pairs_without_an_unasked_boot_up_prove_no_second_device(boots: list[Row]) -> None:
    first = heartbeats(0, 17_000, every_ms=500)
    rows = ordered(first, boots, in_step(13_500, 17_000), others(17_000))
    assert "nmt.duplicate_node_id" not in run(*rows).ids()


# -- a quiet bus -----------------------------------------------------------------------------------


def quiet(loose_ms: float, master_ms: float = 500) -> list[Row]:
    """Node 5 and a master that is heard once while two heartbeats of node 5 are missing."""
    before = heartbeats(0, 3200)
    after = heartbeats(3100 + loose_ms, 10_000)
    master = heartbeats(10, 10_000, every_ms=master_ms, node=1)
    pdos = [frame(row[0] / MS + 2, 0x185, "01") for row in [*before, *after]]
    return ordered(written(20, 0x1800, 0x185, size=4, sub=1), before, pdos, after, master)


@pytest.mark.triggers("nmt.node_lost")
@pytest.mark.near_miss("nmt.bus_silent")
def test_a_silence_in_which_nobody_else_was_due_is_that_of_the_node() -> None:
    assert run(*quiet(300)).ids() == ["nmt.node_lost"]


@pytest.mark.near_miss("nmt.node_lost")
@pytest.mark.parametrize("by_ms", [130, 200, 700])
def test_a_step_of_the_clock_on_a_quiet_bus_loses_nobody(by_ms: float) -> None:
    rows = shifted(quiet(100), by_ms, after_ms=3150)
    assert "nmt.node_lost" not in run(*rows).ids()


@pytest.mark.near_miss("nmt.node_lost")
def test_a_recorder_that_was_deaf_for_others_too_loses_nobody() -> None:
    """The SYNCs of somebody else are missing as well."""
    sync = [frame(20 * n, 0x080) for n in range(500) if not 3190 < 20 * n < 3405]
    assert "nmt.node_lost" not in run(*ordered(quiet(300), sync)).ids()
