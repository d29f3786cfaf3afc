"""EMCY transitions after CiA 301 7.2.7.2 and the devices' own tables."""

import pytest

from syncline_analyzer.folds.emcy.fold import MAX_EMPTY
from syncline_analyzer.results import EmcyRow
from syncline_schemas.devices import load_device
from tests.analyzer.control_runs import MS, Row, Run, frame, run

ALIVE = frame(0, 0x705, "05")


def lir(*messages: str) -> Run:
    """A LIR-DA158A on node 5 sends EMCYs 100 ms apart, from 100 ms on."""
    rows = [frame(100 * (n + 1), 0x085, data) for n, data in enumerate(messages)]
    return run(ALIVE, *rows, devices={5: load_device("lir-da158a")})


def transitions(result: Run) -> list[str]:
    return [row.transition for row in result.analysis.emcy]


def first(result: Run) -> EmcyRow:
    return result.analysis.emcy[0]


def test_raised_and_all_cleared() -> None:
    result = lir("2073010100000000", "0000000000000000")
    assert transitions(result) == ["raised", "all cleared"]
    (error,) = result.analysis.errors
    assert (error.code, error.status, error.count) == (0x7320, "cleared", 1)
    assert (error.raised_ns, error.cleared_ns) == (100 * MS, 200 * MS)
    assert first(result).meaning == "position error"
    assert first(result).registers == ["general"]
    assert first(result).details["alarms"] == 1


def test_a_clear_with_bits_left_tells_which_errors_stay() -> None:
    """LA20: 0000h with register 80h: the EEPROM error is still there."""
    result = lir("2073010100000000", "3055810100000000", "0000800000000000")
    assert transitions(result) == ["raised", "further", "partly cleared"]
    by_code = {error.code: error.status for error in result.analysis.errors}
    assert by_code == {0x7320: "cleared", 0x5530: "still active"}


def test_a_boot_up_loses_errors_without_clearing_them() -> None:
    result = run(ALIVE, frame(100, 0x085, "2073010100000000"), frame(200, 0x705, "00"))
    assert transitions(result) == ["raised", "reset"]
    (error,) = result.analysis.errors
    assert (error.status, error.cleared_ns) == ("lost at reset", None)
    assert result.nodes[5].emcy == 1


@pytest.mark.parametrize("length", range(8))
def test_short_messages_are_malformed_and_raise_nothing(length: int) -> None:
    result = run(ALIVE, frame(100, 0x085, "3081110000000000"[: 2 * length]))
    assert transitions(result) == ["malformed"]
    assert (result.analysis.errors, result.nodes[5].emcy) == ([], 0)


def test_repeats_are_counted_on_one_error() -> None:
    result = run(ALIVE, *[frame(100 * n, 0x085, "2082110000000000") for n in range(1, 4)])
    assert transitions(result) == ["raised", "further", "further"]
    assert [(e.code, e.count) for e in result.analysis.errors] == [(0x8220, 3)]


