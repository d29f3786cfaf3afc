"""Rules on SYNC producers and PDOs, from the frames to the finding."""

import pytest

from syncline_schemas.batch import Gap
from tests.analyzer.control_runs import MS, Row, S
from tests.analyzer.whole_run import T0, beats, every, found, ids, severe, whole, write

NODE = 5
TPDO, COUNTING = 0x185, b"\1\2"


def quiet(stop_ms: float = 30_000) -> list[Row]:
    """SYNC and the heartbeat of the node, which is OPERATIONAL."""
    return [*every(0x80, 1, stop_ms, 20), *beats(NODE, 7, stop_ms), *beats(9, 12, stop_ms)]


def setting(index: int, sub: int, value: int, size: int, t_ms: float = 0.1) -> list[Row]:
    return write(t_ms, NODE, index, sub, value, size)


def synchronous(t_ms: float = 0.1) -> list[Row]:
    """TPDO1 answers every SYNC."""
    return [*setting(0x1800, 1, TPDO, 4, t_ms), *setting(0x1800, 2, 1, 1, t_ms + 2)]


def cyclic(timer_ms: int) -> list[Row]:
    """TPDO1 is sent by its event timer."""
    rows = [*setting(0x1800, 1, TPDO, 4), *setting(0x1800, 2, 0xFE, 1, 2.1)]
    return [*rows, *setting(0x1800, 5, timer_ms, 2, 4.1)]


def between(rows: list[Row], start_ms: float, stop_ms: float) -> list[Row]:
    """The rows without those of a stretch."""
    return [row for row in rows if not start_ms * MS <= row[0] < stop_ms * MS]


@pytest.mark.triggers("pdo.stopped")
@pytest.mark.parametrize("batch", [200, 100_000])
def test_a_synchronous_pdo_stops_for_good_though_the_heartbeat_goes_on(batch: int) -> None:
    """peers.md 4.1 item 5: "TPDO stops while heartbeat is fine" is "no problems found" elsewhere."""
    told = whole(synchronous(), quiet(), every(TPDO, 2, 12_000, 20, COUNTING), batch=batch)
    (finding,) = told.findings
    assert (finding.id, finding.severity, finding.node) == ("pdo.stopped", "error", NODE)
    assert finding.start_ns == T0 + 11_982 * MS
    assert "it did not come again" in finding.text
    assert "though it stayed OPERATIONAL" in finding.text


@pytest.mark.triggers("pdo.stopped")
@pytest.mark.parametrize("told_by", ["event timer", "rhythm"])
def test_a_cyclic_pdo_stops_and_comes_again(told_by: str) -> None:
    rows = between(every(TPDO, 3, 30_000, 50, COUNTING), 10_000, 18_000)
    setup = cyclic(50) if told_by == "event timer" else setting(0x1800, 1, TPDO, 4)
    (finding,) = whole(setup, quiet(), rows).findings
    assert (finding.id, finding.severity) == ("pdo.stopped", "warning")
    assert finding.end_ns - finding.start_ns == pytest.approx(8 * S, rel=0.02)
    assert len(finding.evidence) == 2


@pytest.mark.near_miss("pdo.stopped")
def test_a_value_that_moved_and_stands_still_sends_no_event() -> None:
    """Change of state, at its inhibit time while the shaft turns: no rhythm that could be missed."""
    rows = [
        (round((3 + 50 * k) * MS), 0, TPDO, 0, 2, (k % 60_000).to_bytes(2, "little"))
        for k in range(200)
    ]
    assert ids(whole(setting(0x1800, 1, TPDO, 4), quiet(), rows)) == set()


@pytest.mark.near_miss("pdo.stopped", "pdo.missed")
def test_a_pdo_that_is_switched_off_is_not_missed() -> None:
    off = setting(0x1800, 1, 0x8000_0000 | TPDO, 4, 12_000)
    told = whole(synchronous(), quiet(), every(TPDO, 2, 12_000, 20, COUNTING), off)
    assert severe(told) == []


@pytest.mark.near_miss("pdo.stopped")
@pytest.mark.parametrize(("index", "sub", "value", "size"), [(0x1800, 2, 0, 1), (0x2049, 0, 3, 1)])
def test_a_pdo_that_a_setting_stopped_is_not_missed(
    index: int, sub: int, value: int, size: int
) -> None:
    written = setting(index, sub, value, size, 12_000)
    told = whole(synchronous(), quiet(), every(TPDO, 2, 12_000, 20, COUNTING), written)
    assert [i for i in ids(told) if i.startswith("pdo.")] == []


