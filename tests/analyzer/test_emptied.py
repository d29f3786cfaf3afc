"""Heartbeats that a remote frame has emptied: which byte 00h is a boot-up, and which is none."""

import pytest

from syncline_schemas.batch import Gap
from syncline_schemas.devices import load_device
from tests.analyzer.control_runs import MS, Row, frame, remote, run
from tests.analyzer.test_nmt_findings import NODE, boot, one, others, written
from tests.analyzer.test_nmt_fold import heartbeats, ordered

LIR = {NODE: load_device("lir-da158a")}


def bare(begin_ms: float, end_ms: float) -> list[Row]:
    """Heartbeats without any byte."""
    return [frame(begin_ms + 100 * n, 0x705) for n in range(round((end_ms - begin_ms) / 100))]


def pdos(begin_ms: float, end_ms: float) -> list[Row]:
    """A PDO of node 5, which was told to be its own, 5 ms before each heartbeat."""
    count = round((end_ms - begin_ms) / 100)
    return [frame(begin_ms + 95 + 100 * n, 0x185, "01") for n in range(count)]


# -- restarts --------------------------------------------------------------------------------------


@pytest.mark.triggers("nmt.unexpected_reset")
@pytest.mark.parametrize("silent_ms", [50, 800])
@pytest.mark.parametrize("batch", [1, 7, 1 << 20])
def test_the_last_00h_before_states_come_again_is_the_boot_up(silent_ms: int, batch: int) -> None:
    rows = ordered(
        [boot(50)],
        heartbeats(100, 3000),
        [remote(2950, 0x705)],
        heartbeats(3000, 6000, state="00"),
        [boot(5900 + silent_ms)],
        heartbeats(6000 + silent_ms, 9000 + silent_ms, state="7F"),
        others(9000),
    )
    result = run(*rows, batch=batch)
    assert f"+{5.9 + silent_ms / 1000:.3f} s" in one(result, "nmt.unexpected_reset").text
    assert result.nodes[NODE].boot_ups == 2
    assert result.nodes[NODE].heartbeats == 59
    assert result.tables.nmt.nodes[0, NODE].counts.empty == 30


@pytest.mark.triggers("nmt.unexpected_reset")
def test_a_byte_between_heartbeats_without_any_is_a_boot_up() -> None:
    rows = ordered(
        heartbeats(100, 3000),
        [remote(2950, 0x705)],
        bare(3000, 6000),
        [boot(6050)],
        heartbeats(6150, 9000, state="7F"),
        others(9000),
    )
    assert "nmt.unexpected_reset" in run(*rows).ids()
    assert run(*rows).nodes[NODE].boot_ups == 1


@pytest.mark.triggers("nmt.unexpected_reset")
def test_the_first_7fh_after_empty_heartbeats_is_the_boot_up_of_a_lir() -> None:
    rows = ordered(
        heartbeats(100, 3000),
        [remote(2950, 0x705)],
        heartbeats(3000, 6000, state="00"),
        heartbeats(6050, 9000, state="7F"),
        others(9000),
    )
    assert "nmt.unexpected_reset" in run(*rows, devices=LIR).ids()


@pytest.mark.near_miss("nmt.unexpected_reset")
def test_a_restart_that_a_gap_hides_is_not_dated() -> None:
    """States come again after it: the device started anew in the gap, not before it."""
    before = ordered(
        [boot(50)],
        heartbeats(100, 3000),
        [remote(2950, 0x705)],
        heartbeats(3000, 6000, state="00"),
        others(6000),
    )
    gap = Gap(6000 * MS, 7000 * MS, "adapter lost", 0, 0)
    after = ordered(heartbeats(7050, 9000), heartbeats(7000, 9000, node=9))
    assert "nmt.unexpected_reset" not in run(*before, gap, *after).ids()


# -- no restarts -----------------------------------------------------------------------------------


@pytest.mark.near_miss("nmt.unexpected_reset", "nmt.boot_loop")
@pytest.mark.parametrize("every_ms", [100, 500])
@pytest.mark.parametrize("batch", [1, 1 << 20])
def test_the_remote_frame_that_emptied_the_heartbeats_may_lie_in_a_gap(
    every_ms: int, batch: int
) -> None:
    before = ordered(heartbeats(100, 6000, every_ms=every_ms), others(6000))
    gap = Gap(6000 * MS, 8000 * MS, "adapter lost", 0, 0)
    zeros = heartbeats(8030, 16_030, every_ms=every_ms, state="00")
    after = ordered(zeros, heartbeats(8000, 16_000, node=9))
    result = run(*before, gap, *after, batch=batch)
    assert [i for i in result.ids() if i.startswith("nmt.")] == []
    assert result.nodes[NODE].boot_ups == 0