def test_unspecific_codes_are_told_apart_by_the_maker_s_bytes() -> None:
    """Sevcon: 1000h stands for many faults; the clear names the one it clears."""
    result = run(
        ALIVE,
        frame(100, 0x085, "0010018448000000"),
        frame(200, 0x085, "001001C445000000"),
        frame(300, 0x085, "0000008448000000"),
        frame(400, 0x085, "000000C445000000"),
    )
    assert [(e.raised_ns // MS, (e.cleared_ns or 0) // MS) for e in result.analysis.errors] == [
        (100, 300),
        (200, 400),
    ]


def test_a_moved_emcy_belongs_to_its_node() -> None:
    """1014h = 90h on node 5: the message on 090h is not node 16's."""
    move = [frame(1, 0x605, "2314100090000000"), frame(2, 0x585, "6014100000000000")]
    result = run(ALIVE, *move, frame(100, 0x090, "1043010000000000"), batch=3)
    assert [(row.node, row.code) for row in result.analysis.emcy] == [(5, 0x4310)]
    assert list(result.nodes) == [5]


def test_an_error_from_before_the_capture_is_told() -> None:
    result = lir("0000800000000000")
    assert transitions(result) == ["partly cleared"]
    assert result.ids() == ["emcy.active_before"]


def test_storm_and_its_near_miss() -> None:
    def storm(every_ms: int) -> Run:
        codes = ("2073010100000000", "0000000000000000")
        rows = [frame(100 + n * every_ms, 0x085, codes[n % 2]) for n in range(30)]
        return run(ALIVE, *rows, devices={5: load_device("lir-da158a")})

    assert "emcy.storm" in storm(20).ids()
    assert len(storm(20).tables.emcy.storms) == 1
    assert storm(20).tables.emcy.storms[0].number == 30
    assert "emcy.storm" not in storm(101).ids()


def test_inhibit_time_counts_only_when_it_is_known() -> None:
    write = [frame(1, 0x605, "2B151000F4010000"), frame(2, 0x585, "6015100000000000")]
    pair = [frame(100, 0x085, "2082110000000000"), frame(120, 0x085, "2082110000000000")]
    assert "emcy.inhibit_time" in run(ALIVE, *write, *pair).ids()
    assert "emcy.inhibit_time" not in run(ALIVE, *pair).ids()
    wide = [pair[0], frame(160, 0x085, "2082110000000000")]
    assert "emcy.inhibit_time" not in run(ALIVE, *write, *wide).ids()


def sync_at_090(count: int, begin_ms: int = 100) -> list[Row]:
    return [frame(begin_ms + 10 * n, 0x090) for n in range(count)]


MOVE_SYNC = [frame(10, 0x605, "2305100090000000"), frame(11, 0x585, "6005100000000000")]


@pytest.mark.parametrize("batch", [7, 1 << 20])
def test_a_sync_moved_by_1005h_is_no_emcy_of_the_number_it_lies_on(batch: int) -> None:
    """CiA 301 7.5.2.5: any node on the bus tells where the SYNC is."""
    result = run(ALIVE, frame(5, 0x090), *MOVE_SYNC, *sync_at_090(300), batch=batch)
    assert [row.seq for row in result.analysis.emcy] == [1]
    assert list(result.nodes) == [5]


def test_an_emcy_of_the_node_whose_identifier_the_sync_took_is_still_told() -> None:
    both = [*sync_at_090(50), frame(700, 0x090, "2082110000000000"), frame(800, 0x710, "05")]
    result = run(ALIVE, *MOVE_SYNC, *both)
    assert [row.code for row in result.analysis.emcy] == [0x8220]


def test_empty_frames_in_a_rhythm_of_a_number_without_life_are_no_emcys() -> None:
    result = run(ALIVE, *sync_at_090(300))
    assert (result.analysis.emcy, list(result.nodes), result.ids()) == ([], [5], [])
    alive = run(ALIVE, frame(1, 0x710, "05"), *sync_at_090(20))
    assert transitions(alive) == ["malformed"] * 20


def test_many_empty_frames_leave_room_for_real_emcys() -> None:
    late = frame(20_000, 0x085, "2082110000000000")
    result = run(ALIVE, frame(1, 0x710, "05"), *sync_at_090(MAX_EMPTY + 500), late, batch=400)
    assert len(result.analysis.emcy) == MAX_EMPTY + 1
    assert result.tables.emcy.dropped == 500


def test_a_pdo_bound_to_an_emcy_identifier_is_no_emcy() -> None:
    bind = [frame(10, 0x605, "2300180191000000"), frame(11, 0x585, "6000180100000000")]
    pdos = [frame(20 + 10 * n, 0x091, "0102030405060708") for n in range(30)]
    result = run(ALIVE, *bind, *pdos)
    assert (result.analysis.emcy, list(result.nodes)) == ([], [5])