@pytest.mark.triggers("pdo.missed")
@pytest.mark.parametrize(("index", "before_ms"), [(0x1017, 100), (0x6003, 1500)])
def test_a_setting_that_did_not_stop_a_pdo_hides_nothing(index: int, before_ms: int) -> None:
    """Error control has nothing to do with it; after a preset the PDO went on."""
    written = setting(index, 0, 100, 2, 12_000 - before_ms)
    rows = between(every(TPDO, 2, 30_000, 20, COUNTING), 12_000, 14_000)
    told = whole(synchronous(), quiet(), rows, written)
    (finding,) = found(told, "pdo.missed")
    assert "up to 100 in a row" in finding.text


@pytest.mark.near_miss("pdo.stopped")
def test_in_a_gap_no_pdo_stops() -> None:
    early = [*synchronous(), *quiet(10_000), *every(TPDO, 2, 10_000, 20, COUNTING)]
    late = [
        row for row in [*quiet(), *every(TPDO, 2, 30_000, 20, COUNTING)] if row[0] > 20_000 * MS
    ]
    told = whole(early, Gap(10_000 * MS, 20_000 * MS, "adapter lost", None, 0), late)
    assert ids(told) == {"capture.gap"}


@pytest.mark.near_miss("pdo.stopped")
def test_a_node_that_leaves_operational_may_stop() -> None:
    stopped = [
        (t, bus, can_id, flags, dlc, b"\x7f" if can_id == 0x705 and t > 12_000 * MS else data)
        for t, bus, can_id, flags, dlc, data in quiet()
    ]
    told = whole(synchronous(), stopped, every(TPDO, 2, 12_000, 20, COUNTING))
    assert not {"pdo.stopped", "pdo.missed"} & ids(told)


@pytest.mark.triggers("pdo.extra")
def test_a_pdo_that_comes_twice_in_a_sync_period() -> None:
    again = every(TPDO, 210, 10_000, 200, COUNTING)
    told = whole(synchronous(), quiet(), every(TPDO, 2, 30_000, 20, COUNTING), again)
    (finding,) = told.findings
    assert (finding.id, finding.node) == ("pdo.extra", NODE)
    assert "came a second time before the next SYNC, 49 times" in finding.text
    assert len(finding.evidence) == 20


@pytest.mark.triggers("pdo.extra")
def test_pdos_that_are_missed_another_time_hide_no_extra_ones() -> None:
    rows = between(every(TPDO, 2, 30_000, 20, COUNTING), 20_000, 22_000)
    told = whole(synchronous(), quiet(), rows, every(TPDO, 10_010, 11_000, 200, COUNTING))
    (finding,) = found(told, "pdo.extra")
    assert "5 times" in finding.text
    assert "pdo.missed" in ids(told)


@pytest.mark.near_miss("pdo.extra")
def test_an_answer_that_comes_after_the_next_sync_is_late_not_extra() -> None:
    late = {500, 600, 601, 700, 900}
    rows = [
        (row[0] + (20 * MS if k in late else 0), *row[1:])
        for k, row in enumerate(every(TPDO, 2, 30_000, 20, COUNTING))
    ]
    assert "pdo.extra" not in ids(whole(synchronous(), quiet(), rows))