@pytest.mark.near_miss("nmt.unexpected_reset", "nmt.boot_loop")
def test_a_master_that_sets_the_heartbeat_anew_after_each_00h_resets_nothing() -> None:
    """It takes each of them for a boot-up: they come a period after its write of 1017h."""
    before = ordered(heartbeats(100, 6000, every_ms=200), others(6000))
    gap = Gap(6000 * MS, 8000 * MS, "adapter lost", 0, 0)
    zeros = heartbeats(8030, 16_030, every_ms=231, state="00")
    writes = [row for zero in zeros for row in written(zero[0] / MS + 30, 0x1017, 200)]
    after = ordered(zeros, writes, heartbeats(8000, 16_000, node=9))
    assert [i for i in run(*before, gap, *after).ids() if i.startswith("nmt.")] == []


@pytest.mark.near_miss("nmt.boot_loop")
def test_nobody_boots_5_ms_after_a_pdo() -> None:
    """A recorder that holds no remote frames: only the PDOs show that the node goes on."""
    bound = written(20, 0x1800, 0x185, size=4, sub=1)
    rows = ordered(
        bound,
        heartbeats(100, 3000),
        heartbeats(3000, 9000, state="00"),
        pdos(100, 9000),
        others(9000),
    )
    result = run(*rows)
    assert [i for i in result.ids() if i.startswith("nmt.")] == []
    assert result.nodes[NODE].boot_ups == 0


@pytest.mark.triggers("nmt.boot_loop")
def test_a_boot_loop_after_a_gap_does_not_keep_the_period_of_the_heartbeat() -> None:
    before = ordered(heartbeats(100, 6000), others(6000))
    gap = Gap(6000 * MS, 8000 * MS, "adapter lost", 0, 0)
    zeros = heartbeats(8030, 16_030, every_ms=900, state="00")
    after = ordered(zeros, heartbeats(8000, 16_000, node=9))
    assert "nmt.boot_loop" in run(*before, gap, *after).ids()


# -- commands --------------------------------------------------------------------------------------


@pytest.mark.triggers("nmt.command_ignored")
@pytest.mark.near_miss("nmt.pdo_outside_operational")
@pytest.mark.parametrize("command", ["8005", "0205"])
def test_pdos_show_that_a_node_without_states_ignores_a_command(command: str) -> None:
    bound = written(20, 0x1800, 0x185, size=4, sub=1)
    rows = ordered(
        bound,
        heartbeats(100, 3000),
        [remote(2950, 0x705)],
        heartbeats(3000, 9000, state="00"),
        pdos(100, 9000),
        [frame(5010, 0x000, command)],
        others(9000),
    )
    found = run(*rows)
    assert "285 ms later it still sends PDOs (185h)" in one(found, "nmt.command_ignored").text
    assert "nmt.pdo_outside_operational" not in found.ids()


@pytest.mark.near_miss("nmt.command_ignored")
def test_pdos_that_end_within_two_heartbeats_show_nothing() -> None:
    bound = written(20, 0x1800, 0x185, size=4, sub=1)
    rows = ordered(
        bound,
        heartbeats(100, 3000),
        [remote(2950, 0x705)],
        heartbeats(3000, 9000, state="00"),
        pdos(100, 5150),
        [frame(5010, 0x000, "8005")],
        others(9000),
    )
    assert "nmt.command_ignored" not in run(*rows).ids()


def test_empty_heartbeats_before_the_states_of_a_twin_are_no_requests() -> None:
    """The log holds a remote frame: it does not store others as frames without data."""
    rows = ordered(
        heartbeats(0, 3000, every_ms=150),
        [remote(3010, 0x705)],
        [frame(t_ms, 0x705) for t_ms in range(3150, 20_000, 150)],
        heartbeats(5000, 20_000, every_ms=280),
    )
    assert run(*rows).nodes[NODE].guard_requests == 1