@pytest.mark.near_miss("pdo.extra")
def test_where_a_sync_was_lost_no_pdo_is_extra() -> None:
    """The recorder missed SYNCs; the PDOs that answered them seem to come twice."""
    rows = quiet()
    lost = [row for row in rows if not (row[2] == 0x80 and row[0] // MS % 2000 == 1)]
    told = whole(synchronous(), lost, every(TPDO, 2, 30_000, 20, COUNTING))
    assert "pdo.extra" not in ids(told)


@pytest.mark.triggers("pdo.inhibit_time")
def test_frames_sooner_than_the_inhibit_time() -> None:
    setup = [
        *setting(0x1800, 1, TPDO, 4),
        *setting(0x1800, 2, 0xFF, 1, 2.1),
        *setting(0x1800, 3, 200, 2, 4.1),
    ]
    rows = [
        row for k in range(30) for row in every(TPDO, 500 + 613 * k, 509 + 613 * k, 8, COUNTING)
    ]
    told = whole(setup, quiet(), rows)
    (finding,) = found(told, "pdo.inhibit_time")
    assert "30 times in less than half of its inhibit time of 20 ms" in finding.text
    assert "8 ms" in finding.text


@pytest.mark.triggers("pdo.inhibit_time")
@pytest.mark.parametrize("after", ["reset", "longer"])
def test_an_inhibit_time_that_holds_no_longer_was_broken_all_the_same(after: str) -> None:
    """A reset throws the written value away, another write replaces it: the frames came before."""
    setup = [*setting(0x1800, 2, 0xFF, 1, 2.1), *setting(0x1800, 3, 200, 2, 4.1)]
    rows = [row for k in range(8) for row in every(TPDO, 500 + 613 * k, 509 + 613 * k, 8, COUNTING)]
    reset = [(10_000 * MS, 0, 0, 0, 2, bytes([0x81, NODE])), (10_300 * MS, 0, 0x705, 0, 1, b"\0")]
    longer = setting(0x1800, 3, 1000, 2, 10_000)
    told = whole(setup, quiet(), rows, reset if after == "reset" else longer)
    (finding,) = found(told, "pdo.inhibit_time")
    assert "8 times in less than half of its inhibit time of 20 ms" in finding.text


@pytest.mark.near_miss("pdo.inhibit_time")
def test_frames_that_arbitration_pulled_together_keep_the_inhibit_time() -> None:
    setup = [
        *setting(0x1800, 1, TPDO, 4),
        *setting(0x1800, 2, 0xFF, 1, 2.1),
        *setting(0x1800, 3, 200, 2, 4.1),
    ]
    rows = [
        row for k in range(30) for row in every(TPDO, 500 + 613 * k, 520 + 613 * k, 17, COUNTING)
    ]
    assert "pdo.inhibit_time" not in ids(whole(setup, quiet(), rows))


@pytest.mark.triggers("pdo.event_timer")
def test_a_period_longer_than_the_event_timer_misses_nothing() -> None:
    told = whole(cyclic(50), quiet(), every(TPDO, 20, 30_000, 80, COUNTING))
    (finding,) = told.findings
    assert finding.id == "pdo.event_timer"
    assert "every 80 ms, its event timer (180xh:5) is 50 ms" in finding.text


@pytest.mark.near_miss("pdo.event_timer")
@pytest.mark.parametrize("period_ms", [30, 50, 54])
def test_events_before_the_timer_and_a_coarse_clock_are_fine(period_ms: float) -> None:
    told = whole(cyclic(50), quiet(), every(TPDO, 20, 30_000, period_ms, COUNTING))
    assert ids(told) == set()


@pytest.mark.triggers("sync.two_producers")
@pytest.mark.parametrize("first", ["alone", "both"])
def test_a_second_producer_joins_or_leaves(first: str) -> None:
    second = every(
        0x80, 10_004 if first == "alone" else 4, 30_000 if first == "alone" else 20_000, 20
    )
    told = whole(quiet(), second)
    (finding,) = found(told, "sync.two_producers")
    assert finding.severity == "error"
    assert "those that come every 20 ms there were" in finding.text
    assert "the first 3 ms beside one of them" in finding.text
    assert "sync.jitter" not in ids(told)


@pytest.mark.triggers("sync.two_producers")
@pytest.mark.parametrize("period_ms", [7, 30, 33.3, 50])
def test_a_second_producer_with_a_period_of_its_own(period_ms: float) -> None:
    told = whole(quiet(), every(0x80, 10_004.4, 16_000, period_ms))
    (finding,) = found(told, "sync.two_producers")
    assert finding.start_ns == pytest.approx(T0 + 10 * S, abs=S)
    assert finding.end_ns == pytest.approx(T0 + 16 * S, abs=S)
    assert "sync.jitter" not in ids(told)


@pytest.mark.near_miss("sync.two_producers")
@pytest.mark.parametrize("period_ms", [5, 10, 40])
def test_a_producer_that_is_set_to_another_period_is_one(period_ms: float) -> None:
    rows = [*every(0x80, 1, 10_000, 20), *every(0x80, 10_001, 20_000, period_ms)]
    told = whole(rows, beats(NODE, 7, 20_000), beats(9, 12, 20_000))
    assert "sync.two_producers" not in ids(told)


@pytest.mark.near_miss("sync.two_producers")
def test_a_producer_that_alternates_is_one() -> None:
    """A timer of 10 ms steps makes 15 ms of 10 and 20."""
    rows = [*every(0x80, 1, 30_000, 30), *every(0x80, 11, 30_000, 30)]
    told = whole(rows, beats(NODE, 7, 30_000), beats(9, 12, 30_000))
    assert "sync.two_producers" not in ids(told)


@pytest.mark.triggers("sync.two_producers")
def test_a_second_producer_beside_a_timer_that_alternates_a_little() -> None:
    """50.6 and 49.4 ms in turn, as one of 0.6 ms steps makes of 50."""
    rows = [*every(0x80, 1, 20_000, 100), *every(0x80, 51.6, 20_000, 100)]
    told = whole(rows, every(0x80, 5019, 9000, 50), beats(NODE, 7, 20_000), beats(9, 12, 20_000))
    (finding,) = found(told, "sync.two_producers")
    assert finding.start_ns == pytest.approx(T0 + 5 * S, abs=S)
    assert "sync.jitter" not in ids(told)


@pytest.mark.triggers("sync.jitter")
@pytest.mark.parametrize("joins_ms", [5000, 15_800, 23_200])
def test_jitter_is_told_of_a_bus_that_had_two_producers(joins_ms: int) -> None:
    wavering = [
        (row[0] + (k % 7) * 2 * MS, *row[1:])
        for k, row in enumerate(every(0x80, 20_001, 23_000, 20))
    ]
    rows = [*every(0x80, 1, 20_000, 20), *every(0x80, 23_001, 30_000, 20), *wavering]
    second = every(0x80, joins_ms + 4, joins_ms + 4000, 20)
    told = whole(rows, second, beats(NODE, 7, 30_000), beats(9, 12, 30_000))
    assert {"sync.two_producers", "sync.jitter"} <= ids(told)
    (finding,) = found(told, "sync.jitter")
    assert finding.start_ns == pytest.approx(T0 + 20 * S, abs=S)
    assert finding.end_ns == pytest.approx(T0 + 23 * S, abs=S)


@pytest.mark.near_miss("sync.jitter")
@pytest.mark.parametrize("period_ms", [10, 13, 28, 40])
def test_another_period_is_no_jitter(period_ms: float) -> None:
    rows = [*every(0x80, 1, 10_000, 20), *every(0x80, 10_001, 20_000, period_ms)]
    told = whole(rows, beats(NODE, 7, 20_000), beats(9, 12, 20_000))
    assert "sync.jitter" not in ids(told)


@pytest.mark.triggers("sync.period")
def test_sync_with_another_period_than_it_was_set_to() -> None:
    setup = [*setting(0x1006, 0, 25_000, 4), *setting(0x1005, 0, 0x4000_0080, 4, 2.1)]
    (finding,) = found(whole(setup, quiet()), "sync.period")
    assert finding.node == NODE
    assert "every 25 ms (1006h), but SYNC 080h comes every 20 ms" in finding.text


@pytest.mark.near_miss("sync.period")
@pytest.mark.parametrize("told", [0x4000_0080, 0x80])
def test_the_period_of_a_producer_or_of_a_consumer_that_fits(told: int) -> None:
    period = 20_100 if told > 0x80 else 25_000
    setup = [*setting(0x1006, 0, period, 4), *setting(0x1005, 0, told, 4, 2.1)]
    assert "sync.period" not in ids(whole(setup, quiet()))


@pytest.mark.near_miss("sync.jitter", "sync.missing")
def test_sync_out_for_300_ms_with_others_alive_and_a_quiet_line() -> None:
    """peers.md 4.1 item 5, and the same line whole."""
    rows = every(TPDO, 2, 30_000, 20, COUNTING)
    assert ids(whole(synchronous(), quiet(), rows)) == set()
    out = [
        row
        for row in [*quiet(), *rows]
        if row[2] not in (0x80, TPDO) or not 0 <= row[0] - 12 * S < 300 * MS
    ]
    told = whole(synchronous(), out)
    assert ids(told) == {"sync.missing"}
    assert "stayed away for 320 ms" in told.findings[0].text


def started_late(first_ms: float) -> list[Row]:
    """A reset at 12 s and a start at 14 s, from which on TPDO1 comes so late."""
    told = [
        (t, bus, can_id, flags, dlc, b"\x7f" if can_id == 0x705 and t < 14_000 * MS else data)
        for t, bus, can_id, flags, dlc, data in quiet()
        if not (can_id == 0x705 and t < 12_500 * MS)
    ]
    reset = [(12_000 * MS, 0, 0, 0, 2, b"\x81\x05"), (12_400 * MS, 0, 0x705, 0, 1, b"\0")]
    start = [(14_000 * MS, 0, 0, 0, 2, b"\1\5")]
    saved = [*cyclic(20), *write(8, NODE, 0x1010, 1, 0x65766173)]
    before = [row for row in quiet() if row[2] == 0x705 and row[0] < 12_000 * MS]
    pdos = [*every(TPDO, 13, 12_000, 20, COUNTING), *every(TPDO, first_ms, 30_000, 20, COUNTING)]
    return [*told, *before, *reset, *start, *saved, *pdos]


@pytest.mark.near_miss("pdo.missed")
def test_a_node_has_time_for_its_first_pdo_after_a_start() -> None:
    """Its event timer begins anew: what came before the reset makes nothing due."""
    assert found(whole(started_late(14_100)), "pdo.missed") == []


@pytest.mark.triggers("pdo.missed")
def test_pdos_that_stay_away_after_a_start_are_proven_by_the_start() -> None:
    told = whole(started_late(17_000))
    (finding,) = found(told, "pdo.missed")
    (start,) = (row for row in told.nmt_commands if row.command.startswith("start"))
    assert finding.evidence[0] == start.seq
    assert finding.start_ns >= T0 + 14_500 * MS
